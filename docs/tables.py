"""Tables of the documentation that the code has: `python docs/tables.py` writes them into the pages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from mjframes.base.choices import COROTATIONAL
from mjframes.base.options import described, options_of
from mjframes.body.options import BuildOptions
from mjframes.elasticity.law_table import ALL_LAWS, LAWS
from mjframes.elasticity.laws import law_parameters, stress
from mjframes.elasticity.pressed import FLAT, PressedCell
from mjframes.scene.sensors import QUANTITIES
from mjframes.volume.images import IMAGE_TYPES
from mjframes.volume.material import Material
from mjframes.volume.meshes import MESH_TYPES

FOLDER = Path(__file__).parent


def options_of_build() -> str:
    """Return the options of `mf.build` as a table."""
    rows = [f"| `{some.name}` | {_coded(described(some, said))} |" for some, said in options_of(BuildOptions)]
    return "\n".join(["| argument | what it is |", "| --- | --- |", *rows])


def laws() -> str:
    """Return the hyperelastic laws and their constants as a table."""
    rows = [f"| `{name}` | {', '.join(f'`{constant}`' for constant in law.names)} |" for name, law in LAWS.items()]
    return "\n".join(["| law | constants |", "| --- | --- |", *rows])


def stretched() -> str:
    """Return how hard bars of each law pull or push, to one of textbook neo-Hooke of the same E and ν, as a table."""
    laws = {f"`{law}`": (law, {}) for law in ALL_LAWS}
    laws["`mooney_rivlin`, `c01` = 0"] = "mooney_rivlin", {"c01": 0.0}
    cases = [(stretch, poisson) for poisson in (0.3, 0.45) for stretch in (0.6, 1.2, 1.5, 2.0)]
    rows = [[f"λ = {stretch:g}, ν = {poisson:g}" for stretch, poisson in cases], ["---"] * len(cases)]
    for law, constants in laws.values():
        bars = [(Material(1.0, poisson, 1.0, law_constants=constants), stretch) for stretch, poisson in cases]
        rows.append([f"{_pull(law, *bar) / _pull(None, *bar):.2f}" for bar in bars])
    return "\n".join(f"| {name} | {' | '.join(row)} |" for name, row in zip(["law", "---", *laws], rows, strict=True))


def sensors() -> str:
    """Return what a sensor can measure as a table."""
    rows = [
        f"| `{name}` | {one.what} | {one.unit} | {one.values}{' per point' if one.reads else ''} |"
        for name, one in QUANTITIES.items()
    ]
    return "\n".join(["| quantity | what it is | unit | values |", "| --- | --- | --- | --- |", *rows])


def volume_formats() -> str:
    """Return the files that a volume is made of as a table."""
    kinds = {"label images": IMAGE_TYPES, "meshes": MESH_TYPES}
    rows = [f"| {kind} | {' '.join(f'`{name}`' for name in names)} |" for kind, names in kinds.items()]
    return "\n".join(["| files | types |", "| --- | --- |", *rows])


TABLES = {
    ("options.md", "options"): options_of_build,
    ("options.md", "laws"): laws,
    ("options.md", "stretched"): stretched,
    ("scenes.md", "sensors"): sensors,
    ("volumes.md", "formats"): volume_formats,
}


def written(page: str, name: str, table: str) -> str:
    """Return the text of a page with that table between its marks."""
    begin, end = f"<!-- table: {name} -->\n", "<!-- end -->"
    before, after = (FOLDER / page).read_text(encoding="utf-8").split(begin)
    return f"{before}{begin}{table}\n{end}{after.partition(end)[2]}"


def _pull(law: str | None, material: Material, stretch: float) -> float:
    """Force of a bar that is free at its sides, by its area at rest [Pa].  law: None for textbook neo-Hooke."""

    def piola(across: float) -> NDArray[np.float64]:
        F = np.diag([stretch, across, across])
        if law == COROTATIONAL:
            return _hooke(material, F)
        return _textbook(material, F) if law is None else stress(law_parameters(law, material), F[None])[0]

    free = root_scalar(lambda across: piola(across)[1, 1], bracket=(0.3, 1.5))
    return float(piola(free.root)[0, 0])


def _textbook(material: Material, F: NDArray[np.float64]) -> NDArray[np.float64]:
    """P (3, 3) [Pa] of ψ = μ/2 (I₁ J^(−2/3) − 3) + K/2 (J − 1)²."""
    lam, mu = material.lame
    i1, j, inverse = (F**2).sum(), np.linalg.det(F), np.linalg.inv(F).T
    return mu * j ** (-2 / 3) * (F - i1 / 3 * inverse) + (lam + 2 / 3 * mu) * (j - 1) * j * inverse


def _hooke(material: Material, F: NDArray[np.float64]) -> NDArray[np.float64]:
    """P (3, 3) [Pa] of the law `corotational` for a symmetric F."""
    lam, mu = material.lame
    strain = F - np.eye(3)
    pressed = PressedCell(lam * mu / (lam + mu), np.zeros((6, 0))).at(FLAT @ strain.ravel())[1] @ FLAT
    return lam * np.trace(strain) * np.eye(3) + 2 * mu * strain + pressed.reshape(3, 3)


def _coded(text: str) -> str:
    """What is in quotes, or a name of mjframes, as code."""
    return re.sub(r'("\w[^"]*"|mf\.\w+\(\w*\))', r"`\1`", text)


if __name__ == "__main__":
    for (page, name), table in TABLES.items():
        (FOLDER / page).write_text(written(page, name, table()), encoding="utf-8")
