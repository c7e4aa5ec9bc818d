"""The edits of `abuse`: each does one thing that MuJoCo lets a program do."""

from __future__ import annotations

import copy
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from mujoco import rollout

from mjframes.app.video import make_renderer
from mjframes.scene.view import soft, soft_names

Generator = np.random.Generator
Edit = Callable[["World", Generator], None]
EDITS: dict[str, Edit] = {}  # by name

SOLVERS = (mujoco.mjtSolver.mjSOL_NEWTON, mujoco.mjtSolver.mjSOL_CG)
INTEGRATORS = (
    mujoco.mjtIntegrator.mjINT_EULER,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    mujoco.mjtIntegrator.mjINT_IMPLICIT,
)


class World:
    """A scene, its model and data.  datas: how many of its mjDatas may tell the same."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        self.spec = spec
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.datas = 1
        mujoco.mj_forward(self.model, self.data)

    def changed(self) -> None:
        """Start anew after changes to the model, which data in use do not see, as MuJoCo asks for."""
        self.data = mujoco.MjData(self.model)
        self.datas += 1
        mujoco.mj_forward(self.model, self.data)


def _edit(edit: Edit) -> Edit:
    EDITS[edit.__name__.strip("_")] = edit
    return edit


@_edit
def _step(world: World, rng: Generator) -> None:
    mujoco.mj_step(world.model, world.data, nstep=int(rng.integers(1, 60)))


@_edit
def _forward(world: World, rng: Generator) -> None:
    for _ in range(rng.integers(1, 4)):
        mujoco.mj_forward(world.model, world.data)


@_edit
def _inverse(world: World, rng: Generator) -> None:
    world.data.qacc[:] = rng.normal(size=world.model.nv)
    mujoco.mj_inverse(world.model, world.data)


@_edit
def _halves(world: World, rng: Generator) -> None:
    mujoco.mj_step1(world.model, world.data)
    world.data.ctrl[:] = rng.normal(size=world.model.nu)
    mujoco.mj_step2(world.model, world.data)


@_edit
def _throw(world: World, rng: Generator) -> None:
    world.data.qvel[:] += rng.normal(size=world.model.nv) * 10 ** rng.uniform(-2, 1)


@_edit
def _scramble(world: World, rng: Generator) -> None:
    turned = rng.normal(size=world.model.nv) * 10 ** rng.uniform(-3, -1)
    mujoco.mj_integratePos(world.model, world.data.qpos, turned, 1.0)


@_edit
def _push(world: World, rng: Generator) -> None:
    world.data.xfrc_applied[rng.integers(1, world.model.nbody)] = rng.normal(size=6) * 10 ** rng.uniform(-3, 1)


@_edit
def _steer(world: World, rng: Generator) -> None:
    world.data.ctrl[:] = rng.normal(size=world.model.nu)
    world.data.mocap_pos[:] = rng.uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.6), (world.model.nmocap, 3))


@_edit
def _weld(world: World, rng: Generator) -> None:
    world.data.eq_active[:] = rng.integers(0, 2, world.model.neq)


@_edit
def _reset(world: World, rng: Generator) -> None:
    mujoco.mj_resetData(world.model, world.data)
    if rng.random() < 0.5:
        mujoco.mj_forward(world.model, world.data)


@_edit
def _copy_data(world: World, rng: Generator) -> None:
    if rng.random() < 0.5:
        world.data = copy.copy(world.data)
    else:
        other = mujoco.MjData(world.model)
        mujoco.mj_copyData(other, world.model, world.data)
        world.data = other
    world.datas += 1


@_edit
def _copy_model(world: World, rng: Generator) -> None:
    del rng
    world.model = copy.copy(world.model)
    world.changed()


@_edit
def _state(world: World, rng: Generator) -> None:
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.empty(mujoco.mj_stateSize(world.model, kind))
    mujoco.mj_getState(world.model, world.data, state, kind)
    mujoco.mj_step(world.model, world.data, nstep=int(rng.integers(1, 10)))
    mujoco.mj_setState(world.model, world.data, state, kind)


@_edit
def _recompile(world: World, rng: Generator) -> None:
    if rng.random() < 0.5:
        mujoco.MjData(world.model)  # where the plugin refuses its options, recompile would end the process
        world.model, world.data = world.spec.recompile(world.model, world.data)
        world.datas += 1
    else:
        world.model = mujoco.MjModel.from_xml_string(world.spec.to_xml())
        world.changed()


@_edit
def _resize(world: World, rng: Generator) -> None:
    """Sizes of rigid geoms, as domain randomization changes them, while data are in use."""
    geom = world.model.geom(str(rng.choice(["box", "ball", "capsule", "egg", "arm", "hand"])))
    world.model.geom_size[geom.id] *= rng.uniform(0.3, 2)
    world.model.geom_rbound[geom.id] = np.linalg.norm(world.model.geom_size[geom.id]) + 0.01
    world.model.geom_aabb[geom.id, 3:] = world.model.geom_rbound[geom.id]


@_edit
def _surface(world: World, rng: Generator) -> None:
    model = world.model
    model.geom_friction[:] *= rng.uniform(0.3, 2)
    model.geom_margin[rng.integers(model.ngeom)] = rng.choice([0, 0.002])
    model.geom_solref[:, 0] = rng.choice([0.004, 0.02])
    model.geom_condim[rng.integers(model.ngeom)] = rng.choice([1, 3, 4, 6])
    some = rng.integers(model.ngeom)
    model.geom_contype[some] = model.geom_conaffinity[some] = rng.integers(0, 2)


@_edit
def _heavier(world: World, rng: Generator) -> None:
    factor = rng.uniform(0.5, 2)
    world.model.body_mass[:] *= factor
    world.model.body_inertia[:] *= factor
    mujoco.mj_setConst(world.model, world.data)


@_edit
def _timestep(world: World, rng: Generator) -> None:
    world.model.opt.timestep = 10 ** rng.uniform(-4, -2)


@_edit
def _option(world: World, rng: Generator) -> None:
    option = world.model.opt
    option.solver = rng.choice(SOLVERS)
    option.cone = rng.integers(0, 2)
    option.impratio = 10 ** rng.uniform(0, 2)
    option.iterations, option.tolerance = int(rng.integers(1, 100)), 10 ** rng.uniform(-12, -4)
    option.jacobian = rng.integers(0, 3)
    option.gravity[:] = rng.normal(size=3) * 5
    option.density, option.viscosity = rng.choice([0, 1.2]), rng.choice([0, 1e-5])
    world.changed()


@_edit
def _integrator(world: World, rng: Generator) -> None:
    world.model.opt.integrator = rng.choice(INTEGRATORS)
    world.changed()


@_edit
def _any_option(world: World, rng: Generator) -> None:
    """Also what the plugin refuses, of data in use and of new ones."""
    option = world.model.opt
    option.solver, option.integrator = rng.integers(0, 3), rng.integers(0, 4)
    option.noslip_iterations = rng.integers(0, 3)
    option.sdf_initpoints, option.sdf_iterations = rng.integers(0, 20), rng.integers(1, 12)
    if rng.random() < 0.5:
        world.changed()


@_edit
def _flags(world: World, rng: Generator) -> None:
    option = world.model.opt
    option.disableflags = 1 << rng.integers(0, 18) if rng.random() < 0.6 else 0
    option.enableflags = 1 << rng.integers(0, 5) if rng.random() < 0.4 else 0
    if rng.random() < 0.5:
        world.changed()


@_edit
def _ray(world: World, rng: Generator) -> None:
    points, directions = rng.uniform(-0.3, 0.6, (8, 3)), rng.normal(size=(8, 3))
    found = np.zeros(1, np.int32)
    for point, direction in zip(points, directions, strict=True):
        mujoco.mj_ray(world.model, world.data, point, direction, None, 1, -1, found)
    distance, geoms = np.zeros(8), np.zeros(8, np.int32)
    normals = [np.zeros(24)] if "normal" in (mujoco.mj_multiRay.__doc__ or "") else []
    mujoco.mj_multiRay(
        world.model, world.data, points[0], directions.ravel(), None, 1, -1, geoms, distance, *normals, 8, 10.0
    )


@_edit
def _pick(world: World, rng: Generator) -> None:
    option, shown, camera = mujoco.MjvOption(), mujoco.MjvScene(world.model, 2000), mujoco.MjvCamera()
    option.geomgroup[:] = 1
    mujoco.mjv_updateScene(world.model, world.data, option, None, camera, int(mujoco.mjtCatBit.mjCAT_ALL), shown)
    point, geom, flex, skin = np.zeros(3), np.zeros(1, np.int32), np.zeros(1, np.int32), np.zeros(1, np.int32)
    x, y = rng.random(2)
    mujoco.mjv_select(world.model, world.data, option, 1.5, x, y, shown, point, geom, flex, skin)


@_edit
def _render(world: World, rng: Generator) -> None:
    """Colours, depths or segments, with any of what MuJoCo can show."""
    renderer = make_renderer(world.model, 64, 48)
    try:
        kind = rng.integers(3)
        if kind == 1:
            renderer.enable_depth_rendering()
        elif kind == 2:
            renderer.enable_segmentation_rendering()
        option = mujoco.MjvOption()
        option.flags[:] = rng.random(option.flags.size) < 0.5
        option.geomgroup[:] = 1
        option.frame = rng.integers(mujoco.mjtFrame.mjNFRAME)
        if kind < 2:  # MuJoCo takes the colours of text, fog and sky for segments
            option.label = rng.integers(mujoco.mjtLabel.mjNLABEL)
        renderer.update_scene(world.data, int(rng.integers(-1, world.model.ncam)), option)
        if kind < 2:
            renderer.scene.flags[:] = rng.random(renderer.scene.flags.size) < 0.5
        renderer.render()
    finally:
        renderer.close()


@_edit
def _cloth(world: World, rng: Generator) -> None:
    """How flexes touch, where the scene has any."""
    model = world.model
    model.flex_friction[:] *= rng.uniform(0.3, 2)
    model.flex_solref[:, 0] = rng.choice([0.004, 0.02])
    model.flex_radius[:] = rng.choice([0.001, 0.005])
    model.flex_margin[:] = rng.choice([0, 0.002])
    model.flex_condim[:] = rng.choice([1, 3, 4, 6])
    model.flex_contype[:] = model.flex_conaffinity[:] = rng.random() < 0.7


@_edit
def _distance(world: World, rng: Generator) -> None:
    some, other = rng.integers(world.model.ngeom, size=2)
    mujoco.mj_geomDistance(world.model, world.data, int(some), int(other), 0.2, np.zeros(6))


@_edit
def _read(world: World, rng: Generator) -> None:
    del rng
    model, data = world.model, world.data
    mujoco.mj_fullM(model, data, np.zeros((model.nv, model.nv)))
    mujoco.mj_energyPos(model, data)
    mujoco.mj_energyVel(model, data)
    mujoco.mj_subtreeVel(model, data)
    mujoco.mj_rnePostConstraint(model, data)
    for name in soft_names(model):
        soft(model, data, name).quiet().elastic_energy  # noqa: B018


@_edit
def _threads(world: World, rng: Generator) -> None:
    """The model in two threads at once, each with data of its own."""
    steps = int(rng.integers(1, 30))
    datas = [copy.copy(world.data) for _ in range(2)]
    world.datas += 2
    with ThreadPoolExecutor(2) as pool:
        for job in [pool.submit(mujoco.mj_step, world.model, data, steps) for data in datas]:
            job.result()
    alike = np.array_equal(datas[0].qpos, datas[1].qpos, equal_nan=True)
    if not alike:
        raise AssertionError("two threads step the same state to different bits")


@_edit
def _rollout(world: World, rng: Generator) -> None:
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(world.model, kind))
    mujoco.mj_getState(world.model, world.data, state, kind)
    datas = [mujoco.MjData(world.model) for _ in range(2)]
    world.datas += 2
    rollout.rollout(world.model, datas, np.tile(state, (3, 1)), nstep=int(rng.integers(1, 10)))
