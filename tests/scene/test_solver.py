"""The solver that suits the number of degrees of freedom."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled, lump

from mjframes.body.build import build
from mjframes.frames.supports import Fixed
from mjframes.scene.attach import attach
from mjframes.scene.scene_file import standalone_scene
from mjframes.scene.solver import (
    FEW,
    FEW_ELLIPTIC,
    MANY,
    MANY_MOVING,
    STARTS,
    WRONG_SPARSE,
    advice,
    avoid_wrong_solver,
    choose_solver,
)
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume


def chain(count: int) -> mujoco.MjSpec:
    """Bodies on a free, a ball and hinge and slide joints, `count` degrees of freedom."""
    spec = mujoco.MjSpec()
    free = spec.worldbody.add_body(mass=1, inertia=[1, 1, 1])
    free.add_joint(type=mujoco.mjtJoint.mjJNT_FREE)
    ball = free.add_body(mass=1, inertia=[1, 1, 1])
    ball.add_joint(type=mujoco.mjtJoint.mjJNT_BALL)
    for k in range(count - 9):
        body = spec.worldbody.add_body(mass=1, inertia=[1, 1, 1])
        body.add_joint(type=(mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)[k % 2])
    return spec


@pytest.mark.parametrize(("count", "solver", "sparse"), [(FEW, "NEWTON", False), (FEW + 1, "CG", True)])
def test_the_choice_is_by_degrees_of_freedom(count: int, solver: str, sparse: bool) -> None:
    spec = chain(count)
    choose_solver(spec)
    model = spec.compile()
    assert model.nv == count
    assert model.opt.solver == getattr(mujoco.mjtSolver, f"mjSOL_{solver}")
    assert bool(mujoco.mj_isSparse(model)) == sparse
    assert advice(model) == ""


@pytest.mark.parametrize(("count", "sparse"), [(FEW_ELLIPTIC, False), (FEW_ELLIPTIC + 1, True)])
def test_elliptic_cones_are_newtons(count: int, sparse: bool) -> None:
    """With CG and `impratio` 10 a box between two pads of 20 frames shook: 100 iterations were too few."""
    spec = chain(count)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    choose_solver(spec)
    model = spec.compile()
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert bool(mujoco.mj_isSparse(model)) == (sparse and mujoco.mj_versionString() != WRONG_SPARSE)
    assert advice(model) == ""


GRIPPER = """<mujoco><option gravity="0 0 0" cone="elliptic" impratio="10"/><worldbody>
  <body name="left" pos="-.03 0 0"><joint name="left" type="slide" axis="1 0 0" damping="5"/>
    <geom type="box" size=".003 .015 .02" mass=".1"/></body>
  <body name="right" pos=".03 0 0"><joint name="right" type="slide" axis="-1 0 0" damping="5"/>
    <geom type="box" size=".003 .015 .02" mass=".1"/></body>
  <body name="held"><freejoint/><geom type="box" size=".015 .015 .015" mass=".015"/></body></worldbody>
  <equality><joint joint1="left" joint2="right" solref=".005 1"/></equality>
  <actuator><motor joint="left"/></actuator></mujoco>"""


@pytest.mark.slow
def test_what_is_held_rests_with_the_chosen_solver() -> None:
    """It moved at 8.5 mm/s [root mean square] with CG."""
    volume = Volume.box((0.006, 0.03, 0.04), Material.named("silicone-00-50"), spacing=0.0015)
    spec = mujoco.MjSpec.from_string(GRIPPER)
    for link, glued, way in (("left", "-x", 1), ("right", "x", -1)):
        pad = build(volume, 14, supports=Fixed(volume.side(glued)), damping=(0, 0.002))
        attach(spec, pad, f"{link}_pad", link, pos=(0.006 * way, 0, 0))
    choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    assert model.nv > FEW
    places = []
    for step in range(400):
        data.ctrl[0] = 10 * min(1, step / 250)
        mujoco.mj_step(model, data)
        places.append(data.body("held").xpos.copy())
    speed = np.diff(places[350:], axis=0) / model.opt.timestep
    assert np.sqrt((speed**2).sum(axis=1).mean()) < 3e-4


@pytest.mark.parametrize(("version", "form"), [("4.0.0", "DENSE"), ("4.0.1", "AUTO"), ("3.17.0", "AUTO")])
def test_the_wrong_sparse_newton_is_avoided(version: str, form: str) -> None:
    spec, own, gradients = mujoco.MjSpec(), mujoco.MjSpec(), mujoco.MjSpec()
    own.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    gradients.option.solver = mujoco.mjtSolver.mjSOL_CG
    for one in (spec, own, gradients):
        avoid_wrong_solver(one, version)
    assert spec.option.jacobian == getattr(mujoco.mjtJacobian, f"mjJAC_{form}")
    assert own.option.jacobian == mujoco.mjtJacobian.mjJAC_SPARSE  # the user's own choice
    assert gradients.option.jacobian == mujoco.mjtJacobian.mjJAC_AUTO


def test_advice_is_what_would_be_chosen() -> None:
    assert advice(chain(FEW + 100).compile()) == '<option solver="CG" jacobian="sparse"/>'
    spec = chain(100)  # MuJoCo's automatic choice is a sparse one from 60 on
    assert advice(spec.compile()) == '<option solver="Newton" jacobian="dense"/>'
    assert advice(chain(30).compile()) == ""
    for _ in range(2):
        spec.worldbody.add_geom(size=[0.1, 0, 0])
    model = spec.compile()
    assert advice(model) == '<option solver="Newton" jacobian="dense"><flag midphase="disable"/></option>'
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    assert advice(spec.compile()) == '<option solver="Newton" jacobian="dense"/>'
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert advice(model) == '<option solver="Newton" jacobian="dense"/>'
    model.opt.disableflags = 0
    model.opt.solver, model.opt.jacobian = mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtJacobian.mjJAC_DENSE
    assert advice(model) == '<option><flag midphase="disable"/></option>'


def test_a_written_scene_has_it() -> None:
    body = lump()
    model = standalone_scene(body, body.fields.volume).compile()
    assert model.nv < FEW
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert not mujoco.mj_isSparse(model)


CLOTH = """<mujoco><worldbody><flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" dim="2" radius=".01"/>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("moves", "geoms", "trees"),
    [(False, MANY, False), (False, MANY + 1, True), (True, MANY_MOVING, False), (True, MANY_MOVING + 1, True)],
)
def test_trees_of_boxes_are_for_bodies_of_many_geoms(moves: bool, geoms: int, trees: bool) -> None:
    spec = mujoco.MjSpec()
    inner = spec.worldbody.add_frame(pos=[0, 0, 1]).attach_body(mujoco.MjSpec().worldbody.add_body(), "inner-", "")
    if moves:
        inner.add_joint()
    body = inner.add_body(pos=[0, 0, 1])
    for _ in range(geoms):
        body.add_geom(size=[0.1, 0, 0])
        body.add_geom(size=[0.1, 0, 0], contype=0, conaffinity=0)  # seen only
    body.add_body().add_geom(size=[0.1, 0, 0])
    attach(spec, lump(), "lump")
    assert ("midphase" in advice(spec.compile())) != trees
    choose_solver(spec)
    model = spec.compile()
    assert (model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MIDPHASE == 0) == trees
    assert advice(model) == ""


