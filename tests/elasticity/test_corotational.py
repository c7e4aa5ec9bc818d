"""The reference itself: force as the energy's gradient, balance, the stiffness's null space, and how regions turn."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from builders.linked import MIXED
from builders.linked import body as bar
from builders.scenes import distorted, in_space, lump
from builders.tiers import tiered
from scipy.spatial.transform import Rotation

from mjframes.elasticity.corotational import FOLDED, CorotationalRegion, closest_rotation, cross_stack
from mjframes.scene.view import soft

STATES = 9


BODIES = {  # of three materials and two bones by both methods, and of all types of frames
    "lump by regions": lambda: lump(method="paper"),
    "lump": lump,
    **{str(name): partial(bar, name) for name in ("quadratic", "rigid", "point", MIXED)},
}


@cache
def regions_of(body: str) -> list[CorotationalRegion]:
    """One of each number of points."""
    every = soft(*in_space(BODIES[body]()), "soft0").regions
    found = {len(some.points): some for some in every if isinstance(some, CorotationalRegion)}
    assert len(found) > 1
    return list(found.values())


# MIXED, too, has quadratic frames
NAMES = tiered(BODIES, lambda name: name == "quadratic")


@pytest.fixture(params=NAMES)
def regions(request: pytest.FixtureRequest) -> list[CorotationalRegion]:
    return regions_of(request.param)


@pytest.fixture(params=[name for name in NAMES if name.values != ("point",)])
def solids(request: pytest.FixtureRequest) -> list[CorotationalRegion]:
    """Those whose turn their points show."""
    found = regions_of(request.param)
    assert all(region.solid for region in found)
    return found


def turned_over(region: CorotationalRegion, x: np.ndarray) -> np.ndarray:
    """The last half of the points mirrored at their middle."""
    moved, half = x.copy(), len(x) // 2
    moved[half:] = 2 * x[half:].mean(axis=0) - x[half:]
    return moved


def states(region: CorotationalRegion, seed: int, size: float = 0.3) -> list[np.ndarray]:
    """Ordinary ones, mirrored ones, and ones half turned over, in turns."""
    rng = np.random.default_rng(seed)
    some = [distorted(region.rest, rng, size, mirrored=n % 3 == 1) for n in range(STATES)]
    return [turned_over(region, x) if n % 3 == 2 else x for n, x in enumerate(some)]


def test_force_is_minus_the_gradient_of_the_energy(regions: list[CorotationalRegion]) -> None:
    """In every state: mirrored and folded ones, too."""
    for region in regions:
        rng = np.random.default_rng(0)
        step = 3e-7 * np.ptp(region.rest, axis=0).max()
        for x in states(region, 0, 0.15)[:12]:
            force, _ = region.response(x)
            along = rng.normal(size=x.shape)
            ahead, behind = (region.energy(x + s * step * along) for s in (1, -1))
            slope = (ahead - behind) / (2 * step)
            assert abs(slope + (force * along).sum()) < 2e-6 * np.linalg.norm(force)


def test_energy_is_the_least_over_all_rotations(solids: list[CorotationalRegion]) -> None:
    for solid in solids:
        others = Rotation.random(100, rng=np.random.default_rng(1)).as_matrix()
        for x in states(solid, 1)[:3]:
            z = x - x.mean(axis=0)
            least = solid.energy(x)
            assert min(solid._energy(z @ R)[0] for R in others) > least * (1 - 1e-9)


@pytest.mark.parametrize(
    "solids",
    tiered((name for name in BODIES if name != "point"), lambda name: name != "lump"),
    indirect=True,
)
def test_energy_does_not_jump(solids: list[CorotationalRegion]) -> None:
    """Along a way through flat and mirrored states it changes by no more than forces explain."""
    for solid in solids:
        x, steps = solid.rest, 60
        flip = np.eye(3) - 2 * np.outer(*[np.array([0.6, 0.64, 0.48])] * 2)
        way = [x + t * (x @ flip - x) for t in np.linspace(0, 1, steps)]
        energies = np.array([solid.energy(p) for p in way])
        slopes = np.array([-(solid.response(p)[0] * (way[-1] - way[0])).sum() for p in way]) / (steps - 1)
        explained = 0.5 * (np.abs(slopes[1:]) + np.abs(slopes[:-1])) + 1e-9 * np.abs(energies).max()
        assert (np.abs(np.diff(energies)) < 1.5 * explained + 0.02 * np.ptp(energies)).all()


def test_force_and_torque_are_balanced(regions: list[CorotationalRegion]) -> None:
    for region in regions:
        for x in states(region, 1):
            force, _ = region.response(x)
            arm = x - x.mean(axis=0)
            assert np.abs(force.sum(axis=0)).max() < 1e-10 * np.abs(force).sum()
            assert np.abs(np.cross(arm, force).sum(axis=0)).max() < 1e-10 * (np.abs(arm).max() * np.abs(force).sum())


def test_stiffness_is_positive_semidefinite_and_blind_to_rigid_motion(regions: list[CorotationalRegion]) -> None:
    for region in regions:
        for x in states(region, 2):
            _, stiffness = region.response(x)
            size = np.abs(stiffness).max()
            assert np.abs(stiffness - stiffness.T).max() < 1e-12 * size
            assert np.linalg.eigvalsh(stiffness)[0] > -1e-11 * size
            turns = cross_stack(x - x.mean(axis=0))
            assert np.abs(stiffness @ turns).max() < 1e-9 * size * np.abs(turns).max()
            assert np.abs(stiffness @ np.tile(np.eye(3), (len(x), 1))).max() < 1e-9 * size


def test_stiffness_is_the_hessian_at_rest(regions: list[CorotationalRegion]) -> None:
    for region in regions:
        rest = region.rest
        rng = np.random.default_rng(3)
        _, stiffness = region.response(rest)
        step = 1e-7 * np.ptp(rest, axis=0).max()
        for _ in range(10):
            along = rng.normal(size=rest.shape)
            ahead, behind = (region.response(rest + s * step * along)[0] for s in (1, -1))
            change = (ahead - behind).ravel() / (2 * step)
            assert np.abs(change + stiffness @ along.ravel()).max() < 1e-6 * np.abs(change).max()


@pytest.mark.parametrize(
    "regions",
    tiered(BODIES, lambda name: name in ("quadratic", str(MIXED))),
    indirect=True,
)
def test_energy_and_force_turn_with_the_body(regions: list[CorotationalRegion]) -> None:
    for region in regions:
        rng = np.random.default_rng(4)
        for x in states(region, 4)[:9]:
            turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
            moved = x @ turn.T + shift
            assert region.energy(moved) == pytest.approx(region.energy(x))
            force, _ = region.response(x)
            np.testing.assert_allclose(region.response(moved)[0], force @ turn.T, atol=1e-9 * np.abs(force).max())


def test_stiffness_is_the_curvature_of_the_energy_where_nothing_turns(solids: list[CorotationalRegion]) -> None:
    """In strained states along motions that do not turn the region, where those that turn it add nothing."""
    for solid in solids:
        rng = np.random.default_rng(6)
        step = 1e-4 * np.ptp(solid.rest, axis=0).max()
        for _ in range(5):
            x = distorted(solid.rest, rng, 0.05)
            x = x - x.mean(axis=0)
            rotation = solid.rotation(x)
            if np.linalg.eigvalsh(rotation.T @ x.T @ solid.gradient + solid.gradient.T @ x @ rotation)[0] < 2 * FOLDED:
                continue
            along = rng.normal(size=x.shape)
            spin = solid.spin(x, rotation)
            along -= np.cross(rotation @ np.tensordot(spin, along), x)
            np.testing.assert_allclose(np.tensordot(spin, along), 0, atol=1e-9)
            _, stiffness = solid.response(x)
            here, ahead, behind = (solid.energy(x + s * step * along) for s in (0, 1, -1))
            assert (ahead - 2 * here + behind) / step**2 == pytest.approx(
                along.ravel() @ stiffness @ along.ravel(), rel=1e-3
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
