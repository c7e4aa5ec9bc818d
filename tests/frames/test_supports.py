from __future__ import annotations

import mujoco
import numpy as np
import pytest

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.frames.supports import Fixed, held_cores
from mjframes.volume.grid import voxel_grid

SHAPE, SPACING = (32, 8, 8), 0.0125  # 0.4 × 0.1 × 0.1 m
DEFLECTION = -1000 * 9.81 * 0.01 * 0.4**4 / (8 * 1e6 * 0.1**4 / 12)  # [m] of Euler and Bernoulli's cantilever


def bar(labels: np.ndarray | None = None) -> mf.Volume:
    material = mf.Material(young=1e6, poisson=0.3, density=1000)
    return mf.Volume.from_labels(np.ones(SHAPE, int) if labels is None else labels, SPACING, {1: material})


def end() -> np.ndarray:
    mask = np.zeros(SHAPE, bool)
    mask[0] = True
    return mask


@pytest.fixture(scope="module")
def cantilever() -> mf.SoftBody:
    at = [(x, 0.05, 0.05) for x in (0.1, 0.2, 0.3, 0.39)]
    return mf.build(bar(), at=at, weights="linear", supports=[Fixed(end())])


def hang(body: mf.SoftBody, **place) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.01
    mf.attach(spec, body, "bar", contact=False, **place)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1500)
    return model, data


def test_cantilever_bends_by_its_own_weight(cantilever: mf.SoftBody) -> None:
    model, data = hang(cantilever)
    assert model.nv == 4 * 12
    assert np.abs(data.qvel).max() < 1e-9
    x = cantilever.skin.weights @ mf.soft(model, data, "bar").control_positions
    sag = x[:, 2] - cantilever.skin.vertices[:, 2]
    tip = cantilever.skin.vertices[:, 0] > 0.399
    root = cantilever.skin.vertices[:, 0] < 0.001
    assert np.abs(sag[root]).max() < 1e-6  # [m]: 6 digits of the written positions
    np.testing.assert_allclose(sag[tip].mean(), DEFLECTION, rtol=0.12)


def test_what_holds_turns_with_the_body_it_is_attached_to(cantilever: mf.SoftBody) -> None:
    upright = (np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0)  # the bar's x axis up: it is pressed, not bent
    model, data = hang(cantilever, pos=(1.0, 2.0, 3.0), quat=upright)
    x = mf.soft(model, data, "bar").control_positions
    fixed = cantilever.control.frame < cantilever.held
    rest = cantilever.control.rest
    np.testing.assert_allclose(x[fixed, 2] - 3, rest[fixed, 0], atol=1e-6)
    sag = np.average(x[:, 2] - 3 - rest[:, 0], weights=cantilever.control.mass)
    np.testing.assert_allclose(sag, -1000 * 9.81 * 0.4**2 / (3 * 1e6), rtol=0.12)  # ρ g L² / 3E


@pytest.mark.parametrize(
    ("masks", "words"),
    [
        ([np.ones((3, 3, 3), bool)], "must be boolean over the volume's"),
        ([np.ones(SHAPE)], "type float64"),
        ([np.zeros(SHAPE, bool)], "no voxel inside"),
        ([end(), end()], r"supports\[1\] overlaps"),
    ],
)
def test_wrong_masks_are_refused(masks: list[np.ndarray], words: str) -> None:
    with pytest.raises(MjframesError, match=words):
        held_cores(voxel_grid(bar()), [Fixed(mask) for mask in masks])


@pytest.mark.parametrize(("shape", "held"), [((8, 8, 2), slice(1)), ((8, 8, 6), slice(5)), ((20, 2, 2), slice(1))])
def test_flesh_of_one_voxel_over_what_is_held_is_refused(shape: tuple[int, int, int], held: slice) -> None:
    """Its frames shear without stiffness: a lid on such a pad felt thousands of newtons."""
    mask = np.zeros(shape, bool)
    mask[:, :, held] = True
    volume = mf.Volume.from_labels(np.ones(shape, int), 0.005, {1: mf.Material(1e6, 0.3, 1000)})
    with pytest.raises(MjframesError, match=r"a layer of one voxel free in 100% .* a spacing of 0\.0025 m or less"):
        mf.build(volume, 4, supports=Fixed(mask))


def test_a_touched_rigid_piece_is_fixed_as_a_whole() -> None:
    labels = np.ones(SHAPE, int)
    labels[:5] = 2
    soft = mf.Material(young=1e6, poisson=0.3, density=1000)
    volume = mf.Volume.from_labels(labels, SPACING, {1: soft, 2: mf.Material.rigid(density=2000)})
    ((core,), _) = held_cores(voxel_grid(volume), [Fixed(end())])
    assert len(core) == 5 * 64
