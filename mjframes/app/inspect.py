"""Pictures of a soft body: what the paper shows in Figures 1, 6 and 7, and how good its regions are.

stiffness: Young's modulus E.  distance: to the nearest frame, in that frame's Voronoi cell.
weight_i: each frame's shape function w_i.  frames: where frames and regions are.  regions: §5.3.
error: where displacements miss those of the finite elements, as far as that is known.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjframes.app.pictures.keys import NO_COLOR, NOTHING, Bar, categorical
from mjframes.app.pictures.page import HEIGHT, RESOLUTION, WIDTH, Marks, Picture, draw_page
from mjframes.app.pictures.surface import surface_of
from mjframes.base.choices import EVEN
from mjframes.base.errors import MjframesError
from mjframes.base.files import replacing
from mjframes.base.packages import optional
from mjframes.body.soft_body import SoftBody
from mjframes.frames.distance import compliance_distance, sources_of, voxel_graph
from mjframes.volume.grid import Grid, evened, voxel_grid
from mjframes.weights.weights import weights_at

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

BANDS = 10  # [-] between contours
FRAME, SAMPLE = 13.0, 5.5  # [points] size of the dots
CROWD = 40  # [-] more frames get smaller dots
FRAME_COLOR, RIGID_COLOR, SOFT_COLOR = (0.12, 0.12, 0.12, 1.0), (0.93, 0.90, 0.80, 1.0), (0.76, 0.81, 0.88, 1.0)
MM, MM_PER_KPA = 1e3, 1e6  # [mm / m], [(mm/kPa) / (m/Pa)]


def draw_pictures(
    body: SoftBody,
    folder: str | os.PathLike[str],
    name: str = "soft body",
    progress: Callable[[str], None] = lambda picture: None,
) -> list[Path]:
    """Write the pictures of `body` into `folder` as .png and return their paths; `name` is how they call the body.

    Raise MjframesError where matplotlib is missing or where the folder cannot be written.
    """
    Figure = optional("matplotlib.figure", "a picture", "plot").Figure
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise MjframesError(f"{folder}: this is a file; name a folder for the pictures.")
    grid = voxel_grid(body.fields.volume)
    surface = surface_of(grid, body.skin.vertices, body.skin.faces)
    caption = _caption(body, grid, name)
    written: list[Path] = []

    def write(picture: str, draw: Callable[[Figure], None]) -> None:
        figure = Figure(figsize=(WIDTH, HEIGHT))
        draw(figure)
        with replacing(folder / f"{picture}.png", "the picture") as partial:
            figure.savefig(partial, dpi=RESOLUTION)
        written.append(folder / f"{picture}.png")

    for picture in field_pictures(body, grid):
        progress(picture.name)
        write(picture.name, lambda figure, picture=picture: draw_page(figure, picture, grid, surface, caption))
    return written


def field_pictures(body: SoftBody, grid: Grid) -> Iterator[Picture]:
    """Yield the pictures of fields, one after the other: there may be hundreds of frames."""
    yield _stiffness(body, grid)
    yield _distance(body, grid)
    for i in range(len(body.parent)):
        yield _weight(body, grid, i)
    yield _frames(body, grid)
    yield _regions(body, grid)
    if body.fields.error is not None:
        yield _error(body, body.fields.error, grid)


def _caption(body: SoftBody, grid: Grid, name: str) -> str:
    spacing = " × ".join(sorted({f"{1e3 * step:.3g}" for step in grid.spacing}, key=float))
    counts = [(len(body.parent), "frame"), (len(body.stiffness.points), "region")]
    parts = [f"{len(grid.index):,} voxels of {spacing} mm"]
    parts += [f"{number} {what}" + ("" if number == 1 else "s") for number, what in counts]
    parts.append(f"{body.control.mass.sum():.3g} kg")
    return f"{name}:  {',  '.join(parts)}" + (f"\n{body.error}" if body.error else "")


def _middle(grid: Grid) -> NDArray[np.int64]:
    """(3,) index of the voxel at the centroid, through which the slices go."""
    return np.floor(grid.index.mean(axis=0) + 0.5).astype(np.int64)


def _frame_marks(body: SoftBody, grid: Grid) -> Marks:
    count = len(body.parent)
    size = FRAME if count <= CROWD else 0.6 * FRAME
    return Marks(body.fields.frame_centers(grid), np.tile(FRAME_COLOR, (count, 1)), size, np.arange(count))


def _scheme(name: str, low: float, high: float, log: bool = False) -> ScalarMappable:
    """Return what gives values from low to high their colours."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    return ScalarMappable(LogNorm(low, high) if log else Normalize(low, high), name)


