"""That the report measures what it says; never how long anything takes."""

from __future__ import annotations

import csv
import os
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share

from benchmarks.accuracy import report, table2
from benchmarks.accuracy.measures import Row, front, race, slopes
from benchmarks.accuracy.vibration import exact_vibration, vibrations
from benchmarks.contenders.flex import FlexProcess, FlexSetting, flex_settings
from benchmarks.contenders.frames import Setting, settings, solved
from benchmarks.solids import bodies, cases, models
from benchmarks.solids.bricks import at_centers, bricks
from benchmarks.solids.cases import Case, all_cases, bar
from benchmarks.solids.reference import Reference, linear_solution, references, refined
from mjframes.base.choices import PAPER
from mjframes.base.errors import MjframesError
from mjframes.cli.commands import exit_code

pytest.importorskip("pyamg")
MUJOCO4 = sys.executable if mujoco.__version__ >= "4" else os.environ.get("MJFRAMES_MUJOCO4")
needs_flex = pytest.mark.skipif(not MUJOCO4, reason="MJFRAMES_MUJOCO4 names no Python that has MuJoCo 4")


@pytest.fixture(scope="module")
def cantilever() -> Case:
    return bar("cantilever", "cantilever", "weight", across=6)


@pytest.fixture(scope="module")
def known(cantilever: Case) -> Reference:
    return refined(cantilever)


def distance(moved: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(moved - exact) / np.linalg.norm(exact))


def row(kind: str, error: float, step: float, **more) -> Row:
    """A row of which only these count."""
    rest = {"name": "", "family": kind, "frames": 1, "dofs": 1, "goal_error": 0.0, "steps": 1, "timestep": 1.0}
    rest |= {"case": "", "rest_seconds": step, "build_seconds": 0.0, "edited": False}
    return Row(kind=kind, error=error, step_seconds=step, **(rest | more))


@pytest.mark.slow
def test_the_reference_is_converged_and_has_the_wanted_size(cantilever, known):
    assert known.levels[0][:2] == (1, 1)
    assert len(known.levels) >= 3
    assert known.change[0] > known.change[1] > known.change[-1] == 0
    assert known.change[1] < 0.01
    assert np.isclose(np.abs(known.moved).max() / cantilever.grid.length, 1e-3, rtol=0.05)
    # Euler and Bernoulli's deflection of the end is w L³ / 8 E I; shear adds some, the last voxels' centres lose some
    weight, inertia = -known.load[~cantilever.held].sum(axis=0)[2], 0.1**4 / 12
    assert 0.95 < known.quantity[-1] / (weight * 0.4**3 / (8 * 1e6 * inertia)) < 1.1


@pytest.mark.slow
def test_frames_come_to_rest_where_finite_elements_do(cantilever, known):
    placed, by_hand, papers = (
        distance(solved(cantilever, setting, known.load).moved, known.moved)
        for setting in (Setting(5), Setting(5, by_hand=True), Setting(5, method=PAPER))
    )
    assert placed < 0.04
    assert by_hand < 0.055  # 4.9 %: short regions only imply what far frames have together
    assert papers > 0.25


@pytest.mark.slow
def test_a_contender_is_measured_without_being_moved(cantilever, known):
    one = solved(cantilever, Setting(2), known.load)
    before = one.simulation.field()
    np.testing.assert_allclose(before, one.moved, rtol=0, atol=1e-9 * np.abs(before).max())
    assert one.seconds_per_step(0.002, 1e-4) > 0
    assert one.seconds_to_rest() > 0
    np.testing.assert_allclose(one.simulation.field(), before, rtol=0, atol=1e-9 * np.abs(before).max())
    assert one.dofs == 24
    assert one.steps <= 2


@pytest.mark.slow
def test_forces_on_points_of_turning_frames_have_their_torque(known, cantilever):
    """Eight rigid frames bend; without the torques of their points they would not."""
    one = solved(cantilever, Setting(8, "rigid"), known.load)
    assert distance(one.moved, known.moved) < 0.25


def test_every_case_is_held_loaded_and_within_reach():
    for case in all_cases(quick=False):
        n = len(case.grid.index)
        assert case.load.shape == case.goal.shape == (n, 3)
        assert 0 < case.held.sum() < n
        assert np.abs(case.load[~case.held]).max() > 0
        assert len(case.frames) >= 3
        assert all(len(case.places(f)) == f for f in case.frames if case.places)
        assert case.heterogeneous == (len(np.unique(case.grid.young)) > 1)
        assert any(setting.by_hand for setting in settings(case, quick=False)) == case.straight


def test_flex_cells_fill_thin_bodies_with_one_layer():
    (sheet,) = (case for case in all_cases(quick=False) if case.name == "sheet")
    found = flex_settings(sheet, quick=False)
    assert {setting.cells[2] for setting in found} == {1}
    assert max(setting.cells[0] for setting in found) >= 20


