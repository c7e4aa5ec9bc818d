"""What weighs little is as firm below a plate as its flesh, and what is squeezed stays calm."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

PAD = (0.024, 0.03, 0.01)  # [m] of a fingertip; 7 g at the density of water
WIDE = (0.06, 0.06, 0.02)
YOUNG = 1e5
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
STIFF = Contact(solref=(0.001, 1), priority=1, dents=False)  # at a timestep of 0.5 ms: what the frames alone bear


@cache
def pad(
    size: tuple[float, float, float],
    frames: int,
    density: float,
    beta: float = 0,
    young: float = YOUNG,
    glued: bool = False,
) -> SoftBody:
    volume = Volume.box(size, Material(young, 0.3, density), spacing=0.003)
    supports = [Fixed(volume.side("-z"))] if glued else []
    return build(volume, frames, damping=(0, beta), supports=supports)


def squeezed(
    body: SoftBody, height: float, strain: float, contact: Contact, option: str = "", timestep: float = 0.002
) -> tuple[float, float]:
    """What a plate bears that squeezes a body on a plane [N], and how fast that moves at the end [m/s]."""
    scene = f"""<mujoco><option {option}/><worldbody><geom type="plane" size="1 1 .1" pos="0 0 {-height / 2}"/>
      <body name="plate" mocap="true" pos="0 0 1"><geom type="box" size=".1 .1 .02"/></body></worldbody></mujoco>"""
    model, data = compiled(scene, (body, (0, 0, 0), UPRIGHT), contact=contact, timestep=timestep)
    fastest, steps = 0.0, round(1.5 / timestep)
    for step in range(steps):
        data.mocap_pos[0, 2] = height / 2 + 0.02 - strain * height * min(1, step * timestep / 0.4)
        mujoco.mj_step(model, data)
        if step > 0.8 * steps:
            fastest = max(fastest, float(np.abs(data.qvel).max()))
    mujoco.mj_forward(model, data)
    carried = soft(model, data, "soft0").patch_forces[:, 2]
    return -float(carried[carried < 0].sum()), fastest


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("frames", [1, 5])
def test_a_light_pad_is_as_firm_as_its_flesh(frames: int, cone: str) -> None:
    """MuJoCo's spring of a contact goes with the mass: alone it bears a tenth of this."""
    body = pad(PAD, frames, 1000, 0.002)
    wanted = squeezed(body, PAD[2], 0.05, STIFF, timestep=0.0005)[0]
    assert 0.7 < squeezed(body, PAD[2], 0.05, Contact(), f'cone="{cone}"')[0] / wanted < 1


@pytest.mark.parametrize(
    ("young", "frames"), [(1e6, 1), pytest.param(1e6, 5, marks=pytest.mark.slow), (1e7, 1), (1e7, 5)]
)
def test_a_glued_pad_is_as_firm_at_every_step(young: float, frames: int) -> None:
    """What holds it adds to its inertia: with its mass alone it bore half of this, or a fifth, at 2 ms."""
    body = pad(PAD, frames, 1000, 0.002, young, glued=True)
    wanted = squeezed(body, PAD[2], 0.05, STIFF, timestep=0.0005)[0]
    coarse, fine = (squeezed(body, PAD[2], 0.05, Contact(), timestep=step)[0] for step in (0.002, 0.0005))
    assert coarse == pytest.approx(fine, rel=0.02)
    assert 0.75 < coarse / wanted < 1


def test_the_firmness_hardly_depends_on_the_mass() -> None:
    """At steps that resolve it: a foam of 7 g and a rubber of 72 g."""
    push = [
        squeezed(pad(WIDE, 1, density, 0.002), WIDE[2], 0.05, Contact(), timestep=0.0005)[0] for density in (100, 1000)
    ]
    assert push[0] == pytest.approx(push[1], rel=0.1)


def test_a_contact_that_is_to_be_soft_is() -> None:
    push = [
        squeezed(pad(PAD, 1, 1000, 0.002), PAD[2], 0.05, Contact(solref=solref, priority=1))[0]
        for solref in ((0.01, 1), (0.05, 1), (0.01, 0.5))
    ]
    assert max(push[1:]) < 0.7 * push[0]


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("gravity", [0, 9.81])
@pytest.mark.parametrize("frames", [5, 8])
def test_what_is_squeezed_without_damping_comes_to_rest(frames: int, gravity: float, cone: str) -> None:
    """It shook at 0.1 to 0.5 m/s where contacts went to corners over heights that do not grow with their depth."""
    option = f'cone="{cone}" gravity="0 0 {-gravity}"'
    assert squeezed(pad(WIDE, frames, 1000), WIDE[2], 0.05, Contact(), option)[1] < 1e-3


