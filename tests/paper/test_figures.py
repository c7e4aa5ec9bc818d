"""Figure 5 of the paper as numbers: a bar of three materials, from the volume to its displacement under a load."""

from __future__ import annotations

import numpy as np
import pytest

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.frames.supports import Fixed
from mjframes.kinematics.control import control_weights
from mjframes.volume.grid import voxel_grid
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

EDGE, AREA, FORCE = 0.01, 1e-4, 0.2  # [m], [m²], [N]
YOUNG = {1: 1e4, 2: 8e4, 3: 3e5}  # [Pa] without Poisson's ratio, as in the paper's one dimension
PARTS = [3] * 7 + [1] * 4 + [2] * 9


def bar_of_figure_5(method: str) -> SoftBody:
    """Clamps of one rigid voxel at both ends; the left one does not move, a frame is in the right one."""
    materials = {label: Material(young, 0.0, 1000) for label, young in YOUNG.items()} | {4: Material.rigid(1900)}
    labels = np.array([4, *PARTS, 4]).reshape(-1, 1, 1)
    left = np.zeros(labels.shape, bool)
    left[0] = True
    right = [((len(labels) - 0.5) * EDGE, EDGE / 2, EDGE / 2)]
    return build(
        Volume.from_labels(labels, EDGE, materials),
        at=right,
        supports=[Fixed(left)],
        method=method,
        metric="compliance",
    )


def pulled(body: SoftBody) -> np.ndarray:
    """(k, 3) of the control points where FORCE along x is spread over the right clamp: K u = Wᵀ f."""
    grid = voxel_grid(body.fields.volume)
    shapes = control_weights(body.fields.weights, body.control, grid.centers).toarray()
    size = len(body.control.frame)
    stiffness = np.zeros((3 * size, 3 * size))
    for points, matrix in zip(body.stiffness.points, body.stiffness.matrix, strict=True):
        dof = (3 * points[:, None] + np.arange(3)).ravel()
        stiffness[np.ix_(dof, dof)] += matrix
    load = np.zeros((size, 3))
    load[:, 0] = FORCE * shapes[-1]
    free = np.repeat(body.control.frame >= body.held, 3)
    moved = np.zeros(3 * size)
    moved[free] = np.linalg.solve(stiffness[free][:, free], load.ravel()[free])
    return shapes @ moved.reshape(-1, 3)


@pytest.mark.parametrize("method", ["paper", "whole_body"])
def test_figure_5(method: str) -> None:
    body = bar_of_figure_5(method)
    compliance = np.array([1 / YOUNG[label] for label in PARTS])
    along = (np.cumsum(compliance) - compliance / 2) / compliance.sum()  # of voxel centres, 0 at the left clamp
    weights = body.fields.weights.toarray()[1:-1]
    np.testing.assert_allclose(weights, np.stack([1 - along, along], axis=1), atol=1e-6)  # equation (5)

    moved = pulled(body)
    stretch = FORCE / AREA * EDGE * compliance.sum()  # of bars in series [m]
    # The clamps are a thousand times as stiff as the stiffest part: that is 1.2e-5 of the compliance of all. Frames of
    # the whole body are moments over voxels in which weights count as constant.
    bound = {"paper": 3e-5, "whole_body": 0.012}[method]  # the latter is what the solver leaves
    np.testing.assert_allclose(moved[1:-1, 0], stretch * along, atol=bound * stretch)
    assert np.abs(moved[:, 1:]).max() < 1e-6 * stretch
