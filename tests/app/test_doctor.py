"""What the doctor prints of what is there, what is missing and what fails."""

from __future__ import annotations

import importlib.util
import re
import sys
import tomllib
from pathlib import Path

import pytest

from mjframes.app import doctor
from mjframes.app.view.page import page
from mjframes.base.errors import MjframesError
from mjframes.scene import plugin


def test_the_doctor_finds_everything_needed(capsys: pytest.CaptureFixture[str]) -> None:
    status = doctor.main()
    printed = capsys.readouterr().out
    assert status == 0, printed
    assert str(plugin.library_path()) in printed
    assert f"made {doctor.STEPS} steps" in printed
    assert "Newton, dense, up to 300 degrees of freedom" in printed


def test_the_doctor_reports_a_failure_as_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(plugin.LIBRARY_VARIABLE, "missing.so")
    assert doctor.main() == 2
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("FAILS")]
    assert "missing.so" in line


def test_what_is_missing_is_never_called_ok(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CXX", "missing-compiler")
    monkeypatch.setattr(doctor, "working_backend", lambda: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert doctor.main() == 0
    lines = {line[15:].split()[0]: line for line in capsys.readouterr().out.splitlines()}
    assert lines["mujoco"].startswith("ok  ")
    assert lines["compiler"].startswith("not installed  ")
    assert lines["drawing"].startswith("not working    ")
    for module, (use, extra) in doctor.OPTIONAL.items():
        assert lines[module].startswith("not installed  ")
        assert lines[module].endswith(f'for {use}: pip install "mjframes[{extra}]"')


@pytest.mark.parametrize("fault", ["import missing_part_of_it", "raise AttributeError('viser has no paint')", "1 / 0"])
def test_what_is_found_and_does_not_work_is_never_called_ok(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "viser").mkdir()
    (tmp_path / "viser/__init__.py").write_text(fault)
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "viser"]:
        monkeypatch.delitem(sys.modules, name)
    words = r"needs viser, which does not work \(.+\); install it anew\.$"
    (found,) = [finding for finding in doctor.report() if finding.name == "viser"]
    assert found.status == doctor.UNUSABLE
    assert re.search(words, found.text)
    with pytest.raises(MjframesError, match=words), page({}):
        pass


def test_the_doctor_knows_the_packages_of_all_extras() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    modules = {"pynrrd": "nrrd", "libigl": "igl", "foxglove-sdk": "foxglove", "dm-control": "dm_control"}
    needed = set()
    for extra, packages in project["optional-dependencies"].items():
        if extra in ("all", "identify", "test", "lint", "dev", "docs", "wheels"):  # an example's, and a developer's
            continue
        names = {re.split(r"[<>=\[]", package)[0] for package in packages} - {"mjframes", "mujoco"}
        needed |= {(modules.get(name, name), extra) for name in names}
    assert {(module, extra) for module, (_, extra) in doctor.OPTIONAL.items()} == needed