@pytest.mark.parametrize("force", [20, 50])
@pytest.mark.parametrize("frames", [3, 5, 11])
def test_what_a_light_plate_presses_without_damping_comes_to_rest(frames: int, force: float) -> None:
    """It shook at up to 6 m/s, and sank half as deep again: contacts of what was pressed hard jumped to corners."""
    size, young = (0.06, 0.06, 0.02), 5e4
    volume = Volume.box(size, Material(young, 0.45, 1000), spacing=0.004)
    body = build(volume, frames, supports=Fixed(volume.side("-z")))
    scene = """<mujoco><worldbody><body pos="0 0 0.061"><joint name="down" type="slide" axis="0 0 -1" damping="2"/>
      <geom type="box" size=".1 .1 .05" mass="0.05"/></body></worldbody></mujoco>"""
    model, data = compiled(scene, (body, (0, 0, 0), UPRIGHT))
    fastest = 0.0
    while data.time < 1.5:
        data.joint("down").qfrc_applied = force * min(1, data.time / 0.5)
        mujoco.mj_step(model, data)
        fastest = max(fastest, float(np.abs(data.qvel).max())) if data.time > 1.2 else 0
    assert fastest < 2e-3
    assert 0.0005 < data.joint("down").qpos[0] - 0.001 < 0.005


@pytest.mark.parametrize("timestep", [0.0002, 0.0005, 0.001])
@pytest.mark.parametrize("young", [1e5, 1e6])
def test_a_box_that_falls_on_flesh_comes_back_no_higher(young: float, timestep: float) -> None:
    """It came back up to twice as high, the more the shorter the step: contacts took the flesh for one piece."""
    volume = Volume.box((0.06, 0.06, 0.04), Material(young, 0.3, 1000), spacing=0.005)
    body, height = build(volume, 5, supports=Fixed(volume.side("-z"))), 0.05
    scene = f"""<mujoco><worldbody><body pos="0 0 {0.02 + height}"><joint name="up" type="slide" axis="0 0 1"/>
      <geom type="box" size=".05 .05 .03" pos="0 0 .03" mass="1"/></body></worldbody></mujoco>"""
    model, data = compiled(scene, (body, (0, 0, 0), UPRIGHT), timestep=timestep)
    highest, touched = -np.inf, False
    while data.time < 0.45:
        mujoco.mj_step(model, data)
        touched = touched or data.ncon > 0
        highest = max(highest, float(data.joint("up").qpos[0])) if touched else highest
    assert -0.045 < highest < 0


def plate_on_a_wide_pad(frames: int, law: str, force: float) -> float:
    """How deep a plate sinks into a pad of 50 kPa that is glued below [m]."""
    volume = Volume.box(WIDE, Material(5e4, 0.45, 1000), spacing=0.004)
    body = build(volume, frames, supports=Fixed(volume.side("-z")), damping=(0, 0.01), law=law)
    scene = f"""<mujoco><worldbody><body pos="0 0 {WIDE[2] / 2 + 0.0501}"><joint name="down" type="slide" axis="0 0 -1"
      damping="2"/><geom type="box" size=".1 .1 .05" mass="0.05"/></body></worldbody></mujoco>"""
    model, data = compiled(scene, (body, (0, 0, 0), UPRIGHT))
    for step in range(800):
        data.joint("down").qfrc_applied = force * min(1, step / 400)
        mujoco.mj_step(model, data)
    return float(data.joint("down").qpos[0])


@pytest.mark.parametrize(
    ("frames", "force"), [(3, 100), (3, 150), (5, 100), pytest.param(11, 100, marks=pytest.mark.slow)]
)
def test_a_pad_bears_half_of_its_modulus(frames: int, force: float) -> None:
    """At 100 N (28 kPa) the plate went through 5 frames or more, where Hooke's law got no stiffer."""
    hooke, neo = (plate_on_a_wide_pad(frames, law, force) for law in ("corotational", "neo_hookean"))
    assert hooke == pytest.approx(neo, rel=1 / 8)
