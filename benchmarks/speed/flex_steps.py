"""Steps of MuJoCo's own flex in the same scenes: a beam, as exact under its weight as frames make it, or more exact.

Which flex is that exact is found as the report finds it: ever finer cells, in the report's cantilever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.contenders.flex import FlexProcess, FlexSetting, best_flex
from benchmarks.contenders.frames import Setting, solved
from benchmarks.solids.cases import Case, bar
from benchmarks.solids.reference import refined
from benchmarks.speed.step_scenes import FALL, TIMESTEP, Extent, places, surroundings
from mjframes.volume.volume import Volume

ACROSS = 6  # voxels of the beam across
KINDS = ("trilinear", "quadratic")
MOST_DOFS = 800  # of a flex that is tried: finer ones take minutes to come to rest
RADIUS = 1e-3  # [-] of a cell, of the flex's vertices


@dataclass(frozen=True)
class Match:
    """A flex beside frames in the report's cantilever; errors are relative ones of displacements.

    setting: the one with the fewest degrees of freedom that is as exact, or else the most exact that was tried.
    """

    setting: FlexSetting
    error: float
    frames: int
    error_of_frames: float

    @property
    def contender(self) -> str:
        return self.setting.family


@dataclass(frozen=True)
class FlexRun:
    """Steps of a scene with flexes in the other process."""

    body: str
    frames: int
    scene: str
    contender: str
    dofs: int
    found: tuple[float, float]
    number: int
    process: FlexProcess

    def step(self, steps: int) -> float:
        return self.process.ask({"do": "steps", "id": self.number, "steps": steps})["seconds"]

    def contacts(self, steps: int) -> tuple[float, float]:
        return self.found


def beam() -> Case:
    """Return the report's cantilever in coarse voxels."""
    return bar("cantilever", "cantilever, ν = 0.3", "weight", across=ACROSS)


def matches(case: Case, frames: int, process: FlexProcess) -> list[Match]:
    """Return the flex of each kind that goes with so many frames."""
    known = refined(case)
    mine = known.error(solved(case, Setting(frames), known.load).moved)
    found: list[Match] = []
    for kind in KINDS:
        best, _ = best_flex(case, kind, known, mine, MOST_DOFS, process)
        if best:
            found.append(Match(best.setting, best.error, frames, mine))
    process.forget()
    return found


def flex_run(
    name: str, match: Match, scene: str, volume: Volume, number: int, steps: int, process: FlexProcess
) -> FlexRun:
    """Return the steps of a flex in a scene; `number` tells runs apart.

    Raise MjframesError where MuJoCo refuses it.
    """
    material = volume.materials[1]
    size = np.array(volume.labels.shape) * volume.spacing
    around = Extent((0.0, 0.0, 0.0), tuple(size.tolist()), float(np.prod(size)) * material.density)
    cells = np.array(match.setting.cells)
    flexes = "".join(
        f"""<flexcomp name="flex{k}" type="grid" dim="3" dof="{match.setting.dof}" mass="{around.mass}"
          count="{_text(cells + 1)}" cellcount="{_text(cells)}" spacing="{_text(size / cells)}"
          pos="{_text(np.array(pos) + size / 2)}" radius="{RADIUS * float(np.min(size / cells))}">
          <elasticity young="{material.young}" poisson="{material.poisson}"/><contact selfcollide="none"/></flexcomp>"""
        for k, pos in enumerate(places(scene, around))
    )
    spec = surroundings(scene, around)
    spec.compile()
    option = f'<option timestep="{TIMESTEP}" integrator="discrete"/><size memory="1G"/>'
    _, _, rest = spec.to_xml().partition("<worldbody")
    body = "<worldbody/>" if rest.startswith("/>") else f"<worldbody{rest.partition('</worldbody>')[0]}</worldbody>"
    xml = f"<mujoco>{option}{body}<worldbody>{flexes}</worldbody></mujoco>"
    answer = process.ask({"do": "scene", "id": number, "xml": xml, "fall": FALL, "steps": steps})
    found = answer["contacts"], answer["iterations"]
    return FlexRun(name, match.frames, scene, match.contender, answer["dofs"], found, number, process)


def _text(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))
