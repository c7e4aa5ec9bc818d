"""Figure 4: two affine frames and one sample have energy against stretch, shear, bending and twist."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share

import mjframes as mf
from examples import modes
from mjframes.elasticity.law_table import LAWS

DEFORMED = [mode for mode in modes.MOTIONS if mode != "rest"]
SHEAR_MODULUS = modes.YOUNG / (2 * (1 + modes.POISSON))
SMALL = 0.01  # of the drawn motions
BAR = (0.8, 0.6, 0.55)  # its colour


@pytest.mark.slow
def test_each_mode_costs_energy(tmp_path: Path) -> None:
    energies = modes.run(tmp_path)
    rows = np.array_split(picture(tmp_path / "modes.png"), 2)
    assert min(share(panel, BAR) for row in rows for panel in np.array_split(row, 3, axis=1)) > 0.04
    assert abs(energies.pop("rest")) < 1e-12
    assert set(energies) == {"twist", "stretch", "compression", "shear", "bending"}
    assert min(energies.values()) > 5  # [J]


@pytest.mark.parametrize("law", ["corotational", *LAWS])
def test_each_mode_is_resisted(law: str) -> None:
    made = modes.bar(law)
    assert len(made.body.parent) == 2
    assert len(made.body.stiffness.points) == 2  # each frame's own
    for mode in DEFORMED:
        made.move(mode)
        energy, slope = made.energy, np.abs(made.data.qfrc_passive).max()
        made.move(mode, 0.99)
        assert 0 < made.energy < energy
        assert slope > 10  # [N]


def test_small_twist_is_saint_venants_and_small_stretch_that_of_a_held_cross_section() -> None:
    made = modes.bar()
    made.move("twist", SMALL)
    torsion = SHEAR_MODULUS * 0.1406 * modes.WIDTH**4 * (SMALL * modes.TWIST) ** 2 / (2 * modes.LENGTH)
    assert made.energy == pytest.approx(torsion, rel=0.1)
    made.move("stretch", SMALL)
    modulus = modes.YOUNG * (1 - modes.POISSON) / ((1 + modes.POISSON) * (1 - 2 * modes.POISSON))
    stretch = modulus * modes.WIDTH**2 * (SMALL * modes.PULL) ** 2 / (2 * modes.LENGTH)
    assert made.energy == pytest.approx(stretch, rel=0.1)  # the frames are a voxel less apart than the bar is long


def test_bending_bends_and_let_go_it_straightens() -> None:
    made = modes.bar()
    made.move("bending")
    weights, rest = made.body.skin.weights, made.body.skin.vertices
    x = weights @ mf.soft(made.model, made.data, "bar").control_positions
    middle = np.abs(rest[:, 0] - modes.LENGTH / 2) < modes.VOXEL
    ends = (rest[:, 0] < modes.VOXEL) | (rest[:, 0] > modes.LENGTH - modes.VOXEL)
    assert x[middle, 2].mean() > x[ends, 2].mean() + modes.LENGTH / 4  # linear interpolation would not move it
    start = made.energy
    mujoco.mj_step(made.model, made.data, nstep=2000)
    mujoco.mj_forward(made.model, made.data)
    assert made.energy < 1e-3 * start
