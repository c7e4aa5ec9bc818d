"""Hyperelastic laws inside mj_step: the same forces and inertia as NumPy's, energy, rest, recovery from inversion."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import mujoco
import numpy as np
import pytest
from builders.rubber import bar
from builders.scenes import (
    beam,
    check_implicit_step,
    check_slope_of_energy,
    compiled,
    distort,
    implicit_step,
    in_space,
    jumble,
    move_points,
)
from builders.shapes import mixed
from builders.tiers import thinned, tiered
from scipy.spatial.transform import Rotation

import mjframes as mf
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.law_table import LAWS
from mjframes.scene.view import soft

METHODS = ("whole_body", "paper")
QUICK = {("green_lagrange", "paper"), *product(["mooney_rivlin"], METHODS)}


@cache
def body(law: str, method: str) -> SoftBody:
    types = ("affine", "quadratic", "rigid", "affine")
    return mf.build(
        mixed(), 4, method=mf.Paper(6) if method == "paper" else method, law=law, frame_type=types, damping=(0.3, 0.001)
    )


@pytest.mark.parametrize(
    ("law", "method"),
    tiered(product(LAWS, METHODS), lambda case: case not in QUICK),
)
def test_force_and_inertia_are_those_of_the_implicit_step(law: str, method: str) -> None:
    check_implicit_step(*in_space(body(law, method)), np.random.default_rng(0), angle=0.5, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_force_is_the_slope_of_the_energy(law: str, method: str) -> None:
    check_slope_of_energy(*in_space(body(law, method)), np.random.default_rng(2), angle=0.5, states=1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_rest_and_rotations_are_free_of_force(law: str, method: str) -> None:
    model, data = in_space(bar(law, method))
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    firmness = np.abs(implicit_step(model, data)[1]).max() / model.opt.timestep**2
    assert np.abs(data.qfrc_passive).max() < 1e-12 * firmness * np.ptp(view.rest)
    turned = view.control_positions @ Rotation.from_rotvec([1, 2, -3]).as_matrix().T
    move_points(model, data, view, turned)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_passive).max() < 1e-10 * firmness * np.ptp(view.rest)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("h", [1 / 60, 1 / 1000])
@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_scrambled_and_mirrored_it_returns(law: str, h: float, method: str) -> None:
    model, data = in_space(bar(law, method))
    model.opt.timestep = h
    view = soft(model, data, "soft0")
    mujoco.mj_forward(model, data)
    size = np.linalg.norm(np.ptp(view.rest, axis=0))
    rng = np.random.default_rng(2)
    for mirrored in (False, True):
        distort(model, data, rng, mirrored=mirrored)
        energy = view.elastic_energy
        for _ in range(int(4 / h)):
            mujoco.mj_step(model, data)
            data.qvel *= 0.98
        mujoco.mj_forward(model, data)
        assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number == 0
        assert view.elastic_energy < 1e-3 * energy
        gaps = np.linalg.norm(view.control_positions[:, None] - view.control_positions, axis=-1)
        rest = np.linalg.norm(view.rest[:, None] - view.rest, axis=-1)
        assert np.abs(gaps - rest).max() < 0.02 * size


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("law", thinned(product(LAWS), 2))
def test_small_strains_are_hookes(law: str, method: str) -> None:
    energies = {}
    for name in (law, "corotational"):
        made = mf.build(beam_volume(), 3, method=mf.Paper(4) if method == "paper" else method, law=name)
        model, data = in_space(made)
        view = soft(model, data, "soft0")
        mujoco.mj_kinematics(model, data)
        x = view.control_positions
        stretch = np.eye(3) + 1e-4 * np.array([[1, 0.3, 0], [0.3, -0.4, 0.2], [0, 0.2, 0.5]])
        move_points(model, data, view, x @ stretch)
        mujoco.mj_forward(model, data)
        energies[name] = view.elastic_energy
    assert energies[law] == pytest.approx(energies["corotational"], rel=2e-3)


@cache
def beam_volume() -> mf.Volume:
    return beam().fields.volume


def with_constants(**constants: float) -> mf.Volume:
    """The beam, with constants of a law on the material of label 1."""
    materials = dict(beam_volume().materials)
    return replace(beam_volume(), materials=materials | {1: replace(materials[1], law_constants=constants)})


def test_constants_can_be_set_by_label() -> None:
    plain = mf.build(beam_volume(), 3, law="mooney_rivlin")
    mu = plain.law_constants[0, :2].sum() * 2
    chosen = mf.build(with_constants(c10=0.4 * mu), 3, law="mooney_rivlin")
    np.testing.assert_allclose(chosen.law_constants[0, :2], [0.4 * mu, 0.1 * mu])
    np.testing.assert_array_equal(chosen.law_constants[1:], plain.law_constants[1:])


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"law": "hooke"}, "law is 'hooke'; it must be one of 'corotational', 'green_lagrange'"),
        ({"law": "neo_hookean", "volume": with_constants(c10=1e4)}, "no constant 'c10'"),
        ({"volume": with_constants(mu=1e4)}, r"law_constants {'mu': 10000.0}, but the corotational law has none"),
        ({"law": "neo_hookean", "frame_type": "point"}, "'point' frames, which cannot turn"),
    ],
)
def test_wrong_laws_are_refused(choices: dict, words: str) -> None:
    with pytest.raises(mf.MjframesError, match=words):
        mf.build(**{"volume": beam_volume(), "frames": 3, **choices})


@pytest.mark.parametrize("method", METHODS)
def test_saved_and_loaded_it_is_the_same(tmp_path, method: str) -> None:
    made = bar("arruda_boyce", method)
    made.save(str(tmp_path / "bar.npz"))
    states = []
    for some in (made, mf.SoftBody.load(str(tmp_path / "bar.npz"))):
        model, data = compiled("<mujoco/>", (some, (0, 0, 0), (1, 0, 0, 0)), contact=False)
        jumble(model, data, np.random.default_rng(3), 0.01, 0)
        mujoco.mj_step(model, data, 10)
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)
