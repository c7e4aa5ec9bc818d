from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from builders.harness import region, respond, signed_svd
from scipy.spatial.transform import Rotation

from mjframes.base.errors import MjframesError
from mjframes.elasticity.law_table import LAWS
from mjframes.elasticity.laws import (
    REACH,
    LawParameters,
    cauchy_stress,
    energy,
    hessian,
    law_parameters,
    projected_hessian,
    stress,
)
from mjframes.volume.material import Material

FLESH = Material(2e4, 0.45, 1000)


def with_constants(law: str, material: Material = FLESH, **constants: float) -> LawParameters:
    return law_parameters(law, replace(material, law_constants=constants))


PARAMETERS = {law: law_parameters(law, FLESH) for law in LAWS} | {
    "mooney_rivlin of c10 and c01": with_constants("mooney_rivlin", c10=1e3, c01=5e3),
    "arruda_boyce of short chains": with_constants("arruda_boyce", Material(2e4, 0.0, 1000), segments=2),
    "green_lagrange, stiff volume": with_constants("green_lagrange", bulk=2e6),
}


@pytest.fixture(params=PARAMETERS, ids=str)
def parameters(request: pytest.FixtureRequest) -> LawParameters:
    return PARAMETERS[request.param]


def rotations(n: int, rng: np.random.Generator) -> np.ndarray:
    return Rotation.from_quat(rng.normal(size=(n, 4))).as_matrix()


def of_singular_values(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """F (q, 3, 3) with the given signed singular values (q, 3), turned at random on both sides."""
    return rotations(len(values), rng) * values[:, None, :] @ rotations(len(values), rng)


def gradients(seed: int = 0) -> np.ndarray:
    """F (8000, 3, 3) of every kind: at random, inverted, flattened, of rank 1 and 0, with equal and opposite σ."""
    rng = np.random.default_rng(seed)
    n = 800
    wide = rng.normal(size=(n, 3)) * np.array([2, 1, 0.5])
    pair = rng.uniform(0.1, 3, (n, 1)) * np.array([1, 1, 0]) + rng.uniform(-2, 2, (n, 1)) * np.array([0, 0, 1])
    tiny = 10.0 ** rng.uniform(-17, 0, (n, 3))
    kinds = [
        np.eye(3) + 0.1 * rng.normal(size=(n, 3, 3)),
        rng.normal(size=(n, 3, 3)),
        -rng.uniform(0.1, 2, (n, 1, 1)) * rotations(n, rng),
        of_singular_values(wide * np.array([1, 1, 0]), rng),
        of_singular_values(wide * np.array([1, 0, 0]), rng),
        of_singular_values(pair, rng),
        of_singular_values(pair * np.array([1, -1, 1]), rng),
        of_singular_values(pair + 1e-9 * rng.normal(size=(n, 3)), rng),
        of_singular_values(tiny * rng.choice([-1, 1], (n, 3)), rng),
        np.concatenate([np.zeros((4, 3, 3)), rotations(4, rng), np.diag([1.0, 1, -1])[None].repeat(n - 8, axis=0)]),
    ]
    return np.concatenate(kinds)


def moderate(seed: int = 1) -> np.ndarray:
    """F (300, 3, 3) at random, a third inverted."""
    rng = np.random.default_rng(seed)
    F = np.eye(3) + 0.4 * rng.normal(size=(300, 3, 3))
    F[::3, 0] *= -1
    return F


def differences(function, F: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """∂ function/∂F_sb (q, …, 9) by central differences of fourth order."""
    columns = []
    for e in range(9):
        along = step * np.eye(9)[e].reshape(3, 3)
        near, far = (function(F + s * along) - function(F - s * along) for s in (1, 2))
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


def test_stress_is_the_slope_of_the_energy(parameters):
    F = moderate()
    P = stress(parameters, F)
    slope = differences(lambda f: energy(parameters, f), F, 1e-3).reshape(P.shape)
    scale = np.abs(P).max(axis=(1, 2), keepdims=True)
    assert np.abs((slope - P) / scale).max() < 1e-6


def test_hessian_is_the_slope_of_the_stress(parameters):
    F = moderate()
    H = hessian(parameters, F)
    slope = differences(lambda f: stress(parameters, f).reshape(-1, 9), F, 1e-3)
    scale = np.abs(H).max(axis=(1, 2), keepdims=True)
    assert np.abs((slope - H) / scale).max() < 1e-6
    assert np.abs(H - H.transpose(0, 2, 1)).max() < 1e-13 * scale.max()


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49])
@pytest.mark.parametrize("law", LAWS)
def test_small_strains_follow_hooke(law, poisson):
    material = Material(3e5, poisson, 1000)
    lam, mu = material.lame
    eye = np.eye(3)
    hooke = (
        lam * np.einsum("ra,sb->rasb", eye, eye)
        + mu * np.einsum("rs,ab->rasb", eye, eye)
        + mu * np.einsum("rb,as->rasb", eye, eye)
    ).reshape(9, 9)
    parameters = law_parameters(law, material)
    assert abs(energy(parameters, eye[None])[0]) < 1e-10 * mu
    assert np.abs(stress(parameters, eye[None])).max() < 1e-14 * (lam + mu)
    for H in (hessian(parameters, eye[None])[0], respond(parameters, eye[None])[3][0]):
        assert np.abs(H - hooke).max() < 1e-13 * (lam + 2 * mu)


