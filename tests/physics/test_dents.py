"""Where something presses, flesh gives way as finite elements do: dents beyond what the frames show."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.punch import punch_stiffness
from builders.scenes import TILTED, compiled
from builders.stacked import block
from numpy.typing import NDArray

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.load import mujoco_warnings
from mjframes.scene.scaling import scale
from mjframes.scene.view import soft, soft_names
from mjframes.surface.dents import dents, pairs
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

EDGE = """<worldbody>
  <geom type="plane" size="1 1 .1"/><geom type="box" size=".05 .1 .05" pos=".05 0 .05"/>
</worldbody></mujoco>"""
YOUNG, POISSON, SPACING = 1e5, 0.45, 0.005
WIDTH, THICK = 0.1, 0.02  # [m] of a gripper's pad, glued at its base


@cache
def pad(frames: int, young: float = YOUNG) -> SoftBody:
    labels = np.ones((20, 20, 5), np.uint8)
    held = np.zeros(labels.shape, bool)
    held[:, :, 0] = True
    volume = Volume.from_labels(labels, SPACING, {1: Material(young, POISSON, 1000)}, origin=(0, 0, -SPACING))
    return build(volume, frames, supports=Fixed(held), damping=(0, 0.02))


def pressed(
    body: SoftBody,
    half: float,
    force: float,
    contact: Contact,
    timestep: float = 0.002,
    factor: float = 1,
    seconds: float = 3,
    rest: float = 2e-4,
) -> float:
    """How deep a square punch comes to rest [m], below where the voxels end; rest: how fast it may be then [m/s]."""
    cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity, spec.option.cone = timestep, (0, 0, 0), cone
    attach(spec, body, "pad", contact=contact)
    punch = spec.worldbody.add_body(name="punch", pos=(WIDTH / 2, WIDTH / 2, THICK + 0.0305))
    punch.add_joint(name="down", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    punch.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, 0.03), mass=0.1, condim=contact.condim or 3)
    model = spec.compile()
    data = mujoco.MjData(model)
    scale(model, "pad", factor)
    for step in range(round(seconds / timestep)):
        data.qfrc_applied[model.joint("down").dofadr] = force * min(1, step * timestep)
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < rest
    return float(data.qpos[model.joint("down").qposadr[0]]) - 0.0005


@cache
def exact(half: float) -> float:
    """[N/m] of finite elements.  half: the punch's width."""
    return punch_stiffness(WIDTH, THICK, half, YOUNG, POISSON, SPACING)


@pytest.mark.parametrize(
    ("frames", "half", "condim"),
    [
        pytest.param(1, 0.01, 1, marks=pytest.mark.slow),
        pytest.param(1, 0.01, 3, marks=pytest.mark.slow),
        (1, 0.02, 1),
        (1, 0.02, 3),
        pytest.param(5, 0.01, 1, marks=pytest.mark.slow),
        pytest.param(5, 0.01, 3, marks=pytest.mark.slow),
        (5, 0.02, 1),
        pytest.param(5, 0.02, 3, marks=pytest.mark.slow),
    ],
)
def test_a_punch_goes_as_deep_as_in_finite_elements(frames: int, half: float, condim: int) -> None:
    stiffness = {}
    for on in (True, False):
        depth = [
            pressed(pad(frames), half, exact(half) * x, Contact(condim=condim, dents=on), seconds=5)
            for x in (5e-4, 1.5e-3)
        ]
        stiffness[on] = exact(half) * 1e-3 / (depth[1] - depth[0])
    assert stiffness[True] == pytest.approx(exact(half), rel=0.2)
    assert stiffness[False] > 1.2 * exact(half)


def test_a_dent_hardly_depends_on_the_step() -> None:
    """What is left is MuJoCo's own spring of the contact, in series."""
    depths = [pressed(pad(1), 0.02, 20, Contact(condim=1, dents=True), timestep) for timestep in (0.004, 0.002, 0.0005)]
    np.testing.assert_allclose(depths, depths[-1], rtol=0.02)


def test_a_dent_in_a_pyramid_does_not_creep() -> None:
    """Half a second after the last of the force; friction's damping along the normal would make it 3e-5 m/s."""
    pressed(pad(1), 0.01, 6, Contact(dents=True), seconds=1.5, rest=1e-6)


def test_dents_are_narrower_with_more_frames() -> None:
    widths = [np.median(pad(frames).contact.dents.width) for frames in (1, 5)]
    assert widths[1] < 0.85 * widths[0]


