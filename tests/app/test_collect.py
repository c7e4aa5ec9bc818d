"""Collections of worlds: the same bytes whatever the threads, the shards and how often they were killed."""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from builders.lengthwise import block
from builders.pictures import film, share_drawn
from builders.scenes import lump
from builders.tiers import thinned

from mjframes.app.collect.options import CollectOptions
from mjframes.app.collect.plan import engine
from mjframes.app.collect.push import pushes
from mjframes.app.collect.run import SUMS, TABLE, collect
from mjframes.app.collect.shard import shard_bytes
from mjframes.app.log.read import read_log
from mjframes.app.replay import film_of, state_at
from mjframes.base.errors import MjframesError
from mjframes.cli.commands import main
from mjframes.scene.attach import attach
from mjframes.scene.moving import movable
from mjframes.scene.scaling import scale
from mjframes.scene.scene_file import write_scene
from mjframes.scene.sensors import add_sensor
from mjframes.scene.view import soft

pytest.importorskip("mcap")

SCENE = """<mujoco><option timestep="0.004"/><worldbody><geom type="plane" size="1 1 .1"/>
<body name="ball" pos=".3 0 .3"><freejoint/><geom size=".03" mass=".1"/></body>
<body name="arm" pos="0 .3 .2"><joint name="swing" axis="1 0 0" damping=".01"/><geom size=".02" mass=".1"/></body>
</worldbody><actuator><motor joint="swing" ctrlrange="-.1 .1"/></actuator></mujoco>"""
VARY = {
    "lump.stiffness": (0.5, 2.0),
    "lump.2": (0.5, 2.0),
    "lump.beta": (0.5, 2.0),
    "lump.x": (-0.02, 0.02),
    "lump.yaw": (-180.0, 180.0),
    "lump.roll": (-20.0, 20.0),
    "ball.z": (0.0, 0.2),
}
OPTIONS: dict[str, Any] = {
    "worlds": 10, "seconds": 0.2, "vary": VARY, "push": {"lump": (0.0, 2.0), "ball": (0.0, 1.0)}, "control": "random",
    "rate": 50.0, "seed": 3, "shard": 2,
}  # fmt: skip


def options(**changed: Any) -> dict[str, Any]:
    return OPTIONS | changed


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.xml"
    spec = mujoco.MjSpec.from_string(SCENE)
    attach(spec, lump(0.5, 0.001), "lump", pos=(0, 0, 0.02))
    add_sensor(spec, lump(0.5, 0.001), "lump", "elastic_energy")
    spec.compile()
    write_scene(spec, path)
    return path