def _stiffness(body: SoftBody, grid: Grid) -> Picture:
    from matplotlib.ticker import FuncFormatter

    soft = grid.compliance > 0
    moduli = np.unique(grid.young[soft]) if soft.any() else np.ones(1)
    low, high = float(moduli[0]), float(moduli[-1])
    wide = 1.5 if high / low < 1.5 else 1.0  # a bar of one colour tells nothing
    scheme = _scheme("viridis", low / wide, high * wide, log=True)
    colors = np.where(soft[:, None], scheme.to_rgba(np.where(soft, grid.young, low)), RIGID_COLOR)
    legend = []
    for label in np.unique(grid.label):
        material = body.materials[int(label)]
        modulus = "rigid" if material.is_rigid else _pascals(material.young)
        legend.append((f"{material.name or f'label {label}'}: {modulus}", colors[np.argmax(grid.label == label)]))
    ticks = (moduli if len(moduli) <= 6 else np.geomspace(low, high, 5)).tolist()
    bar = Bar(scheme, "Young's modulus E", ticks, FuncFormatter(lambda value, _: _pascals(value)))
    return Picture("stiffness", "Stiffness: Young's modulus E of each voxel", colors, _middle(grid), legend, bar)


def _pascals(pressure: float) -> str:
    for unit, factor in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3)):
        if pressure >= factor:
            return f"{pressure / factor:.3g} {unit}"
    return f"{pressure:.3g} Pa"


def _distance(body: SoftBody, grid: Grid) -> Picture:
    seeds = body.fields.seeds
    even = body.fields.metric == EVEN
    nearest = compliance_distance(voxel_graph(evened(grid) if even else grid), *sources_of(seeds))
    distance = (MM if even else MM_PER_KPA) * nearest.distance
    far = float(distance.max()) or 1.0
    scheme = _scheme("plasma", 0, far)
    kind = "Distance inside the body" if even else "Compliance distance"
    return Picture(
        "distance",
        f"{kind} to the nearest frame, and the frames' Voronoi cells",
        scheme.to_rgba(distance),
        _middle(grid),
        bar=Bar(scheme, "∫ ds  [mm]" if even else "∫ ds / E  [mm/kPa]"),
        lines=nearest.label,
        contours=(distance, np.linspace(0, far, BANDS + 1)[1:-1]),
        marks=(_frame_marks(body, grid),),
    )


def _weight(body: SoftBody, grid: Grid, i: int) -> Picture:
    weight = weights_at(body.fields.weights, np.arange(len(grid.index)), [i])[:, 0]
    scheme = _scheme("YlGnBu", 0, 1)
    core = body.fields.seeds[i]
    center = body.fields.frame_centers(grid)[i]
    return Picture(
        f"weight_{i:0{len(str(len(body.parent) - 1))}d}",
        f"Weight of frame {i}: its share in the displacement",
        np.where((weight > 0)[:, None], scheme.to_rgba(weight), NOTHING),
        through=grid.index[core[np.argmin(np.sum((grid.centers[core] - center) ** 2, axis=1))]],
        legend=[("no influence", NOTHING), (f"reaches {np.mean(weight > 0):.0%} of the voxels", NO_COLOR)],
        bar=Bar(scheme, "w [-]"),
        contours=(weight, np.linspace(0, 1, BANDS + 1)[1:-1]),
        marks=(_frame_marks(body, grid),),
    )


def _frames(body: SoftBody, grid: Grid) -> Picture:
    regions = categorical(len(body.stiffness.points))
    samples = Marks(body.fields.sample_centers(grid), regions[np.unique(body.fields.region)], SAMPLE)
    rigid = grid.piece >= 0
    legend = [
        (f"frames: {len(body.parent)}", FRAME_COLOR),
        (f"regions: {len(regions)}, each with a colour", regions[0]),
        ("soft", SOFT_COLOR),
    ]
    if rigid.any():
        legend.append(("rigid", RIGID_COLOR))
    return Picture(
        "frames",
        "Frames, and the centres of the regions",
        np.where(rigid[:, None], RIGID_COLOR, SOFT_COLOR),
        _middle(grid),
        legend,
        marks=(samples, _frame_marks(body, grid)),
    )


def _error(body: SoftBody, error: NDArray[np.float64], grid: Grid) -> Picture:
    scheme = _scheme("magma", 0, float(error.max()) or 1.0)
    return Picture(
        "error",
        "Error of displacements: rms over own weights and pushes, to that of all displacements",
        scheme.to_rgba(error),
        through=grid.index[int(np.argmax(error))].astype(np.int64),
        bar=Bar(scheme, "|û − u|  [-]"),
        marks=(_frame_marks(body, grid),),
    )


def _regions(body: SoftBody, grid: Grid) -> Picture:
    palette = categorical(len(body.stiffness.points))
    size = np.bincount(body.fields.region, minlength=len(palette)) * grid.cell_volume * 1e6
    influence = [sorted(set(body.control.frame[points].tolist())) for points in body.stiffness.points]
    legend = [
        (f"{e}: frames {' '.join(map(str, frames))}, {volume:.3g} cm³", palette[e])
        for e, (frames, volume) in enumerate(zip(influence, size, strict=True))
    ]
    return Picture(
        "regions",
        "Regions, and the frames that each couples",
        palette[body.fields.region],
        _middle(grid),
        legend,
        lines=body.fields.region,
    )
