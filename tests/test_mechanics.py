"""The reference itself: force as the energy's gradient, balance, and the stiffness's null space."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import distorted, lump
from scipy.spatial.transform import Rotation

from mjframes.mechanics import closest_rotation, cross_stack, region_energy, region_response

STATES = 100

Region = tuple[np.ndarray, np.ndarray, np.ndarray]


def regions() -> list[Region]:
    """x̄, ḡ and K_e of the regions of a body of three materials and two bones."""
    body = lump()
    parts = zip(body.stiffness.points, body.stiffness.gradient, body.stiffness.matrix, strict=True)
    return [(body.control.rest[points], gradient, matrix) for points, gradient, matrix in parts]


def is_firm(x: np.ndarray, gradient: np.ndarray) -> bool:
    """Whether the shape determines its rotation well, so that the force is the gradient of the energy (λ = 0)."""
    stretch = closest_rotation(x.T @ gradient).T @ x.T @ gradient
    return bool(np.linalg.eigvalsh(np.trace(stretch) * np.eye(3) - stretch)[0] > 0.11)


@pytest.fixture(params=range(len(regions())), ids="region {}".format)
def region(request: pytest.FixtureRequest) -> Region:
    return regions()[request.param]


def test_force_is_minus_the_gradient_of_the_energy(region: Region) -> None:
    rest, gradient, matrix = region
    rng = np.random.default_rng(0)
    step = 1e-5 * np.ptp(rest, axis=0).max()
    states = 0
    while states < STATES:
        x = distorted(rest, rng)
        if not is_firm(x, gradient):
            continue
        states += 1
        force, _ = region_response(x, rest, gradient, matrix)
        along = rng.normal(size=x.shape)
        ahead, behind = (region_energy(x + s * step * along, rest, gradient, matrix) for s in (1, -1))
        slope = (ahead - behind) / (2 * step)
        assert abs(slope + (force * along).sum()) < 1e-6 * np.linalg.norm(force)


def test_force_and_torque_are_balanced(region: Region) -> None:
    rest, gradient, matrix = region
    rng = np.random.default_rng(1)
    for state in range(STATES):
        x = distorted(rest, rng, mirrored=state % 2 == 1)
        force, _ = region_response(x, rest, gradient, matrix)
        arm = x - x.mean(axis=0)
        assert np.abs(force.sum(axis=0)).max() < 1e-10 * np.abs(force).sum()
        assert np.abs(np.cross(arm, force).sum(axis=0)).max() < 1e-10 * (np.abs(arm).max() * np.abs(force).sum())


def test_stiffness_is_positive_semidefinite_and_blind_to_rigid_motion(region: Region) -> None:
    rest, gradient, matrix = region
    rng = np.random.default_rng(2)
    for state in range(STATES):
        x = distorted(rest, rng, mirrored=state % 2 == 1)
        _, stiffness = region_response(x, rest, gradient, matrix)
        size = np.abs(stiffness).max()
        assert np.abs(stiffness - stiffness.T).max() < 1e-12 * size
        assert np.linalg.eigvalsh(stiffness)[0] > -1e-11 * size
        turns = cross_stack(x - x.mean(axis=0))
        assert np.abs(stiffness @ turns).max() < 1e-9 * size * np.abs(turns).max()
        assert np.abs(stiffness @ np.tile(np.eye(3), (len(x), 1))).max() < 1e-9 * size


def test_stiffness_is_the_hessian_at_rest(region: Region) -> None:
    rest, gradient, matrix = region
    rng = np.random.default_rng(3)
    _, stiffness = region_response(rest, rest, gradient, matrix)
    step = 1e-7 * np.ptp(rest, axis=0).max()
    for _ in range(10):
        along = rng.normal(size=rest.shape)
        ahead, behind = (region_response(rest + s * step * along, rest, gradient, matrix)[0] for s in (1, -1))
        change = (ahead - behind).ravel() / (2 * step)
        assert np.abs(change + stiffness @ along.ravel()).max() < 1e-6 * np.abs(change).max()


def test_energy_and_force_turn_with_the_body(region: Region) -> None:
    rest, gradient, matrix = region
    rng = np.random.default_rng(4)
    x = distorted(rest, rng)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    moved = x @ turn.T + shift
    assert region_energy(moved, rest, gradient, matrix) == pytest.approx(region_energy(x, rest, gradient, matrix))
    force, _ = region_response(x, rest, gradient, matrix)
    np.testing.assert_allclose(
        region_response(moved, rest, gradient, matrix)[0], force @ turn.T, atol=1e-10 * np.abs(force).max()
    )


@pytest.mark.parametrize("sign", [1, -1], ids=["upright", "inverted"])
def test_closest_rotation_is_proper_and_closest(sign: int) -> None:
    rng = np.random.default_rng(5)
    others = Rotation.random(2000, rng=rng).as_matrix()
    for _ in range(20):
        deformation = rng.normal(size=(3, 3))
        deformation *= sign * np.sign(np.linalg.det(deformation))
        rotation = closest_rotation(deformation)
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(rotation) == pytest.approx(1)
        reached = np.trace(rotation.T @ deformation)
        assert np.all(np.einsum("nab,ab->n", others, deformation) <= reached + 1e-12)
