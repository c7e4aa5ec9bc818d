"""Pictures of a scene: from the camera that is named, from a place of one's own, or from the scene's first camera."""

from __future__ import annotations

from typing import Any, cast

import mujoco
import numpy as np
import pytest

import mjframes as mf

SCENE = """
<mujoco><worldbody>
  <light pos="0 0 3"/>
  <camera name="top" pos="0 0 2" fovy="45"/>
  <camera name="side" pos="2 0 0" xyaxes="0 1 0 0 0 1" fovy="45"/>
  <geom type="box" size=".1 .4 .2" rgba="1 0 0 1"/>
</worldbody></mujoco>
"""


def red(picture: np.ndarray) -> tuple[int, int]:
    """Width and height of what is red [pixels]."""
    rows, columns = np.nonzero(picture[..., 0] > picture[..., 1].astype(int) + 20)
    return int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


def test_what_is_no_model_or_no_state_is_refused() -> None:
    model, other = mujoco.MjModel.from_xml_string(SCENE), cast(Any, 5)
    for call in (
        lambda: mf.still(other, other),
        lambda: mf.soft(other, other, "a"),
        lambda: mf.film(other, "a.mp4").__enter__(),
    ):
        with pytest.raises(mf.MjframesError, match=r"^model is a int; give the MjModel"):
            call()
    for call in (lambda: mf.still(model, other), lambda: mf.soft(model, other, "a")):
        with pytest.raises(mf.MjframesError, match=r"^data is a int; give the MjData of the model\.$"):
            call()


def test_a_still_is_taken_by_the_camera_that_is_named() -> None:
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    side = mf.still(model, data, "side", (320, 240))
    top = mf.still(model, data, "top", (320, 240))
    assert side.shape == (240, 320, 3)
    assert red(side)[0] > 1.8 * red(side)[1]  # 80 cm wide, 40 high
    assert red(top)[1] > 3 * red(top)[0]  # 20 cm wide, 80 high
    assert (mf.still(model, data, size=(320, 240)) == top).all()
    own = mf.still(model, data, mf.look_from((0, 0, 0), 2, 180, 0), (320, 240))
    assert red(own) == pytest.approx(red(side), abs=2)
    with pytest.raises(mf.MjframesError, match=r"camera 'back' is not in the scene; its cameras are top, side\.$"):
        mf.still(model, data, "back")