def test_the_softness_of_a_dent_is_that_of_the_half_space_of_the_material_there() -> None:
    labels = np.ones((4, 4, 4), np.uint8)
    labels[:, :, 2:] = 2
    materials = {1: Material(1e4, 0.3, 1000), 2: Material(1e6, 0.45, 1000)}
    grid = voxel_grid(Volume.from_labels(labels, 0.01, materials))
    places: NDArray[np.float64] = np.array([[0.02, 0.02, 0.0], [0.02, 0.02, 0.04]])
    found = dents(grid, places, np.array([[0, 0, -1.0], [0, 0, 1.0]]), 1)
    expected = [(1 - 0.3**2) / (np.pi * 1e4), (1 - 0.45**2) / (np.pi * 1e6)]
    np.testing.assert_allclose(found.softness**2, expected, rtol=1e-12)
    np.testing.assert_allclose(found.width, 0.29 * 0.04, rtol=1e-12)
    np.testing.assert_allclose(found.thickness, [0.02, 0.04], atol=0.006)  # that of the soft one ends at the hard one
    np.testing.assert_array_equal(found.material, [0, 1])


def test_pairs_of_voxels_are_summed_by_how_far_apart_they_are() -> None:
    spacing = np.array([0.01, 0.02, 0.03])
    grid = voxel_grid(Volume.from_labels(np.ones((3, 4, 2), int), spacing, {1: Material(YOUNG, 0.3, 1000)}))
    voxels = np.arange(0, len(grid.index), 2)
    beta = np.random.default_rng(0).random(len(voxels))
    r, share = pairs(grid, voxels, beta)
    far = np.linalg.norm(grid.centers[voxels, None] - grid.centers[voxels], axis=2)
    assert len(r) < len(voxels) ** 2 / 4
    assert share @ np.exp(-r / 0.01) == pytest.approx(beta @ np.exp(-far / 0.01) @ beta, rel=1e-12)


def test_a_factor_of_the_stiffness_is_as_good_as_a_stiffer_material() -> None:
    contact = Contact(condim=1, dents=True)
    scaled = pressed(pad(1), 0.02, 30, contact, factor=3)
    assert scaled == pytest.approx(pressed(pad(1, 3 * YOUNG), 0.02, 30, contact), rel=1e-3)


def test_flesh_gives_way_less_the_deeper_it_is_pressed() -> None:
    contact = Contact(condim=1, dents=True)
    assert pressed(pad(1), 0.02, 80, contact) < 0.97 * 80 / 40 * pressed(pad(1), 0.02, 40, contact)


def test_flesh_over_a_bone_gives_way_no_deeper_than_it_is_thick() -> None:
    """A ball with a radius of 1 cm on 6 mm of flesh: it was 8.1 mm deep at 32 N, in the bone."""
    labels = np.ones((30, 30, 8), np.uint8)
    labels[:, :, :5] = 2
    materials = {1: Material(5e4, POISSON, 1000), 2: Material(1e10, 0.3, 1900, is_rigid=True)}
    volume = Volume.from_labels(labels, 0.002, materials)
    body = build(volume, 1, supports=Fixed(labels == 2))
    assert 2e-3 < sunk(body, 0.01, 4, 0.03, 0.016) < 4e-3
    assert 4e-3 < sunk(body, 0.01, 32, 0.03, 0.016) < 6e-3


def sunk(body: SoftBody, radius: float, force: float, middle: float, top: float) -> float:
    """How deep a ball comes to rest that is pressed down on the middle of a body's upper side [m]."""
    spec = mujoco.MjSpec()
    spec.option.gravity = (0, 0, 0)
    attach(spec, body, "flesh")
    ball = spec.worldbody.add_body(pos=(middle, middle, top + radius))
    joint = ball.add_joint(name="down", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -1))
    joint.damping[0] = 2
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(radius, 0, 0), mass=0.05)
    model = spec.compile()
    data = mujoco.MjData(model)
    while data.time < 1.5:
        data.joint("down").qfrc_applied = force * min(1, data.time / 0.5)
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-4
    return float(data.joint("down").qpos[0])


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("young", [1e4, 1e6])
def test_a_block_that_falls_on_an_edge_and_one_on_it_make_no_energy(young: float, cone: str) -> None:
    scene = f'<mujoco><option cone="{cone}" timestep="0.002"/>' + EDGE
    bodies = [(block((6, 6, 4), 0.01, 1000, young=young), (0, 0, z), TILTED) for z in (0.15, 0.25)]
    model, data = compiled(scene, *bodies, contact=Contact(dents=True))
    views = [soft(model, data, name) for name in soft_names(model)]

    def energy() -> float:
        mujoco.mj_energyPos(model, data)
        return float(data.energy[0]) + sum(view.kinetic_energy + view.elastic_energy for view in views)

    mujoco.mj_forward(model, data)
    start = energy()
    for _ in range(100):
        mujoco.mj_step(model, data, 5)
        mujoco.mj_forward(model, data)
        assert energy() < start + 1e-3 * abs(start)
    once = data.efc_aref.copy()
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.efc_aref, once)  # springs are set, not scaled


