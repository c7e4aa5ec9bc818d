"""Each example runs and gives the number it should."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import mujoco.sysid
import numpy as np
import pytest
from builders.pictures import film, picture, share, share_drawn
from matplotlib import colormaps

import mjframes as mf
from examples import arm, identify, kernels, knee, taxels
from examples.steak import run, steak_scene
from mjframes.app.log.read import read_log
from mjframes.testing import Goldens

STEAK, MUSCLE, SKIN = (0.58, 0.09, 0.11), (0.62, 0.12, 0.13), (0.9, 0.68, 0.58)  # colours of the models' materials


@pytest.mark.slow
def test_steak_comes_to_rest_on_the_block() -> None:
    model = steak_scene().compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=5000)
    soft = model.body_rootid == model.body("steak").id
    speed = data.cvel[soft, 3:]
    assert np.abs(speed).max() < 1e-3  # [m/s], after 10 s: it creeps off its edge for ten more
    assert data.subtree_com[model.body("steak").id][2] > 0.04  # [m]: on the block, not on the worktop


def test_steak_leaves_film_plot_and_log(tmp_path: Path) -> None:
    recording = run(tmp_path, duration=0.3)
    shown, plot = film(tmp_path / "steak.mp4"), picture(tmp_path / "steak.png")
    assert len(shown) == 9
    assert min(share(frame, STEAK) for frame in shown) > 0.008
    assert min(share(plot, color) for color in ("C0", "C1", "C2", "tab:red")) > 3e-4  # energies and penetration
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "steak.xml")).nskin > 0
    assert recording.energy_gain < 1e-3  # [J]
    assert recording.penetration < 8e-3  # [m]: it lands at 1.2 m/s on contacts with a time constant of 5 ms
    logged = read_log(tmp_path / "steak.mcap").messages
    assert len(logged["/energy"]) == recording.steps
    times = [state["time"] for state in logged["/state"]]
    assert len(times) == 10  # nine frames of the film, and the end
    assert times[-1] == recording.states[-1].time
    assert (tmp_path / "steak.mcap").stat().st_size < 600_000  # [bytes]


@pytest.mark.slow
def test_pulling_the_quadriceps_lifts_the_tibia(tmp_path: Path) -> None:
    found = knee.run(tmp_path)
    shown = picture(tmp_path / "knee.png")
    assert share(shown, MUSCLE) > 0.015  # the sections alone show it
    assert share(shown, SKIN) > 0.1
    assert len(found.body.parent) == 10
    assert 14 < found.extension < 17  # [degrees]; finite elements 18 in the first order
    assert np.abs(found.data.qvel).max() < 0.01  # [m/s]: it is held there
    assert not any(warning.number for warning in found.data.warning)
    x, stiffness = mf.soft(found.model, found.data, "knee").control_positions, found.body.stiffness
    stretch = [np.linalg.det(x[p].T @ g) for p, g in zip(stiffness.points, stiffness.gradient, strict=True)]
    assert min(stretch) > 0.05  # no region is inside out


@pytest.mark.slow
def test_a_fingertip_feels_a_pen_roll_and_slide(tmp_path: Path) -> None:
    felt = taxels.run(tmp_path)
    shown, plot = film(tmp_path / "taxels.mp4"), picture(tmp_path / "taxels.png")
    assert len(shown) == round(30 * taxels.END) - 1
    assert min(share(frame, (0.2, 0.22, 0.26)) for frame in shown) > 0.003  # the fingertip's back
    assert min(share(plot, colormaps["magma"](value)[:3]) for value in (0.3, 0.7)) > 0.001
    start, end, last = map(felt.at, (taxels.PRESSING, taxels.ROLLED, taxels.STOPPED))
    area = np.prod(taxels.SIZE) / np.prod(taxels.SHAPE)
    assert felt.force[start:last, 2] == pytest.approx(taxels.FORCE, rel=0.05)
    assert area * felt.traction[start, ..., 0].sum() == pytest.approx(taxels.FORCE, rel=0.05)
    wandered = (felt.centre[start] - felt.centre[end]) / (felt.gone[end] - felt.gone[start])
    assert 0.4 < wandered < 0.52  # half, less as the fingertip is round
    assert felt.grip[start : felt.at(1.1)].max() < 0.15
    assert felt.grip[last - 50 : last] == pytest.approx(taxels.FRICTION, rel=0.15)


@pytest.mark.slow
def test_an_arm_with_three_cables_reaches_its_targets(tmp_path: Path) -> None:
    found = arm.run(tmp_path)
    shown, plot = film(tmp_path / "arm.mp4"), picture(tmp_path / "arm.png")
    assert len(shown) == round(arm.FPS * arm.STAY * len(arm.TARGETS))
    assert min(share(frame, (0.17, 0.61, 0.28)) for frame in shown) > 0.001  # the targets' posts
    assert share(plot, (0.12, 0.47, 0.71)) > 0.001
    assert found.errors.max() < 0.05 * np.linalg.norm(arm.TARGETS[0])
    assert found.tensions.min() >= 0
    assert found.tensions.max() < arm.MOST


def test_kernels_of_figure_6(tmp_path: Path) -> None:
    fields = kernels.run(tmp_path)
    shown = picture(tmp_path / "kernels.png")
    assert min(share(shown, colormaps["turbo"](value)[:3]) for value in (0.2, 0.5, 0.8, 1.0)) > 0.008
    arm, right = (slice(30, 50), slice(41, 52)), (slice(65, None), slice(0, 20))
    assert np.nanmax(fields[1][arm]) == 0  # "not guaranteed to reach all the expected regions"
    assert np.nanmin(fields[2][arm]) > 0.03
    assert np.nanmax(fields[2][right]) == 0
    assert np.nanmin(fields[5][right]) > 0.06  # "unrealistically large influence regions"
    assert np.nanmax(fields[5][right]) < 0.09


@pytest.mark.dm_control
@pytest.mark.slow
def test_a_coarser_rat_starts_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("dm_control")
    from examples import rat
    from mjframes.dm import rodent

    monkeypatch.setattr(rodent, "VOXELS", 15_000)
    found = rat.run(tmp_path, duration=0.1)
    shown = film(tmp_path / "rat.mp4")
    assert len(shown) == 3
    assert min(map(share_drawn, shown)) > 0.3
    assert not any(warning.number for warning in found.data.warning)
    assert found.stretch.max() > 1


@pytest.mark.slow
@pytest.mark.dm_control
def test_the_flesh_of_dm_controls_rodent_follows_its_bones(tmp_path: Path, golden: Goldens) -> None:
    pytest.importorskip("dm_control")
    from examples import rat
    from mjframes.dm.rodent import BONES, FREE

    found = rat.run(tmp_path, duration=0.4)
    shown = film(tmp_path / "rat.mp4")
    assert len(shown) == 12
    assert min(map(share_drawn, shown)) > 0.3
    assert len(found.body.types) == len(BONES) + FREE
    assert not any(warning.number for warning in found.data.warning)
    sway = np.ptp(found.belly, axis=0)
    assert 3e-3 < sway[1] < 0.02  # [m]: the spine bends, and the belly with it
    assert 0.01 < sway[2] < 0.03  # [m]: the guts go on where the spine turns back
    assert found.stretch.max() < 8  # in the ankles; boneless toes stretched by 18
    assert np.count_nonzero(found.stretch > 3) < 0.005 * len(found.stretch)  # 0.43 %; 0.24 % where Hooke got no stiffer
    view = mf.soft(found.model, found.data, "flesh")
    assert found.body.links == tuple(BONES)
    assert view.elastic_energy > 0
    mujoco.mj_forward(found.model, found.data)  # the film moved the bodies on and left the rest of the data behind
    assert np.linalg.eigvalsh(mf.mass_matrix(found.model, found.data))[0] > 0  # its pieces are on many branches
    golden(found.model, mujoco.MjData(found.model), "rat", "beside")
    golden(found.model, found.data, "running_rat", "beside")


@pytest.mark.dm_control
@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_a_jaco_arm_lifts_the_steak(seed: int) -> None:
    from examples import lift

    found = lift.lift(lift.started(seed))
    assert found.rise > 0.15  # [m], all through the last second
    assert found.clearance > 0.02  # [m] above the block, of the lowest point
    assert found.rewards[0] == 0
    assert found.rewards[-1] == 1


@pytest.mark.slow
def test_moduli_of_a_post_are_identified_from_its_own_pokes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not hasattr(mujoco.sysid, "optimize"):
        pytest.skip("mujoco.sysid needs its extra")
    monkeypatch.setattr(identify, "ROUNDS", 2)
    monkeypatch.setattr(identify, "FITS", dict.fromkeys(identify.FITS, (identify.COARSE, identify.COARSE)))
    *_, found = identify.run(tmp_path).values()
    shown = picture(tmp_path / "identify.png")
    assert min(share(shown, color) for color in ("C0", "C1")) > 3e-4  # two layers
    assert (found.error < 0.02).all()


def test_the_errors_of_moduli_are_those_of_the_gallery() -> None:
    page = (Path(__file__).parents[2] / "docs/gallery.md").read_text(encoding="utf-8")
    section = page.partition("## Moduli from pokes")[2].partition("\n## ")[0]
    said, drawn = (" ".join(str(text).split()) for text in (identify.__doc__, section))
    percent = r"(\d+(?:, \d+ and \d+)?) %"
    assert set(re.findall(percent, said)) == set(re.findall(percent, drawn))


@pytest.mark.slow
def test_two_moduli_are_identified_from_pokes(tmp_path: Path) -> None:
    if not hasattr(mujoco.sysid, "optimize"):
        pytest.skip("mujoco.sysid needs its extra")
    found, coarse, fine = identify.run(tmp_path).values()
    shown = picture(tmp_path / "identify.png")
    assert min(share(shown, color) for color in ("C0", "C1")) > 3e-4  # two layers
    assert max(coarse.error.max(), fine.error.max()) < 0.06  # from the record of a finer post
    np.testing.assert_allclose(found.young[0] / identify.TRUE, [3, 1 / 3])
    assert (found.error < 0.01).all()
    assert np.ptp(found.recorded, axis=0).min() > 0.005  # [m]: pokes that are felt
    # the dents are as wide as those of the last build, whose moduli are not quite the true ones
    assert np.sqrt(np.mean((found.fitted - found.recorded) ** 2)) < 6 * identify.NOISE
