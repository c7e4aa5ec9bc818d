"""From scanners' images and scanned surfaces to a second of simulation."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.commands import main
from mjframes.finite_elements import conjugate
from mjframes.scene.scene_file import standalone_scene
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

pytestmark = pytest.mark.slow
SHARED = Path(__file__).parents[3] / "shared" / "data"
BONE = Material.rigid(1900, name="bone")
CARTILAGE = Material(1e7, 0.45, 1100, name="cartilage")
FLESH = Material(1.5e4, 0.45, 1050, name="flesh")


def shared(name: str) -> Path:
    if not (SHARED / name).is_file():
        pytest.skip(f"{name} is not there: it is one of the large files that are not part of this repository")
    return SHARED / name


def after_a_second(body: SoftBody, volume: Volume) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The body on its floor; fails at MuJoCo's warnings."""
    model = standalone_scene(body, volume).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(1 / model.opt.timestep))
    assert not any(warning.number for warning in data.warning)
    assert np.abs(data.qvel).max() < 2.0  # [m/s]
    return model, data


@pytest.mark.filterwarnings("error")
def test_knee_in_a_hull_of_flesh(monkeypatch: pytest.MonkeyPatch) -> None:
    materials = {label: BONE if 5 <= label <= 8 else CARTILAGE for label in range(1, 11)}
    knee = Volume.load(shared("volumes/knee_dess_labels.nrrd"), materials=materials)
    volume = knee.filled(FLESH)
    assert np.count_nonzero(volume.labels == 11) == 1_868_016
    volume = volume.resample(100_000)
    steps = []
    solve = conjugate.solve
    monkeypatch.setattr(conjugate, "solve", lambda *arguments: steps.append(solve(*arguments)))
    body = build(volume, 10)
    assert max(steps) < 40  # also for forces that but for the stiff bones cancel
    assert len(body.parent) == 10
    assert body.error is not None
    assert body.error.pushes < 0.4
    mass = sum(volume.materials[k].density * (knee.labels == k).sum() for k in range(1, 11)) + 1050 * 1_868_016
    model, data = after_a_second(body, volume)
    np.testing.assert_allclose(model.body_mass.sum(), mass * np.prod(knee.spacing), rtol=0.01)
    assert data.ncon > 0  # it has fallen on the floor
    height = data.subtree_com[0][2]
    assert 0 < height < 0.15


def test_frog_of_131_pieces_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    soft = "young=2e4,poisson=0.45,density=1050"
    tissues = [f"{label}=tissue:{soft}" for label in range(1, 16) if label != 13] + ["13=skeleton:rigid,density=1900"]
    command = [
        "build",
        str(shared("volumes/frog_tissue_labels.nii.gz")),
        "--frames",
        "10",
        "--method",
        "paper",
        "--samples",
        "200",
    ]
    command += [f"--material={tissue}" for tissue in tissues]
    assert main([*command, "-o", str(tmp_path / "frog.npz")]) == 2
    assert "labels 16, 17, 20, 21, 23, 24, 25, 26, 27, 29 have no material" in capsys.readouterr().err
    assert main([*command, "-o", str(tmp_path / "frog.npz"), "--drop-unknown"]) == 2
    assert "unconnected pieces" in capsys.readouterr().err
    assert main([*command, "-o", str(tmp_path / "frog.npz"), "--drop-unknown", "--largest"]) == 0
    captured = capsys.readouterr()
    assert "not connected to the others, are dropped" in captured.err
    assert "10 frames, 200 regions, 1139136 voxels" in captured.out


@pytest.mark.filterwarnings("ignore:.*encloses no voxel")
def test_rat() -> None:
    volume = Volume.from_meshes([(shared("meshes/rat_skin_closed_5k4.ply"), FLESH)], voxels=60_000)
    body = build(volume, 6)
    model, data = after_a_second(body, volume)
    np.testing.assert_allclose(model.body_mass.sum(), 1050 * 6.29979e-4, rtol=0.01)
    assert data.ncon > 0
