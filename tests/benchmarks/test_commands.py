"""The commands of the benchmarks: what the Makefile and pages name is there and tells its options."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

import benchmarks
from mjframes.cli.commands import exit_code

ROOT = Path(__file__).parents[2]
COMMANDS = re.findall(r"^python -m ([\w.]+)", benchmarks.__doc__ or "", re.MULTILINE)
NEEDS_DM_CONTROL = ("benchmarks.speed.tasks", "benchmarks.speed.lift_flex")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.dm_control if name in NEEDS_DM_CONTROL else ()) for name in COMMANDS],
)
def test_a_command_tells_its_options_and_its_mistakes(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module = importlib.import_module(name)
    if hasattr(module, "__path__"):
        module = importlib.import_module(f"{name}.__main__")
    with pytest.raises(SystemExit) as end:
        module.main(["--help"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: python -m {name} ")
    assert exit_code(lambda: module.main(["--nonsense"])) == 2
    assert f"see python -m {name} --help.\n" in capsys.readouterr().err


def test_pages_name_commands_that_are_there() -> None:
    pages = [ROOT / "Makefile", *(ROOT / "benchmarks").rglob("*.py"), *ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    named = {
        name for page in pages for name in re.findall(r"-m (benchmarks[\w.]*\w)", page.read_text(encoding="utf-8"))
    }
    assert named == set(COMMANDS)