@pytest.fixture(scope="module")
def whole(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return collect(scene, tmp_path_factory.mktemp("whole") / "runs", threads=1, **OPTIONS).folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def table(folder: Path) -> list[dict[str, str]]:
    with (folder / TABLE).open(newline="") as stream:
        return list(csv.DictReader(stream))


def arguments(scene: Path, out: Path) -> list[str]:
    """The command line of OPTIONS."""
    given = [f"--{name}={OPTIONS[name]}" for name in ("worlds", "seconds", "control", "rate", "seed", "shard")]
    for option in ("vary", "push"):
        given += [f"--{option}={name}={low}:{high}" for name, (low, high) in OPTIONS[option].items()]
    return ["collect", str(scene), "--out", str(out), *given]


def test_a_world_is_what_one_run_with_its_row_of_the_table_is(scene: Path, whole: Path) -> None:
    row = table(whole)[3]
    model = mujoco.MjModel.from_xml_path(str(scene))
    log = read_log(whole / row["file"], 3)
    states = log.states()
    assert len(states) == int(row["entries"]) == 10
    common, second = float(row["lump.stiffness"]), float(row["lump.2"])
    scale(model, "lump", materials={1: common, 2: common * second, 3: common}, damping=(1.0, float(row["lump.beta"])))
    data = mujoco.MjData(model)
    data.qpos[:] = states[0]["qpos"]
    weights = pushes(model, data, [("lump", (0, 1)), ("ball", (0, 1))], 1.0)
    drawn = {name: float(row[name]) for name in row if ".push." in name}
    mujoco.mj_forward(model, data)
    wrenches = [push.wrenches(model, data, drawn) for push in weights]
    first = [round(drawn[f"{body}.push.time"] / 0.004) for body in ("lump", "ball")]
    found = []
    for step in range(50):
        if step % 5 == 0:
            found.append(data.qpos.tolist())
        data.ctrl[:] = states[step // 5]["ctrl"]
        data.xfrc_applied[:] = sum(w for w, f in zip(wrenches, first, strict=True) if f <= step < f + 25)
        mujoco.mj_step(model, data)
        if step % 5 == 0:
            assert log.messages["/sensors"][step // 5]["lump_elastic_energy"] == data.sensordata[0]
    assert found == [state["qpos"] for state in states]
    assert np.ptp([state["ctrl"] for state in states]) > 0


def test_worlds_differ_and_keep_to_their_bounds(whole: Path) -> None:
    rows = table(whole)
    assert [row["world"] for row in rows] == [str(i) for i in range(10)]
    assert {row["ended"] for row in rows} == {""}
    for name, (low, high) in VARY.items():
        values = [float(row[name]) for row in rows]
        assert low <= min(values) < max(values) <= high
        assert len(set(values)) == 10
    sizes = [np.linalg.norm([float(row[f"lump.push.{axis}"]) for axis in "xyz"]) for row in rows]
    assert 0 <= min(sizes) < max(sizes) <= 2


@pytest.mark.parametrize(("shard", "threads"), [(2, 2), (3, 1), (100, 2)])
def test_worlds_do_not_depend_on_shards_and_threads(
    scene: Path, whole: Path, tmp_path: Path, shard: int, threads: int
) -> None:
    other = collect(scene, tmp_path / "runs", threads=threads, **options(shard=shard)).folder
    if shard == OPTIONS["shard"]:
        assert contents(other) == contents(whole)
    for one, two in zip(table(whole), table(other), strict=True):
        assert {**one, "file": ""} == {**two, "file": ""}
        if one["world"] == "7":
            messages = [read_log(folder / row["file"], 7).messages for folder, row in ((whole, one), (other, two))]
            assert messages[0] == messages[1]


def test_more_worlds_and_fewer_variations_draw_the_same(scene: Path, whole: Path, tmp_path: Path) -> None:
    few = {"worlds": 2, "seconds": 0.1, "vary": {"lump.yaw": VARY["lump.yaw"]}, "push": {}}
    collect(scene, tmp_path / "runs", **options(**few))
    assert [row["lump.yaw"] for row in table(tmp_path / "runs")] == [row["lump.yaw"] for row in table(whole)[:2]]


@pytest.mark.slow
def test_a_collection_that_is_killed_goes_on_to_the_same_bytes(scene: Path, whole: Path, tmp_path: Path) -> None:
    """Killed ten times at random, and once with nothing left to do."""
    moments, out = random.Random(0), tmp_path / "runs"
    processes = multiprocessing.get_context("forkserver")
    processes.set_forkserver_preload(["mjframes.app.collect.run"])
    for _ in range(10):
        process = processes.Process(target=collect, args=(scene, out), kwargs=OPTIONS)
        process.start()
        goal = len(list(out.glob("shard*"))) + moments.choice((0, 1))
        while process.is_alive() and len(list(out.glob("shard*" if goal else "*.json"))) < max(1, goal):
            time.sleep(0.001)
        time.sleep(0.02 * moments.random())
        process.kill()
        process.join()
        assert process.exitcode in (0, -signal.SIGKILL)
        if process.exitcode == 0:
            shutil.rmtree(out)
    assert main(arguments(scene, out)) == 0
    assert contents(out) == contents(whole)
    assert main(arguments(scene, out)) == 0
    assert contents(out) == contents(whole)


def test_what_a_killed_process_left_half_written_goes(scene: Path, whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "runs"
    shutil.copytree(whole, out)
    (out / TABLE).unlink()
    (out / "shard-00001.mcap").rename(out / ".shard-00001.4194999.partial.mcap")
    mine = out / f".shard-00001.{os.getpid()}.partial.mcap"
    collect(scene, out, **OPTIONS)
    assert contents(out) == contents(whole)
    assert not mine.exists()


def test_a_shard_that_was_damaged_is_computed_again(
    scene: Path, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bit that flips, also where MCAP's readers find none: they look at no checksum of metadata."""
    out = tmp_path / "runs"
    shutil.copytree(whole, out)
    path = out / "shard-00001.mcap"
    content = path.read_bytes()
    for place in (content.index(b"lump.stiffness") + 20, len(content) // 2):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        assert main(arguments(scene, out)) == 0
        told = f"mjframes: {path}: it is not as it was written, but damaged or changed; it is computed again.\n"
        assert capsys.readouterr().err == told
        assert contents(out) == contents(whole)


def test_sha256sum_knows_the_digests(whole: Path) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("there is no sha256sum")
    done = subprocess.run(["sha256sum", "--check", "--strict", SUMS], cwd=whole, capture_output=True, text=True)
    assert (done.returncode, done.stdout.count(": OK\n")) == (0, 5)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"seed": 4}, "begun with seed 3 and not 4"),
        ({"vary": {}}, "begun with vary lump.stiffness=0.5:2, .* and not nothing"),
        ({"worlds": 11}, "begun with worlds 10 and not 11"),
    ],
)
def test_another_collection_in_the_folder_is_refused(
    scene: Path, whole: Path, changed: dict[str, Any], told: str
) -> None:
    before = contents(whole)
    with pytest.raises(MjframesError, match=told):
        collect(scene, whole, **options(**changed))
    assert contents(whole) == before


def test_another_engine_is_refused(scene: Path, tmp_path: Path) -> None:
    few = options(worlds=1, seconds=0.1)
    plan = collect(scene, tmp_path / "runs", **few).folder / "plan.json"
    plan.write_text(plan.read_text().replace(engine(), "mujoco 1.2.3, plugin 0123"))
    with pytest.raises(MjframesError, match=f"begun with engine mujoco 1.2.3, plugin 0123 and not {engine()}"):
        collect(scene, tmp_path / "runs", **few)
    with pytest.raises(MjframesError, match=f"a worker has {engine()}, but the plan is for mujoco 1.2.3"):
        shard_bytes(CollectOptions(scene, tmp_path, worlds=1), {}, 0, 1, "mujoco 1.2.3, plugin 0123")


def test_a_folder_of_other_things_is_left_alone(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(MjframesError, match="there is something else already"):
        collect(scene, tmp_path, **OPTIONS)
    (tmp_path / "notes.txt").rename(tmp_path / "plan.json")
    with pytest.raises(MjframesError, match="cannot be read as the plan"):
        collect(scene, tmp_path, **OPTIONS)
    assert contents(tmp_path) == {"plan.json": b"mine"}


def test_the_scene_is_a_file(tmp_path: Path) -> None:
    call: Any = collect
    with pytest.raises(MjframesError, match=r"^scene is a MjModel; give the path of an MJCF file \(\.xml\)\.$"):
        call(mujoco.MjModel.from_xml_string("<mujoco/>"), tmp_path, worlds=2)
    with pytest.raises(MjframesError, match=r"^out is a NoneType; give the path of a folder\.$"):
        call("scene.xml", None, worlds=2)


@pytest.mark.parametrize(
    ("changed", "told"),
    thinned(
        [
            ({"worlds": 0}, "worlds is 0; give a whole number from 1 on"),
            ({"seconds": 0.0}, "seconds is 0.0; give a positive time"),
            ({"rate": np.nan}, "rate is nan; give a positive number"),
            ({"threads": 0}, "threads is 0; give a whole number"),
            ({"control": "good"}, "control is 'good'; it must be one of 'none', 'random'"),
            ({"vary": {"lump": (0, 1)}}, "vary has 'lump'; give BODY and what of it"),
            (
                {"vary": {"lump.color": (1, 2)}},
                "vary has 'lump.color', but what of 'lump' can vary is: stiffness, .*, yaw, ",
            ),
            (
                {"vary": {"ball.flesh": (1, 2)}},
                "vary has 'ball.flesh', but what of 'ball' can vary is: stiffness, .*, yaw.",
            ),
            ({"vary": {"steak.flesh": (1, 2)}}, "the scene has no body 'steak'; its soft bodies are: 'lump'"),
            ({"vary": {"lump.stiffness": (0, 1)}}, "vary of 'lump.stiffness' goes from 0; factors are positive"),
            ({"vary": {"lump.x": (1, 0)}}, r"vary of 'lump.x' is \(1, 0\); give two numbers, the lower one first"),
            ({"vary": [("lump.x", (0, 1)), ("lump.x", (0, 2))]}, "vary has 'lump.x' twice"),
            ({"vary": {"ball.stiffness": (1, 2)}}, "name is 'ball' but the soft bodies that the model can scale are"),
            ({"vary": {"arm.x": (0, 1)}}, "'arm' is no soft body and no body on a free joint; .*: 'lump', 'ball'"),
            ({"vary": "lump"}, "vary is 'lump'; give bounds by name"),
            ({"push": {"steak": (0, 1)}}, "push has 'steak', which does not move; what does is: 'lump', 'ball', 'arm'"),
            ({"push": {"lump": (-1, 1)}}, "push of 'lump' goes from -1 N"),
            ({"push": {"lump": (0, np.inf)}}, "push of 'lump' is .*; give two numbers"),
            ({"seconds": 0.05}, "seconds is 0.05, and a push takes 0.1 s"),
        ],
        3,
    ),
)
def test_what_cannot_be_is_told_in_a_sentence(scene: Path, tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    with pytest.raises(MjframesError, match=told):
        collect(scene, tmp_path / "runs", **options(**changed))
    assert not (tmp_path / "runs").exists()


def test_the_command_line_tells_of_bad_bounds(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in ("lump.x", "lump.x=1", "lump.x=a:b", "=1:2", "lump.x=1:inf"):
        assert main(["collect", str(scene), "--worlds=2", "--out", str(tmp_path / "runs"), "--vary", wrong]) == 2
        assert f"{wrong!r} is not NAME=LOW:HIGH" in capsys.readouterr().err
    bad = ["collect", str(tmp_path / "no.xml"), "--worlds", "2", "--out", str(tmp_path / "runs")]
    assert main(bad) == 2
    assert "there is no such scene" in capsys.readouterr().err


def test_worlds_are_replayed(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shard = whole / "shard-00002.mcap"
    assert main(["replay", str(shard), "--world", "5", "--state", "0.1"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == state_at(read_log(shard, 5), 0.1)
    assert main(["replay", str(shard), "--state", "0.1"]) == 2
    assert "the log is of the worlds 4 to 5; choose one, with --world" in capsys.readouterr().err
    assert main(["replay", str(shard), "--state", "0.1", "--world", "9"]) == 2
    assert "world is 9, but the log has those of 4 to 5" in capsys.readouterr().err


def test_mcaps_own_reader_finds_a_world_and_what_was_drawn_for_it(whole: Path) -> None:
    from mcap.reader import make_reader

    with (whole / "shard-00001.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        found = [json.loads(message.data) for _, _, message in reader.iter_messages(topics="/world_2/state")]
        drawn = [record.metadata for record in reader.iter_metadata() if record.name == "world"]
    assert [state["qpos"] for state in found] == [s["qpos"] for s in read_log(whole / "shard-00001.mcap", 2).states()]
    assert drawn == [{k: v for k, v in row.items() if k != "file"} for row in table(whole)[2:4]]


def test_a_world_that_diverges_ends_there_alone(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text("""<mujoco><worldbody><body name="rod"><joint stiffness="1e8" axis="0 1 0"/>
        <geom size=".05" fromto="0 0 0 0 0 -1" type="capsule"/></body><body name="ball" pos="9 9 9"><freejoint/>
        <geom size=".05"/></body></worldbody></mujoco>""")
    found = collect(path, tmp_path / "runs", worlds=4, seconds=4, push={"rod": (1, 9)}, shard=4)
    rows = table(found.folder)
    assert found.ended == 4
    assert {row["ended"] for row in rows} <= {"BADQPOS", "BADQVEL", "BADQACC"}
    assert len({row["entries"] for row in rows}) > 1
    states = read_log(found.shards[0], 0).states()
    assert 0 < len(states) == int(rows[0]["entries"]) < 120
    assert np.isfinite(np.array([state["qpos"] for state in states])).all()


@pytest.mark.parametrize("kind", ["lump", "mixed", "quadratic"])
def test_a_start_that_is_moved_strains_nothing(kind: str) -> None:
    body = lump() if kind == "lump" else block(frame_type=("rigid", "affine", "rigid") if kind == "mixed" else kind)
    spec = mujoco.MjSpec()
    attach(spec, body, "steak", pos=(0.1, 0.2, 0.3), quat=(0.9, 0.3, -0.2, 0.25))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view, turn, shift = soft(model, data, "steak", body), np.array([0.5, 0.5, -0.5, 0.5]), np.array([0.1, 0.0, 0.3])
    before, some = view.control_positions, movable(model, data, "steak")
    some.move(data.qpos, shift, turn)
    mujoco.mj_forward(model, data)
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, turn)
    wanted = some.centre + shift + (before - some.centre) @ matrix.reshape(3, 3).T
    np.testing.assert_allclose(view.control_positions, wanted, atol=1e-9)
    moved = data.qpos.copy()
    data.qpos[:] = moved + 1e-3 * np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    strained = view.elastic_energy
    data.qpos[:] = moved
    mujoco.mj_forward(model, data)
    assert view.elastic_energy < 1e-9 * strained


def test_a_push_puts_its_force_on_the_body(scene: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    (push,) = pushes(model, data, [("lump", (1.0, 1.0))], 1.0)
    drawn = push.draw(0, 5, 1.0)
    found = push.wrenches(model, data, drawn)[:, :3]
    np.testing.assert_allclose(found.sum(axis=0), [drawn[f"lump.push.{axis}"] for axis in "xyz"], rtol=1e-5)
    assert np.linalg.norm(found.sum(axis=0)) == pytest.approx(1, rel=1e-5)


def test_held_bodies_are_not_moved(tmp_path: Path) -> None:
    from mjframes.frames.supports import Fixed

    mask = np.zeros((12, 4, 4), bool)
    mask[:2] = True
    spec = mujoco.MjSpec()
    attach(spec, block(supports=(Fixed(mask),)), "pad")
    spec.compile()
    write_scene(spec, tmp_path / "scene.xml")
    with pytest.raises(MjframesError, match="'pad' is held by the scene"):
        collect(tmp_path / "scene.xml", tmp_path / "runs", worlds=1, seconds=1, vary={"pad.x": (0, 1)})


def test_a_world_has_its_film(whole: Path, tmp_path: Path) -> None:
    pytest.importorskip("av")
    film_of(read_log(whole / "shard-00000.mcap", 1), tmp_path / "film.mp4", fps=10, size=(64, 48))
    shown = film(tmp_path / "film.mp4")
    assert [frame.shape for frame in shown] == [(48, 64, 3)] * 2
    assert min(map(share_drawn, shown)) > 0.1
