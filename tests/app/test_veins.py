"""Veins of the example: drawn on the skins of the materials that have them, and kept in the scene's XML."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np

import mjframes as mf
from examples.steak import draw_veins, vein_coordinates

RED, WHITE = (0.6, 0.1, 0.1, 1.0), (0.95, 0.9, 0.85)
LABELS = np.repeat([1, 2], 6)[:, None, None] * np.ones((12, 12, 4), int)
MEAT = mf.Material(1e4, 0.45, 1000, name="meat", rgba=RED)
PLAIN = mf.Material(1e4, 0.45, 1000, name="plain", rgba=RED)


def test_veins_are_as_far_apart_as_they_should_be() -> None:
    """Crossings of the middle of the texture along straight lines, in the mean over many of them."""
    line = np.linspace(0, 1, 20_000)
    for spacing in (0.01, 0.03):
        crossings = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            along = rng.normal(size=3)
            points = rng.uniform(-0.5, 0.5, 3) + line[:, None] * along / np.linalg.norm(along)
            crossings.append(np.count_nonzero(np.diff(vein_coordinates(points, spacing)[:, 0] > 0.5)))
        assert 0.3 < 1 / np.mean(crossings) / spacing < 1.2


def test_coordinates_are_in_the_middle_row() -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))
    found = vein_coordinates(points, 0.02)
    assert found.min() >= 0
    assert found.max() <= 1
    assert (found[:, 1] == 0.5).all()
    assert 0.05 < (np.abs(found[:, 0] - 0.5) < 0.25).mean() < 0.5  # veins are less than the rest


def test_a_saved_scene_has_its_veins() -> None:
    volume = mf.Volume.from_labels(LABELS, 0.005, {1: MEAT, 2: PLAIN})
    spec, body = mujoco.MjSpec(), mf.build(volume, 2)
    for name, pos in (("a", (0, 0, 0)), ("b", (0, 0, 1))):
        mf.attach(spec, body, name, pos=pos)
        draw_veins(spec, name, {"meat": WHITE})
    spec.compile()
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    veined, plain = model.skin("a:meat").id, model.skin("a:plain").id
    texture = model.mat_texid[model.skin_matid[veined], mujoco.mjtTextureRole.mjTEXROLE_RGB]
    assert (model.tex_height[texture], model.ntex) == (3, 2)
    row = model.tex_data[model.tex_adr[texture] :][: 3 * 256 * 3].reshape(3, 256, 3)[1]
    np.testing.assert_allclose(row[128] / 255, WHITE, atol=0.03)
    np.testing.assert_allclose(row[0] / 255, RED[:3], atol=0.03)
    start, count = model.skin_texcoordadr[veined], model.skin_vertnum[veined]
    u = model.skin_texcoord[start : start + count, 0]
    assert np.ptp(u) > 0.5
    assert model.skin_matid[plain] == -1
    np.testing.assert_allclose(model.skin_rgba[plain], RED, atol=1e-6)
    mf.detach(spec, "a")
    assert spec.compile().ntex == 1


def test_older_volumes_with_veins_are_read(tmp_path: Path) -> None:
    mf.Volume.from_labels(LABELS, 0.005, {1: MEAT, 2: PLAIN}).save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as archive:
        arrays = dict(archive)
    materials = json.loads(str(arrays["materials"]))
    materials["1"] |= {"veins": [1, 1, 1, 1], "vein_spacing": 0.02}
    materials["2"] |= {"veins": None, "vein_spacing": 0.03}
    np.savez(tmp_path / "b.npz", **{**arrays, "materials": json.dumps(materials)})
    assert mf.Volume.load(tmp_path / "b.npz").materials == {1: MEAT, 2: PLAIN}
