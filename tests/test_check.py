"""`mjframes check`: a reduced sweep of stiff and extreme cases, and what is told of it."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjframes import check
from mjframes.check.cases import DISTURBANCES, FREE, HEAVY, IMPACT, KINDS, LENGTH, Case, Kind, body
from mjframes.check.reasons import DEEP, OTHER, SLOW, STIFF, reason
from mjframes.check.report import failures, table
from mjframes.check.trial import Outcome, run, shape_error
from mjframes.cli import main

BY_NAME = {kind.name: kind for kind in KINDS}
COROTATIONAL = BY_NAME["corotational"]
HYPERELASTIC = [
    kind for kind in KINDS if kind.name in ("green-lagrange", "neo-hookean", "mooney-rivlin", "arruda-boyce")
]


def outcomes(kinds: Sequence[str], young: Sequence[float], steps: Sequence[float], how: Sequence[str]) -> list[Outcome]:
    return [run(Case(BY_NAME[kind], e, h, what)) for kind in kinds for e in young for h in steps for what in how]


# mixed frames at 1e12 Pa, while relaxation left K_e forces on translations of 4e-11 of itself: every start blew up
@pytest.mark.parametrize("young", [1.0, 1e6, 1e12])
@pytest.mark.parametrize("kind", ["corotational", "mixed frames"])
def test_from_any_shape_a_corotational_body_returns_without_a_gain(kind: str, young: float) -> None:
    for some in outcomes([kind], [young], [2e-3, 1 / 30], FREE):
        assert some.recovers, some
        assert some.gain < (1.001 if young > 1 else 1.02), some


@pytest.mark.parametrize("kind", HYPERELASTIC, ids=lambda kind: kind.name)
def test_stiff_hyperelastic_bodies_do_not_overshoot(kind: Kind) -> None:
    # before steps had a longest reach: 3.7e9 and reset, 161, 431, 53
    for some in outcomes([kind.name], [1e6, 1e12], [1e-3, 1 / 30], ("inside out", "stretched 10×", "flattened")):
        assert some.recovers, some
        assert some.gain < 1.001, some


def test_a_stiffness_of_one_to_a_billion_in_one_body() -> None:
    for some in outcomes(["stiffness 1 : 10⁹"], [1.0, 1e3], [2e-3, 1 / 30], FREE):
        assert some.recovers, some
        assert some.gain < 1.001, some


def test_point_frames_on_a_line_return_from_any_shape() -> None:
    # while A Z counted as regular down to 1e-12, turns about the line were made of rounding: 1e12 and reset
    for some in outcomes(["point frames"], [1e3, 1e9], [2e-3, 1 / 30], ("scrambled", "stretched 10×", "flattened")):
        assert some.recovers, some
        assert some.gain < 1.001, some


def test_impacts_and_weights_give_no_motion() -> None:
    for some in outcomes(["corotational", "neo-hookean"], [1e6, 1e12], [2e-3, 1 / 30], (IMPACT, HEAVY)):
        assert some.recovers, some
        assert some.motion < 1.02, some
    soft = outcomes(["corotational"], [1e3], [1e-4], (IMPACT,))[0]
    assert soft.recovers
    assert soft.gain < 1.001


def test_shape_error() -> None:
    made = body(COROTATIONAL, 1e6)
    turned = made.control.rest @ Rotation.from_rotvec([1, 2, 3]).as_matrix().T + [3, 2, 1]
    assert shape_error(made, turned) < 1e-12
    assert shape_error(made, turned * [1, 1, -1]) > 0.1
    stretched = made.control.rest * [1.1, 1, 1]
    assert shape_error(made, stretched) == pytest.approx(0.05 * np.ptp(made.skin.vertices[:, 0]) / LENGTH, rel=1e-3)


def test_reasons() -> None:
    case = Case(COROTATIONAL, 1e6, 2e-3, IMPACT)
    lost = Outcome(case, False, np.inf, np.inf, np.inf, False, "BADQACC")
    assert reason(lost) == DEEP
    assert reason(replace(lost, case=replace(case, young=1e12, timestep=1 / 30, disturbance=HEAVY))) == STIFF
    stays = Outcome(case, True, 1, 1, 0.5, True, "")
    assert (reason(stays), reason(replace(stays, balanced=False))) == (OTHER, SLOW)
    assert failures([stays, replace(stays, error=0.0)]) == [f"1 run: {OTHER} (corotational: {IMPACT}, 1e+06 Pa, 2 ms)"]


def test_every_case_has_a_state_of_its_own() -> None:
    cases = check.all_cases()
    assert len({tuple(case.seed) for case in cases}) == len(cases)
    assert {case.disturbance for case in cases} == set(DISTURBANCES)
    assert max(case.stiffest for case in cases) <= 1e12
    assert set(check.few_cases()) <= set(cases)


def test_command_prints_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    cases = [Case(COROTATIONAL, 1e6, 1 / 30, "scrambled"), Case(BY_NAME["neo-hookean"], 1e12, 1 / 30, "stretched 10×")]
    monkeypatch.setattr(check, "few_cases", lambda: cases)
    assert main(["check", "--quick", "--out", str(tmp_path / "new")]) == 0
    printed, said = capfd.readouterr()
    assert "2 runs: 2 survive, 2 recover their shape of rest." in printed
    assert said == ""
    with (tmp_path / "new" / "stability.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["body"], row["recovers"]) for row in rows] == [("corotational", "1"), ("neo-hookean", "1")]
    assert "| corotational | 1 | 1 | 1 | 1 | – |" in (tmp_path / "new" / "stability.md").read_text(encoding="utf-8")
    assert (tmp_path / "new" / "stability.png").read_bytes().startswith(b"\x89PNG")


def test_table_has_a_line_for_each_body() -> None:
    some = Outcome(Case(COROTATIONAL, 1e6, 2e-3, IMPACT), True, 1, 1, 0, True, "")
    other = replace(some, case=replace(some.case, kind=HYPERELASTIC[0]))
    assert table([some, some, other]).row_count == 2