def test_a_law_of_given_constants_has_their_small_strains():
    rubber = with_constants("mooney_rivlin", c10=1e5, c01=2e4, bulk=3e7)
    H = hessian(rubber, np.eye(3)[None])[0]
    shear = H[1, 1]  # ∂P_01/∂F_01
    assert shear == pytest.approx(2 * (1e5 + 2e4), rel=1e-12)
    assert H[0, 0] - 4 / 3 * shear == pytest.approx(3e7, rel=1e-12)


@pytest.mark.parametrize("stretch", [0.5, 1.5, 2.0, 2.5])
def test_incompressible_stretch_is_the_textbooks(stretch):
    """Cauchy's stress along less across a bar of J = 1, in closed form: 2 (λ² − 1/λ) (∂ψ/∂I₁ + ∂ψ/∂I₂ / λ)."""
    F = np.diag([stretch, stretch**-0.5, stretch**-0.5])[None]
    i1 = stretch**2 + 2 / stretch

    def pull(parameters: LawParameters) -> float:
        sigma = cauchy_stress(parameters, F)[0]
        return sigma[0, 0] - sigma[1, 1]

    common = 2 * (stretch**2 - 1 / stretch)
    rubber = with_constants("mooney_rivlin", c10=3e3, c01=1e3)
    assert pull(rubber) == pytest.approx(common * (3e3 + 1e3 / stretch), rel=1e-12)
    chains = with_constants("arruda_boyce", segments=8)
    n = 8.0
    series = (
        0.5 + i1 / (10 * n) + 11 * i1**2 / (350 * n**2) + 19 * i1**3 / (1750 * n**3) + 519 * i1**4 / (134750 * n**4)
    )
    at_rest = 1 + 3 / (5 * n) + 99 / (175 * n**2) + 513 / (875 * n**3) + 42039 / (67375 * n**4)
    assert pull(chains) == pytest.approx(common * chains["mu"] / at_rest * series, rel=1e-12)


def test_energy_is_objective_and_isotropic(parameters):
    rng = np.random.default_rng(2)
    F = moderate()
    Q, R = rotations(len(F), rng), rotations(len(F), rng)
    size = np.abs(energy(parameters, F)).max()
    assert np.abs(energy(parameters, Q @ F @ R) - energy(parameters, F)).max() < 1e-12 * size
    P = stress(parameters, F)
    assert np.abs(stress(parameters, Q @ F @ R) - Q @ P @ R).max() < 1e-12 * np.abs(P).max()
    kirchhoff = P @ F.transpose(0, 2, 1)
    assert np.abs(kirchhoff - kirchhoff.transpose(0, 2, 1)).max() < 1e-12 * np.abs(kirchhoff).max()


def test_rest_is_the_only_minimum(parameters):
    """From any start but ideally symmetric ones, inverted, flattened or collapsed, ψ leads down to a rotation."""
    rng = np.random.default_rng(3)
    starts = [[0.05] * 3, [0.001] * 3, [1, 0.001, 0.001], [1, 1, -1], [0.3, 0.3, -0.3], [1.5, 0.6, -0.9], [2, 0, 0]]
    F = of_singular_values(np.repeat(np.array(starts, float), 6, axis=0), rng)
    F += 0.05 * rng.normal(size=F.shape)
    for _ in range(200):
        H = projected_hessian(parameters, F) + 1e-3 * parameters["bulk"] * np.eye(9)
        step = np.linalg.solve(H, stress(parameters, F).reshape(-1, 9, 1)).reshape(F.shape)
        length = np.sqrt((step**2).sum(axis=(1, 2), keepdims=True))
        F = F - step * np.minimum(1, 0.1 / np.maximum(length, 1e-300))
    assert np.abs(F.transpose(0, 2, 1) @ F - np.eye(3)).max() < 1e-6
    assert np.linalg.det(F).min() > 0.99


