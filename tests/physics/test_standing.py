"""Flat sides stand: columns, stacks, cubes on a slope."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled
from scipy.spatial.transform import Rotation

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.scene.contact import Contact
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

FLOOR = '<mujoco><option {option}/><worldbody><geom type="plane" size="2 2 .1" friction="1.5"/></worldbody></mujoco>'
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def block(shape: tuple[int, int, int], spacing: float, young: float, frames: int) -> SoftBody:
    return build(Volume.from_labels(np.ones(shape, int), spacing, {1: Material(young, 0.3, 1000)}), frames)


def middles(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> np.ndarray:
    """The mean of each body's control points (count, 3)."""
    return np.array([soft(model, data, f"soft{i}").control_positions.mean(axis=0) for i in range(count)])


def run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


@pytest.mark.parametrize("dents", [False, True])
def test_a_column_stands_and_rests(dents: bool) -> None:
    """4 × 4 × 12 cm; on a base that bulges it fell over."""
    placed = (block((4, 4, 12), 0.01, 1e6, 3), (0, 0, 5e-4), UPRIGHT)
    model, data = compiled(FLOOR.format(option=""), placed, contact=Contact(dents=dents))
    mujoco.mj_forward(model, data)
    start = middles(model, data, 1)
    run(model, data, 10)
    moved = np.abs(middles(model, data, 1) - start)[0]
    assert (moved < [5e-4, 5e-4, 1.5e-3]).all()  # it falls by half a millimetre
    assert np.abs(data.qvel).max() < 1e-6


def test_a_block_that_falls_flat_stays_near() -> None:
    """Dents that gave back all that they took threw it 13 mm aside and turned it by 7°."""
    body = build(Volume.box((0.1, 0.06, 0.06), Material(1e5, 0.45, 1000), spacing=0.01), 3)
    floor = '<mujoco><worldbody><geom type="plane" size="2 2 .1"/></worldbody></mujoco>'
    model, data = compiled(floor, (body, (0, 0, 0.1), UPRIGHT))
    mujoco.mj_forward(model, data)
    view = soft(model, data, "soft0")
    start = view.control_positions.copy()
    run(model, data, 2)
    mujoco.mj_forward(model, data)
    before, now = (points - view.mass @ points / view.mass.sum() for points in (start, view.control_positions))
    turn = Rotation.align_vectors(now, before, weights=view.mass)[0]
    moved = view.mass @ (view.control_positions - start) / view.mass.sum()
    assert np.linalg.norm(moved[:2]) < 0.01
    assert np.degrees(turn.magnitude()) < 4
    assert np.abs(data.qvel).max() < 1e-5


@pytest.mark.parametrize(
    ("count", "young"),
    [(3, 5e4), pytest.param(3, 1e7, marks=pytest.mark.slow), pytest.param(5, 1e6, marks=pytest.mark.slow)],
)
def test_aligned_blocks_stand(count: int, young: float) -> None:
    body = block((8, 6, 4), 0.01, young, 3)
    placed = ((body, (0, 0, 0.0402 * i + 2e-4), UPRIGHT) for i in range(count))
    model, data = compiled(FLOOR.format(option=""), *placed)
    mujoco.mj_forward(model, data)
    start = middles(model, data, count)
    run(model, data, 5)
    assert np.abs(middles(model, data, count) - start)[:, :2].max() < 6e-4


@pytest.mark.parametrize("timestep", [0.0005, 0.004])
def test_a_block_rests_as_deep_as_a_rigid_one_whatever_the_step(timestep: float) -> None:
    """One affine frame cannot sag between its corners. R of a contact does not depend on the step or on stiffness."""
    rigid = mujoco.MjModel.from_xml_string(
        f'''<mujoco><option timestep="{timestep}"/><worldbody><geom type="plane" size="2 2 .1"/>
        <body pos="0 0 .0302"><freejoint/><geom type="box" size=".06 .06 .03" mass=".864" solref=".01 1"/></body>
        </worldbody></mujoco>'''
    )
    floor = '<mujoco><option timestep="{}"/><worldbody><geom type="plane" size="2 2 .1"/></worldbody></mujoco>'
    depths = []
    for model, data in (
        (rigid, mujoco.MjData(rigid)),
        compiled(
            floor.format(timestep),
            (block((12, 12, 6), 0.01, 5e4, 1), (0, 0, 2e-4), UPRIGHT),
            contact=Contact(dents=False),
        ),
    ):
        run(model, data, 2)
        assert data.ncon == 4
        depths.append(data.contact.dist)
    assert depths[1].mean() == pytest.approx(depths[0].mean(), rel=1e-4)
    assert depths[1] == pytest.approx(
        depths[0], rel=0.06
    )  # not all clusters are as large, and a contact is at both ends


