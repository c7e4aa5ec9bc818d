"""The scene of all motions: one body, a floor, two plates that move as they are told; its energy in every step.

Energy is that of the mass alone, ½ q̇ᵀ M q̇, the elastic one and the potential one: two sensors of ours and MuJoCo's
`data.energy[0]`, at the start of each step. What plates do to the body is the work of the contacts, Σ h f_c · q̇ at the
step's end: not their force times their own way, since MuJoCo's contacts do not know the velocity of a mocap body.

A step moves points straight along the tangent. One that turns a stiff body by φ stretches it, F = I + [φ]×, by an
elastic energy A φ⁴ that goes with the turning. `World.turning` is A, largest over the three axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.stability.states import jacobian, move_points
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.contact import Contact
from mjframes.scene.load import DIVERGED
from mjframes.scene.sensors import add_sensor
from mjframes.scene.solver import choose_solver
from mjframes.scene.view import Soft, soft

Array = NDArray[np.float64]
Plates = Callable[[float], tuple[float, float] | None]  # heights [m] of the plates' faces at a time [s], None: gone

GRAVITY = 9.81  # [m/s²]
NAME = "soft"
FLOOR, PLATES = "floor", ("below", "above")
FAR = 50.0  # [m] where the plates wait
OUT = np.array([-FAR, FAR])
HALF = 0.05  # [m] of a plate's thickness
ANGLE = 0.1  # [rad] of the turn that A is found from
SLIM = 1e-6  # [-] of the moments of inertia, for bodies that are squeezed to a line
LOOK = 50  # [steps] after which is looked whether MuJoCo has reset a state that is not finite

SCENE = f"""<mujoco><option gravity="0 0 -{GRAVITY}"><flag energy="enable"/></option><worldbody>
<geom name="{FLOOR}" type="plane" size="2 2 .1"/>
<body name="below" mocap="true" pos="0 0 -{FAR}"><geom name="below" type="box" size="1 1 {HALF}"/></body>
<body name="above" mocap="true" pos="0 0 {FAR}"><geom name="above" type="box" size="1 1 {HALF}"/></body>
</worldbody></mujoco>"""


@dataclass(frozen=True, eq=False)
class World:
    """A scene with one body.

    rest: (k, 3) control points at rest about the centre of mass [m].  start: where they are at qpos = 0 [m].
    surface: (s, k) weights of the skin's vertices.
    frame: (k,) of each control point.
    mass: [kg].  size: the longest distance of the surface from the centre, twice [m].
    turning: A [J/rad⁴].
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    view: Soft
    rest: Array
    start: Array
    surface: Array
    frame: NDArray[np.int64]
    mass: float
    size: float
    turning: float

    def reset(self, timestep: float, gravity: bool = False, floor: bool = False, plates: bool = False) -> None:
        """Go back to rest, with a time step [s], and say what there is of gravity, floor and plates."""
        mujoco.mj_resetData(self.model, self.data)
        self.model.opt.timestep = timestep
        self.model.opt.gravity[2] = -GRAVITY if gravity else 0
        for name, there in ((FLOOR, floor), *((plate, plates) for plate in PLATES)):
            self.model.geom(name).contype = self.model.geom(name).conaffinity = int(there)
        mujoco.mj_forward(self.model, self.data)

    def move(self, points: Array, velocities: Array | None = None) -> None:
        """Set the state from control points (k, 3) [m] and their velocities (k, 3) [m/s]."""
        move_points(self.view, points)
        if velocities is not None:
            mujoco.mj_forward(self.model, self.data)
            self.data.qvel[:] = np.linalg.lstsq(jacobian(self.view), velocities.ravel(), rcond=None)[0]
        mujoco.mj_forward(self.model, self.data)

    @property
    def elastic(self) -> float:
        """Return the elastic energy as the sensor has it, current after `mj_forward` [J]."""
        return float(self.data.sensordata[0])


@dataclass(frozen=True, eq=False)
class Course:
    """What a run came to; t steps.

    motion: (t,) kinetic and potential energy [J].  kinetic, elastic: (t,) [J].
    work: (t,) that contacts have done until then, where there are plates [J].
    turn: (t,) by how much the body turned in that step [rad].
    finite: whether MuJoCo never reset the state.
    """

    kinetic: Array
    motion: Array
    elastic: Array
    work: Array
    turn: Array
    finite: bool

    @property
    def total(self) -> Array:
        """Return the energy (t,) without the work of the plates [J]."""
        return self.motion + self.elastic - self.work


def world(body: SoftBody, contact: bool | Contact = True) -> World:
    """Return a scene with the body."""
    spec = mujoco.MjSpec.from_string(SCENE)
    attach(spec, body, NAME, contact=contact)
    for quantity in ("elastic_energy", "kinetic_energy"):
        add_sensor(spec, body, NAME, quantity)
    choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    view = soft(model, data, NAME).quiet()
    mass = view.mass
    start = view.control_positions
    rest = start - mass @ start / mass.sum()
    surface = np.asarray(body.skin.weights.todense())
    size = 2 * float(np.linalg.norm(surface @ rest, axis=1).max())
    frame = np.asarray(body.control.frame)
    made = World(model, data, view, rest, start, surface, frame, float(mass.sum()), size, 0.0)
    energies = []
    for axis in np.eye(3):
        move_points(view, rest + np.cross(ANGLE * axis, rest))
        mujoco.mj_forward(model, data)
        energies.append(made.elastic)
    return replace(made, turning=max(energies) / ANGLE**4)


def run(world: World, seconds: float, plates: Plates | None = None) -> Course:
    """Step the world from where it is.

    plates: where they are, the lower one first; without it they stay away.
    """
    model, data = world.model, world.data
    steps = round(seconds / model.opt.timestep)
    seen, states = np.zeros((steps, 4)), np.zeros((2, steps, model.nv))
    worked, finite, slides = 0.0, True, bool((model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE).all())
    for step in range(steps):
        if slides:
            states[0, step], states[1, step] = data.qpos, data.qvel
        mujoco.mj_step(model, data)
        seen[step] = data.energy[0], worked, *data.sensordata
        faces = plates(data.time) if plates is not None else None
        there = OUT if faces is None else np.array(faces) + HALF * np.array([-1, 1])
        data.mocap_pos[:, 2] = there
        if plates is not None:
            worked += model.opt.timestep * float(data.qfrc_constraint @ data.qvel)
        if step % LOOK == LOOK - 1 and data.warning.number[DIVERGED].any():
            finite = False
            break
    finite = finite and not data.warning.number[DIVERGED].any() and bool(np.isfinite(seen).all())
    potential, work, elastic, kinetic = seen.T
    turn = _rates(world, *states) * model.opt.timestep
    return Course(kinetic, kinetic + potential, elastic, work, turn, finite)


def _rates(world: World, qpos: Array, qvel: Array) -> Array:
    """|ω| (t,) of the rigid motion with the body's angular momentum, for states (t, nv) of slides [rad/s]."""
    mass = world.view.mass
    to_points = jacobian(world.view)
    x, v = (some @ to_points.T for some in (qpos, qvel))
    x = x.reshape(len(qpos), -1, 3) + world.start
    v = v.reshape(x.shape)
    x, v = (some - (mass @ some / world.mass)[:, None] for some in (x, v))
    momentum = np.einsum("k,tkc->tc", mass, np.cross(x, v))
    second = np.einsum("k,tka,tkb->tab", mass, x, x)
    spread = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    return np.linalg.norm(np.linalg.solve(spread * (1 + SLIM) - second, momentum[..., None])[..., 0], axis=1)
