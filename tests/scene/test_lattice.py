"""The lattice below the contact surface: weights of 16 bits that leave bodies as they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.damaged import edited
from builders.deformed import lattice_weights
from scipy.ndimage import map_coordinates

from mjframes.body.build import build
from mjframes.scene.attach import attach
from mjframes.scene.plugin_text import decode, encode
from mjframes.scene.view import soft
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

STEAK = Path(__file__).parents[2] / "models" / "steak.npz"


def steak() -> Volume:
    return Volume.load(STEAK)


def sheet() -> Volume:
    return Volume.from_labels(np.ones((40, 40, 2), int), 0.01, {1: Material(1e5, 0.3, 1000)})


@pytest.mark.parametrize(
    ("volume", "frames", "kind"),
    [
        (steak, 3, "affine"),
        pytest.param(steak, 10, "affine", marks=pytest.mark.slow),
        (sheet, 4, "quadratic"),
    ],
)
def test_rounded_weights_leave_the_surface_where_it_is(volume: Callable[[], Volume], frames: int, kind: str) -> None:
    body = build(volume(), frames, frame_type=kind)
    spec = mujoco.MjSpec()
    attach(spec, body, "soft")
    model = spec.compile()
    view = soft(model, mujoco.MjData(model), "soft")
    shape, node, xi = (decode(view.configuration[f"lattice_{key}"]) for key in ("shape", "node", "vertex"))
    error = np.zeros((*shape, 3))
    exact = body.distance_field.weights @ body.control.rest
    error.reshape(-1, 3)[node] = lattice_weights(view) @ body.control.rest - exact
    of_vertices = [map_coordinates(error[..., c], xi.reshape(-1, 3).T, order=1) for c in range(3)]
    size = np.ptp(body.contact.positions, axis=0).max()
    # nodes outside of a sheet have weights of 28 and are off by up to 0.5 mm, but none of them is at a vertex
    assert np.linalg.norm(of_vertices, axis=0).max() < 1.3 * size / 2**15


def test_units_of_a_node_are_its_own() -> None:
    """Scaled by powers of two, another at each node, they leave contacts and motion what they are, to the bit."""
    pegs = "".join(f'<geom type="box" size=".008 .008 .03" pos="{0.03 * i - 0.1} 0 .03"/>' for i in range(12))

    def scene(weights: str) -> mujoco.MjModel:
        xml = edited("lattice_weight", r"[^\"]*", weights)
        return mujoco.MjModel.from_xml_string(xml.replace("<worldbody>", f"<worldbody>{pegs}", 1))

    get = soft(model := scene(r"\g<2>"), mujoco.MjData(model), "soft0").configuration
    size, of_node, weights = (decode(get[key]).astype(int) for key in ("set_size", "lattice_set", "lattice_weight"))
    few = np.sign(weights) * np.maximum(abs(weights) // 16, 1)
    scale = 2 ** np.random.default_rng(0).integers(0, 5, len(of_node))
    ends = []
    for some in (few, few * np.repeat(scale, size[of_node])):
        data = mujoco.MjData(model := scene(encode(some)))
        mujoco.mj_step(model, data, 300)
        ends.append(np.concatenate([data.qpos, *(np.r_[contact.pos, contact.dist] for contact in data.contact)]))
    assert len(ends[0]) >= 4 * 5 + len(data.qpos)
    np.testing.assert_array_equal(*ends)