@needs_flex
@pytest.mark.parametrize("stiffer", [1.0, 100.0])
def test_flex_of_one_cell_a_voxel_is_finite_elements(stiffer):
    case = bar("core", "core", "weight", across=4, core=stiffer)
    mesh = bricks(case.grid, case.held, 1, 1)
    load = 1e-7 * case.load  # small: flex turns with the material
    exact = at_centers(mesh, linear_solution(mesh, mesh, load))
    assert MUJOCO4
    with FlexProcess(MUJOCO4) as flex:
        one = flex.solved(case, FlexSetting("trilinear", (16, 4, 4)), load)
        assert one.edited == (stiffer != 1)
        assert distance(one.moved, exact) < 1e-3
        assert one.dofs == 3 * 16 * 25
        tetrahedra = flex.solved(case, FlexSetting("full", (16, 4, 4)), load)
        assert 0.05 < distance(tetrahedra.moved, exact) < 0.5  # they lock
        assert tetrahedra.seconds_per_step(0.002, 1e-4) > 0
        assert tetrahedra.seconds_to_rest() > 0


@needs_flex
def test_what_flex_refuses_is_an_error_and_it_goes_on(cantilever, known):
    assert MUJOCO4
    with FlexProcess(MUJOCO4) as flex:
        with pytest.raises(MjframesError, match="flex"):
            flex.ask({"do": "nothing"})
        assert flex.solved(cantilever, FlexSetting("quadratic", (2, 1, 1)), known.load).dofs == 108


@needs_flex
@pytest.mark.parametrize("dof", ["full", "trilinear", "quadratic"])
def test_a_flex_is_put_among_the_things_of_a_scene(cantilever, tmp_path, dof):
    assert MUJOCO4
    scene = tmp_path / "scene.xml"
    scene.write_text("""<mujoco><worldbody><body pos="0 0 3"><joint name="hinge" axis="0 1 0"/><geom size=".1"/></body>
        </worldbody><actuator><motor joint="hinge"/></actuator></mujoco>""")
    free = replace(cantilever, fixed=np.zeros_like(cantilever.fixed))
    turn, position, controls = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([0, 0, 1.0]), np.ones((5, 1))
    with FlexProcess(MUJOCO4) as flex:
        placed = flex.placed(free, FlexSetting(dof, (4, 1, 1)), scene, '<contact selfcollide="none"/>', 0.005)
        seconds, warned = placed.act({"hinge": 0.3}, turn, position, controls, 20)
        assert seconds > 0
        assert warned == {}
        assert placed.dofs == 1 + 3 * (5 * 4 if dof != "quadratic" else 9 * 9)
        with pytest.raises(MjframesError, match=r"flex.*elbow"):
            placed.act({"elbow": 0.3}, turn, position, controls, 20)


def test_a_python_without_flex_is_refused(tmp_path):
    with pytest.raises(MjframesError, match="cannot run MuJoCo's flex"):
        FlexProcess(str(tmp_path / "python"))
    if mujoco.__version__ < "4":
        with pytest.raises(MjframesError, match=r"from 4\.0\.0 on"):
            FlexProcess(sys.executable)


@needs_flex
def test_its_python_may_be_named_from_the_folder_that_one_is_in(monkeypatch):
    assert MUJOCO4
    monkeypatch.chdir(os.path.dirname(MUJOCO4))
    with FlexProcess(os.path.join(".", os.path.basename(MUJOCO4))) as flex:
        assert flex.version >= "4"


def test_a_race_is_run_at_the_same_error():
    rows = [
        row("mjframes", 0.04, 1.0),
        row("mjframes", 0.03, 2.0),
        row("mjframes", 0.3, 0.1),
        row("flex", 0.045, 6.0),
        row("flex", 0.035, 8.0),
        row("flex", 0.02, 30.0),
    ]
    found = race("", rows)
    assert found.bound == 0.05
    assert (found.mine, found.theirs) == (rows[1], rows[5])
    assert found.lead == 15
    assert found.lead_within_bound == 6
    assert race("", [*rows, row("mjframes", 0.01, 0.1, family="affine, by hand")]) == found
    assert race("", rows[:3]).lead == np.inf
    assert race("", rows[3:]).lead == 0
    assert front(rows, lambda r: r.step_seconds) == [rows[2], rows[0], rows[1], rows[5]]


