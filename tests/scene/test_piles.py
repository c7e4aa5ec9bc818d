"""Many soft bodies: the memory that a scene asks for, and the boxes that MuJoCo takes patches for."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, compiled, lump, move_points
from builders.stacked import block

from mjframes.scene.attach import attach
from mjframes.scene.carriers import carriers
from mjframes.scene.patches import ordered_patches
from mjframes.scene.scene_file import fragment
from mjframes.scene.solver import choose_solver
from mjframes.scene.view import soft

APART = 0.07  # [m] from one cube to the next, which are 0.06 m large


def cubes(count: int, memory: int = -1) -> mujoco.MjSpec:
    """A heap of cubes that do not touch."""
    spec = mujoco.MjSpec.from_string(FLOOR)
    spec.memory = memory
    for number, place in enumerate(itertools.islice(itertools.product(range(3), repeat=3), count)):
        attach(spec, block((6, 6, 6), 0.01, 1000.0), f"cube{number}", pos=(APART * np.array([*place]) + 0.1).tolist())
    return spec


def test_a_heap_of_soft_bodies_has_the_memory_that_it_needs() -> None:
    spec = cubes(22)
    choose_solver(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert data.ncon == 0
    kilobytes = 3.3 * (model.ngeom**2 / 2)  # of all pairs
    assert spec.nconmax * 0.6 < 1.3 * kilobytes


def test_memory_that_a_scene_asks_for_is_made_larger_and_never_smaller() -> None:
    assert cubes(8, memory=1 << 20).memory > 1 << 20
    assert cubes(8, memory=1 << 32).memory == 1 << 32


def test_what_holds_one_soft_body_asks_for_nothing() -> None:
    """MuJoCo prints a conflict where what is attached asks for memory, and the scene it goes into for none."""
    spec = fragment(lump())
    assert spec.memory == -1
    assert spec.nconmax == -1


def test_the_box_of_a_patch_holds_it_at_twice_its_size_whichever_way_it_is_turned_and_hardly_more() -> None:
    body = block((6, 6, 6), 0.01, 1000.0)
    model, data = compiled(FLOOR, (body, (0, 0, 1), (1, 0, 0, 0)))
    mujoco.mj_kinematics(model, data)
    vertices = body.contact.weights @ soft(model, data, "soft0").control_positions
    carried = carriers(body, {})
    patches = ordered_patches(body, carried, np.arange(len(carried)))
    assert len(patches) == model.ngeom - 1
    for geom, patch in enumerate(patches, 1):
        alike = [other for other in patches if other.carrier == patch.carrier]
        far = [np.linalg.norm(vertices[some.vertices] - data.geom_xpos[geom], axis=1).max() for some in (patch, *alike)]
        half = model.geom_aabb[geom, 3:]
        assert half.min() >= 2 * far[0] * (1 - 1e-5)
        assert half.max() < 2 * (max(far) + body.contact.reach)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_body_of_twice_its_length_touches_at_its_ends(axis: int, side: int) -> None:
    """A ball and another soft body that overlap an end by 2 mm."""
    body = block((6, 6, 6), 0.01, 1000.0)
    ball = '<body name="ball"><freejoint/><geom size="0.02"/></body>'
    model, data = compiled(FLOOR.replace("</worldbody>", ball + "</worldbody>"), (body, (0, 0, 1), (1, 0, 0, 0)),
                           (body, (1, 1, 1), (1, 0, 0, 0)))  # fmt: skip
    stretched, other = (soft(model, data, name) for name in ("soft0", "soft1"))
    stretch = np.ones(3)
    stretch[axis] = 2
    middle = body.contact.positions.mean(axis=0)
    move_points(model, data, stretched, (stretched.rest - middle) * stretch)
    toward = side * np.eye(3)[axis]
    move_points(model, data, other, other.rest - middle - 0.088 * toward)
    data.qpos[:3] = 0.078 * toward
    mujoco.mj_forward(model, data)
    touching = {frozenset(model.geom(g).name.split(":")[0] for g in contact.geom) for contact in data.contact}
    assert frozenset({"soft0", ""}) in touching
    move_points(model, data, other, other.rest - middle + 0.088 * toward)
    data.qpos[:3] = 5
    mujoco.mj_forward(model, data)
    touching = {frozenset(model.geom(g).name.split(":")[0] for g in contact.geom) for contact in data.contact}
    assert frozenset({"soft0", "soft1"}) in touching
