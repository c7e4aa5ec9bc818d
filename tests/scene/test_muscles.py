"""Muscles as tendons: virtual work, momentum, contraction, MuJoCo's own muscle, and what is said of bad arguments."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import mujoco
import numpy as np
import pytest
from builders.hollow import SHAPE, SPACING, actuated, check_momentum, check_virtual_work, corrected, hollow_body
from builders.linked import ARM, CASES
from builders.linked import body as linked
from builders.scenes import jumble

import mjframes as mf
from mjframes.base.errors import MjframesError
from mjframes.scene.material_points import material_points
from mjframes.volume.grid import voxel_grid

pytestmark = pytest.mark.filterwarnings(
    "ignore::mjframes.scene.attach.FloatWarning",
    "ignore::mjframes.scene.attach.BranchWarning",
    "ignore::mjframes.body.build.TurnWarning",
)

ALL = 10_000  # samples: as many as there are voxels


def low() -> np.ndarray:
    """The material below the cavity."""
    mask = np.zeros(SHAPE, bool)
    mask[2:, :, :4] = True
    return mask


def helical() -> np.ndarray:
    """Directions that turn about the bar's axis along it, of any length."""
    angle = 0.2 * np.arange(SHAPE[0])
    direction = np.zeros((*SHAPE, 3))
    direction[..., 0] = 2
    direction[..., 1] = np.cos(angle)[:, None, None]
    direction[..., 2] = np.sin(angle)[:, None, None]
    return direction


def twisted(samples: int = 100) -> dict[str, mf.Chamber | mf.Fibre | mf.Muscle]:
    return {"muscle": mf.Muscle(low(), helical(), samples)}


@pytest.mark.parametrize("frames", [3, 10, 20])
def test_an_active_stress_does_the_work_of_the_muscles_length(frames: int) -> None:
    check_virtual_work(actuated(hollow_body(frames), twisted()), ["muscle"])


@pytest.mark.parametrize("case", ["point", "quadratic", "all types on a moving link"])
def test_so_it_does_on_links_and_with_all_types_of_frames(case: str) -> None:
    types, links, parent = CASES[case]
    spec = mujoco.MjSpec.from_string(ARM)
    body = linked(types, links)
    mask = body.fields.volume.labels > 0
    mf.attach(spec, body, "bar", parent, tendons={"muscle": mf.Muscle(mask, (1, 0.5, 0))})
    check_virtual_work(spec, ["muscle"], 0.01)


@pytest.mark.parametrize(("samples", "most"), [(ALL, 1e-9), (200, 0.025), (100, 0.04)])
def test_its_length_is_the_stretch_of_the_bodys_own_deformation_gradient(samples: int, most: float) -> None:
    """Sampled, it is within 4 % of ∫ ||F f| − 1| dV on states in which frames have nothing to do with each other."""
    body = hollow_body(10)
    spec = actuated(body, twisted(samples))
    model = spec.compile()
    data = mujoco.MjData(model)
    grid = voxel_grid(body.fields.volume)
    voxels = grid.lookup[low()]
    along = helical()[low()]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    mujoco.mj_forward(model, data)
    view = mf.soft(model, data, "bar", body)
    rest = view.control_positions
    assert data.ten_length[0] == pytest.approx(len(voxels) * SPACING**3, rel=1e-6)
    points = material_points(body, rest, grid.points(voxels))
    rng = np.random.default_rng(0)
    for _ in range(3):
        jumble(model, data, rng, 0.003, 0.0)
        x = view.control_positions
        F = np.empty((len(voxels), 3, 3))
        for group in points.groups:  # without what the body moves beyond its frames
            F[group.rows] = np.einsum("jr,nja->nra", x[group.points], group.gradient) + group.slack
        stretch = np.linalg.norm(np.einsum("nra,na->nr", F, along), axis=1)
        exact = stretch.sum() * SPACING**3 + corrected(spec, "muscle", x, rest)
        change = np.abs(stretch - 1).sum() * SPACING**3
        assert abs(data.ten_length[0] - exact) < most * change


def test_what_acts_inside_a_body_changes_neither_of_its_momenta() -> None:
    check_momentum(actuated(hollow_body(10, held=False), twisted()), {"muscle": -1e4})


YOUNG, EDGE = 1e5, 0.005


@cache
def strip() -> mf.SoftBody:
    volume = mf.Volume.from_labels(np.ones((24, 4, 4), np.uint8), EDGE, {1: mf.Material(YOUNG, 0.3, 1000)})
    return mf.build(volume, 5)


@pytest.mark.parametrize("stress", [100.0, 2000.0])
def test_a_free_bar_contracts_by_stress_over_youngs_modulus(stress: float) -> None:
    model = actuated(strip(), {"muscle": mf.Muscle(1, (-3, 0, 0))}).compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = -stress
    mujoco.mj_step(model, data, nstep=4000)
    mujoco.mj_forward(model, data)
    ends = mf.soft(model, data, "bar", strip()).positions(np.array([(EDGE / 2, 0.01, 0.01), (23.5 * EDGE, 0.01, 0.01)]))
    strain = 1 - np.linalg.norm(ends[1] - ends[0]) / (23 * EDGE)
    assert strain == pytest.approx(stress / YOUNG, rel=0.05)
    rest = 24 * 4 * 4 * EDGE**3
    assert 1 - data.ten_length[0] / rest == pytest.approx(stress / YOUNG, rel=0.1)
    view, along = mf.soft(model, data, "bar", strip()), EDGE * (np.arange(24) + 0.5)
    low, high = (
        view.positions(np.column_stack([along, np.full(24, y), np.full(24, 0.01)])) for y in (EDGE / 2, 0.0175)
    )
    wider = np.linalg.norm(high - low, axis=1) / (3 * EDGE) - 1
    assert wider.mean() == pytest.approx(0.3 * stress / YOUNG, rel=0.1)


