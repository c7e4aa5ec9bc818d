"""What is measured of a run, to tell why it ended as it did."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.stability.check.cases import CENTRES, LENGTH, VOLUME
from mjframes.elasticity.hyperelastic import HyperelasticRegion
from mjframes.scene.view import Soft

DEEP = 1.0  # [-] lengths of the bar
FAST = 0.5  # [rad] a step, at which a single free body of MuJoCo's is lost in 65 steps of its Euler integrator


@dataclass(frozen=True)
class End:
    """How a body is when its time is up.

    force: the largest elastic one along a degree of freedom, to E times the bar's length squared [-].
    speed: of the fastest control point [lengths of the bar / s].
    energy: elastic, to E times the volume [-].
    inverted: of the `samples`, at which the law knows F (quadrature points, or regions), and of the `voxels` those with
    det F < 0.
    earlier: error of the shape at half of the damped part [-].
    """

    force: float
    speed: float
    energy: float
    inverted: tuple[int, int]
    samples: int
    voxels: int
    earlier: float


@dataclass(frozen=True)
class Evidence:
    """What was measured of a run.

    steps: taken in all.
    time: they took [s].
    stiffness: the largest h²K/m found [-].
    rounding: what that may leave in the solution of a step, nv ε h²K/m [-].
    depth: deepest that the bar's middle was found below the floor, to its length [-].
    sank, spun: the first step at which it was DEEP below, and a rigid frame turned faster than FAST; 0 if none did.
    end: None where the body was lost before.
    """

    steps: int
    time: float
    stiffness: float
    rounding: float
    depth: float
    sank: int
    spun: int
    end: End | None


def stiffness_ratio(view: Soft) -> float:
    """Return the largest h²K/m along a degree of freedom [-]; needs mj_forward."""
    model, data = view.model, view.data
    diagonal = data.M[model.M_rowadr + model.M_rownnz - 1]
    return float((diagonal / model.dof_M0).max())


def turn(view: Soft) -> float:
    """Return the largest angle that a rigid frame turns by in a step, to its parent [rad]."""
    model, data = view.model, view.data
    balls = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_BALL]
    return float(model.opt.timestep * np.linalg.norm(data.qvel[balls[:, None] + np.arange(3)], axis=1).max(initial=0))


def rounding(view: Soft, stiffness: float) -> float:
    """Return nv ε h²K/m [-]: the part of the mass that the factors of M + h²K may have lost."""
    return float(view.model.nv * np.finfo(float).eps * stiffness)


def measure_end(view: Soft, young: float, earlier: float) -> End:
    """Return how the body is, and leave it at a stop; needs mj_forward."""
    speed = float(np.linalg.norm(view.control_velocities, axis=1).max() / LENGTH)
    energy = view.elastic_energy / (young * VOLUME)
    sampled, everywhere = np.linalg.det(_known_deformations(view)), np.linalg.det(view.deformation_gradients(CENTRES))
    inverted = int((sampled < 0).sum()), int((everywhere < 0).sum())
    force = elastic_force(view) / (young * LENGTH**2)
    return End(force, speed, energy, inverted, len(sampled), len(everywhere), earlier)


def elastic_force(view: Soft) -> float:
    """Return the largest elastic force along a degree of freedom [N]; stop the body.

    A rigid frame's points exert none on each other.
    """
    view.data.qvel[:] = 0
    mujoco.mj_forward(view.model, view.data)
    return float(np.abs(view.data.qfrc_passive).max())


def _known_deformations(view: Soft) -> np.ndarray:
    """F (q, 3, 3) of all regions at their quadrature points, or the mean of each."""
    x = view.control_positions
    found = []
    for region in view.regions:
        gradient = region.gradient if isinstance(region, HyperelasticRegion) else region.gradient[None]
        found.append(np.einsum("jr,qja->qra", x[region.points], gradient))
    return np.concatenate(found)
