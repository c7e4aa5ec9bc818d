"""A soft ball between two plates against Hertz: F = 4/3 E* √R δ^1.5, E* = E / (1 − ν²), δ the approach to one plate.

Frames a distance s apart cannot follow a contact area of radius a = √(R δ) that is smaller: the ball is then too stiff.
Its force falls to Hertz's as the frames get closer, slowly: at 20 frames and δ = 8 mm it is 1.7 times Hertz's, and from
ten frames on the excess there is proportional to s/a. With fewer frames, and at δ near a voxel, it is larger than that.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjframes.body import build
from mjframes.contact import Contact
from mjframes.material import Material
from mjframes.mjcf import attach
from mjframes.volume import Volume

RADIUS, YOUNG, POISSON, COUNT = 0.05, 1e5, 0.3, 24
APPROACH = np.array([0.004, 0.006, 0.008])  # [m]
SCENE = f"""<mujoco><option gravity="0 0 0" timestep="0.005"/><worldbody>
<body name="below" mocap="true" pos="0 0 -{RADIUS + 0.01}"><geom type="box" size=".1 .1 .01"/></body>
<body name="above" mocap="true" pos="0 0 {RADIUS + 0.01}"><geom name="above" type="box" size=".1 .1 .01"/></body>
</worldbody></mujoco>"""


def forces(frames: int) -> np.ndarray:
    """On one plate, at each approach [N]."""
    center = (np.arange(COUNT) + 0.5) * 2 * RADIUS / COUNT - RADIUS
    x, y, z = np.meshgrid(center, center, center, indexing="ij")
    ball = (x**2 + y**2 + z**2 < RADIUS**2).astype(int)
    volume = Volume.from_labels(ball, 2 * RADIUS / COUNT, {1: Material(YOUNG, POISSON, 1000)}, origin=(-RADIUS,) * 3)
    spec = mujoco.MjSpec.from_string(SCENE)
    contact = Contact(condim=1, solref=(0.01, 1), solimp=(0.99, 0.99), priority=1)
    attach(spec.worldbody, build(volume, frames, 4 * frames + 40, damping=(0.0, 0.1)), "ball", contact=contact)
    model = spec.compile()
    data, found = mujoco.MjData(model), []
    start, force = data.mocap_pos.copy(), np.zeros(6)
    before = 0.0
    for approach in APPROACH:
        for share in np.minimum(np.arange(1, 61) / 20, 1):
            data.mocap_pos[:] = start * (1 - (before + share * (approach - before)) / start[1, 2])
            mujoco.mj_step(model, data)
        before = approach
        mujoco.mj_forward(model, data)
        total = 0.0
        for number, touch in enumerate(data.contact):
            if model.geom("above").id in touch.geom:
                mujoco.mj_contactForce(model, data, number, force)
                total += force[0]
        found.append(total)
    return np.array(found)


def test_the_force_of_a_pressed_ball_comes_to_that_of_hertz_with_the_number_of_frames(
    capsys: pytest.CaptureFixture[str],
) -> None:
    counts = np.array([10, 20, 40, 60])
    hertz = 4 / 3 * YOUNG / (1 - POISSON**2) * np.sqrt(RADIUS) * APPROACH**1.5
    ratio = np.array([forces(count) for count in counts]) / hertz
    exponent = np.polyfit(np.log(APPROACH), np.log(ratio * hertz).T, 1)[0]
    spacing = RADIUS * (4 / 3 * np.pi / counts) ** (1 / 3)
    coarseness = spacing / np.sqrt(RADIUS * APPROACH[-1])  # s/a at the deepest
    slope, limit = np.polyfit(coarseness, ratio[:, -1], 1)
    with capsys.disabled():
        print(f"\nframes  exponent  F / F_Hertz at δ = {' '.join(f'{1e3 * a:g}' for a in APPROACH)} mm")
        for count, power, row in zip(counts, exponent, ratio, strict=True):
            print(f"{count:6d}  {power:8.2f}  {' '.join(f'{r:.2f}' for r in row)}")
        print(f"F / F_Hertz = {limit:.2f} + {slope:.2f} s/a at δ = {1e3 * APPROACH[-1]:g} mm")
    assert (np.diff(ratio[:, -1]) < 0).all()
    assert ratio[1, -1] == pytest.approx(1.69, abs=0.05)  # 20 frames
    assert limit == pytest.approx(1, abs=0.1)  # E* of frames that are close against the contact area
    assert (np.diff(exponent) > 0).all()
    assert exponent[-1] == pytest.approx(1.35, abs=0.05)  # 1.5 where the area grows without a step
