"""What goes wrong in a run is said once, on the body, with what helps; ordinary and driven scenes alarm nobody."""

from __future__ import annotations

import re
import warnings as python_warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, TILTED, compiled

from benchmarks.stability.states import jacobian, move_points
from mjframes.app.collect.options import CollectOptions
from mjframes.app.collect.worlds import Stepping
from mjframes.app.measure import measure, state_of
from mjframes.app.recording import Recording, summary
from mjframes.app.run import record
from mjframes.app.watch import FOLDED, Watch
from mjframes.body.build import TurnWarning, build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.commands import main
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.instability import GROWN, HELP, InstabilityWarning
from mjframes.scene.load import load_scene, start
from mjframes.scene.scene_file import standalone_scene
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SPACE = "<mujoco><option gravity='0 0 0' timestep='{timestep}'/></mujoco>"
BAR = np.ones((12, 6, 6), np.uint8)


@cache
def bar(young: float = 2e5, law: str = "corotational", method: str = "whole_body") -> SoftBody:
    return build(Volume.from_labels(BAR, 0.01, {1: Material(young, 0.4, 1000)}), 2, law=law, method=method)


def stir(stiffness: float) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """A force that comes from nowhere, stiffness [N/m] times the position turned by 90°."""

    def add(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        x, y, _ = data.qpos.reshape(-1, 3).T
        data.qfrc_passive[0::3] += stiffness * y
        data.qfrc_passive[1::3] -= stiffness * x

    return add


def said(work: Callable[[], object], of: str = "") -> list[str]:
    """The warnings that `work` gives, those that have a word."""
    with python_warnings.catch_warnings(record=True) as caught:
        python_warnings.simplefilter("always")
        work()
    return [
        str(one.message) for one in caught if issubclass(one.category, InstabilityWarning) and of in str(one.message)
    ]


def watched(
    model: mujoco.MjModel, data: mujoco.MjData, steps: int, push: Callable[[mujoco.MjData], None] | None = None
) -> None:
    view = soft(model, data, "soft0")
    watch = Watch(model, data, {"soft0": view})
    for _ in range(steps):
        if push is not None:
            push(data)
        state = state_of(data)
        mujoco.mj_step(model, data)
        watch.look(measure(model, data, {"soft0": view}, state, 0.0))
        watch.step()


def test_energy_from_nothing_is_told_once_and_of_the_body() -> None:
    model, _ = compiled(FLOOR, (bar(), (0, 0, 0.1), TILTED))
    mujoco.set_mjcb_passive(stir(60.0))
    try:
        (sentence, *others) = said(lambda: record(model, 1.0))
    finally:
        mujoco.set_mjcb_passive(None)
    assert sentence.startswith("soft body 'soft0' has made ")
    assert "J of energy from nothing by 0." in sentence
    assert "smaller timestep, damping" in sentence
    assert not any("energy" in other for other in others)


@pytest.mark.parametrize("method", ["whole_body", pytest.param("paper", marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", ["corotational", pytest.param("neo_hookean", marks=pytest.mark.slow)])
def test_an_ordinary_drop_alarms_nobody(law: str, method: str) -> None:
    model, _ = compiled(FLOOR, (bar(law=law, method=method), (0, 0, 0.15), TILTED))
    assert said(lambda: record(model, 1.5)) == []


@pytest.mark.parametrize(
    "law", ["corotational", *(pytest.param(law, marks=pytest.mark.slow) for law in ("neo_hookean", "mooney_rivlin"))]
)
def test_a_body_at_rest_without_gravity_has_energy_of_rounding_alone(law: str) -> None:
    cube = build(Volume.from_labels(np.ones((6, 6, 6), np.uint8), 0.01, {1: Material(1e5, 0.3, 1000)}), 3, law=law)
    model, _ = compiled(SPACE.format(timestep=0.002), (cube, (0, 0, 0), (1, 0, 0, 0)))
    made: list[Recording] = []
    assert said(lambda: made.append(record(model, 1.5))) == []
    assert summary(made[0]).splitlines()[-1].split() == ["energy", "nothing", "moved"]


def test_a_body_at_rest_that_shakes_itself_is_told_of() -> None:
    """From strains as small as 1e-7 on, which are no rounding."""
    model, data = compiled(SPACE.format(timestep=0.002), (bar(), (0, 0, 0), (1, 0, 0, 0)), contact=False)
    data.qpos[:] = 1e-9 * np.random.default_rng(1).normal(size=model.nq)
    mujoco.set_mjcb_passive(stir(60.0))
    try:
        (sentence,) = said(lambda: watched(model, data, 300), "energy")
    finally:
        mujoco.set_mjcb_passive(None)
    assert re.search(r"made \S+e-1\d J of energy from nothing", sentence)


def test_what_users_and_contacts_put_in_alarms_nobody() -> None:
    """The bar is thrown about by a force, and by a heavy box that falls on it."""
    box = '<body pos="0 0 .4"><freejoint/><geom type="box" size=".1 .1 .1" mass="3"/></body></worldbody>'
    model, data = compiled(FLOOR.replace("</worldbody>", box), (bar(), (0, 0, 0.01), (1, 0, 0, 0)))
    dofs = np.flatnonzero(model.jnt_type[model.dof_jntid] == mujoco.mjtJoint.mjJNT_SLIDE)

    def push(data: mujoco.MjData) -> None:
        data.qfrc_applied[dofs[0::3]] = 2 * np.sin(30 * data.time)

    assert said(lambda: watched(model, data, 500, push)) == []


def test_a_stiff_body_that_spins_alarms_nobody_though_each_step_stretches_it() -> None:
    model, data = compiled(SPACE.format(timestep=0.005), (bar(young=1e8), (0, 0, 0), (1, 0, 0, 0)), contact=False)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    x = view.control_positions
    spin = np.cross([0, 15.0, 10.0], x - view.mass @ x / view.mass.sum())
    data.qvel[:] = np.linalg.lstsq(jacobian(view), spin.ravel(), rcond=None)[0]
    mujoco.mj_forward(model, data)
    before = view.kinetic_energy
    assert said(lambda: watched(model, data, 100)) == []
    assert view.kinetic_energy + view.elastic_energy > 1.001 * before  # of its own it is there


def test_a_body_that_grows_is_told_of() -> None:
    model, data = compiled(SPACE.format(timestep=0.002), (bar(), (0, 0, 0), TILTED), contact=False)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    assert view.size_ratio == pytest.approx(1)
    move_points(view, 1.4 * view.control_positions)
    assert said(lambda: watched(model, data, 1)) == []
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    move_points(view, 1.6 * view.control_positions)
    mujoco.mj_kinematics(model, data)
    assert view.size_ratio > GROWN
    assert said(lambda: watched(model, data, 1)) == [
        "soft body 'soft0' is 1.6 times as large as at rest at 0 s; try a smaller timestep, damping, more or other "
        "frames, or another law."
    ]


@pytest.mark.parametrize(
    ("method", "law"),
    [
        ("whole_body", "corotational"),
        pytest.param("whole_body", "neo_hookean", marks=pytest.mark.slow),
        pytest.param("paper", "corotational", marks=pytest.mark.slow),
        ("paper", "neo_hookean"),
    ],
)
def test_what_stays_folded_is_told_of_and_what_unfolds_is_not(law: str, method: str) -> None:
    made = bar(law=law, method=method)
    model, data = compiled(SPACE.format(timestep=0.01), (made, (0, 0, 0), TILTED), contact=False)
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    rest = view.control_positions.copy()
    watch, bodies = Watch(model, data, {"soft0": view}), {"soft0": view}

    def look(time: float, x: np.ndarray) -> None:
        move_points(view, x)
        mujoco.mj_forward(model, data)
        assert view.is_folded == (x is not rest)
        data.time = time
        watch.look(measure(model, data, bodies, state_of(data), 0.0))

    inside_out = -rest
    assert [said(lambda t=t: look(t, inside_out), "folded") for t in (0.0, FOLDED - 0.01)] == [[], []]
    assert said(lambda: look(FOLDED, rest), "folded") == []
    assert said(lambda: look(0.6, inside_out), "folded") == []
    assert said(lambda: look(1.0, inside_out), "folded") == []
    (sentence,) = said(lambda: look(0.6 + FOLDED, inside_out), "folded")
    assert "'soft0' has been folded over, inside out, since 0.6 s; try" in sentence
    assert said(lambda: look(2.0, inside_out), "folded") == []


@pytest.mark.parametrize("method", ["whole_body", pytest.param("paper", marks=pytest.mark.slow)])
def test_who_reads_a_body_is_told_once_that_it_is_too_large_or_folded_over(method: str) -> None:
    model, data = compiled(SPACE.format(timestep=0.002), (bar(method=method), (0, 0, 0), TILTED), contact=False)
    view = soft(model, data, "soft0")
    assert said(lambda: view.elastic_energy) == []  # of data in which nothing is known yet
    mujoco.mj_forward(model, data)
    rest, mover = view.control_positions.copy(), soft(model, data, "soft0").quiet()

    def read(x: np.ndarray) -> list[str]:
        move_points(mover, x)
        mujoco.mj_forward(model, data)
        return said(lambda: (view.elastic_energy, view.elastic_forces, view.positions([[0.05, 0.03, 0.03]])))

    assert read(rest) == read(1.4 * rest) == []
    assert read(1.6 * rest) == [f"soft body 'soft0' is more than 1.5 times as large as at rest; {HELP}."]
    assert read(-rest) == [f"soft body 'soft0' is folded over, inside out, in some region; {HELP}."]
    assert read(-2 * rest) == []
    assert said(lambda: mover.elastic_energy) == []


def test_a_body_of_points_on_a_line_is_not_folded() -> None:
    """Its region shows no volume: det F is rounding."""
    volume = Volume.from_labels(np.ones((9, 3, 3), int), 0.01, {1: Material(2e5, 0.4, 1000)})
    with pytest.warns(TurnWarning):
        made = build(volume, 2, frame_type="point")
    model, data = compiled(SPACE.format(timestep=0.002), (made, (0, 0, 0), TILTED), contact=False)
    view = soft(model, data, "soft0")
    for push in np.random.default_rng(0).normal(0, 1e-3, (20, model.nq)):
        data.qpos[:] = push
        mujoco.mj_forward(model, data)
        assert said(lambda: view.elastic_energy) == []


def test_a_held_body_is_not_asked_for_energy_that_comes_through_what_holds_it() -> None:
    held = np.zeros(BAR.shape, bool)
    held[0] = True
    volume = Volume.from_labels(BAR, 0.01, {1: Material(2e5, 0.4, 1000)})
    made = build(volume, 2, supports=Fixed(held))
    arm = """<mujoco><worldbody><body name="arm" pos="0 0 1"><joint name="turn" axis="0 0 1" damping=".05"/>
    <geom type="capsule" size=".02" fromto="0 0 0 .2 0 0"/></body></worldbody>
    <actuator><general joint="turn" biastype="affine" biasprm=".5 0 0"/></actuator></mujoco>"""
    spec = mujoco.MjSpec.from_string(arm)
    attach(spec, made, "soft0", "arm", pos=(0.2, 0, 0))
    assert said(lambda: record(spec.compile(), 0.5)) == []  # it turns by some radians


def test_run_prints_it_and_ends_well(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, path = mujoco.MjSpec.from_string(FLOOR), tmp_path / "bar.xml"
    attach(spec, bar(), "bar", pos=(0, 0, 0.1), quat=TILTED)
    path.write_text(spec.to_xml())
    assert main(["run", str(path), "--duration", "0.5"]) == 0
    assert "energy from nothing" not in capfd.readouterr().err

    def stirring(model: mujoco.MjModel, warnings: list[str]) -> mujoco.MjData:
        data = start(model, warnings)
        mujoco.set_mjcb_passive(stir(60.0))  # not before: MuJoCo's compiler cannot call what is of Python
        return data

    monkeypatch.setattr("mjframes.app.run.start", stirring)
    try:
        assert main(["run", str(path), "--duration", "1"]) == 0
    finally:
        mujoco.set_mjcb_passive(None)
    assert capfd.readouterr().err.count("mjframes: soft body 'bar' has made ") == 1


def test_collect_tells_of_bodies_that_are_too_large_or_folded_at_the_end(tmp_path: Path) -> None:
    volume = Volume.from_labels(BAR, 0.01, {1: Material(2e5, 0.4, 1000)})
    path = tmp_path / "bar.xml"
    path.write_text(standalone_scene(bar(), volume, name="bar").to_xml())
    stepping = Stepping(CollectOptions(path, tmp_path, worlds=3, seconds=1.0, rate=10.0), load_scene(path)[0])
    assert said(lambda: stepping.run(range(3), 1)) == []
    view = soft(stepping.model, stepping.data, "bar")
    rest = view.control_positions.copy()
    states = []
    for shape in (rest, 2 * rest, -rest):
        move_points(view, shape)
        states.append(np.tile(stepping.data.qpos, (10, 1)))
    entries, count = np.array(states), np.array([10, 10, 10])
    assert said(lambda: stepping.tell_of_bodies(entries, count, [4, 5, 6])) == [
        f"soft body 'bar' is {what} at the end of 1 worlds, the first of them {world}; {HELP}."
        for what, world in (("far larger than at rest", 5), ("folded over, inside out,", 6))
    ]
    assert len(said(lambda: stepping.tell_of_bodies(entries, np.array([10, 10, 2]), [4, 5, 6]))) == 1


@pytest.mark.parametrize(("apart", "told"), [(0.03, True), (0.0595, False)])
def test_soft_bodies_that_are_inside_each_other_are_told_of_once(tmp_path: Path, apart: float, told: bool) -> None:
    spec = mujoco.MjSpec.from_string(SPACE.format(timestep=0.002))
    for name, y in (("left", 0.0), ("right", apart)):
        attach(spec, bar(), name, pos=(0, y, 0))
    path = tmp_path / "scene.xml"
    spec.compile()
    path.write_text(spec.to_xml())
    model = load_scene(path)[0]
    sentences = said(lambda: record(model, 0.05))
    assert [re.sub(r"\d+ mm|at .* s;", "…", sentence).split(" start")[0] for sentence in sentences] == told * [
        "the soft bodies 'left' and 'right' are … inside each other …"
    ]
    stepping = Stepping(CollectOptions(path, tmp_path, worlds=3, seconds=1.0, rate=10.0), model)
    entries = np.zeros((2, 1, model.nq))
    found = said(lambda: stepping.tell_of_bodies(entries, np.array([1, 1]), [4, 5]))
    assert ["at the end of 2 worlds, the first of them 4;" in sentence for sentence in found] == [True] * told
