"""Scenes as MJCF text: of few letters, and the same model."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
from builders.scenes import lump

from mjframes.body.build import build
from mjframes.scene.attach import attach
from mjframes.scene.load import load_scene
from mjframes.scene.rounding import in_units
from mjframes.scene.scene_file import standalone_scene, write_scene
from mjframes.volume.volume import Volume

STEAK = Path(__file__).parents[2] / "models" / "steak.npz"
SKINS = ("skin_vert", "skin_texcoord", "skin_face", "skin_bonevertid", "skin_bonevertweight")
UNEVEN = """<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body>
<body name="b"><freejoint/><geom size=".1"/></body></worldbody><deformable>
<skin name="own" vertex="0 0 0 0.5 -0.25 10.5 0 1e-05 0" face="0 1 2">
<bone body="a" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="0.123456 0.2 1.5"/>
<bone body="b" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="0.876544 0.8 -0.5"/></skin>
<skin name="whole" vertex="0 0 0 1 0 0 0 1 0" face="0 1 2">
<bone body="a" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2" vertweight="1 1 1"/></skin>
</deformable></mujoco>"""


def written(spec: mujoco.MjSpec, path: Path) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """The model, and what is loaded from the scene that is written."""
    model = spec.compile()
    write_scene(spec, path)
    return model, load_scene(path)[0]


def test_the_steak_takes_about_a_megabyte(tmp_path: Path) -> None:
    volume = Volume.load(STEAK)
    spec = standalone_scene(build(volume, 3), volume, "steak")
    before, after = written(spec, tmp_path / "steak.xml")
    assert (tmp_path / "steak.xml").stat().st_size < 1.1e6 < len(spec.to_xml())
    for name in SKINS:
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=0, atol=3e-7)
    of_bones = re.findall(r' vertweight="([^"]*)"', (tmp_path / "steak.xml").read_text())
    assert len(of_bones) >= 3
    assert all(re.fullmatch(r"-?\d+( -?\d+)*", weights) for weights in of_bones)


def test_numbers_of_other_skins_stay_what_they_are(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(UNEVEN)
    attach(spec, lump(), "lump", pos=(0, 0, 1))
    before, after = written(spec, tmp_path / "scene.xml")
    for name in SKINS:
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=0, atol=3e-7)
    own = (tmp_path / "scene.xml").read_text().partition('<skin name="own"')[2]
    assert 'vertex="0 0 0 .5 -.25 10.5 0 1e-05 0"' in own
    assert 'vertweight="0.123456 0.2 1.5"' in own
    assert 'vertweight="1 1 1"' in own


def test_units_of_a_row_are_as_many_as_there_are() -> None:
    weights = lump().distance_field.weights
    units = in_units(weights, 1000)
    np.testing.assert_array_equal(units.sum(axis=1), 1000)
    assert np.abs(units - 1000 * weights).max() <= 1
