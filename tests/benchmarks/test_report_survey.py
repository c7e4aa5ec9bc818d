"""What the report says of bodies nobody tuned: its finite elements, its loads, and the errors of the defaults."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy import survey
from benchmarks.accuracy.survey import Judged, Verdict, judge
from benchmarks.accuracy.survey_page import survey_page
from benchmarks.contenders.frames import timed_build
from benchmarks.solids.bodies import Body, all_bodies, beam, free_core, sandwich
from benchmarks.solids.bricks import bricks, linear_stiffness, nodal_load
from benchmarks.solids.exact import exact_solution
from benchmarks.solids.incompatible import consistent_mass, incompatible_stiffness
from mjframes.base.choices import PAPER, WHOLE_BODY
from mjframes.volume.grid import voxel_grid
from mjframes.volume.volume import Volume, require_connected


@pytest.fixture(scope="module")
def layers() -> Verdict:
    body = sandwich()
    return judge(body, exact_solution(body), True, lambda stage: None)


def test_every_body_is_one_piece_and_its_loads_are_what_they_are_called() -> None:
    for body in all_bodies(quick=False):
        require_connected(body.volume)
        loads = {load.name: load for load in body.loads()}
        assert all(np.abs(load.force).max() > 0 for load in loads.values())
        if body.fixed is None:  # in balance
            assert all(
                np.abs(load.force.sum(axis=0)).max() < 1e-9 * np.abs(load.force).max() for load in loads.values()
            )
            continue
        assert body.held.any()
        down = loads["weight along z"].force
        mass = np.sum(body.grid.density) * body.grid.cell_volume
        np.testing.assert_allclose(down.sum(axis=0), [0, 0, mass], rtol=1e-12, atol=1e-12)


def test_pushes_cover_their_share_of_the_surface_and_point_inwards() -> None:
    body = beam(0.3)
    surface = len(body.grid.outermost) - np.count_nonzero(body.held[body.grid.outermost])
    middle = body.grid.centers.mean(axis=0)
    for load in body.loads():
        if load.kind.startswith("push"):
            pushed = load.force.any(axis=1)
            share = float(load.kind.removeprefix("push ").removesuffix("%")) / 100
            assert pushed.sum() == pytest.approx(share * surface, abs=1)
            toward = middle - body.grid.centers[pushed].mean(axis=0)
            assert load.force.sum(axis=0) @ toward > 0


def test_incompatible_bricks_keep_uniform_strain_and_bend_one_voxel_thick() -> None:
    """A strip, one brick thick, under a moment: M L² / 2 E I at the end, where bricks of order 1 lock."""
    length, thick, young = 20, 1, 1e6
    material = beam(0.0).volume.materials[1]
    grid = voxel_grid(Volume.from_labels(np.ones((length, 1, thick), np.uint8), 0.01, {1: material}))
    mesh = bricks(grid, np.zeros(length, bool), 1, 1)
    matrix = incompatible_stiffness(mesh)
    strain = np.diag([0.1, -0.2, 0.3])
    moved = (mesh.nodes @ strain).ravel()
    energy = length * grid.cell_volume * 2 * grid.mu[0] * np.sum(strain**2)
    assert moved @ matrix @ moved == pytest.approx(energy, rel=1e-12)
    x, _, z = mesh.nodes.T
    force = np.zeros_like(mesh.nodes)
    force[x == x.max(), 0] = np.where(z[x == x.max()] > 0, 1.0, -1.0) / 2
    free = np.repeat(x > 0, 3)
    bent = np.zeros(mesh.nodes.size)
    bent[free] = np.linalg.solve(matrix[free][:, free].toarray(), force.ravel()[free])
    exactly = 0.01 * 0.2**2 / (2 * young * 0.01 * 0.01**3 / 12)
    assert np.abs(bent.reshape(-1, 3)[x == x.max(), 2]).mean() == pytest.approx(exactly, rel=0.01)
    locked = np.linalg.solve(linear_stiffness(mesh)[free][:, free].toarray(), force.ravel()[free])
    assert np.abs(locked).max() < 0.7 * np.abs(bent).max()


def test_the_consistent_mass_is_all_of_it() -> None:
    body = beam(0.3)
    mesh = bricks(body.grid, body.held, 1, 1)
    mass = consistent_mass(mesh, body.grid.density)
    along = np.tile([1.0, 0.0, 0.0], len(mesh.nodes))
    assert along @ mass @ along == pytest.approx(np.sum(body.grid.density) * body.grid.cell_volume, rel=1e-12)


@pytest.mark.slow
def test_finite_elements_bend_and_swing_a_beam_as_euler_and_bernoulli_say() -> None:
    body = beam(0.3)
    known = exact_solution(body)
    length, thick = 0.35, 0.06
    stiffness, by_length = 1e6 * thick**4 / 12, 1000 * thick**2
    assert known.frequencies[0] == pytest.approx(
        1.8751**2 / (2 * np.pi) * np.sqrt(stiffness / by_length / length**4), rel=0.03
    )
    number = [load.name for load in body.loads()].index("weight along z")
    end = body.grid.index[:, 0] == 35
    weight = known.loads[number, ~body.held].sum(axis=0)[2]
    bent = known.moved[number, end, 2].mean()
    assert bent == pytest.approx(weight * length**3 / (8 * stiffness), rel=0.06)
    assert known.mesh.max() < 0.01
    assert np.abs(known.moved).max() == pytest.approx(1e-3 * body.grid.length, rel=1e-6)


@pytest.mark.slow
def test_a_free_body_is_solved_without_its_rigid_motions() -> None:
    body = free_core()
    mesh = bricks(body.grid, body.held, 1, 1)
    known = exact_solution(body)
    for field in known.moved:
        assert np.abs(body.motions.T @ field.ravel()).max() < 1e-9 * np.linalg.norm(field)
    assert nodal_load(mesh, known.loads[0]).sum(axis=0) == pytest.approx(0, abs=1e-9 * np.abs(known.loads[0]).max())
    assert 1 < known.frequencies[0] < 20


@pytest.mark.slow
def test_a_free_body_comes_to_rest_under_loads_that_would_turn_it_over() -> None:
    body = free_core()
    found = judge(body, exact_solution(body), True, lambda stage: None)
    assert not found.refused
    few, more = found.of(WHOLE_BODY)
    assert 0.1 < more.static < few.static < 0.7  # turned over: 1000
    assert more.push("20%") < 0.5


@pytest.mark.slow
def test_the_defaults_follow_a_sandwich_and_the_papers_method_does_not(layers: Verdict) -> None:
    defaults, papers = (next(row for row in layers.of(m) if row.frames == 5) for m in (WHOLE_BODY, PAPER))
    assert defaults.push("5%") < 0.05
    assert defaults.static < 0.3
    assert abs(defaults.frequency) < 0.10
    assert papers.static > 0.9
    assert layers.promised == (defaults.static, "pull", False)
    assert not layers.refused


@pytest.mark.slow
def test_a_row_has_all_that_was_measured(layers: Verdict) -> None:
    for row in layers.rows:
        assert row.dofs == 12 * row.frames
        assert set(row.errors) == {"weight", "end", "push 1%", "push 5%", "push 20%"}
        assert row.step_seconds > 0
        assert row.build_seconds > 0
        assert np.isnan(row.estimate[0]) == (row.method == PAPER)


def judged(frames: int, error: float, method: str = WHOLE_BODY) -> Judged:
    kinds = ("weight", "end", "push 1%", "push 5%", "push 20%")
    return Judged(
        "", method, frames, 12 * frames, dict.fromkeys(kinds, error), "pull", error, 0.0, (error, error), 1e-4, 1.0
    )


@pytest.mark.slow
def test_the_page_tells_what_does_not_hold(layers: Verdict) -> None:
    rows = [judged(3, 0.05), judged(5, 0.12), judged(3, 0.9, PAPER), judged(5, 0.8, PAPER)]
    bad = Verdict(layers.body, layers.exact, rows, [(PAPER, 20, "too many")])
    assert bad.growth == pytest.approx(2.4)
    assert bad.promised == (0.12, "pull", False)
    page = "\n".join(survey_page([bad]))
    assert "| 5.0 / 12.0 | 90.0 / 80.0 |" in page
    assert "12.0 %, pull: **does not hold**" in page
    assert "2.40 **more**" in page
    assert "- left out: sandwich 1:100, paper, 20 frames: too many" in page


@pytest.mark.slow
def test_what_does_not_build_is_left_out_with_its_reason(monkeypatch: pytest.MonkeyPatch, layers: Verdict) -> None:
    monkeypatch.setattr(survey, "FRAMES", (10**6,))
    found = judge(layers.body, layers.exact, False, lambda stage: None)
    assert found.rows == []
    assert [entry[:2] for entry in found.refused] == [(WHOLE_BODY, 10**6), (PAPER, 10**6)]
    assert found.promised is None


def test_builds_are_timed_with_nothing_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    import os

    seen = []
    body: Body = beam(0.3)
    monkeypatch.setenv("MJFRAMES_CACHE", "1")
    _, seconds = timed_build(body.volume, 2, progress=lambda stage: seen.append(os.environ["MJFRAMES_CACHE"]))
    assert set(seen) == {"0"}
    assert os.environ["MJFRAMES_CACHE"] == "1"
    assert seconds > 0