def test_too_little_memory_for_dents_is_told_once() -> None:
    spec = mujoco.MjSpec.from_string(f"<mujoco>{EDGE}")
    attach(spec, block((6, 6, 4), 0.01, 1000), "block", pos=(0, 0, 0.1), contact=Contact(dents=True))
    spec.memory = 75_000  # [bytes]; the step itself takes 49,200
    model = spec.compile()
    data = mujoco.MjData(model)
    with mujoco_warnings() as told:
        mujoco.mj_step(model, data, 200)
    assert [text.split(":")[0] for text in told if "dents" in text] == ["mjframes"]


@pytest.mark.parametrize("force", [5, 20])
def test_two_sides_that_are_pressed_do_not_meet(force: float) -> None:
    """What is left between two punches is near a column's: σ = E/3 (λ⁻² − λ), and firmer by the flesh around it."""
    young, half, thick = 1e4, 0.01, 0.02
    slab = Volume.from_labels(np.ones((20, 20, 4), np.uint8), SPACING, {1: Material(young, POISSON, 1000)})
    spec = mujoco.MjSpec()
    spec.option.gravity = (0, 0, 0)
    attach(spec, build(slab, 1, damping=(0, 0.02)), "slab", contact=Contact(condim=1))
    joints = []
    for side in (1, -1):
        punch = spec.worldbody.add_body(pos=(WIDTH / 2, WIDTH / 2, thick / 2 + side * (thick / 2 + 0.0205)))
        joints.append(punch.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, -side), damping=5, name=f"{side}"))
        punch.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, 0.02), mass=0.1, contype=2)
    names = [joint.name for joint in joints]
    model = spec.compile()
    data = mujoco.MjData(model)
    for step in range(1500):
        for name in names:
            data.joint(name).qfrc_applied = force * min(1, step * model.opt.timestep)
        mujoco.mj_step(model, data)
    left = (thick + 0.001 - sum(float(data.joint(name).qpos[0]) for name in names)) / thick
    stress = 3 * force / (young * (2 * half) ** 2)
    column = next(root.real for root in np.roots([1, stress, 0, -1]) if root.real > 0)
    assert 0.55 * column < left < 1.2 * column


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_piles_that_do_not_touch_step_as_each_does_alone(cone: str) -> None:
    """Their contacts are in turns in MuJoCo's list."""
    low, high = block((8, 6, 4), 0.01, 1000), block((6, 6, 4), 0.01, 1000, young=3e4)
    ways = []
    for places in ((0.0,), (0.5,), (0.0, 0.5)):
        spec = mujoco.MjSpec.from_string(
            f'<mujoco><option cone="{cone}"/><worldbody><geom type="plane" size="1 1 .1"/></worldbody></mujoco>'
        )
        for body, height in ((low, 0.0002), (high, 0.0404)):
            for x in places:
                attach(spec, body, f"{height:g}-{x:g}", pos=(x, 0.1 * x, height))
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, nstep=150)
        assert data.ncon >= 8 * len(places)
        ways.append({name: soft(model, data, name).control_positions for name in soft_names(model)})
    one, other, both = ways
    for name, positions in both.items():
        np.testing.assert_allclose(positions, (one | other)[name], rtol=0, atol=1e-9)


def test_what_is_pressed_on_all_of_its_side_makes_no_dent() -> None:
    """One frame shows all of it; dents halved the force."""
    width, thickness, strain = 0.06, 0.02, 0.05
    volume = Volume.box((width, width, thickness), Material(YOUNG, 0.3, 1000), spacing=SPACING)
    body = build(volume, 1, damping=(0, 0.002))
    scene = f"""<mujoco><option gravity="0 0 0"/><worldbody>
      <geom type="plane" size="1 1 .1" pos="0 0 {-thickness / 2}"/>
      <body name="plate" mocap="true"><geom name="plate" type="box" size=".1 .1 .02"/></body></worldbody></mujoco>"""
    push = []
    for makes in (True, False):
        contact = Contact(solref=(0.001, 1), priority=1, dents=makes)
        model, data = compiled(scene, (body, (0, 0, 0), (1, 0, 0, 0)), contact=contact, timestep=0.0005)
        for step in range(3000):
            data.mocap_pos[0, 2] = thickness / 2 + 0.02 - strain * thickness * min(1, step / 800)
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        carried = soft(model, data, "soft0").patch_forces[:, 2]
        push.append(-carried[carried < 0].sum())
    assert push[0] == pytest.approx(push[1], rel=0.05)
    # one frame alone is a sixth softer than E A / L: its strain is not even
    assert 0.75 < push[0] / (YOUNG * width**2 * strain) < 0.9
