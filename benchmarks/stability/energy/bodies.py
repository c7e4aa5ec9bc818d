"""The bodies: meshes of others, where they are there, and shapes drawn from a seed; built with the default settings.

A subject is drawn, not built: name, materials, frames and law. Each mesh is scaled to 150 mm, as a user would.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.stability.energy.shapes import SHAPES, VOXELS, drawn
from mjframes.base.choices import COROTATIONAL, PAPER, WHOLE_BODY
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.law_table import LAWS
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

MESHES = Path(__file__).parents[4] / "shared" / "data"  # beside a checkout, as in tests/builders/data.py
FORMATS = (".obj", ".stl", ".ply", ".off")
MESH_LENGTH = 0.15  # [m]
MESH_YOUNG, MESH_POISSON = 5e4, 0.45  # [Pa], [-]
LENGTHS, YOUNG, POISSON = (0.06, 0.15), (1e4, 1e7), (0.3, 0.49)  # [m], [Pa], [-] of what is drawn
DENSITY = 1000.0  # [kg/m³]
FRAMES = (3, 5, 10)
RATIOS = (0.1, 10.0, 100.0)  # [-] of the second material's modulus
TWO = 0.3  # [-] of the shapes have two materials
EVERY = {"hyperelastic": 5, PAPER: 4}  # of the bodies are built so, too
METHODS = (COROTATIONAL, *LAWS, PAPER)  # what `--laws` chooses from


@dataclass(frozen=True)
class Subject:
    """A body that is to be built.

    shape: of `shapes`, or the path of a mesh.  seed: of the shape.
    length: of its longest side [m].  young: of the softer or only material [Pa].
    ratio: of the second material's modulus, 1 for one material [-].
    """

    name: str
    shape: str
    seed: int
    length: float
    young: float
    poisson: float
    ratio: float
    frames: int
    law: str = COROTATIONAL
    method: str = WHOLE_BODY

    @property
    def label(self) -> str:
        """Return the name, with the law or method that is not the default."""
        other = PAPER if self.method == PAPER else self.law
        return self.name if other == COROTATIONAL else f"{self.name}, {other.replace('_', '-')}"

    def volume(self) -> Volume:
        """Return the labels with their materials.  Raise MjframesError for a mesh that cannot be used."""
        material = Material(self.young, self.poisson, DENSITY, "one")
        if self.shape not in SHAPES:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of faults of the mesh
                found = Volume.from_meshes([(self.shape, material)], voxels=sum(VOXELS) // 2).largest_component()
            size = (np.array(found.labels.shape) * found.spacing).max()
            return replace(found, spacing=found.spacing * self.length / size, origin=found.origin * self.length / size)
        inside = drawn(self.shape, self.seed)
        labels = inside.astype(np.uint8)
        if self.ratio != 1:
            where = np.argwhere(inside)
            cut = where @ np.random.default_rng(self.seed).normal(size=3)
            labels[tuple(where[cut > np.median(cut)].T)] = 2
        other = replace(material, young=self.young * self.ratio, name="two")
        return Volume.from_labels(labels, self.length / max(inside.shape), {1: material, 2: other})

    def build(self) -> SoftBody:
        """Return the body, undamped."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return build(self.volume(), self.frames, law=self.law, method=self.method)


def subjects(count: int, seed: int, laws: Sequence[str], meshes: bool = True) -> list[Subject]:
    """Return `count` bodies drawn from a seed, and one for each mesh that is there.

    laws: some of `METHODS`; all bodies have the corotational law, some of them the others as well.
    """
    plain = [_drawn(number, seed) for number in range(count)] + (_meshes() if meshes else [])
    found = list(plain) if COROTATIONAL in laws else []
    for law in LAWS:
        if law in laws:
            found += [replace(subject, law=law) for subject in plain[list(LAWS).index(law) :: EVERY["hyperelastic"]]]
    if PAPER in laws:
        found += [replace(subject, method=PAPER) for subject in plain[:: EVERY[PAPER]]]
    return found


def _drawn(number: int, seed: int) -> Subject:
    rng = np.random.default_rng((seed, number))
    shape = list(SHAPES)[number % len(SHAPES)]
    ratio = float(rng.choice(RATIOS)) if rng.random() < TWO else 1.0
    return Subject(
        name=f"{number:02} {shape}",
        shape=shape,
        seed=int(rng.integers(2**31)),
        length=float(rng.uniform(*LENGTHS)),
        young=float(10 ** rng.uniform(*np.log10(YOUNG))),
        poisson=float(rng.uniform(*POISSON)),
        ratio=ratio,
        frames=int(rng.choice(FRAMES)),
    )


def _meshes() -> list[Subject]:
    paths = [path for path in sorted(MESHES.glob("*meshes/*")) if path.suffix in FORMATS]
    return [
        Subject(path.stem, str(path), 0, MESH_LENGTH, MESH_YOUNG, MESH_POISSON, 1.0, FRAMES[number % len(FRAMES)])
        for number, path in enumerate(paths)
    ]
