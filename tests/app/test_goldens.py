"""The examples look as they did; a changed weight, colour or pose is seen, and users can test their scenes so."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from examples import elbow, grasp, knee, steak
from mjframes.base.errors import MjframesError
from mjframes.testing import COLORS, Goldens, Sight, likeness, load, save, see, side_by_side

GOLDENS = Path(__file__).parent.parent / "goldens"


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene, who looks at it when, and what drives it until then."""

    model: mujoco.MjModel
    data: mujoco.MjData
    camera: str | mujoco.MjvCamera
    times: tuple[float, ...]
    control: Callable[[mujoco.MjData], None] | None = None

    def check(self, golden: Goldens, name: str) -> None:
        golden(self.model, self.data, name, self.camera, self.times, self.control)


def eye(lookat: tuple[float, float, float], distance: float, azimuth: float, elevation: float) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.lookat[:] = lookat
    camera.distance, camera.azimuth, camera.elevation = distance, azimuth, elevation
    return camera


@functools.cache
def steak_model() -> mujoco.MjModel:
    return steak.steak_scene().compile()


def falling_steak() -> Scene:
    return Scene(steak_model(), mujoco.MjData(steak_model()), "front", (0.0, 0.2))


def pulled_knee() -> Scene:
    leg = knee.knee_at_rest()
    bodies = leg.bodies(leg.tendon)

    def pull(data: mujoco.MjData) -> None:
        data.xfrc_applied[bodies, :3] = min(1.0, data.time / 0.1) * knee.PULL / len(bodies)

    return Scene(leg.model, leg.data, eye((-0.01, 0, -0.02), 0.42, 110, -10), (0.0, 0.3), pull)


def bent_elbow() -> Scene:
    arm = elbow.elbow()

    def bend(data: mujoco.MjData) -> None:
        data.ctrl[0] = min(1.0, data.time / 0.2)

    return Scene(arm.model, arm.data, eye((0, 0.05, 0), 0.65, 90, -70), (0.0, 0.4), bend)


def soft_grasp() -> Scene:
    hand = grasp.soft_block()
    fingers = hand.data.actuator("gripper_fingers_actuator")

    def close(data: mujoco.MjData) -> None:
        fingers.ctrl[0] = grasp.GRIP * min(1.0, data.time / 0.1)

    return Scene(hand.model, hand.data, "front", (0.2,), close)


@pytest.mark.parametrize(
    "scene",
    [falling_steak, *(pytest.param(some, marks=pytest.mark.slow) for some in (pulled_knee, bent_elbow, soft_grasp))],
)
def test_an_example_looks_as_it_did(scene: Callable[[], Scene], golden: Goldens) -> None:
    scene().check(golden, scene.__name__)


def test_goldens_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in GOLDENS.iterdir()}
    assert len(sizes) == 9
    assert max(sizes.values()) < 100_000


def heavier_bone(scene: Scene) -> None:
    """A skin follows one of its bones by half as much again."""
    start, count = scene.model.skin_bonevertadr[0], scene.model.skin_bonevertnum[0]
    scene.model.skin_bonevertweight[start : start + count] *= 1.5


def paler_flesh(scene: Scene) -> None:
    scene.model.skin_rgba[:, 1] += 0.06


def other_pose(scene: Scene) -> None:
    """All of the steak is 3 mm to the side: two pixels."""
    slides = scene.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    along = slides & (np.abs(scene.model.jnt_axis[:, 0]) > 0.99)
    scene.data.qpos[scene.model.jnt_qposadr[along]] += 0.003


@pytest.mark.parametrize(
    ("change", "reason"),
    [(heavier_bone, "silhouettes agree by"), (paler_flesh, "mean colours differ by"), (other_pose, "similarity is")],
)
def test_what_is_changed_is_seen(change: Callable[[Scene], None], reason: str, tmp_path: Path) -> None:
    model = falling_steak().model.__copy__()
    scene = Scene(model, mujoco.MjData(model), "front", (0.0,))
    scene.check(Goldens(GOLDENS, tmp_path), "falling_steak")
    assert not list(tmp_path.iterdir())
    change(scene)
    with pytest.raises(AssertionError, match=rf"falling_steak-0s is not what it was: .*{reason}.*\.failed\.png\.$"):
        scene.check(Goldens(GOLDENS, tmp_path), "falling_steak")
    assert [path.name for path in tmp_path.iterdir()] == ["falling_steak-0s.failed.png"]


