"""What the doctor prints of what is there, what is missing and what fails."""

from __future__ import annotations

import importlib.util

import pytest

from mjframes.app import doctor
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