def test_slopes_are_those_of_power_laws_and_stalls_are_named():
    sizes, errors = (10, 20, 40), (0.4, 0.1, 0.025)
    good = [row("mjframes", e, 1.0, dofs=n, frames=n) for n, e in zip(sizes, errors, strict=True)]
    bad = [replace(r, family="bad", error=e) for r, e in zip(good, (0.4, 0.3, 0.31), strict=True)]
    first, second = slopes("", good + bad)
    assert np.isclose(first.order, 2)
    assert not first.stalled
    assert second.stalled
    assert slopes("", good[:2]) == []


@pytest.mark.slow
def test_a_bar_let_go_swings_with_the_frequency_of_its_modes(cantilever, known):
    first, _, exact = exact_vibration(cantilever, known)
    timoshenko = 0.94 * 1.8751**2 / (2 * np.pi) * np.sqrt(1e6 * 0.1**4 / 12 / (1000 * 0.01 * 0.4**4))
    assert abs(first / timoshenko - 1) < 0.03
    assert np.isclose(exact[0], cantilever.quantity(known.moved), rtol=0.02)
    found = {one.name: one for one in vibrations(cantilever, known, None, True) if one.family == "affine"}
    assert abs(found["5 free frames"].error) < 0.02
    assert 0.5 < found["5 free frames"].left <= 1


@pytest.mark.slow
def test_references_of_several_processes_are_those_of_one():
    case = next(case for case in all_cases(quick=False) if case.name == "three")
    (found,) = references(["three"], lambda stage: None).values()
    exact = refined(case).moved
    np.testing.assert_allclose(found.moved, exact, rtol=0, atol=1e-10 * np.abs(exact).max())  # multigrid is random


@pytest.mark.slow
def test_the_command_writes_a_page_a_table_and_figures(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    small = [bar("cantilever", "cantilever", "weight", across=4, frames=(1, 2, 4))]
    monkeypatch.setattr(report, "all_cases", lambda quick: small)
    monkeypatch.setattr(report, "all_bodies", lambda quick: [bodies.beam(0.3)])
    monkeypatch.setattr(table2, "volume_of", lambda model, files: None)
    assert report.main(["--quick", "-o", str(tmp_path / "out")]) == 0
    assert "report.md" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert "flex: left out" in page
    assert "| cantilever | affine, by hand |" in page
    assert "| beam, ν = 0.3 | " in page
    assert ": holds |" in page
    figures = ("survey_time", "survey_dofs", "survey_build", "error_time", "error_dofs", "error_build")
    for figure in (*figures, "vibration"):
        drawn = "tab:purple" if figure == "vibration" else "tab:blue"  # affine frames are blue elsewhere
        assert share(picture(tmp_path / "out" / f"{figure}.png"), drawn) > 3e-4
        assert f"{figure}.png" in page
    with (tmp_path / "out" / "report.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {entry["frames"] for entry in rows} == {"1", "2", "4"}
    assert all(0 < float(entry["error"]) < 1 for entry in rows)


def test_mistakes_are_one_sentence(capsys):
    assert exit_code(lambda: report.main(["--model", "dragon"])) == 2
    assert "NAME=FILE" in capsys.readouterr().err
    with pytest.raises(MjframesError, match="model 'cat' is not in the table"):
        table2.measure({"cat": "cat.ply"}, True, lambda stage: None)


@pytest.mark.slow
def test_the_table_of_the_paper_is_measured_on_the_steak(monkeypatch):
    if not cases.STEAK.is_file():
        pytest.skip("models/steak.npz is in a checkout only")
    monkeypatch.setattr(table2, "PAPER", {("steak", 3, 10): table2.PAPER["steak", 3, 10]})
    monkeypatch.setattr(table2, "STEPS", 50)
    (line,) = table2.measure({}, True, lambda stage: None)
    assert (line.frames, line.samples) == (3, 10)
    assert 60_000 < line.voxels < 70_000
    assert line.steps > 0


def test_models_of_the_paper_have_stand_ins():
    ribbon = models.volume_of("ribbon", {})
    assert ribbon is not None
    assert np.count_nonzero(ribbon.labels) == pytest.approx(60_000, rel=0.05)
    assert np.count_nonzero(ribbon.largest_component().labels) == np.count_nonzero(ribbon.labels)
    assert models.volume_of("dragon", {}) is None
    with pytest.raises(MjframesError, match="needs a label image"):
        models.volume_of("steak", {"steak": "steak.stl"})


@pytest.mark.slow
@pytest.mark.dm_control
def test_the_rat_is_dm_controls_rodent(monkeypatch):
    pytest.importorskip("dm_control")
    monkeypatch.setitem(models.VOXELS, "rat", 5_000)
    rat = models.volume_of("rat", {})
    assert rat is not None
    assert np.count_nonzero(rat.labels) == pytest.approx(5_000, rel=0.1)
    assert rat.labels.shape[0] * rat.spacing[0] == pytest.approx(0.397, rel=0.05)  # [m] from nose to tail