def test_uniform_compression_is_pushed_back_all_the_way(parameters):
    s = np.linspace(1e-4, 0.999, 2000)
    F = s[:, None, None] * np.eye(3)
    for P in (stress(parameters, F), respond(parameters, F)[2]):
        assert P[:, 0, 0].max() < 0


@pytest.mark.parametrize("smallest", [0.0, -0.2, -1.0, -2.0])
def test_inverted_and_flat_points_are_pushed_back(parameters, smallest):
    F = np.diag([1.1, 0.9, smallest])[None]
    for P in (stress(parameters, F)[0], respond(parameters, F)[2][0]):
        assert P[2, 2] < 0  # the force −P opens the smallest singular value
    step = -1e-6 * stress(parameters, F) / np.abs(stress(parameters, F)).max()
    assert energy(parameters, F + step)[0] < energy(parameters, F)[0]


def test_plugin_and_reference_agree_everywhere(parameters):
    F = gradients()
    psi, sigma, P, H = respond(parameters, F)
    size = np.maximum(parameters["bulk"], np.abs(H).max(axis=(1, 2)))
    norm = np.maximum(1, np.sqrt((F**2).sum(axis=(1, 2))))
    assert np.isfinite(psi).all()
    assert np.abs((psi - energy(parameters, F)) / (size * norm**2)).max() < 1e-12
    assert np.abs((P - stress(parameters, F)) / (size * norm)[:, None, None]).max() < 1e-12
    reference = projected_hessian(parameters, F)
    assert np.abs((H - reference) / size[:, None, None]).max() < 1e-10
    firm = np.linalg.det(F) > 0.1
    exact = cauchy_stress(parameters, F[firm])
    assert np.abs(sigma[firm] - exact).max() < 1e-11 * np.abs(exact).max()
    assert np.isfinite(sigma).all()


def test_plugins_hessian_is_positive_semidefinite(parameters):
    values = np.linalg.eigvalsh(respond(parameters, gradients(4))[3])
    assert (values[:, 0] >= -1e-12 * values[:, -1]).all()


def test_a_definite_hessian_is_left_alone(parameters):
    F = np.eye(3) + 0.02 * np.random.default_rng(5).normal(size=(400, 3, 3))
    exact = hessian(parameters, F)
    values, vectors = np.linalg.eigh(exact)
    # of nearly incompressible points some are further than a strain of 1 from where the slopes point
    within = np.abs(np.einsum("qe,qen->qn", stress(parameters, F).reshape(-1, 9), vectors)) < REACH * values
    definite = (values[:, 0] > 0) & within.all(axis=1)
    assert 10 < definite.sum() < 390  # compressed points have a few negative eigenvalues
    H = respond(parameters, F)[3]
    assert np.abs(H - exact)[definite].max() < 1e-13 * np.abs(exact).max()
    assert np.abs(H - exact)[~definite].max() > 1e-5 * np.abs(exact).max()


def test_singular_values_are_signed_and_accurate():
    F = gradients(6)
    U, sigma, V = signed_svd(F)
    size = np.sqrt((F**2).sum(axis=(1, 2), keepdims=True))
    assert np.abs(U @ (sigma[:, :, None] * V.transpose(0, 2, 1)) - F).max() <= 4e-15 * size.max()
    assert (np.abs(U @ (sigma[:, :, None] * V.transpose(0, 2, 1)) - F) <= 1e-14 * size).all()
    for turn in (U, V):
        assert np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max() < 1e-13
        assert np.abs(np.linalg.det(turn) - 1).max() < 1e-13
    assert (np.diff(sigma[:, :2], axis=1) <= 1e-15 * size[:, 0]).all()
    assert (sigma[:, :2] >= 0).all()
    assert (np.abs(sigma[:, 2]) <= sigma[:, 1] * (1 + 1e-12) + 1e-15 * size[:, 0, 0]).all()
    expected = np.linalg.svd(F, compute_uv=False)
    assert np.abs(np.abs(sigma) - expected).max() < 1e-14 * size.max()
    determinant = np.linalg.det(F)
    clear = np.abs(determinant) > 1e-12 * size[:, 0, 0] ** 3
    assert (np.sign(sigma[clear, 2]) == np.sign(determinant[clear])).all()


