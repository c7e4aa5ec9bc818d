"""A sleeve on the two links of an elbow: it bends, keeps its volume, resists, and is stable however stiff."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from builders.pictures import picture, share

from examples import elbow

STIFFNESSES = 10.0 ** np.arange(3, 9)  # [Pa]
TIMESTEP = 0.005  # [s]
SLEEVE = (0.8, 0.6, 0.55)  # its colour


@cache
def bent(young: float, law: str) -> elbow.Elbow:
    arm = elbow.elbow(young, law)
    assert arm.model.opt.timestep == TIMESTEP
    elbow.bend(arm)
    return arm


def skins_swelling(arm: elbow.Elbow) -> float:
    """Relative change of the volume that the visible surface encloses [-]."""
    skin = arm.sleeve.skin
    volumes = []
    for x in (skin.vertices, skin.weights @ arm.view.control_positions):
        a, b, c = (x[skin.faces[:, corner]] for corner in range(3))
        volumes.append(np.einsum("ta,ta->", a, np.cross(b, c)) / 6)
    return volumes[1] / volumes[0] - 1


def test_the_sleeve_bends_with_the_elbow_and_keeps_its_volume(tmp_path: Path) -> None:
    arm = elbow.run(tmp_path)
    assert share(picture(tmp_path / "elbow.png"), SLEEVE) > 0.05
    assert 80 < arm.angle < 90  # [degrees]
    assert abs(arm.swelling) < 0.05
    assert abs(skins_swelling(arm)) < 0.05
    assert np.abs(arm.data.qvel).max() < 1e-3


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
@pytest.mark.parametrize("young", STIFFNESSES, ids="{:.0e} Pa".format)
def test_it_is_stable_however_stiff(young: float, law: str) -> None:
    arm = bent(young, law)
    assert not any(warning.number for warning in arm.data.warning)
    assert 0 < arm.angle < 90
    if young > 1e3:  # a sleeve of 1 kPa hangs down by more than its thickness, folded
        assert abs(arm.swelling) < 0.05
        assert abs(skins_swelling(arm)) < 0.05
    mujoco.mj_step(arm.model, arm.data, 1000)
    assert np.abs(arm.data.qvel).max() < 0.1  # [m/s]


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_the_actuator_feels_the_sleeve(law: str) -> None:
    arms = [bent(young, law) for young in STIFFNESSES]
    torques = np.array([arm.torque for arm in arms])
    assert (np.diff(torques) > 0).all()
    assert torques[0] < 0.5  # [N m]
    assert torques[-1] > 0.98 * elbow.STIFFNESS * elbow.TARGET
    for arm in arms[2:]:  # at rest the sleeve's moment about the elbow is the actuator's
        assert -arm.data.joint("elbow").qfrc_passive[0] == pytest.approx(arm.torque, rel=1e-3)
