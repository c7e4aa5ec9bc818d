"""Which of MuJoCo's solvers suits how many degrees of freedom, and where its trees of boxes find out nothing.

Newton factors a matrix of all degrees of freedom in every iteration, and contacts of soft bodies fill it: n³
operations, fast ones where it is dense. Conjugate gradients multiply by it only, in its sparsity. Under elliptic cones
they need some forty iterations a step, and with a large `impratio` more than MuJoCo lets them have: then what a gripper
holds shakes.

Of two bodies with several geoms MuJoCo compares trees of boxes before geoms. What a soft body has may go far, so its
boxes overlap all that is near. Where rigid bodies with many geoms meet, as links of an arm do, trees pay.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import mujoco

from mjframes.base.errors import MjframesError
from mjframes.scene import plugin

FEW = 300  # degrees of freedom up to which dense Newton is faster than sparse conjugate gradients: 1.0 times at 240
FEW_ELLIPTIC = 600  # up to which it is faster than sparse Newton under elliptic cones: 0.6 times at 490
MANY = 16  # geoms up to which a body that stands still is faster without trees: by 17 % where a steak lies among them
MANY_MOVING = 4  # and one that moves: steps with arms of 6 boxes a link took 12 % longer without
STARTS = 12  # places in a triangle of a flex that MuJoCo looks for its lowest from: more find the same, ever slower
PATCH = mujoco.mjtGeom.mjGEOM_SDF  # the type of a soft body's geoms, of which no other body has many
MIDPHASE, CONTACT = mujoco.mjtDisableBit.mjDSBL_MIDPHASE, mujoco.mjtDisableBit.mjDSBL_CONTACT
WRONG_SPARSE = "4.0.0"  # its sparse Newton has a wrong Hessian: google-deepmind/mujoco#3767, mended in 4.0.1
JOINTS = {  # degrees of freedom of each type
    mujoco.mjtJoint.mjJNT_FREE: 6,
    mujoco.mjtJoint.mjJNT_BALL: 3,
    mujoco.mjtJoint.mjJNT_SLIDE: 1,
    mujoco.mjtJoint.mjJNT_HINGE: 1,
}


def choose_solver(spec: mujoco.MjSpec) -> None:
    """Set the solver of a spec, and the form of its Jacobians, by its friction cone and number of degrees of freedom.

    It also disables MuJoCo's midphase where this only costs time: without flexes and without bodies of many geoms. With
    flexes, whose contacts with soft bodies MuJoCo looks for from many places, it has it look from fewer. Call it when
    everything is attached.

    Parameters
    ----------
    spec
        The scene to change.

    Raises
    ------
    MjframesError
        For what is no `MjSpec`, as a compiled model.
    """
    if not isinstance(spec, mujoco.MjSpec):
        raise MjframesError(f"spec is a {type(spec).__name__}; give the scene as an MjSpec, before it is compiled.")
    freedom = sum(JOINTS[mujoco.mjtJoint(joint.type)] for joint in spec.joints)
    spec.option.solver, spec.option.jacobian = _best(freedom, spec.option.cone)
    if _has_idle_midphase(len(spec.flexes), _bodies_of(spec)):
        spec.option.disableflags |= MIDPHASE
    fields = [geom for geom in spec.geoms if geom.type == PATCH]
    if spec.flexes and all(geom.plugin.plugin_name == plugin.PATCH_NAME for geom in fields):
        spec.option.sdf_initpoints = min(spec.option.sdf_initpoints, STARTS)


def avoid_wrong_solver(spec: mujoco.MjSpec, version: str = mujoco.mj_versionString()) -> None:
    """Have MuJoCo 4.0.0 use dense Jacobians where a spec leaves the choice to it: its sparse Newton solver is wrong."""
    option = spec.option
    is_newton = option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    if version == WRONG_SPARSE and is_newton and option.jacobian == mujoco.mjtJacobian.mjJAC_AUTO:
        option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE


def rule() -> str:
    """Return the choice in a line."""
    return (
        f"Newton, dense, up to {FEW} degrees of freedom of a scene, CG, sparse, beyond; "
        'Newton under elliptic cones; "mjframes run" tells'
    )


def advice(model: mujoco.MjModel) -> str:
    """Return the <option> that would suit a scene better, "" where it has all of it."""
    solver, jacobian = _best(model.nv, model.opt.cone)
    names = {mujoco.mjtSolver.mjSOL_NEWTON: "Newton", mujoco.mjtSolver.mjSOL_CG: "CG"}
    form = "dense" if jacobian == mujoco.mjtJacobian.mjJAC_DENSE else "sparse"
    is_dense = not mujoco.mj_isSparse(model)
    is_best = model.opt.solver == solver and is_dense == (form == "dense")
    attributes = "" if is_best else f' solver="{names[solver]}" jacobian="{form}"'
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    geoms = [model.geom_type[touching & (model.geom_bodyid == body)].tolist() for body in range(model.nbody)]
    bodies = zip(model.body_weldid == 0, geoms, strict=True)
    if _has_idle_midphase(model.nflex, bodies) and not model.opt.disableflags & (MIDPHASE | CONTACT):
        return f'<option{attributes}><flag midphase="disable"/></option>'
    return f"<option{attributes}/>" if attributes else ""


def _bodies_of(spec: mujoco.MjSpec) -> Iterator[tuple[bool, list[int]]]:
    """Yield whether a body stands still, and the types of its geoms that touch."""
    left = [(spec.worldbody, True)]
    while left:
        body, is_still = left.pop()
        left += [(child, is_still and not child.joints) for child in body.bodies]
        yield is_still, [geom.type for geom in body.geoms if geom.contype or geom.conaffinity]


def _has_idle_midphase(flexes: int, bodies: Iterable[tuple[bool, list[int]]]) -> bool:
    """Whether trees of boxes only cost: of how many flexes there are, and of the bodies' touching geoms.

    A body of one such geom has no tree.
    """
    most = 0
    for is_still, geoms in bodies:
        most = max(most, len(geoms))
        if sum(kind != PATCH for kind in geoms) > (MANY if is_still else MANY_MOVING):
            return False
    return not flexes and most > 1


def _best(freedom: int, cone: int) -> tuple[mujoco.mjtSolver, mujoco.mjtJacobian]:
    is_elliptic = cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    is_wrong = is_elliptic and mujoco.mj_versionString() == WRONG_SPARSE
    if freedom <= (FEW_ELLIPTIC if is_elliptic else FEW) or is_wrong:
        return mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtJacobian.mjJAC_DENSE
    solver = mujoco.mjtSolver.mjSOL_NEWTON if is_elliptic else mujoco.mjtSolver.mjSOL_CG
    return solver, mujoco.mjtJacobian.mjJAC_SPARSE