def test_trees_of_boxes_are_for_flexes() -> None:
    spec = mujoco.MjSpec.from_string(CLOTH)
    choose_solver(spec)
    model = spec.compile()
    assert model.opt.disableflags == 0
    assert advice(model) == ""


@pytest.mark.parametrize("flex", [False, True])
def test_a_cloth_is_looked_at_from_few_places(flex: bool) -> None:
    spec = mujoco.MjSpec.from_string(CLOTH) if flex else mujoco.MjSpec()
    attach(spec, lump(), "lump")
    choose_solver(spec)
    assert spec.option.sdf_initpoints == (STARTS if flex else mujoco.MjSpec().option.sdf_initpoints)


def test_contacts_are_the_same_without_trees() -> None:
    model, data = compiled(FLOOR, (lump(), (0, 0, 0), (1, 0, 0, 0)), (lump(), (0.01, 0, 0.06), (1, 0, 0, 0)))
    start, found = data.qpos.copy(), []
    for flags in (0, mujoco.mjtDisableBit.mjDSBL_MIDPHASE):
        model.opt.disableflags = flags
        data = mujoco.MjData(model)  # nothing kept from before
        data.qpos = start
        mujoco.mj_forward(model, data)
        found.append(np.array(sorted([*contact.geom, contact.dist, *contact.pos] for contact in data.contact)))
    assert len(found[0]) > 3
    np.testing.assert_array_equal(found[0], found[1])


def test_both_solvers_agree() -> None:
    body = lump()
    ends = []
    for solver, jacobian in (("NEWTON", "DENSE"), ("CG", "SPARSE")):
        model, data = compiled(FLOOR, (body, (0, 0, 0.02), (1, 0, 0, 0)))
        model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver}")
        model.opt.jacobian = getattr(mujoco.mjtJacobian, f"mjJAC_{jacobian}")
        mujoco.mj_resetData(model, data)
        mujoco.mj_step(model, data, 300)
        ends.append(data.xpos.copy())
    assert ends[0] == pytest.approx(ends[1], abs=5e-6)  # of a fall of 20 mm, over 300 steps