@pytest.mark.parametrize(("m", "calm"), [(1, False), (4, False), (7, False), (12, False), (30, False), (30, True)])
@pytest.mark.parametrize("law", LAWS)
def test_a_region_is_the_sum_over_its_points(law: str, m: int, calm: bool):
    rng = np.random.default_rng(m)
    q, k = 6, m + 5
    materials = [law_parameters(law, Material(1e4, 0.3, 1000)), law_parameters(law, Material(5e5, 0.45, 1000))]
    material = np.array([0, 1, 1, 0, 1, 0])
    points = rng.permutation(k)[:m]
    gradient = rng.normal(size=(q, m, 3))
    gradient -= gradient.mean(axis=1, keepdims=True)  # Σ_j ∇W_j = 0
    volume = rng.uniform(0.5, 2, q) * 1e-6
    x = rng.normal(size=(k, 3)) / np.sqrt(m) + 3
    if calm:  # near a rotation everywhere
        wanted = np.tile(np.linalg.qr(rng.normal(size=(3, 3)))[0] + 0.1 * rng.normal(size=(3, 3)), q).T
        wanted *= np.sign(np.linalg.det(wanted[:3]))
        x[points] = 3 + np.linalg.lstsq(gradient.transpose(0, 2, 1).reshape(3 * q, m), wanted, rcond=None)[0]
    count = m * (m + 1) // 2
    pair = rng.permutation(count + 4)[:count].astype(np.int32)
    pair[rng.random(count) < 0.2] = -1
    force, stiffness = rng.normal(size=(k, 3)), 10 * rng.normal(size=(count + 4, 3, 3))
    expected_force, expected_stiffness = force.copy(), stiffness.copy()

    found = region(materials, material, points, gradient, volume, pair, x, force, stiffness)
    alone = expected_force.copy()
    region(materials, material, points, gradient, volume, pair, x, alone, None)

    F = np.einsum("jr,qja->qra", x[points], gradient)
    energies, K = 0.0, np.zeros((m, 3, m, 3))
    for n in range(q):
        p = materials[material[n]]
        energies += volume[n] * energy(p, F[n : n + 1])[0]
        expected_force[points] -= volume[n] * gradient[n] @ stress(p, F[n : n + 1])[0].T
        H = projected_hessian(p, F[n : n + 1])[0].reshape(3, 3, 3, 3)
        K += volume[n] * np.einsum("ja,rasb,kb->jrks", gradient[n], H, gradient[n])
    turns = np.cross(np.eye(3)[:, None], x[points] - x[points].mean(axis=0)).reshape(3, -1).T  # of the current shape
    P = np.eye(3 * m) - turns @ np.linalg.pinv(turns, rcond=1e-9)
    if calm:
        assert (np.linalg.norm(F, axis=(1, 2)) < 2).all()
        assert (np.linalg.det(F) > 0).all()
        K = (P @ K.reshape(3 * m, 3 * m) @ P).reshape(m, 3, m, 3)
    lower = [(j, k) for j in range(m) for k in range(j + 1)]
    for index, (j, k) in zip(pair, lower, strict=True):
        if index >= 0:
            expected_stiffness[index] += K[j, :, k]
    assert found == pytest.approx(energies, rel=1e-11, abs=1e-15)
    np.testing.assert_array_equal(force, alone)
    assert np.abs(force - expected_force).max() < 1e-12 * max(1, np.abs(expected_force).max())
    assert np.abs(stiffness - expected_stiffness).max() < 1e-12 * np.abs(expected_stiffness).max()


def test_constants_that_make_no_stable_law_are_named():
    with pytest.raises(MjframesError, match="'hooke'"):
        law_parameters("hooke", FLESH)
    with pytest.raises(MjframesError, match=r"'c10'.*mu, bulk"):
        with_constants("neo_hookean", c10=1.0)
    with pytest.raises(MjframesError, match=r"segments.*at least 2"):
        with_constants("arruda_boyce", segments=1.0)
    with pytest.raises(MjframesError, match=r"bulk.*2/3"):
        with_constants("green_lagrange", bulk=10.0)
    with pytest.raises(MjframesError, match=r"c01.*at least 0"):
        with_constants("mooney_rivlin", c10=1e5)
    with pytest.raises(MjframesError, match=r"mu.*positive"):
        with_constants("neo_hookean", mu=-1.0)