def test_a_golden_is_what_was_saved(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    sight = Sight(
        rng.integers(0, 256, (24, 32, 3)).astype(np.uint8), rng.integers(0, len(COLORS), (24, 32)).astype(np.uint8)
    )
    save(sight, tmp_path / "a.png")
    again = load(tmp_path / "a.png")
    assert np.array_equal(again.picture, sight.picture)
    assert np.array_equal(again.labels, sight.labels)
    assert not likeness(sight, again).failures
    (tmp_path / "b.png").write_text("no picture")
    with pytest.raises(MjframesError, match=r"b\.png: the golden cannot be read"):
        load(tmp_path / "b.png")


def test_likeness_of_squares() -> None:
    """Two squares of 20 pixels, one moved by 5: they share 15 of 25 columns."""
    labels = np.zeros((2, 60, 60), np.uint8)
    labels[0, 10:30, 10:30] = labels[1, 10:30, 15:35] = 1
    one, other = (Sight(COLORS[2 * found], found) for found in labels)
    assert likeness(one, other).iou == pytest.approx(15 / 25)
    assert likeness(one, one) == likeness(other, other)
    assert (likeness(one, one).iou, likeness(one, one).color) == (1, 0)
    pale = Sight(np.minimum(one.picture, 170), one.labels)  # their green is 180
    assert likeness(one, pale).color == pytest.approx(10 / 255)
    assert side_by_side(one, other).shape == (120, 180, 3)
    gone = Sight(np.zeros_like(one.picture), np.zeros_like(one.labels))
    assert likeness(one, gone).iou == 0


def test_each_tree_has_a_silhouette(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><light pos="0 0 3"/><camera pos="0 0 4"/><geom type="plane" size="3 3 .1"/>
        <body pos="-.5 0 .2"><freejoint/><geom type="box" size=".2 .2 .2"/>
        <body><joint/><geom type="box" size=".1 .1 .1" pos="0 .5 0"/></body></body>
        <body pos=".5 0 .2"><freejoint/><geom type="box" size=".2 .2 .2"/></body></worldbody></mujoco>"""
    )
    labels = see(model, mujoco.MjData(model)).labels
    counts = np.bincount(labels.ravel())
    assert len(counts) == 3
    assert counts[1] == pytest.approx(1.25 * counts[2], rel=0.05)
    with pytest.raises(MjframesError, match=r"times have 0\.1 s, but the simulation is at 0\.2 s; let them ascend"):
        Goldens(tmp_path, tmp_path, update=True)(model, mujoco.MjData(model), "a", times=(0.2, 0.1))


USERS = """
import mujoco
def test_it(golden):
    model = mujoco.MjModel.from_xml_string('''<mujoco><worldbody><light pos="0 0 3"/><camera pos="0 0 2"/>
      <body><freejoint/><geom type="box" size=".2 .1 .1" rgba="1 0 0 1"/></body></worldbody></mujoco>''')
    golden(model, mujoco.MjData(model), "box", times=(0.0, 0.1))
"""
UNUSED = """
import sys
def test_it():
    assert "pytest_mjframes" in sys.modules
    assert "mujoco" not in sys.modules
    assert "mjframes" not in sys.modules
"""


def test_users_test_their_scenes(tmp_path: Path) -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "pytest", "-q", "-p", "pytest_mjframes", "-p", "no:cacheprovider"]
        return subprocess.run([*command, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True)

    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    (tmp_path / "test_a.py").write_text(USERS)
    done = run("test_a.py")
    assert done.returncode == 1
    assert "there is no such golden" in done.stdout
    assert run("test_a.py", "--update-goldens").returncode == 0
    assert {path.name for path in (tmp_path / "goldens").iterdir()} == {"box-0s.png", "box-0.1s.png"}
    (tmp_path / "test_a.py").write_text(USERS.replace('size=".2', 'size=".3'))
    done = run("test_a.py")
    assert done.returncode == 1
    assert "box-0s is not what it was: silhouettes agree by 0.6" in done.stdout
    assert (tmp_path / "goldens" / "box-0s.failed.png").exists()
    (tmp_path / "test_b.py").write_text(UNUSED)
    done = run("test_b.py")
    assert done.returncode == 0, done.stdout
