"""One run: disturb a body, let it go, relieve and damp it, see what has become of it.

First it moves undamped; its gain is the largest energy, elastic + kinetic (+ gravity), to that of the start. Then
load, gravity and contact go, velocities are damped, and the surface is compared with the one at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.stability.check.cases import FREE, HEAVY, IMPACT, LENGTH, LIGHT, Case, body
from benchmarks.stability.states import misfit, move_points, move_with
from mjframes.body.soft_body import SoftBody
from mjframes.scene.attach import attach
from mjframes.scene.view import Soft, soft

GRAVITY = 9.81  # [m/s²]
IMPACT_SPEED = (2 * 1e4 * GRAVITY * LENGTH) ** 0.5  # [m/s] stopped on one length it is 1e4 g; 34 m/s
CONTACT_TIME = 1e-3  # [s] of the contact's spring; MuJoCo makes it two steps at least
GAP = 1e-4  # [m] to the floor
FREE_STEPS = (100, 1000)  # of the undamped part, at least and at most; half a period between
DAMPED_STEPS = (1000, 160_000)  # of the damped part; forty periods between
PERIODS = 40.0
LEAST_DECAY = 0.98  # [-] of velocities in a damped step
LOOKS = 60  # at the energy in the undamped part, beside each of as many first steps
DAMPED_LOOKS = 240  # at the shape in the damped part
CALM = 4  # good looks at the shape, or at a body that rests in another one, one after another
BOUND = 1e4  # [m] beyond which a body has not survived
RECOVERED = 0.02  # [-] of the bar's length
RESTING = 1e-5  # [-] of E times the bar's length squared: with elastic forces below it is no use to wait

WARNINGS = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)

SCENE = """<mujoco><option gravity="0 0 {gravity}" timestep="{timestep}" integrator="{integrator}"/>
<worldbody>{things}</worldbody></mujoco>"""
FLOOR = '<geom type="plane" size="1 1 .1" priority="1" solref="{time} 1"/>'
WEIGHT = """<body name="weight" pos="0 0 {height}"><freejoint/>
<geom type="box" size="{size} {size} {half}" mass="{mass}" priority="2" solref="{time} 1"/></body>"""


@dataclass(frozen=True)
class Outcome:
    """What became of one case.

    gain: largest energy to that of the start [-].
    motion: its part that is not elastic.
    error: of the shape at the end, to the bar's length [-]; infinite for one that was not finite or within bounds any
    more, or that MuJoCo warned of.
    warning: MuJoCo's.
    """

    case: Case
    gain: float
    motion: float
    error: float
    warning: str

    @property
    def survives(self) -> bool:
        return self.error < np.inf

    @property
    def recovers(self) -> bool:
        return self.error < RECOVERED


def run(case: Case) -> Outcome:
    """Run a case from the disturbed start to the end."""
    made = body(case.kind, case.young)
    model, data = _scene(case, made)
    view = soft(model, data, "soft").quiet()
    _disturb(case, model, data, view)
    mujoco.mj_forward(model, data)
    energies = [_energy(view)]
    steps = int(np.clip(np.pi / case.frequency / case.timestep, *FREE_STEPS))
    alive = True
    for number in range(1, steps + 1):
        mujoco.mj_step(model, data)
        if number <= LOOKS or number % max(1, steps // LOOKS) == 0:
            alive = _alive(view)
            if not alive:
                break
            mujoco.mj_forward(model, data)
            energies.append(_energy(view))
    error = _relax(case, made, view) if alive else np.inf
    motion, elastic = np.transpose(energies)
    start = motion[0] + elastic[0]
    gain, moving = (motion + elastic).max() / start, motion.max() / start
    return Outcome(case, float(gain), float(moving), error, _warning(data))


def _relax(case: Case, made: SoftBody, view: Soft) -> float:
    """The shape's error at the end of the damped part."""
    model, data = view.model, view.data
    model.opt.gravity[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    decay = max(np.exp(-case.frequency * case.timestep), LEAST_DECAY)
    steps = int(np.clip(PERIODS * 2 * np.pi / case.frequency / case.timestep, *DAMPED_STEPS))
    stride = max(1, steps // DAMPED_LOOKS)
    calm, resting, error = 0, 0, np.inf
    for _ in range(steps // stride):
        for _ in range(stride):
            mujoco.mj_step(model, data)
            data.qvel *= decay
        if not _alive(view):
            return np.inf
        mujoco.mj_forward(model, data)
        error = misfit(made.skin.weights @ view.control_positions, made.skin.weights @ made.control.rest) / LENGTH
        calm = calm + 1 if error < RECOVERED else 0
        resting = resting + 1 if _rests(case, view) else 0
        if CALM in (calm, resting):
            break
    return error


def _rests(case: Case, view: Soft) -> bool:
    """Whether no force is left to move it; h K v is one of qfrc_passive, small where nothing moves."""
    return float(np.abs(view.data.qfrc_passive).max()) < RESTING * case.young * LENGTH**2


def _scene(case: Case, made: SoftBody) -> tuple[mujoco.MjModel, mujoco.MjData]:
    loaded = case.disturbance not in FREE
    weight = {HEAVY: 1e4, LIGHT: 1e-4}.get(case.disturbance, 0) * made.control.mass.sum()
    time = max(CONTACT_TIME, 2 * case.timestep)
    things = FLOOR.format(time=time) if loaded else ""
    if weight:
        things += WEIGHT.format(height=LENGTH, size=LENGTH, half=LENGTH / 4, mass=weight, time=time)
    gravity = -GRAVITY if weight else 0
    options = {"gravity": gravity, "timestep": case.timestep, "integrator": case.kind.integrator}
    spec = mujoco.MjSpec.from_string(SCENE.format(things=things, **options))
    attach(spec, made, "soft", pos=(-LENGTH / 2, -LENGTH / 4, GAP), contact=loaded)
    model = spec.compile()
    return model, mujoco.MjData(model)


def _disturb(case: Case, model: mujoco.MjModel, data: mujoco.MjData, view: Soft) -> None:
    mujoco.mj_forward(model, data)
    if case.disturbance == IMPACT:
        move_with(view, np.array([0, 0, -IMPACT_SPEED]))
    if case.disturbance not in FREE:
        return
    rng = np.random.default_rng(case.seed)
    x = view.control_positions
    middle = x.mean(axis=0)
    p = x - middle
    if case.disturbance == "scrambled":
        p = p + rng.uniform(-LENGTH, LENGTH, p.shape)
    elif case.disturbance == "mirrored":
        p = p * [-1, 1, 1] + 0.05 * LENGTH * rng.normal(size=p.shape)
    elif case.disturbance == "inside out":
        p = -p
    elif case.disturbance == "stretched 10×":
        p = p * [10, 1, 1]
    elif case.disturbance == "flattened":
        p = p * [1, 1, 1e-3]
    move_points(view, middle + p)


def _energy(view: Soft) -> tuple[float, float]:
    """Of motion and height of everything, and elastic [J]."""
    model, data, motion = view.model, view.data, view.kinetic_energy
    motion -= float(model.body_mass @ data.xipos @ model.opt.gravity)
    weight = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, "weight")
    if weight >= 0:
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, weight, twist, 1)
        motion += 0.5 * float(
            model.body_inertia[weight] @ twist[:3] ** 2 + model.body_mass[weight] * twist[3:] @ twist[3:]
        )
    return motion, view.elastic_energy


def _alive(view: Soft) -> bool:
    data = view.data
    finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    return bool(finite and np.abs(view.control_positions).max() < BOUND and not _warning(data))


def _warning(data: mujoco.MjData) -> str:
    return ", ".join(w.name.removeprefix("mjWARN_") for w in WARNINGS if data.warning[w].number)
