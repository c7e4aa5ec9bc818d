"""That the benchmark measures what it says; never how long anything takes."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share

from benchmarks.contenders.flex import FlexProcess, FlexSetting
from benchmarks.speed import bench, instructions, steps
from benchmarks.speed.flex_steps import Match, beam, flex_run
from benchmarks.speed.profile import contact_share
from benchmarks.speed.step_scenes import BARE, OURS, SCENES, TIMESTEP, Run, bare_run, soft_run
from benchmarks.speed.step_tables import STEAK, draw_steps, flex_table, readme_table, step_table
from benchmarks.speed.steps import Group, Speed
from mjframes.body.soft_body import SoftBody
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

MUJOCO4 = os.environ.get("MJFRAMES_MUJOCO4", "")
SIZE = bench.Size(2)
STEPS = 100


@pytest.fixture(scope="module")
def slab() -> Volume:
    rubber = Material(young=5e3, poisson=0.4, density=1000)
    return Volume.from_labels(np.ones((24, 18, 3), int), 0.01, {1: rubber})


@pytest.fixture(scope="module")
def body(slab: Volume) -> SoftBody:
    (built,), _ = bench.measure_builds(slab, [SIZE], repeats=1)
    return built


@pytest.fixture(scope="module")
def groups(body: SoftBody) -> dict[str, tuple[Run, Run]]:
    found = {}
    for scene in SCENES:
        soft = soft_run("slab", body, scene)
        found[scene] = (soft, bare_run("slab", body, scene, soft.contacts(STEPS)[0]))
    return found


def invented(frames: int, scene: str, contender: str, step: float, body: str = STEAK) -> Speed:
    return Speed(body, frames, scene, contender, 12 * frames, 5.0, 1.0, step)


@pytest.mark.slow
@pytest.mark.usefixtures("uncached")
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


@pytest.mark.parametrize("scene", SCENES)
def test_the_floor_is_the_same_bodies_without_the_plugin(groups: dict[str, tuple[Run, Run]], scene: str) -> None:
    soft, bare = (run.model for run in groups[scene])
    assert bare.nplugin == 0
    own = [soft.body(b).name.startswith("body") for b in range(soft.nbody)]
    np.testing.assert_array_equal(bare.body_mass[1:], soft.body_mass[own])
    assert bare.opt.timestep == soft.opt.timestep == TIMESTEP
    assert (bare.opt.jacobian, bare.opt.solver) == (soft.opt.jacobian, soft.opt.solver)
    assert groups[scene][0].contender == OURS
    assert groups[scene][1].contender == BARE


def test_the_soft_body_touches_and_its_floor_as_often(groups: dict[str, tuple[Run, Run]]) -> None:
    for scene, (soft, bare) in groups.items():
        contacts, _ = soft.contacts(STEPS)
        floor, iterations = bare.contacts(STEPS)
        assert (contacts > 4) == (iterations > 0) == (scene != "free")
        assert floor == pytest.approx(contacts, abs=0.5)
    touched = {
        scene: {run.model.geom(geom).name.split(":")[0] for contact in run.data.contact for geom in contact.geom}
        for scene, (run, _) in groups.items()
    }
    assert {"body0", "box"} <= touched["contact"]
    assert {"body0", "body1", "body2", "floor"} <= touched["stack"]
    assert {"body0", "finger", ""} <= touched["grasp"]  # the one above has no name


def test_what_is_grasped_stays_there(groups: dict[str, tuple[Run, Run]]) -> None:
    run, _ = groups["grasp"]
    mujoco.mj_setState(run.model, run.data, run.state, mujoco.mjtState.mjSTATE_INTEGRATION)
    height = run.data.subtree_com[run.model.body("body0").id, 2]
    run.step(2 * STEPS)
    assert run.data.subtree_com[run.model.body("body0").id, 2] == pytest.approx(height, abs=0.02)


def test_each_round_makes_the_same_steps(groups: dict[str, tuple[Run, Run]]) -> None:
    run, _ = groups["contact"]
    ends = []
    for _ in range(2):
        assert run.step(STEPS) > 0
        ends.append((run.data.time, *run.data.qpos))
    assert ends[0] == ends[1]


def test_speeds_are_of_every_run(groups: dict[str, tuple[Run, Run]]) -> None:
    rounds = []
    some = [Group(10, groups[scene]) for scene in ("free", "contact")]
    speeds = steps.measure(some, 2, lambda: rounds.append(0))
    assert len(rounds) == 4
    assert [(speed.scene, speed.contender) for speed in speeds] == [
        ("free", OURS), ("free", BARE), ("contact", OURS), ("contact", BARE),
    ]  # fmt: skip
    assert all(speed.step > 0 and speed.dofs == 24 and speed.body == "slab" for speed in speeds)


def test_scenes_that_take_minutes_are_left_out(body: SoftBody, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steps, "MOST_DOFS", 24)
    assert steps.prepare("slab", body, "stack") is None
    assert steps.prepare("slab", body, "free") is not None


def test_work_on_contacts_is_a_share_of_the_step(groups: dict[str, tuple[Run, Run]]) -> None:
    touching, free = groups["contact"][0], groups["free"][0]
    assert 0 < contact_share(touching, free, STEPS, 3) < 1


def test_instructions_by_valgrind_are_those_of_steps_alone(
    groups: dict[str, tuple[Run, Run]], monkeypatch: pytest.MonkeyPatch
) -> None:
    run, bare = groups["contact"]

    def valgrind(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        assert "--toggle-collect=mj_step" in command
        out = next(option.split("=", 1)[1] for option in command if option.startswith("--callgrind-out-file="))
        Path(out).write_text(f"events: Ir\nsummary: 5\n\ntotals: {7 * int(command[-1])}\n")
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(instructions.shutil, "which", lambda name: f"/usr/bin/{name}" if name == "valgrind" else None)
    monkeypatch.setattr(instructions.subprocess, "run", valgrind)
    speeds = [invented(run.frames, "contact", one.contender, 1e-6) for one in (run, bare)]
    found = steps.counted(speeds, [Group(10, (run, bare))])
    assert [speed.instructions for speed in found] == [7, None]
    monkeypatch.setattr(instructions.shutil, "which", lambda name: None)
    assert instructions.instructions(run) is None


def test_the_process_that_is_counted_makes_the_steps(groups: dict[str, tuple[Run, Run]], tmp_path: Path) -> None:
    run, _ = groups["contact"]
    mujoco.mj_saveModel(run.model, str(tmp_path / "model.mjb"))
    np.save(tmp_path / "state.npy", run.state)
    code = instructions.STEPPING + "\nprint(repr(data.time))"
    command = [sys.executable, "-c", code, str(instructions.plugin.library_path()), str(tmp_path), "10"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    run.step(10)
    assert float(printed) == run.data.time


def test_growth_is_the_exponent() -> None:
    speeds = [invented(frames, "free", OURS, 1e-6 * frames**2.5) for frames in (3, 10, 20, 40)]
    assert steps.growth(speeds, 3, 20) == pytest.approx(2.5)
    assert steps.growth(speeds, 40, 160) is None


def test_tables_have_every_number(tmp_path: Path) -> None:
    speeds = [
        invented(frames, scene, name, factor * 1e-6 * frames)
        for frames in (3, 10, 40)
        for scene in SCENES
        for name, factor in ((OURS, 12.0), (BARE, 4.0))
        if (frames, scene) != (10, "stack")
    ]
    columns = [list(column.cells) for column in step_table(speeds, STEAK).columns]
    assert columns[0] == ["3 frames", "10 frames", "40 frames", "growth 3–20", "growth 20–40"]
    assert columns[1] == ["36", "120", "480", "", ""]
    few = step_table([speed for speed in speeds if speed.frames <= 20], STEAK)
    assert list(few.columns[0].cells) == ["3 frames", "10 frames", "growth 3–20"]
    assert columns[2] == ["36", "120", "480", "1.0", "–"]  # microseconds
    assert columns[4] == ["3.0", "3.0", "3.0", "", ""]
    assert [column[1] for column in columns[12:17]] == ["–"] * 5  # the stack of ten frames
    lines = readme_table(speeds, {3: 0.84}, {3: (3, 500)}).splitlines()
    assert lines[2] == "| 3 | 36 | 0.8 s | 3 s | 36 µs | 36 µs | 3.0 | 36 µs | 36 µs | 28,000 | 500 |"
    assert lines[3] == "| 10 | 120 | – | – | 120 µs | 120 µs | 3.0 | – | 120 µs | 8,300 | – |"
    assert len({line.count("|") for line in lines}) == 1
    beams = [
        invented(3, "free", name, step, "beam") for name, step in ((OURS, 1e-5), (BARE, 5e-6), ("flex trilinear", 2e-4))
    ]
    rows = [list(column.cells) for column in flex_table(beams).columns]
    assert [column[0] for column in rows] == ["free", "10", "5 (0.5 ×)", "200 (20.0 ×)"]
    draw_steps([*speeds, *beams], tmp_path / "steps.png")
    assert (tmp_path / "steps.png").stat().st_size < 60_000
    shown = picture(tmp_path / "steps.png")
    assert min(share(shown, color) for color in ("tab:blue", "tab:purple", "tab:green", "tab:orange")) > 2e-4


@pytest.mark.skipif(not MUJOCO4, reason="MJFRAMES_MUJOCO4 names no Python that has MuJoCo 4")
def test_flex_steps_in_the_same_scenes() -> None:
    case = beam()
    setting = FlexSetting("quadratic", (4, 1, 1))
    with FlexProcess(MUJOCO4) as process:
        match = Match(setting, 0.1, 3, 0.2)
        for number, scene in enumerate(SCENES):
            run = flex_run("beam", match, scene, case.volume, number, 10, process)
            assert (run.contacts(10)[0] > 3) == (scene != "free")
            assert run.dofs == setting.dofs * (3 if scene == "stack" else 1) + (scene == "grasp")
            assert run.step(10) > 0


def test_costs_of_a_law_compare_the_same_contacts(slab: Volume) -> None:
    cost = bench.measure_cost(slab, SIZE, "neo_hookean", rounds=1)
    assert cost.points >= 1
    touching = {speed.contender: speed.contacts for speed in steps.of(cost.speeds, scene="contact")}
    assert touching[BARE] == pytest.approx(touching[OURS], abs=0.5)
    plain = cost.step("contact") - cost.step("free") + cost.step("free", BARE)
    assert cost.over_no_elasticity == pytest.approx(cost.step("contact") / plain)
    assert cost.over_bodies == pytest.approx(cost.step("contact") / cost.step("contact", BARE))


@pytest.mark.slow
def test_main_prints_tables_and_writes_every_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(bench, "PAPER", {bench.Size(3, 10): (3, 500)})
    monkeypatch.setattr(steps, "LEAST_STEPS", 10)
    monkeypatch.setattr(steps, "SECONDS", 1e-3)
    assert bench.main(["--quick", "--picture", "steps.png"]) == 0
    printed = capsys.readouterr().out
    assert "67021 voxels" in printed
    assert "3 frames" in printed
    assert "Cost over the bodies alone, 3 frames" in printed
    assert "flex is left out" in printed
    assert "| 3 | 36 |" in printed
    assert "\x1b" not in printed
    assert (tmp_path / "steps.png").is_file()
    with (tmp_path / bench.OUTPUT).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["table"] for row in rows} == {
        "machine", "build", "step", "dofs", "contacts", "iterations", "share", "cost", "elasticity", "paper",
    }  # fmt: skip
    assert all(float(row["value"]) > 0 for row in rows if row["table"] in ("build", "step", "dofs", "paper"))
    timed = [row["row"] for row in rows if row["table"] == "step"]
    assert timed == [f"steak, {scene}, {name}" for scene in SCENES for name in (OURS, BARE)]
