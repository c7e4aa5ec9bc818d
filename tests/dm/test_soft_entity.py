"""A soft body as an entity of dm_control's composer: its MJCF, its poses, its materials, what is observed of it."""

from __future__ import annotations

import pytest

pytest.importorskip("dm_control")

import mujoco
import numpy as np
from builders.lengthwise import block
from builders.scenes import beam
from dm_control import composer
from dm_control.composer.variation import distributions

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.dm import SoftEntity

pytestmark = pytest.mark.dm_control
PLANE = {"type": "plane", "size": (1, 1, 0.1)}


def environment(*entities: SoftEntity, seed: int = 0, time_limit: float = 0.4) -> composer.Environment:
    arena = composer.Arena()
    arena.mjcf_model.option.noslip_iterations = 0
    arena.mjcf_model.worldbody.add("geom", **PLANE)
    for number, entity in enumerate(entities):
        arena.attach(entity).pos = (0, 0.3 * number, 0.05)
        entity.observables.enable_all()
    return composer.Environment(
        composer.NullTask(arena),
        time_limit,
        seed,
        recompile_mjcf_every_episode=False,
        strip_singleton_obs_buffer_dim=True,
    )


def last_observation(world: composer.Environment) -> dict[str, np.ndarray]:
    step = world.reset()
    while not step.last():
        step = world.step([])
    return step.observation


def test_what_pymjcf_writes_steps_to_the_bits_of_what_attach_writes() -> None:
    world = environment(SoftEntity(beam(beta=0.001), "meat"))
    world.reset()
    spec = mujoco.MjSpec.from_string("<mujoco><worldbody><geom type='plane' size='1 1 .1'/></worldbody></mujoco>")
    mf.attach(spec, beam(beta=0.001), "meat", pos=(0, 0, 0.05))
    model = spec.compile()
    ptr = world.physics.model.ptr
    model.opt.cone, model.opt.timestep = ptr.opt.cone, ptr.opt.timestep
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    world.physics.step(200)
    mujoco.mj_step(model, data, nstep=200)
    assert data.ncon > 0
    np.testing.assert_array_equal(world.physics.data.qpos, data.qpos)


def test_observations_are_what_the_view_says() -> None:
    bodies = {"meat": beam(beta=0.001), "bone": block(frame_type=("rigid", "affine", "rigid"))}
    entities = [SoftEntity(body, name, position=(0, 0.3 * n, 0.06), quaternion=(0.8, 0, -0.6, 0))
                for n, (name, body) in enumerate(bodies.items())]  # fmt: skip
    world = environment(*entities)
    seen = last_observation(world)
    forces = {}
    for entity, body in zip(entities, bodies.values(), strict=True):
        view = entity.soft(world.physics)
        mass, frame = body.control.mass, body.control.frame
        for word, of_points in (("positions", view.control_positions), ("velocities", view.control_velocities)):
            means = [mass[frame == f] @ of_points[frame == f] / mass[frame == f].sum() for f in np.unique(frame)]
            found = seen[f"{entity.mjcf_model.model}/frame_{word}"]
            np.testing.assert_allclose(found, means, atol=1e-6)  # of bodies, whose places MuJoCo has in six digits
        name = entity.mjcf_model.model
        np.testing.assert_allclose(seen[f"{name}/material_points"], view.positions(entity.points), atol=1e-12)
        assert len(entity.points) == 16
        forces[entity] = seen[f"{name}/contact_force"]
    assert any(force[2] > 0 for force in forces.values())
    world.physics.forward()  # dm_control leaves the constraints of the step before
    for entity in entities:
        expected = entity.soft(world.physics).contact_forces.sum(axis=0)
        found = entity.readings(world.physics).contact_force(world.physics.data.sensordata)
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_contact_force_counts_what_is_held() -> None:
    """A slab that is glued at its lower side carries a free one: what it is pushed with is the other's weight."""
    volume = mf.Volume.from_labels(np.ones((6, 6, 3), int), 0.01, {1: mf.Material(1e5, 0.3, 1000)})
    lower = SoftEntity(mf.build(volume, 2, supports=mf.Fixed(volume.side("-z"))), "lower")
    upper = SoftEntity(mf.build(volume, 2, damping=(20.0, 0.005)), "upper", position=(0, 0, 0.081))
    world = environment(lower, upper, time_limit=1.0)
    seen = last_observation(world)
    weight = 9.81 * world.physics.bind(upper.mjcf_model.worldbody.body["upper"]).subtreemass
    np.testing.assert_allclose(seen["lower/contact_force"], [0, 0, -weight], atol=1e-3 * weight)
    np.testing.assert_allclose(seen["upper/contact_force"], [0, 0, weight], atol=1e-3 * weight)


