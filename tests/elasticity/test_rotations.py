"""The gradients of regions of one frame and its parents: exact for linear maps, weighted by coupling."""

from __future__ import annotations

import numpy as np
import pytest
from builders.linked import MIXED
from builders.linked import body as bar
from builders.scenes import lump

from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.rotations import frame_gradients, frame_shares, region_gradient

MAP = np.array([[1.1, 0.3, -0.2], [0.1, 0.9, 0.4], [-0.3, 0.2, 1.2]])
BODIES = {
    "lump": lump,
    **{str(types): (lambda types=types: bar(types)) for types in ("quadratic", "rigid", "point", MIXED)},
    "on two links": lambda: bar(MIXED, ("upper", "lower")),
}

RNG = np.random.default_rng(0)
PARENTS, CHILD = np.repeat([0, 1], 4), np.full(4, 2)  # two affine frames and a third
FRAMES = np.concatenate([PARENTS, CHILD])
POINTS = RNG.normal(size=(12, 3))


@pytest.fixture(params=BODIES)
def body(request: pytest.FixtureRequest) -> SoftBody:
    return BODIES[request.param]()


def deformation(x: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    return np.einsum("jr,ja->ra", x, gradient)


def test_every_gradient_shows_linear_maps(body: SoftBody) -> None:
    """As far as the points reach: a line of them does not show what happens across."""
    frame, rest = body.control.frame, body.control.rest
    own = frame_gradients(rest, frame)
    for i in np.unique(frame):
        found = deformation(rest[frame == i] @ MAP.T + [1, 2, 3], own[frame == i])
        np.testing.assert_allclose(found, MAP if body.types[i] != "point" else 0, atol=1e-9)
    for points, gradient in zip(body.stiffness.points, body.stiffness.gradient, strict=True):
        offset = rest[points] - rest[points].mean(axis=0)
        reach = np.linalg.pinv(offset, rcond=1e-6) @ offset
        moved = rest[points] @ MAP.T + [1, 2, 3]
        np.testing.assert_allclose(deformation(moved, gradient) @ reach, MAP @ reach, atol=1e-8)


def test_frames_count_as_firmly_as_they_hold_the_child() -> None:
    stiffness = np.zeros((36, 36))
    stiffness[-1, 0], stiffness[-12, 13] = -3.0, 1.0
    shares = frame_shares(FRAMES, stiffness)
    np.testing.assert_allclose(shares[::4], [0.5 * 0.75, 0.5 * 0.25, 0.5])
    np.testing.assert_array_equal(frame_shares(CHILD, np.eye(12)), 1)
    np.testing.assert_array_equal(frame_shares(FRAMES, np.zeros((36, 36)))[::4], [0.25, 0.25, 0.5])


def test_a_region_is_turned_halfway_between_a_child_and_its_parents() -> None:
    turned = POINTS.copy()
    turned[8:] = POINTS[8:] @ MAP.T
    stiffness = RNG.normal(size=(36, 36))
    found = deformation(turned, region_gradient(POINTS, FRAMES, stiffness))
    np.testing.assert_allclose(found, 0.5 * (MAP + np.eye(3)), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_regions_of_single_points(count: int) -> None:
    """One fixes no rotation, two all but that about their line, three all."""
    rest, frame = POINTS[:count], np.arange(count)
    gradient = region_gradient(rest, frame, np.ones((3 * count, 3 * count)))
    assert np.linalg.matrix_rank(deformation(rest, gradient), tol=1e-9) == min(count - 1, 3)
    assert np.abs(gradient.sum(axis=0)).max() < 1e-12
