"""What lies on a thin sheet is pushed back to where it came from, whatever its shape."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from builders.obstacles import lowest
from builders.scenes import compiled
from builders.tiers import tiered

from mjframes.body.build import build
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

SHEETS = {  # size and voxel [m]; the nodes of the distance field are half of the thickness apart, and more
    "of 8 mm": ((0.3, 0.12, 0.008), 0.004),
    "of 5 mm": ((0.3, 0.12, 0.005), 0.0025),
}
SHAPES = {
    "box": ("box", (0.02, 0.015, 0.02)),
    "plate": ("box", (0.02, 0.02, 0.003)),
    "cylinder": ("cylinder", (0.02, 0.02, 0)),
    "capsule": ("capsule", (0.012, 0.02, 0)),
    "ball": ("sphere", (0.012, 0, 0)),
}
POSES = 40


@pytest.mark.parametrize("sheet", tiered(SHEETS, lambda sheet: sheet == "of 5 mm"))
def test_they_are_pushed_back_by_whatever_is_in_them(sheet: str) -> None:
    """Corners that were 2 mm deep were pushed out on the other side, and of 5 mm none was felt."""
    extent, spacing = SHEETS[sheet]
    body = build(Volume.box(extent, Material(1e6, 0.3, 1000), spacing=spacing), 4)
    for name, (shape, size) in SHAPES.items():
        scene = f"""<mujoco><option gravity="0 0 0"/><worldbody>
          <body name="obstacle"><freejoint name="obstacle"/>
            <geom name="obstacle" type="{shape}" size="{" ".join(map(str, size))}" mass="1"/></body>
          </worldbody></mujoco>"""
        model, data = compiled(scene, (body, (0, 0, 0), (1, 0, 0, 0)))
        place, force = model.joint("obstacle").qposadr[0], model.joint("obstacle").dofadr[0] + 2
        rng = np.random.default_rng(2)
        for pose in range(POSES):
            quat = rng.normal(size=4)
            depth, (x, y) = rng.uniform(1e-3, 2e-3), rng.uniform((-0.09, -0.02), (0.09, 0.02))
            mujoco.mj_resetData(model, data)
            data.qpos[place : place + 7] = [x, y, 0, *quat / np.linalg.norm(quat)]
            mujoco.mj_kinematics(model, data)
            data.qpos[place + 2] = extent[2] / 2 - depth - lowest(model, data)
            mujoco.mj_forward(model, data)
            assert data.qfrc_constraint[force] > 0, (name, pose, depth)