def test_poses_are_what_was_asked_for() -> None:
    entity = SoftEntity(block(frame_type=("rigid", "affine", "rigid")), "meat")
    world = environment(entity)
    world.reset()
    physics, pos, quat = world.physics, np.array([0.1, -0.2, 0.7]), np.array([0.5, 0.1, -0.7, 0.5])
    quat /= np.linalg.norm(quat)
    entity.set_pose(physics, pos, quat)
    physics.forward()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quat)
    view = entity.soft(physics)
    np.testing.assert_allclose(view.control_positions, view.rest @ turn.reshape(3, 3).T + pos, atol=1e-7)
    assert view.elastic_energy == pytest.approx(0, abs=1e-9)  # MuJoCo has places in six digits
    found = entity.get_pose(physics)
    np.testing.assert_allclose(found[0], pos, atol=1e-6)
    np.testing.assert_allclose(np.abs(found[1] @ quat), 1, atol=1e-9)
    entity.set_pose(physics, position=(0, 0, 0.5))
    np.testing.assert_allclose(np.abs(entity.get_pose(physics)[1] @ quat), 1, atol=1e-9)


def test_episodes_draw_material_and_pose_by_the_seed() -> None:
    def drawn(seed: int) -> list[np.ndarray]:
        place = distributions.Uniform((0.0, 0.0, 0.1), (0.1, 0.1, 0.2))
        entity = SoftEntity(
            beam(), "meat", stiffness=distributions.Uniform(0.5, 2.0), damping=(2.0, 3.0), position=place
        )
        world = environment(entity, seed=seed)
        found = []
        for _ in range(2):
            world.reset()
            found.append(np.concatenate([world.physics.model.ptr.numeric_data, entity.get_pose(world.physics)[0]]))
        return found

    first, again, other = drawn(3), drawn(3), drawn(4)
    np.testing.assert_array_equal(first, again)
    assert all((0.5 < some[0] < 2) and (some[-3:] > -1e-9).all() for some in first)
    assert first[0][0] != first[1][0] != other[0][0]
    assert all((some[-5:-3] == (2.0, 3.0)).all() for some in first)


def test_a_held_body_is_not_placed() -> None:
    mask = np.zeros((12, 4, 4), bool)
    mask[:2] = True
    entity = SoftEntity(block(supports=(mf.Fixed(mask),)), "meat")
    world = environment(entity)
    world.reset()
    with pytest.raises(MjframesError, match="is held by the scene"):
        entity.set_pose(world.physics, (0, 0, 1), (1, 0, 0, 0))


def test_taxels_feel_what_the_body_lies_on() -> None:
    """A grid on the lower side of a block bears it, one on the upper side feels nothing."""
    volume = mf.Volume.box((0.04, 0.04, 0.02), mf.Material(1e5, 0.4, 1000), spacing=0.004)
    grids = {
        side: mf.TaxelGrid((0, 0, 0), (0, 0, up), (0.04 - 1e-6, 0.04 - 1e-6), (4, 4))
        for side, up in (("below", -1), ("above", 1))
    }
    entity = SoftEntity(mf.build(volume, 1, damping=(2.0, 0.01)), "block", taxels=grids)
    world = environment(entity, time_limit=1.5)
    pressure = last_observation(world)["block/pressures"].reshape(2, 4, 4)
    weight = 9.81 * world.physics.named.model.body_subtreemass["block/block"]
    assert 0.01**2 * pressure[0].sum() == pytest.approx(weight, rel=0.02)
    assert not pressure[1].any()
