"""The reference itself: force as the energy's gradient, balance, the stiffness's null space, and how regions turn."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from builders.linked import MIXED
from builders.linked import body as bar
from builders.scenes import distorted, in_space, lump
from scipy.spatial.transform import Rotation

from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.corotational import (
    AGREEING,
    OPPOSED,
    SOFT_TWIST,
    CorotationalRegion,
    Fallback,
    closest_rotation,
    cross_stack,
    trust,
)
from mjframes.scene.view import soft

STATES = 100


@cache
def regions() -> dict[str, CorotationalRegion]:
    """Of a body of three materials and two bones by both methods, and of bodies of all types of frames."""
    bodies = {"lump by regions": lump(method="paper"), "lump": lump()}
    bodies |= {str(name): bar(name) for name in ("quadratic", "rigid", "point", MIXED)}
    return {f"{name}, region {e}": region for name, body in bodies.items() for e, region in enumerate(regions_of(body))}


def regions_of(body: SoftBody) -> list[CorotationalRegion]:
    return [some for some in soft(*in_space(body), "soft0").regions if isinstance(some, CorotationalRegion)]


def fallback_of(region: CorotationalRegion) -> Fallback:
    assert region.fallback is not None
    return region.fallback


@pytest.fixture(params=regions())
def region(request: pytest.FixtureRequest) -> CorotationalRegion:
    return regions()[request.param]


@pytest.fixture(params=[name for name, region in regions().items() if region.fallback])
def child(request: pytest.FixtureRequest) -> CorotationalRegion:
    """What a frame adds to its parents."""
    return regions()[request.param]


def is_firm(region: CorotationalRegion, x: np.ndarray) -> bool:
    """Whether the shape determines its rotation well: then the force is the gradient of the energy (λ = 0, θ = 1)."""
    theta, gradient = region.effective_gradient(x)
    stretch = closest_rotation(x.T @ gradient).T @ x.T @ gradient
    twist = np.linalg.eigvalsh(np.trace(stretch) * np.eye(3) - stretch)[0]
    return bool(theta == 1 and twist > 1.01 * SOFT_TWIST)


def turned_over(region: CorotationalRegion, x: np.ndarray) -> np.ndarray:
    """The child's points mirrored at their middle, through the parents' middle where it has but one."""
    moved, parents = x.copy(), fallback_of(region).parents
    middle = x[parents:].mean(axis=0) if len(x) - parents > 1 else x[:parents].mean(axis=0)
    moved[parents:] = 2 * middle - x[parents:]
    return moved


def states(region: CorotationalRegion, seed: int, size: float = 0.3) -> list[np.ndarray]:
    """Ordinary ones, mirrored ones, and with the child turned over, in turns."""
    rng = np.random.default_rng(seed)
    some = [distorted(region.rest, rng, size, mirrored=n % 3 == 1) for n in range(STATES)]
    return [turned_over(region, x) if n % 3 == 2 and region.fallback else x for n, x in enumerate(some)]


def test_force_is_minus_the_gradient_of_the_energy(region: CorotationalRegion) -> None:
    rng = np.random.default_rng(0)
    step = 3e-7 * np.ptp(region.rest, axis=0).max()
    tried = 0
    for x in states(region, 0, 0.15):
        if not is_firm(region, x):
            continue
        tried += 1
        force, _ = region.response(x)
        along = rng.normal(size=x.shape)
        ahead, behind = (region.energy(x + s * step * along) for s in (1, -1))
        slope = (ahead - behind) / (2 * step)
        assert abs(slope + (force * along).sum()) < 1e-6 * np.linalg.norm(force)
    assert tried > 20 or np.linalg.matrix_rank(region.gradient) == 1  # points on a line can turn about it


def test_force_and_torque_are_balanced(region: CorotationalRegion) -> None:
    for x in states(region, 1):
        force, _ = region.response(x)
        arm = x - x.mean(axis=0)
        assert np.abs(force.sum(axis=0)).max() < 1e-10 * np.abs(force).sum()
        assert np.abs(np.cross(arm, force).sum(axis=0)).max() < 1e-10 * (np.abs(arm).max() * np.abs(force).sum())


def test_stiffness_is_positive_semidefinite_and_blind_to_rigid_motion(region: CorotationalRegion) -> None:
    for x in states(region, 2):
        _, stiffness = region.response(x)
        size = np.abs(stiffness).max()
        assert np.abs(stiffness - stiffness.T).max() < 1e-12 * size
        assert np.linalg.eigvalsh(stiffness)[0] > -1e-11 * size
        turns = cross_stack(x - x.mean(axis=0))
        assert np.abs(stiffness @ turns).max() < 1e-9 * size * np.abs(turns).max()
        assert np.abs(stiffness @ np.tile(np.eye(3), (len(x), 1))).max() < 1e-9 * size


def test_stiffness_is_the_hessian_at_rest(region: CorotationalRegion) -> None:
    rest = region.rest
    rng = np.random.default_rng(3)
    _, stiffness = region.response(rest)
    step = 1e-7 * np.ptp(rest, axis=0).max()
    for _ in range(10):
        along = rng.normal(size=rest.shape)
        ahead, behind = (region.response(rest + s * step * along)[0] for s in (1, -1))
        change = (ahead - behind).ravel() / (2 * step)
        assert np.abs(change + stiffness @ along.ravel()).max() < 1e-6 * np.abs(change).max()


def test_energy_and_force_turn_with_the_body(region: CorotationalRegion) -> None:
    rng = np.random.default_rng(4)
    for x in states(region, 4)[:9]:
        turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
        moved = x @ turn.T + shift
        assert region.energy(moved) == pytest.approx(region.energy(x))
        force, _ = region.response(x)
        np.testing.assert_allclose(region.response(moved)[0], force @ turn.T, atol=1e-9 * np.abs(force).max())


def test_regions_turn_by_their_own_gradients_unless_a_frame_disagrees(child: CorotationalRegion) -> None:
    seen = {child.effective_gradient(x)[0] for x in states(child, 5)}
    assert {0.0, 1.0} <= seen
    theta, gradient = child.effective_gradient(child.rest)
    assert theta == 1
    np.testing.assert_array_equal(gradient, child.gradient)
    theta, gradient = child.effective_gradient(turned_over(child, child.rest))
    assert theta == 0
    np.testing.assert_array_equal(gradient, fallback_of(child).gradient)


def test_agreement_is_the_least_stretch_seen_from_the_region(child: CorotationalRegion) -> None:
    turn = Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix()
    stretched = child.rest @ np.diag([1.2, 0.7, 1.0]) @ turn.T
    assert fallback_of(child).agreement(stretched, child.gradient) == pytest.approx(0.7)
    assert trust(AGREEING) == 1
    assert trust(OPPOSED) == 0
    assert trust(0.5 * (AGREEING + OPPOSED)) == pytest.approx(0.5)


def test_given_its_parents_the_energy_of_a_child_is_convex(child: CorotationalRegion) -> None:
    """With θ = 0 it is a quadratic of the child's points."""
    parents = fallback_of(child).parents
    rng = np.random.default_rng(6)
    rotation = closest_rotation(child.rest.T @ fallback_of(child).gradient)
    away = np.zeros_like(child.rest)
    away[parents:] = 0.002 * np.ptp(child.rest) * rng.normal(size=away[parents:].shape)
    over = turned_over(child, child.rest)
    energies = [child.energy(over + s * away) for s in (-1, 0, 1)]
    bend = away.ravel() @ np.kron(np.eye(len(away)), rotation) @ child.stiffness @ away.ravel()
    assert child.effective_gradient(over + away)[0] == child.effective_gradient(over - away)[0] == 0
    assert energies[0] - 2 * energies[1] + energies[2] == pytest.approx(bend, rel=1e-5)


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
