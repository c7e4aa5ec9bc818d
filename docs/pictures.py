"""Pictures and films of the examples' own scenes for the gallery, drawn again when these or the package change."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

import mjframes as mf
from examples import (
    arm,
    elbow,
    finger,
    fingertips,
    flight,
    grasp,
    hertz,
    identify,
    kernels,
    knee,
    lift,
    modes,
    steak,
    taxels,
)
from mjframes.dm import lifting

ROOT = Path(__file__).parents[1]
SIZE = (640, 360)
FPS = 30.0


def draw(folder: Path) -> None:
    """Write a film and its last picture of each scene, and the figures of what does not move, to `folder`."""
    stamp = folder / f"{digest()}.txt"
    if stamp.exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    films = steak_falls, elbow_bends, knee_extends, gripper_lifts, fingertips_hold, pen_rolls, arm_reaches, arm_lifts
    for film in films:
        film(folder)
    for figure in (modes, kernels, hertz, identify, flight, finger):
        figure.run(folder)
    with Image.open(
        ROOT / "tests" / "goldens" / "running_rat.png"
    ) as rat:  # its film takes minutes; the left half is the picture
        rat.crop((0, 0, rat.width // 2, rat.height)).save(folder / "rat.png")
    for name in ("steak.webp", "report_time.png"):
        shutil.copy(ROOT / "models" / name, folder)
    stamp.write_text("what these pictures were drawn from has this digest\n")


def digest() -> str:
    """Return a hash of all that the pictures depend on."""
    patterns = ("examples/*.py", "models/*", "mjframes/**/*.py", "plugin/*.cc", "plugin/*.h", "docs/pictures.py")
    files = sorted(path for pattern in patterns for path in ROOT.glob(pattern))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


@contextmanager
def filmed(model: mujoco.MjModel, path: Path, camera: str | None = None, fps: float = FPS) -> Iterator:
    """A function that adds the present state to the film `path`; its last picture stays beside it."""
    last = None
    with mf.film(model, path, camera=camera, fps=fps, size=SIZE) as add:

        def draw(data: mujoco.MjData) -> None:
            nonlocal last
            if last is None:
                mujoco.mj_forward(model, data)  # a new state has no positions to draw yet
            last = data
            add(data)

        yield draw
    renderer = mujoco.Renderer(model, SIZE[1], SIZE[0])
    renderer.update_scene(last, camera=-1 if camera is None else camera)
    Image.fromarray(renderer.render()).save(path.with_suffix(".jpg"), quality=88)
    renderer.close()


def look(
    model: mujoco.MjModel, at: tuple[float, float, float], distance: float, azimuth: float, elevation: float
) -> None:
    """Put the free camera somewhere [m, degrees]."""
    model.stat.center[:] = at
    model.stat.extent = distance / 1.5  # the free camera is that far from the centre
    model.vis.global_.azimuth, model.vis.global_.elevation = azimuth, elevation


def steak_falls(folder: Path) -> None:
    model = steak.steak_scene().compile()
    data = mujoco.MjData(model)
    with filmed(model, folder / "steak.mp4", "front") as add:
        for time in np.arange(0, 2, 1 / FPS):
            while data.time < time:
                mujoco.mj_step(model, data)
            add(data)


def elbow_bends(folder: Path) -> None:
    arm = elbow.elbow()
    look(arm.model, (0, 0.05, 0), 0.65, 90, -70)
    with filmed(arm.model, folder / "elbow.mp4") as add:
        for time in np.arange(1 / FPS, 1, 1 / FPS):
            elbow.bend(arm, time)
            add(arm.data)


def knee_extends(folder: Path) -> None:
    leg = knee.knee_at_rest()
    look(leg.model, (-0.01, 0, -0.02), 0.42, 110, -10)
    with filmed(leg.model, folder / "knee.mp4") as add:
        for time in np.arange(1 / FPS, 1.5, 1 / FPS):
            knee.pull(leg, time)
            add(leg.data)


def gripper_lifts(folder: Path) -> None:
    hand = grasp.soft_block()
    model, data = hand.model, hand.data
    with filmed(model, folder / "grasp.mp4", "front") as add:
        for time in np.arange(0, grasp.LIFTED, 1 / FPS):
            while data.time < time:
                data.actuator("gripper_fingers_actuator").ctrl[0] = grasp.GRIP * min(1.0, data.time / grasp.CLOSED)
                rise = np.clip((data.time - grasp.CLOSED) / (grasp.LIFTED - grasp.CLOSED), 0, 1)
                data.actuator("lift").ctrl[0] = grasp.HEIGHT * rise
                mujoco.mj_step(model, data)
            add(data)


def fingertips_hold(folder: Path) -> None:
    model, peach = fingertips.hand_and_peach()
    with filmed(model, folder / "fingertips.mp4", "front") as add:
        fingertips.grip(model, peach, grasp.every(1 / FPS, add))


def pen_rolls(folder: Path) -> None:
    model = taxels.finger_and_pen()
    with filmed(model, folder / "taxels.mp4", "side") as add:
        felt = taxels.roll(model, grasp.every(1 / FPS, add))
    taxels.plot(felt, folder / "taxels.png")


def arm_reaches(folder: Path) -> None:
    model, body = arm.arm()
    with filmed(model, folder / "arm.mp4", "side") as add:
        found, _ = arm.reach(model, body, grasp.every(1 / FPS, add))
    arm.plot(found, folder / "arm.png")


def arm_lifts(folder: Path) -> None:
    environment = lift.started(seed=0)
    with filmed(environment.physics.model.ptr, folder / "lift.mp4", "beside", 1 / lifting.CONTROL_TIMESTEP) as add:
        lift.lift(environment, add)
