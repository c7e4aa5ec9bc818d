"""Equalities, limits and friction loss see the effective inertia as contacts do: R = (1 − imp)/imp J A⁻¹ Jᵀ."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import beam, dense_constraints, dense_inertia
from builders.shapes import mixed

import mjframes as mf
from mjframes.body.soft_body import SoftBody

EQUALITY, ROW = mujoco.mjtEq, mujoco.mjtConstraint
TORQUESCALE = 0.3
ARM = """<mujoco><option jacobian="{}"/><worldbody><body name="arm" pos="0 0 1">
<joint name="swing" axis="0 1 0" range="-1 -.5" limited="true" frictionloss=".1"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/><body name="hand" pos=".3 0 0">
<joint axis="0 1 0" range=".1 1" limited="true"/><geom size=".03"/></body></body></worldbody></mujoco>"""


def constrained(jacobian: str, exact: bool = False) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A robot's arm, a hanging beam and a body of rigid frames, with constraints of every kind."""
    spec = mujoco.MjSpec.from_string(ARM.format(jacobian))
    if exact:
        spec.option.enableflags = mujoco.mjtEnableBit.mjENBL_DIAGEXACT
    mf.attach(spec, beam(), "slides", pos=(1, 0, 1))
    mf.attach(spec, mf.build(mixed(), 3, frame_type="rigid"), "turns", pos=(2, 0, 1))
    named = {kind: [b.name for b in spec.bodies if b.name.startswith(kind)][1:] for kind in ("slides", "turns")}
    joints = [joint for joint in spec.joints if joint.name.startswith("slides")]
    body = mujoco.mjtObj.mjOBJ_BODY
    for kind in named:
        held = spec.add_equality(type=EQUALITY.mjEQ_CONNECT, objtype=body, name1=named[kind][2], name2="world")
        held.data[:3] = 0.01
    spec.add_equality(type=EQUALITY.mjEQ_CONNECT, objtype=body, name1=named["slides"][0], name2="hand")
    weld = spec.add_equality(type=EQUALITY.mjEQ_WELD, objtype=body, name1=named["turns"][0], name2="world")
    weld.data[10] = TORQUESCALE
    spec.add_equality(
        type=EQUALITY.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=joints[4].name, name2=joints[7].name
    )
    for number, sign in enumerate((1, -1)):
        tendon = spec.add_tendon(name=f"cord{number}", frictionloss=0.1, limited=True, range=(0.1, 1))
        tendon.wrap_joint(joints[2].name, 1)
        tendon.wrap_joint(joints[8].name, sign)
    spec.add_equality(type=EQUALITY.mjEQ_TENDON, objtype=mujoco.mjtObj.mjOBJ_TENDON, name1="cord0", name2="cord1")
    joints[5].frictionloss = 0.2
    joints[6].limited, joints[6].range = True, (0.01, 1)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(3):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    return model, data


def seen_inverse(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """diag J A⁻¹ Jᵀ (nefc,)."""
    rows = dense_constraints(model, data)
    return np.einsum("in,nm,im->i", rows, np.linalg.inv(dense_inertia(model, data)), rows)


def soft_rows(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(nefc,) whether a row has degrees of freedom of a soft body."""
    of_soft = model.body_plugin[model.dof_bodyid] >= 0
    return np.asarray(dense_constraints(model, data)[:, of_soft].any(axis=1))


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_all_rows_of_soft_bodies_have_the_ratio_of_regularization_that_is_asked_for(jacobian: str) -> None:
    model, data = constrained(jacobian)
    seen, rows = seen_inverse(model, data), soft_rows(model, data)
    equality = data.efc_id[: data.ne]
    for number in np.unique(equality):
        kind, own = int(model.eq_type[number]), np.flatnonzero(equality == number)
        if kind == int(EQUALITY.mjEQ_WELD):
            seen[own[3:]] = seen[own[3:]].mean() / TORQUESCALE**2
        if kind in (int(EQUALITY.mjEQ_WELD), int(EQUALITY.mjEQ_CONNECT)):
            seen[own[:3]] = seen[own[:3]].mean()
    impedance = data.efc_KBIP[:, 2]
    kinds = {int(kind) for kind in data.efc_type[rows]}
    assert kinds == set(range(5))  # equality, friction loss of joints and tendons, limits of both
    assert {int(model.eq_type[i]) for i in data.efc_id[: data.ne][rows[: data.ne]]} == {0, 1, 2, 3}
    np.testing.assert_allclose(data.efc_R[rows], (seen * (1 - impedance) / impedance)[rows], rtol=1e-6)
    np.testing.assert_allclose(data.efc_D, 1 / data.efc_R, rtol=1e-12)


def test_with_the_exact_diagonal_enabled_every_row_has_its_own() -> None:
    model, data = constrained("dense", exact=True)
    rows, impedance = soft_rows(model, data), data.efc_KBIP[:, 2]
    expected = seen_inverse(model, data) * (1 - impedance) / impedance
    np.testing.assert_allclose(data.efc_R[rows], expected[rows], rtol=1e-6)


def test_rows_without_soft_bodies_stay_as_they_are() -> None:
    model, data = constrained("dense")
    alone = mujoco.MjModel.from_xml_string(ARM.format("dense"))
    other = mujoco.MjData(alone)
    other.qpos[:] = data.qpos[: alone.nq]
    mujoco.mj_forward(alone, other)
    rigid = data.efc_R[~soft_rows(model, data)]
    assert len(rigid) == other.nefc == 3
    np.testing.assert_array_equal(rigid, other.efc_R)


@cache
def cube(young: float) -> SoftBody:
    material = mf.Material(young, 0.3, 1000)
    return mf.build(mf.Volume.from_labels(np.ones((6, 6, 6), int), 0.01, {1: material}), 3, damping=(5, 0.005))


def test_a_stiff_block_hangs_from_a_connect_as_high_as_a_rigid_one() -> None:
    sag = {}
    for young in (1e5, 1e9):
        spec = mujoco.MjSpec.from_string("<mujoco/>")
        mf.attach(spec, cube(young), "soft")
        held = next(body.name for body in spec.bodies if body.name.startswith("soft:"))
        connect = spec.add_equality(type=EQUALITY.mjEQ_CONNECT, name1=held, name2="world")
        connect.objtype = mujoco.mjtObj.mjOBJ_BODY
        connect.data[:3] = 0
        model = spec.compile()
        data = mujoco.MjData(model)
        for _ in range(4000):
            mujoco.mj_step(model, data)
        assert np.abs(data.qvel).max() < 1e-3
        sag[young] = float(np.linalg.norm(data.efc_pos[:3]))
    rigid = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="b"><freejoint/><geom type="box" size=".03 .03 .03"/></body></worldbody>'
        '<equality><connect body1="b" body2="world" anchor="0 0 .03"/></equality></mujoco>'
    )
    data = mujoco.MjData(rigid)
    for _ in range(2000):
        mujoco.mj_step(rigid, data)
    expected = float(np.linalg.norm(data.efc_pos[:3]))
    assert expected < sag[1e9] < 1.7 * expected
    assert sag[1e9] < sag[1e5]
