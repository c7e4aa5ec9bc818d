"""What a gripper holds does not slip: soft things in rigid fingers, rigid things in soft ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from builders.data import shared
from builders.pictures import film, share

import mjframes as mf
from examples.grasp import BLOCK, FLESH, HEIGHT, PEDESTAL, Grasp, lift, run, soft_block, soft_pads


@pytest.fixture(params=["fingers on slides", pytest.param("Robotiq 2F-85", marks=pytest.mark.slow)])
def gripper(request: pytest.FixtureRequest) -> str | None:
    return None if request.param == "fingers on slides" else str(shared("scenes/robotiq_2f85/2f85.xml"))


@pytest.mark.parametrize(
    "scene", [soft_block, pytest.param(soft_pads, marks=pytest.mark.slow)], ids=["soft block", "soft pads"]
)
def test_what_is_lifted_slips_by_less_than_a_millimetre(
    scene: Callable[[str | None], Grasp], gripper: str | None
) -> None:
    grasp = scene(gripper)
    slip = lift(grasp)
    assert slip < 1e-3  # [m], in 11.5 s
    assert grasp.height == pytest.approx(PEDESTAL + BLOCK / 2 + HEIGHT, abs=2e-3)  # the lift sags under its own weight
    assert not any(warning.number for warning in grasp.data.warning)
    pedestal = grasp.model.geom("pedestal").id
    assert not any(pedestal in contact.geom for contact in grasp.data.contact)


@pytest.mark.parametrize("dents", [pytest.param(False, marks=pytest.mark.slow), True])
def test_without_friction_nothing_is_lifted(dents: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fingers dent the block deeper than their ends are away, which must not hold it by these."""
    monkeypatch.setattr("mjframes.attach", partial(mf.attach, contact=mf.Contact(dents=dents)))
    grasp = soft_block()
    grasp.model.geom_friction[:, 0] = 0.01  # times two fingers of 9 N: less than the block's weight of 0.7 N
    assert lift(grasp) > 0.02
    assert grasp.height < PEDESTAL + BLOCK


@pytest.mark.slow
def test_the_lift_is_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("examples.grasp.END", 1.1)
    slips = run(tmp_path)
    assert set(slips) == {"soft_block", "soft_pads"}
    assert max(slips.values()) < 1e-3
    for name, least in (("soft_block", 0.01), ("soft_pads", 0.002)):
        shown = film(tmp_path / f"{name}.mp4")
        assert len(shown) == 33
        assert min(share(frame, FLESH.rgba[:3]) for frame in shown) > least
