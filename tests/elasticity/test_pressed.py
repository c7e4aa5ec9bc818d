"""What is pressed: derivatives of its energy, the strain that it depends on, and that it resists as rubber does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from mjframes.elasticity.corotational import CorotationalRegion
from mjframes.elasticity.pressed import FLAT, PRESSED_BEGIN, PressedCell, UniformResponse
from mjframes.elasticity.rotations import fitted_gradient

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
STEP = 1e-6
CELL = PressedCell(2.0, np.zeros((6, 12)))


def tetrahedron(poisson: float) -> tuple[CorotationalRegion, float, float]:
    """A linear tetrahedron of 1 Pa, and λ V and μ V."""
    lam, mu, volume = poisson / ((1 + poisson) * (1 - 2 * poisson)), 0.5 / (1 + poisson), 1 / 6
    g = fitted_gradient(CORNERS, np.ones(4))
    strain = np.zeros((3, 3, 12))  # ε_ab for the displacements of the points
    for j, r in np.ndindex(4, 3):
        strain[r, :, 3 * j + r] += 0.5 * g[j]
        strain[:, r, 3 * j + r] += 0.5 * g[j]
    trace = np.einsum("aai->i", strain)
    K = volume * (lam * np.outer(trace, trace) + 2 * mu * np.einsum("abi,abj->ij", strain, strain))
    return CorotationalRegion(np.arange(4), CORNERS, g, K, stiffens=True), lam * volume, mu * volume


def strains() -> list[np.ndarray]:
    """Little, much and wholly pressed ones, sheared and turned inside out."""
    rng = np.random.default_rng(0)
    return [
        FLAT @ np.diag([0.1, wide - 1, s - 1]).ravel() + 0.2 * rng.normal(size=6)
        for wide, s in ((1.0, 0.9), (1.0, 0.6), (1.5, 0.4), (1.0, 0.3), (1.0, 0.1), (0.6, -0.3))
        for _ in range(4)
    ]


def test_stress_and_hessian_are_the_gradients_of_energy_and_stress() -> None:
    some = 0
    for strain in strains():
        total, P, H = CELL.at(strain)
        some += total > 0
        for s in range(6):
            along = STEP * np.eye(6)[s]
            ahead, behind = CELL.at(strain + along), CELL.at(strain - along)
            assert (ahead[0] - behind[0]) / (2 * STEP) == pytest.approx(P[s], abs=1e-6)
            assert (ahead[1] - behind[1]) / (2 * STEP) == pytest.approx(H[s], abs=1e-3)
        assert np.linalg.eigvalsh(H)[0] >= -1e-9  # convex
    assert some > 15


@pytest.mark.parametrize("stretch", [1.3, 1.0, 1 - PRESSED_BEGIN + 1e-9])
def test_what_is_pressed_little_has_none(stretch: float) -> None:
    total, P, H = CELL.at(FLAT @ np.diag([0.3, 0.0, stretch - 1]).ravel())
    assert total == 0
    assert not P.any()
    assert not H.any()


def test_the_strain_is_that_of_a_uniform_one_and_the_energy_resists_it_most() -> None:
    """C⁻¹ Uᵀ K is exact on U, and K is nowhere below Eᵀ C E: a hyperelastic law in its place leaves K positive."""
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(8, 3))
    motions = np.hstack([np.tile(np.eye(3), (8, 1)), *(np.cross(axis, rest).reshape(-1, 1) for axis in np.eye(3))])
    apart = np.eye(24) - motions @ np.linalg.pinv(motions)
    root = apart @ rng.normal(size=(24, 24))
    K = root @ root.T
    response = UniformResponse.of(rest, K)
    E = PressedCell.of(response).slope
    offset = rest - rest.mean(axis=0)
    for strain in rng.normal(size=(5, 6)):
        S = (strain @ FLAT).reshape(3, 3)
        assert E @ (offset @ S).ravel() == pytest.approx(strain, abs=1e-9)
    value = np.linalg.eigvalsh(K - E.T @ response.energy @ E)
    assert value[0] > -1e-12 * value[-1]
    assert np.sum(value < 1e-12 * value[-1]) == 12  # rigid motions, and the six that nothing but uniform strains resist


@pytest.mark.parametrize("poisson", [0.45, 0.49])
@pytest.mark.parametrize("stretch", [0.7, 0.6, 0.5, 0.4])
def test_a_pressed_block_resists_as_rubber_does(poisson: float, stretch: float) -> None:
    """Its sides are free, and it needs up to three times the force of Hooke's law.

    Neo-Hooke's law: ψ = μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)² (Smith et al., 2018).
    """
    region, lame, mu = tetrahedron(poisson)

    def force(energy: Callable[[float, float], float]) -> float:
        """Of the width of least energy [N]."""
        above, below = (
            minimize_scalar(
                energy, bounds=(0.9, 2.5), args=(stretch + s,), method="bounded", options={"xatol": 1e-7}
            ).fun
            for s in (STEP, -STEP)
        )
        return (below - above) / (2 * STEP)

    def hooke(w: float, s: float) -> float:
        return region.energy(CORNERS @ np.diag([w, w, s]))

    def neo(w: float, s: float) -> float:
        j = w * w * s
        return 0.5 * mu * (2 * w * w + s * s - 3) - mu * (j - 1) + 0.5 * (lame + mu) * (j - 1) ** 2

    assert force(hooke) == pytest.approx(force(neo), rel=0.12)
