"""That the benchmark measures what it says; never how long anything takes."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from mjframes.benchmarks import bench
from mjframes.benchmarks.large import Job
from mjframes.benchmarks.profile import contact_share
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SIZE = bench.Size(2)
STEPS = 200


@pytest.fixture(scope="module")
def slab() -> Volume:
    rubber = Material(young=5e3, poisson=0.4, density=1000)
    return Volume.from_labels(np.ones((24, 18, 3), int), 0.01, {1: rubber})


@pytest.fixture(scope="module")
def runs(slab: Volume) -> dict[str, bench.Run]:
    bodies, _ = bench.measure_builds(slab, [SIZE], repeats=1)
    return {run.name: run for run in bench.prepare_runs(bodies[0], slab, SIZE, STEPS)}


def test_builds_are_timed_by_stage(slab: Volume) -> None:
    sizes = [SIZE, bench.Size(3), bench.Size(3, 4)]
    bodies, buildings = bench.measure_builds(slab, sizes, repeats=2)
    assert [building.size for building in buildings] == sizes
    assert [len(body.parent) for body in bodies] == [2, 3, 3]
    for building in buildings:
        assert ("solving the finite elements" in building.stages) == (building.size.samples is None)
        assert ("summing the stiffness" in building.stages) == (building.size.samples is not None)
        assert all(seconds > 0 for seconds in building.stages.values())
        assert building.total > max(building.stages.values())


def test_the_floor_is_the_same_bodies_without_the_plugin(runs: dict[str, bench.Run]) -> None:
    soft = runs[bench.SOFT].model
    for name in (bench.SPHERES, bench.BODIES):
        model = runs[name].model
        assert model.nplugin == 0
        np.testing.assert_array_equal(model.body_mass, soft.body_mass)
        np.testing.assert_array_equal(model.M_rownnz, soft.M_rownnz)
        assert model.opt.timestep == soft.opt.timestep == bench.TIMESTEP
        assert model.opt.jacobian == soft.opt.jacobian


def test_the_soft_body_touches_and_its_floor_as_often(runs: dict[str, bench.Run]) -> None:
    soft = runs[bench.SOFT]
    contacts, _ = soft.contacts(STEPS)
    assert contacts > 4
    touched = {soft.model.geom(geom).name for contact in soft.data.contact for geom in contact.geom}
    assert {"box", "floor"} <= touched
    assert runs[bench.SPHERES].contacts(STEPS)[0] == pytest.approx(contacts, abs=0.5)
    assert runs[bench.AIR].contacts(STEPS)[0] == runs[bench.BODIES].contacts(STEPS)[0] == 0


def test_each_round_makes_the_same_steps(runs: dict[str, bench.Run]) -> None:
    run = runs[bench.SOFT]
    ends = []
    for _ in range(2):
        assert run.step(STEPS) > 0
        ends.append((run.data.time, *run.data.qpos))
    assert ends[0] == ends[1]
    assert run.data.time == pytest.approx((bench.FALL + STEPS) * bench.TIMESTEP)


def test_shares_of_a_step_add_up(runs: dict[str, bench.Run]) -> None:
    shares = bench.measure_profile(list(runs.values()), 3, STEPS)
    assert tuple(shares) == (*bench.PARTS, bench.CONTACTS)
    assert all(share > 0 for share in shares.values())
    assert sum(shares[part] for part in bench.PARTS) == pytest.approx(1)
    assert shares[bench.CONTACTS] < shares["collision"] + shares["forces"]


def test_work_on_contacts_is_what_collision_and_forces_take_more() -> None:
    free = {"position": 2.0, "collision": 1.0, "forces": 3.0, "solver": 0.0, "other": 1.0}
    touching = {"position": 2.0, "collision": 5.0, "forces": 4.0, "solver": 8.0, "other": 1.0}
    assert contact_share(touching, free) == pytest.approx(5 / 20)


def test_costs_of_a_law_compare_the_same_contacts(slab: Volume) -> None:
    cost = bench.measure_cost(slab, SIZE, "neo_hookean", rounds=1, steps=STEPS)
    assert cost.points >= 1
    with_contact = {speed.name: speed.contacts for speed in cost.speeds}
    assert with_contact[bench.SPHERES] == pytest.approx(with_contact[bench.SOFT], abs=0.5)
    plain = cost.step(bench.SOFT) - cost.step(bench.AIR) + cost.step(bench.BODIES)
    assert cost.over_no_elasticity == pytest.approx(cost.step(bench.SOFT) / plain)
    assert cost.over_bodies == pytest.approx(cost.step(bench.SOFT) / cost.step(bench.SPHERES))


def test_main_prints_tables_and_writes_every_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, "standard_jobs", lambda folder: [Job(str(bench.VOLUME), 20_000, 2)])
    monkeypatch.setattr(bench, "PAPER", {bench.Size(3, 10): (3, 500)})
    for name, value in (("BUILDS", 1), ("ROUNDS", 1), ("STEPS", 20)):
        monkeypatch.setattr(bench, name, value)
    bench.main()
    printed = capsys.readouterr().out
    assert "67021 voxels" in printed
    assert "3 frames, 36 degrees of freedom" in printed
    assert "3 frames, 10 samples, 36 degrees of freedom" in printed
    assert "Cost over the bodies alone, 3 frames" in printed
    assert "\x1b" not in printed
    with (tmp_path / bench.OUTPUT).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["table"] for row in rows} == {
        "machine", "build", "large", "memory", "rate", "step", "contacts", "iterations", "share", "cost", "elasticity",
        "paper",
    }  # fmt: skip
    assert all(float(row["value"]) > 0 for row in rows if row["table"] in ("build", "large", "step", "share", "paper"))
    steps = [row["row"] for row in rows if row["table"] == "step"]
    assert steps == 2 * [bench.SOFT, bench.AIR, bench.SPHERES, bench.BODIES]
    assert [row["samples"] for row in rows if row["table"] == "step"] == 4 * [""] + 4 * ["10"]


def test_a_step_is_compared_with_that_of_the_papers_method(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "PAPER", {bench.Size(3, 10): (3, 500)})
    names = (bench.SOFT, bench.AIR, bench.SPHERES, bench.BODIES)
    speeds = [
        bench.Speed(bench.Size(3, samples), name, 36, 1.0, 1.0, step)
        for samples, step in ((None, 3e-5), (10, 4e-5))
        for name in names
    ]
    ratios = list(bench.step_table(speeds).columns[-2].cells)
    assert ratios == ["", "0.75", "0.75", "", "", "", "", "", "", ""]