def test_a_block_with_dents_rests_alike_whatever_the_step() -> None:
    depths = []
    for timestep in (0.0005, 0.004):
        option = f'timestep="{timestep}"'
        placed = (block((12, 12, 6), 0.01, 5e4, 1), (0, 0, 2e-4), UPRIGHT)
        model, data = compiled(FLOOR.format(option=option), placed, contact=Contact(dents=True))
        run(model, data, 4)
        assert np.abs(data.qvel).max() < 1e-6
        depths.append(data.contact.dist.mean())
    assert depths[1] == pytest.approx(depths[0], rel=1e-3)


@pytest.mark.parametrize("frames", [1, 5])
def test_friction_holds_a_block_on_a_slope_as_it_holds_a_rigid_one(frames: int) -> None:
    """Pyramids creep: a rigid box of MuJoCo by 1.32 mm/s at 20° and a friction of 1."""
    slope = np.radians(20)
    option = f'gravity="{-9.81 * np.sin(slope)} 0 {-9.81 * np.cos(slope)}"'
    scene = FLOOR.format(option=option).replace("1.5", "1")
    model, data = compiled(scene, (block((12, 12, 6), 0.01, 5e4, frames), (0, 0, 2e-4), UPRIGHT))
    run(model, data, 2)
    before = middles(model, data, 1)
    run(model, data, 0.2)
    assert 0 < (before - middles(model, data, 1))[0, 0] / 0.2 < 1.35e-3


@pytest.mark.parametrize(("degrees", "stands"), [(40, True), (47, False)])
@pytest.mark.parametrize("voxels", [4, 12])
def test_a_cube_stands_on_a_slope_and_tips_on_a_steep_one(voxels: int, degrees: float, stands: bool) -> None:
    """A rigid one tips at 45°. These do from 40.3°, as they fall onto it: contacts are a little inside the corners."""
    slope = np.radians(degrees)
    option = f'cone="elliptic" impratio="10" gravity="{-9.81 * np.sin(slope)} 0 {-9.81 * np.cos(slope)}"'
    cube = block((voxels, voxels, voxels), 0.06 / voxels, 1e6, 1)
    model, data = compiled(FLOOR.format(option=option), (cube, (0, 0, 2e-4), UPRIGHT))
    view, highest = soft(model, data, "soft0", body=cube), 0.0
    for _ in range(15):
        run(model, data, 0.1)
        highest = max(highest, float(view.positions([[0.0599, 0.03, 1e-4]])[0, 2]))
    assert (highest < 5e-3) == stands


@pytest.mark.parametrize("timestep", [pytest.param(0.001, marks=pytest.mark.slow), 0.002, 0.004])
@pytest.mark.parametrize(("size", "frames"), [((0.08, 0.08, 0.08), 8), ((0.08, 0.06, 0.04), 16)])
def test_a_block_comes_to_rest_at_any_step(size: tuple[float, float, float], frames: int, timestep: float) -> None:
    """Its bulging base lifts the corners a little: contacts that jumped to them shook it by 1 cm/s for ever."""
    body = build(Volume.box(size, Material(1e5, 0.3, 1000), voxels=4000), frames)
    placed = (body, (0, 0, size[2] / 2 + 5e-4), UPRIGHT)
    model, data = compiled(FLOOR.format(option=f'timestep="{timestep}"'), placed)
    run(model, data, 3)
    assert np.abs(data.qvel).max() < 2e-5
