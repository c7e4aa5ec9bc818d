"""MuJoCo's flex as a contender: `flex_worker` in a second Python, asked over a pipe.

Its box is that of the voxels that are not held; cells divide it evenly. Nodes on voxels that are held are pinned.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.solids.cases import Case
from benchmarks.solids.reference import Reference
from mjframes.base.errors import MjframesError

Array = NDArray[np.float64]

WORKER = Path(__file__).with_name("flex_worker.py")
LEAST_VERSION = (4, 0, 0)
ORDER = {"full": 1, "trilinear": 1, "quadratic": 2}
LADDER = (1, 2, 4, 8, 16, 48, 144, 432, 1300)  # [cells] tried, about; `MOST_DOFS` ends it
MOST_DOFS, MOST_DOFS_QUICK = 6000, 800


@dataclass(frozen=True)
class FlexSetting:
    """One way to make a case's flex.

    dof: how a flex is parametrized.
    cells: of the grid along each axis.
    """

    dof: str
    cells: tuple[int, int, int]

    @property
    def dofs(self) -> int:
        """Return how many degrees of freedom there are, about, pinned ones included [-]."""
        return 3 * int(np.prod([c * ORDER[self.dof] + 1 for c in self.cells]))

    @property
    def family(self) -> str:
        return f"flex {self.dof}"

    @property
    def name(self) -> str:
        return f"{'×'.join(map(str, self.cells))} cells"


@dataclass(frozen=True, eq=False)
class FlexContender:
    """A flex at rest in the other process; the same attributes as `contenders.Contender`.

    edited: whether its compiled stiffness was replaced by that of the voxels.
    """

    name: str
    family: str
    dofs: int
    moved: Array
    build_seconds: float
    steps: int
    timestep: float
    edited: bool
    number: int
    process: FlexProcess

    def seconds_per_step(self, timestep: float, least: float) -> float:
        return self._ask("step", timestep=timestep, least=least)["seconds"]

    def seconds_to_rest(self) -> float:
        return self._ask("rest", timestep=self.timestep, steps=self.steps)["seconds"]

    def batch_rate(self, worlds: int, threads: int, least: int) -> tuple[float, float]:
        """Return world-steps of 2 ms a second under the load, as `side_by_side.batch_rate`."""
        answer = self._ask("worlds", worlds=worlds, threads=threads, least=least)
        return answer["wall"], answer["processor"]

    def release(self, timestep: float, steps: int) -> Array:
        return np.array(self._ask("release", timestep=timestep, steps=steps)["history"])

    def _ask(self, what: str, **values: float) -> dict[str, Any]:
        return self.process.ask({"do": what, "id": self.number, **values})


@dataclass(frozen=True, eq=False)
class FlexInScene:
    """A flex in a scene in the other process."""

    dofs: int
    number: int
    process: FlexProcess

    def act(
        self, joints: dict[str, float], turn: Array, position: Array, controls: Array, steps: int
    ) -> tuple[float, dict[str, int]]:
        """Return the processor time [s] of so many steps with each of the controls (n, nu), and MuJoCo's warnings.

        joints: their angles at the start.  turn (3, 3), position (3,): of the flex, undeformed, at the start.
        """
        order = {"do": "act", "id": self.number, "joints": joints, "turn": turn.tolist(), "steps": steps}
        answer = self.process.ask(order | {"position": position.tolist(), "controls": controls.tolist()})
        return answer["seconds"], answer["warned"]


class FlexProcess:
    """The other Python. Raise MjframesError where it cannot run, or its MuJoCo is too old."""

    def __init__(self, python: str) -> None:
        self._folder = tempfile.TemporaryDirectory()
        try:
            self._process = subprocess.Popen(
                [os.path.abspath(python) if os.sep in python else python, str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=self._folder.name,  # where MuJoCo writes its log
                text=True,
            )
            self.version = self.ask({"do": "version"})["version"]
        except (OSError, MjframesError) as error:
            raise MjframesError(f"{python} cannot run MuJoCo's flex; give a Python that has mujoco 4.0.0.") from error
        if tuple(int(part) for part in self.version.split(".")[:3]) < LEAST_VERSION:
            raise MjframesError(f"{python} has MuJoCo {self.version}; flex is right from 4.0.0 on.")
        self._count = 0

    def __enter__(self) -> FlexProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait()
        self._folder.cleanup()

    def ask(self, order: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to an order. Raise MjframesError with the other side's error."""
        assert self._process.stdin
        assert self._process.stdout
        try:
            self._process.stdin.write(json.dumps(order) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError:
            line = ""
        if not line:
            raise MjframesError("MuJoCo's flex ended its process.")
        answer = json.loads(line)
        if "error" in answer:
            raise MjframesError(f"flex: {answer['error']}")
        return answer

    def solved(self, case: Case, setting: FlexSetting, load: Array) -> FlexContender:
        """Return a flex at rest under `load` (n, 3) [N].

        Raise MjframesError where MuJoCo refuses it or it does not come to rest.
        """
        self._count += 1
        job = self._job(case, setting, load)
        result = Path(self._folder.name) / "moved.npy"
        answer = self.ask({"do": "solve", "job": job, "dof": setting.dof, "id": self._count, "result": str(result)})
        return FlexContender(
            name=setting.name,
            family=setting.family,
            dofs=answer["dofs"],
            moved=np.load(result),
            build_seconds=answer["build_seconds"],
            steps=answer["steps"],
            timestep=answer["timestep"],
            edited=answer["edited"],
            number=self._count,
            process=self,
        )

    def placed(self, case: Case, setting: FlexSetting, scene: Path, contact: str, damping: float) -> FlexInScene:
        """Return a flex among the other things of a scene (.xml), in the case's coordinates.

        contact: the flexcomp's element <contact …/>.  damping: Rayleigh's β [s].
        Raise MjframesError where MuJoCo refuses it.
        """
        self._count += 1
        job = self._job(case, setting, np.zeros_like(case.load))
        order = {"do": "place", "job": job, "dof": setting.dof, "id": self._count, "scene": str(scene)}
        return FlexInScene(self.ask(order | {"contact": contact, "damping": damping})["dofs"], self._count, self)

    def _job(self, case: Case, setting: FlexSetting, load: Array) -> str:
        """The file that says what the flex is to be like."""
        grid, held = case.grid, case.held
        corner = grid.index[~held] * grid.spacing + grid.origin
        path = str(Path(self._folder.name) / "job.npz")
        np.savez(
            path,
            centers=grid.centers,
            spacing=grid.spacing,
            young=grid.young,
            poisson=grid.per_material("poisson")[grid.material],
            held=held,
            load=load,
            goal=case.goal,
            mass=np.sum(grid.density[~held]) * grid.cell_volume,
            low=corner.min(axis=0),
            high=corner.max(axis=0) + grid.spacing,
            cells=np.array(setting.cells),
        )
        return path

    def forget(self) -> None:
        """Free what was solved."""
        self.ask({"do": "forget"})


def flex_settings(case: Case, quick: bool) -> list[FlexSetting]:
    """Return every parametrization on ever finer cells, as cubic as they come."""
    extent = np.ptp(case.grid.index[~case.held], axis=0) + 1
    size = extent * case.grid.spacing
    found: list[FlexSetting] = []
    for dof in ORDER:
        for cells in LADDER:
            edge = float(np.prod(size) / cells) ** (1 / 3)
            for _ in range(10):  # thin bodies have one cell across: the others are as long as makes the number right
                thick = size > edge
                edge = float(np.prod(size[thick]) / cells) ** (1 / max(1, int(thick.sum())))
            x, y, z = (int(count) for count in np.clip(np.round(size / edge), 1, extent))
            setting = FlexSetting(dof, (x, y, z))
            if setting not in found and setting.dofs <= (MOST_DOFS_QUICK if quick else MOST_DOFS):
                found.append(setting)
    return found


@dataclass(frozen=True, eq=False)
class BestFlex:
    """A flex at rest in a case.  error: relative L2 of the displacements [-]."""

    setting: FlexSetting
    contender: FlexContender
    error: float

    @property
    def name(self) -> str:
        """Return its kind and its cells."""
        return f"{self.setting.family}, {self.setting.name}"


def best_flex(
    case: Case, kind: str, known: Reference, most: float, most_dofs: int, process: FlexProcess
) -> tuple[BestFlex | None, list[str]]:
    """Return the coarsest flex of a kind with an error of at most `most`, or else the most exact one of those that come
    to rest, if any; and a line of each that does not.

    known: the case's solution.  most_dofs: of those that are tried.
    """
    found: list[BestFlex] = []
    restless: list[str] = []
    for setting in (some for some in flex_settings(case, quick=False) if some.dof == kind):
        if setting.dofs > most_dofs:
            break
        try:
            contender = process.solved(case, setting, known.load)
        except MjframesError as reason:
            restless.append(f"{setting.family}, {setting.name}: {str(reason).removeprefix('flex: ')}")
            continue
        found.append(BestFlex(setting, contender, known.error(contender.moved)))
        if found[-1].error <= most:
            break
    return min(found, key=lambda one: one.error, default=None), restless
