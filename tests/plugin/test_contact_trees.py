"""A soft body held by links of two kinematic trees touches the floor: rows dense or sparse, islands or none."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest
from builders.scenes import compiled, jumble

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Attached
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SHAPE, SPACING = (24, 6, 6), 0.01
DENSE, SPARSE = mujoco.mjtJacobian.mjJAC_DENSE, mujoco.mjtJacobian.mjJAC_SPARSE
CHOICES = [(jacobian, island) for jacobian in (DENSE, SPARSE) for island in (0, mujoco.mjtDisableBit.mjDSBL_ISLAND)]

TWO_ARMS = """<mujoco><option tolerance="0" iterations="100"/><worldbody>
<geom name="floor" type="plane" size="1 1 .1"/>
<body name="left" pos="0 .03 .03"><joint type="ball"/><geom size=".01" mass=".3" contype="0" conaffinity="0"/></body>
<body name="right" pos=".24 .03 .03"><joint axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
  <geom size=".01" mass=".2" contype="0" conaffinity="0"/></body>
</worldbody></mujoco>"""


@cache
def bridge() -> SoftBody:
    """A bar along x whose ends the two links hold; two frames between them."""
    end = np.zeros((2, *SHAPE), bool)
    end[0, :3] = end[1, -3:] = True
    attached = [Attached(link, mask) for link, mask in zip(("left", "right"), end, strict=True)]
    return build(
        Volume.from_labels(np.ones(SHAPE, int), SPACING, {1: Material(2e4, 0.35, 1000)}),
        2,
        frame_type=("affine", "rigid"),
        supports=attached,
    )


def accelerations(jacobian: int, island: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
    place = (bridge(), (0, 0, -0.01), (1, 0, 0, 0))
    model, data = compiled(TWO_ARMS, place, jacobian=jacobian, disableflags=int(island))
    jumble(model, data, np.random.default_rng(0), 0.01, 0.1)
    data.qvel[:] = np.random.default_rng(1).normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.filterwarnings("ignore::mjframes.scene.attach.BranchWarning")  # the bridge couples two trees
def test_dense_rows_hold_no_more_than_sparse_ones() -> None:
    """What the row of a contact has no room for, where its two bodies belong to other trees, it lacks everywhere."""
    model, data = accelerations(*CHOICES[0])
    view = soft(model, data, "soft0")
    assert len(set(model.body_treeid[view.bodies])) == 2
    assert len(set(model.body_treeid[model.geom_bodyid[data.contact.geom[:, 1]]])) == 2
    assert data.ncon >= 5
    for jacobian, island in CHOICES[1:]:
        other_model, other = accelerations(jacobian, island)
        assert mujoco.mj_isSparse(other_model) == (jacobian == SPARSE)
        assert (other.nisland > 0) == (island == 0)
        np.testing.assert_allclose(other.qacc, data.qacc, atol=1e-12 * np.abs(data.qacc).max())  # without the rule: 3.3
