"""What patches keep from the collision stage to that of the rows changes no bit: it is used only where it is true."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, beam, compiled, dense_constraints

# A beam on a bed of balls, more of them than a patch keeps touches with, and on two things with other features.
BALLS = "".join(f'<geom size=".006" pos="{0.02 + 0.006 * i:.3f} .02 .004"/>' for i in range(22))
SCENE = """
<mujoco>
  <option jacobian="{jacobian}"/>
  <worldbody>
    <body name="lift" mocap="true"><geom name="lift" type="box" size=".01 .01 .006" pos=".22 .02 .005"/></body>
    <geom type="plane" size="1 1 .1"/>
    <geom type="cylinder" size=".004 .006" pos=".005 .02 .004"/>
    {balls}
  </worldbody>
</mujoco>
"""


def settled(jacobian: str = "dense") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The beam after a while, its positions known and its contacts found."""
    model, data = compiled(
        SCENE.format(jacobian=jacobian, balls=BALLS), (beam(beta=0.001), (0, 0, 0.009), (1.0, 0, 0, 0))
    )
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_fwdPosition(model, data)
    return model, data


def copied(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    """A copy whose plugins have never found contacts."""
    fresh = mujoco.MjData(model)
    mujoco.mj_copyData(fresh, model, data)
    return fresh


def rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """The constraint rows that the velocity stage writes, and their regularization."""
    mujoco.mj_fwdVelocity(model, data)
    return np.column_stack([dense_constraints(model, data), data.efc_R])


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_a_copy_between_the_stages_has_the_same_rows(jacobian: str) -> None:
    model, data = settled(jacobian)
    other = copied(model, data)
    touched = {tuple(sorted(contact.geom, key=lambda geom: model.geom_plugin[geom])) for contact in data.contact}
    assert max(Counter(patch for _, patch in touched).values()) > 4
    wanted = rows(model, other)
    np.testing.assert_array_equal(rows(model, data), wanted)
    np.testing.assert_array_equal(rows(model, data), wanted)  # and the stage may run again
    assert np.abs(wanted).max() > 0


def bend(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.qpos += 1e-4 * np.random.default_rng(1).normal(size=model.nq)


def lift(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    data.mocap_pos[0, 2] -= 1e-4


@pytest.mark.parametrize("change", [bend, lift])
def test_what_was_found_elsewhere_is_not_used(
    change: Callable[[mujoco.MjModel, mujoco.MjData], None],
) -> None:
    """The contacts are those of the old positions, and must not have rows as if nothing had moved."""
    model, data = settled()
    assert model.geom("lift").id in {geom for contact in data.contact for geom in contact.geom}
    kept = rows(model, copied(model, data))
    other = copied(model, data)
    for each in (data, other):
        change(model, each)
        mujoco.mj_kinematics(model, each)
        mujoco.mj_comPos(model, each)
    moved = rows(model, other)
    np.testing.assert_array_equal(rows(model, data), moved)
    assert not np.array_equal(moved, kept)


def test_a_distance_sensor_may_name_the_two_geoms_in_either_order() -> None:
    corners = " ".join(f"{x} {y} {z}" for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (-0.05, 0.05))
    scene = f"""<mujoco><asset><mesh name="slab" vertex="{corners}"/></asset>
      <worldbody><geom name="slab" type="sdf" mesh="slab" pos=".1 0 -.05"/></worldbody></mujoco>"""
    model, data = compiled(scene, (beam(beta=0.001), (0, 0, 0.002), (1.0, 0, 0, 0)))
    for _ in range(100):
        mujoco.mj_step(model, data)
    mujoco.mj_fwdPosition(model, data)
    wanted = rows(model, data)
    assert data.ncon > 4
    for turned in (False, True):
        mujoco.mj_fwdPosition(model, data)
        for first, second in {tuple(contact.geom) for contact in data.contact}:
            order = (second, first) if turned else (first, second)
            mujoco.mj_geomDistance(model, data, *order, 0.05, np.zeros(6))
        np.testing.assert_array_equal(rows(model, data), wanted)


@pytest.mark.parametrize("shift", [1e-6, 1e-3])
def test_a_contact_that_something_moved_acts_on_the_material_there(shift: float) -> None:
    """And not on the rigid body that MuJoCo takes the patch for; the other contacts of the pair keep their rows."""
    model, data = compiled(FLOOR, (beam(beta=0.001), (0, 0, 0), (1.0, 0, 0, 0)))
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_fwdPosition(model, data)
    wanted = dense_rows(model, data)
    first, second = data.contact[0], data.contact[1]
    assert first.geom.tolist() == second.geom.tolist()
    moved = np.arange(first.efc_address, second.efc_address)
    other = copied(model, data)
    for each in (data, other):
        each.contact[0].pos[0] += shift
        mujoco.mj_makeConstraint(model, each)
    rigid = dense_constraints(model, data)
    found = dense_rows(model, data)
    scale = np.abs(wanted[moved]).max()
    assert np.abs(wanted - rigid)[moved].max() > 0.3 * scale
    assert np.abs(found - wanted)[moved].max() < 0.1 * scale
    np.testing.assert_array_equal(np.delete(found, moved, 0), np.delete(wanted, moved, 0))
    np.testing.assert_array_equal(dense_rows(model, other), found)


def dense_rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """efc_J (nefc, nv) after the velocity stage."""
    return rows(model, data)[:, : model.nv]