def test_mujocos_muscle_pulls_and_a_servo_holds_it_short() -> None:
    """A muscle of 4 kPa and what it resists when stretched; and a servo on the length."""
    spec = actuated(strip(), {"muscle": mf.Muscle(1, (1, 0, 0))})
    rest = 24 * 4 * 4 * EDGE**3
    spec.actuator("muscle").set_to_muscle(timeconst=[0.01, 0.04], tausmooth=0.0, range=[0.75, 1.05], force=4000.0)
    spec.actuator("muscle").lengthrange = [0.75 * rest, 1.05 * rest]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = 1
    mujoco.mj_step(model, data, nstep=3000)
    pull = -data.actuator_force[0]
    assert 2000 < pull < 6000
    assert data.ten_length[0] < 0.99 * rest
    assert not data.warning.number.any()

    spec.actuator("muscle").set_to_position(kp=1e10)  # [Pa/m³]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.97 * rest
    mujoco.mj_step(model, data, nstep=3000)
    assert np.abs(data.qvel).max() < 1e-4
    assert 0.97 * rest < data.ten_length[0] < rest
    assert data.actuator_force[0] == pytest.approx(1e10 * (0.97 * rest - data.ten_length[0]), rel=1e-3)


@pytest.mark.parametrize(
    ("muscle", "said"),
    [
        (lambda: mf.Muscle(2, (1, 0, 0)), "voxels of 'muscle' is the label 2"),
        (lambda: mf.Muscle(np.ones((2, 2, 2), bool), (1, 0, 0)), "voxels of 'muscle' has the shape (2, 2, 2)"),
        (lambda: mf.Muscle(np.ones(SHAPE), (1, 0, 0)), "and type float64"),
        (lambda: mf.Muscle(np.ones(SHAPE, bool), (1, 0, 0)), "voxels outside the body"),
        (lambda: mf.Muscle(np.zeros(SHAPE, bool), (1, 0, 0)), "has no voxel"),
        (lambda: mf.Muscle(1, (0, 0, 0)), "direction of 'muscle' has no length"),
        (lambda: mf.Muscle(1, (1, np.nan, 0)), "direction of 'muscle' has no length"),
        (lambda: mf.Muscle(1, np.zeros((*SHAPE, 3))), "direction of 'muscle' has no length"),
        (lambda: mf.Muscle(1, (1, 0)), "direction of 'muscle' has the shape (2,)"),
        (lambda: mf.Muscle(1, np.ones((3, 3, 3, 3))), "direction of 'muscle' has the shape"),
        (lambda: mf.Muscle(1, "along"), "direction of 'muscle' has the shape ()"),
        (lambda: mf.Muscle(1, (1, 0, 0), samples=0), "samples is 0"),
    ],
)
def test_a_sentence_says_what_is_wrong_with_a_muscle(muscle: Callable[[], mf.Muscle], said: str) -> None:
    with pytest.raises(MjframesError) as found:
        mf.attach(mujoco.MjSpec(), hollow_body(), "bar", tendons={"muscle": muscle()})
    assert said in str(found.value)
    assert str(found.value).count(". ") == 0


@pytest.mark.parametrize(("integrator", "least", "most"), [("Euler", 0.05, 0.085), ("implicitfast", 0.104, 0.106)])
def test_what_follows_the_velocity_chatters_under_euler(integrator: str, least: float, most: float) -> None:
    """MuJoCo's <muscle>, which has a force by velocity, shortens by 10.5 % at steps of 0.1 ms."""
    bar = mf.Volume.box((0.03, 0.03, 0.15), mf.Material(5e4, 0.45, 1000), spacing=0.005)
    half = np.zeros(bar.labels.shape, bool)
    half[:3] = True
    body = mf.build(bar, 3, supports=mf.Fixed(bar.side("z")), damping=(5, 0.005))
    length = 0.03 * 0.015 * 0.15
    spec = mujoco.MjSpec.from_string(f"""<mujoco><option gravity="0 0 0" integrator="{integrator}"/>
        <actuator><muscle tendon="flexor" force="8000" lengthrange="{0.75 * length} {1.05 * length}"/></actuator>
        </mujoco>""")
    mf.attach(spec, body, "bar", tendons={"flexor": mf.Muscle(half, (0, 0, 1))}, contact=False)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rest, data.ctrl[0] = float(data.ten_length[0]), 1
    mujoco.mj_step(model, data, nstep=500)
    lengths = []
    for _ in range(10):
        mujoco.mj_step(model, data)
        lengths.append(data.ten_length[0])
    assert least < 1 - np.mean(lengths) / rest < most
