"""Free vibration after release: a bar bent by its weight, then let go.

The reference superposes the modes of finite elements, K φ = ω² M φ with lumped masses:
u(t) = Σ_i φ_i (φ_iᵀ M u_0) cos ω_i t. It loses nothing; what implicit steps take away is reported as the amplitude
that is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import lobpcg

from benchmarks.contenders.equilibrium import TIMED_STEP
from benchmarks.contenders.flex import FlexProcess, FlexSetting
from benchmarks.contenders.frames import Setting, solved
from benchmarks.solids import SOURCES
from benchmarks.solids.bricks import at_centers, bricks, linear_stiffness, nodal_mass
from benchmarks.solids.cases import Case
from benchmarks.solids.reference import Reference, linear_solution, preconditioner
from mjframes.base.cache import cached
from mjframes.base.errors import MjframesError

Array = NDArray[np.float64]

MODES = 6
LOST = 2.0  # [-] of the first deflection: a free vibration that is larger at the end has no frequency
PERIODS = 6  # of the first mode, that are stepped
TIMESTEP = TIMED_STEP / 4  # [s] about 600 steps a period: frequencies are then the model's, not the integrator's


@dataclass(frozen=True)
class Vibration:
    """How a contender vibrates after release.

    frequency: [Hz] of the first mode.
    error: relative, of the frequency.
    left: amplitude after `PERIODS`, of that at the start.
    distance: relative L2 in time, over the first period, of the quantity of interest.
    """

    kind: str
    family: str
    name: str
    dofs: int
    frequency: float
    error: float
    left: float
    distance: float
    history: tuple[float, ...]


def exact_vibration(case: Case, known: Reference) -> tuple[float, Array, Array]:
    """Return the frequency [Hz] of the first mode, times (t,) [s] and the quantity of interest (t,) [m]."""
    inputs = ((*SOURCES, Path(__file__)), case.volume, case.fixed, known.load, MODES)
    modes = cached("vibration", inputs, lambda: _modes(case, known))
    omega = modes["omega"]
    first = float(omega[0] / (2 * np.pi))
    times = TIMESTEP * np.arange(1.0, int(PERIODS / first / TIMESTEP) + 1)
    part = np.array([case.quantity(field) for field in modes["fields"]])
    return first, times, np.asarray(np.cos(np.outer(times, omega)) @ part, np.float64)


def _modes(case: Case, known: Reference) -> dict[str, Array]:
    mesh, low = (bricks(case.grid, case.held, *level) for level in ((2, 1), (1, 2)))
    moving = mesh.moving
    matrix = linear_stiffness(mesh)[moving][:, moving]
    inverse = preconditioner(linear_stiffness(low)[moving][:, moving], mesh)
    mass = np.repeat(nodal_mass(mesh, case.grid.density * case.grid.cell_volume), 3)[moving]
    start = np.random.default_rng(0).normal(size=(len(mass), MODES))
    bent = linear_solution(mesh, low, known.load).ravel()[moving]
    start[:, 0] = bent
    scale = np.sqrt(mass)
    diagonal = sparse.diags_array(mass, format="csr")
    squares, vectors = lobpcg(
        matrix, start / scale[:, None], B=diagonal, M=inverse, largest=False, tol=1e-6, maxiter=200
    )
    order = np.argsort(squares)
    fields = []
    for i in order:
        whole = np.zeros(len(moving))
        vector = vectors[:, i] / np.sqrt(vectors[:, i] @ (mass * vectors[:, i]))
        whole[moving] = vector * (vector @ (mass * bent))
        fields.append(at_centers(mesh, whole.reshape(-1, 3)))
    return {"omega": np.sqrt(squares[order]), "fields": np.array(fields)}


def vibrations(case: Case, known: Reference, flex: FlexProcess | None, quick: bool) -> list[Vibration]:
    """Return those of some contenders; the ones that do not build are left out."""
    first, times, exact = exact_vibration(case, known)
    found: list[Vibration] = []
    sizes = (3, 5) if quick else (3, 5, 10)
    cells = ((4, 1, 1), (8, 2, 2)) if quick else ((4, 1, 1), (8, 2, 2), (16, 4, 4))
    entries = [
        ("mjframes", Setting(frames, mass=mass, by_hand=by_hand))
        for by_hand in (False, True)
        for mass in ("consistent", "lumped")
        for frames in sizes
    ]
    entries += [
        ("flex", FlexSetting(dof, count))
        for dof in ("trilinear", "quadratic")
        for count in cells
        if flex and count[0] * (dof == "quadratic") < 16
    ]
    for kind, setting in entries:
        try:
            if isinstance(setting, Setting):
                one = solved(case, setting, known.load)
            else:
                assert flex
                one = flex.solved(case, setting, known.load)
        except MjframesError:
            continue
        history = one.release(TIMESTEP, len(times))
        frequency = _frequency(times, history)
        period = times < 1 / first
        last = times > times[-1] - 1 / first
        start = case.quantity(one.moved)
        found.append(
            Vibration(
                kind,
                one.family,
                one.name,
                one.dofs,
                frequency,
                frequency / first - 1,
                float(np.abs(history[last]).max() / abs(start)),
                float(np.linalg.norm((history - exact)[period]) / np.linalg.norm(exact[period])),
                tuple(history[:: max(1, len(history) // 400)].tolist()),
            )
        )
    return found


def _frequency(times: Array, history: Array) -> float:
    """[Hz] from the places where the quantity passes zero."""
    before = np.flatnonzero(history[:-1] * history[1:] < 0)
    if len(before) < 2:
        return 0.0
    share = history[before] / (history[before] - history[before + 1])
    zero = times[before] + share * (times[1] - times[0])
    return float((len(zero) - 1) / 2 / (zero[-1] - zero[0]))
