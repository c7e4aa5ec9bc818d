"""The arguments of `build` are declared once: the signature, the command line and the documents have just those."""

from __future__ import annotations

import argparse
import inspect
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from builders.shapes import mixed

import mjframes as mf
from docs import tables
from mjframes.base.errors import MjframesError
from mjframes.base.options import options_of
from mjframes.body.options import BuildOptions, Paper
from mjframes.cli.build_arguments import add_build, given


def test_the_signature_and_the_help_of_build_have_every_field() -> None:
    names = [field.name for field in fields(BuildOptions)]
    assert (
        list(inspect.signature(mf.build).parameters) == names == [field.name for field, _ in options_of(BuildOptions)]
    )
    for name in names:
        assert f"\n{name}\n    " in str(mf.build.__doc__)


def parsed(*words: str) -> dict[str, Any]:
    parser = argparse.ArgumentParser()
    add_build(parser)
    return given(parser.parse_args(["volume.npz", "-o", "body.npz", *words]))


def test_the_command_line_has_the_same_defaults() -> None:
    found = parsed()
    defaults = {field.name: field.default for field, _ in options_of(BuildOptions)}
    assert found == {name: defaults[name] for name in found}
    assert defaults.keys() - found.keys() == {"volume", "at", "supports", "progress"}  # no text can say those


@pytest.mark.parametrize("name", sorted(parsed()))
def test_each_option_of_the_command_line_arrives(name: str) -> None:
    field, said = next((field, said) for field, said in options_of(BuildOptions) if field.name == name)
    text = {"E": "0.1", "N": "700", "ALPHA,BETA": "1,0.002", "LENGTH": "3mm"}.get(str(said.metavar)) or said.choices[-1]
    found = parsed(f"--{name.replace('_', '-')}", text)[name]
    assert found == (said.reads(text) if said.reads else text)
    assert found != field.default


def test_choices_have_options_of_their_own() -> None:
    assert parsed("--method", "paper", "--samples", "4")["method"] == Paper(4)
    assert parsed("--subdivisions", "3")["weights"] == mf.Voronoi(3)
    assert parsed("--metric", "compliance", "--contact-reach", "2mm")["contact_reach"] == 0.002
    with pytest.raises(MjframesError, match=r"^--samples is given, but only --method paper has any; leave it out"):
        parsed("--samples", "4")
    with pytest.raises(MjframesError, match=r"^--subdivisions is given, but only --weights voronoi has any"):
        parsed("--weights", "harmonic", "--subdivisions", "3")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"metric": "far"}, r"^metric is 'far'; it must be one of None, 'even', 'compliance'\."),
        ({"mass": ["lumped"]}, r"^mass is \['lumped'\]; it must be one of None, 'lumped', 'consistent'\."),
        ({"mode": None}, r"^mode is None; it must be one of 'implicit', 'explicit'\."),
        ({"law": "hooke"}, r"^law is 'hooke'; it must be one of 'corotational', 'green_lagrange',"),
        ({"frames": 2, "error": 0.1}, "^more than one of frames, at and error is given"),
        ({"frames": "3"}, "^frames is '3', a str; it must be a whole number"),
        ({"frames": True}, "^frames is True, a bool; it must be a whole number"),
        ({"frames": 2.5}, r"^frames is 2\.5, a float; it must be a whole number"),
        ({"skin_vertices": 99}, r"^skin_vertices is 99; it must be a whole number from 100 on\."),
        ({"skin_vertices": 1e3}, r"^skin_vertices is 1000\.0; it must be a whole number"),
        ({"frame_type": []}, r"^frame_type is \[\]; give one type, or a sequence with one for each frame\."),
        ({"frame_type": 3}, r"^frame_type is 3; give one type, or a sequence"),
        ({"contact_reach": 1.0}, r"^contact_reach is 1\.0; it must be positive and at most 10 voxels"),
    ],
)
def test_a_wrong_option_is_named_before_anything_runs(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(MjframesError, match=message):
        BuildOptions(mixed(), **wrong)


@pytest.mark.parametrize(("page", "name"), list(tables.TABLES))
def test_pages_have_the_tables_of_the_code(page: str, name: str) -> None:
    now = (Path(tables.FOLDER) / page).read_text(encoding="utf-8")
    assert tables.written(page, name, tables.TABLES[page, name]()) == now, "run python docs/tables.py"


def test_arguments_that_build_does_not_take_are_told_in_a_sentence() -> None:
    call: Any = mf.build
    with pytest.raises(MjframesError, match=r"^build has no option wheights; did you mean weights\?$"):
        call(mixed(), wheights=3)
    with pytest.raises(MjframesError, match=r"^build has no option cells; it has volume, frames, error, at, .*\.$"):
        call(mixed(), cells=3)
    with pytest.raises(MjframesError, match=r"^build: missing a required argument: 'volume'; it takes volume, frames,"):
        call()
    with pytest.raises(MjframesError, match=r"^build: too many positional arguments; it takes volume, frames,"):
        call(mixed(), 3, 0.1)
