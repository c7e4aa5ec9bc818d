"""Figure 6 of the paper: the weight of the left node of a plate, with two, one and five Voronoi subdivisions.

One subdivision ends too early, on the way into the arm; five reach behind the other node; two do neither.
Run `python examples/kernels.py --out out`; it needs matplotlib (`pip install "mjframes[plot]"`).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import mjframes as mf
from mjframes.frames.placement import place_frames
from mjframes.volume.grid import voxel_grid
from mjframes.weights.voronoi import voronoi_weights

EDGE = 0.01  # [m]
NODES = EDGE * np.array([[8.5, 10.5, 0.5], [47.5, 10.5, 0.5], [40.5, 56.5, 0.5]])  # left (red), right, tip of the arm
SHOWN = (2, 1, 5)  # subdivisions


def plate() -> mf.Volume:
    """A homogeneous plate of one voxel, 0.8 m × 0.2 m, with an arm 0.4 m long and 0.2 m wide."""
    labels = np.zeros((80, 60, 1), np.uint8)
    labels[:, :20] = 1
    labels[30:50, 20:] = 1
    return mf.Volume.from_labels(labels, EDGE, {1: mf.Material(young=1e3, poisson=0.45, density=1000)})


def left_weight(subdivisions: int) -> NDArray[np.float64]:
    """Weight of the left node, (80, 60); NaN outside the plate."""
    grid = voxel_grid(plate())
    weights = voronoi_weights(grid, place_frames(grid, at=NODES), subdivisions)
    field = np.full(grid.lookup.shape, np.nan)
    field[tuple(grid.index.T)] = weights[:, [0]].toarray().ravel()
    return field[..., 0]


def run(out: Path) -> dict[int, NDArray[np.float64]]:
    """Write kernels.png to `out`; the weights (80, 60) by number of subdivisions."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    fields = {n: left_weight(n) for n in SHOWN}
    figure = Figure(figsize=(13, 4.2), layout="constrained")
    width, height, _ = EDGE * np.array(plate().labels.shape)
    for axes, (n, field) in zip(np.ravel(figure.subplots(1, len(SHOWN))), fields.items(), strict=True):
        extent = (0.0, width, 0.0, height)
        axes.imshow(field.T, origin="lower", extent=extent, cmap="Greys", vmin=-0.2, vmax=1)
        color = np.where(field.T > 0, field.T, np.nan)
        axes.imshow(color, origin="lower", extent=extent, cmap="turbo", vmin=0, vmax=1)
        x, y = (EDGE * (np.arange(count) + 0.5) for count in field.shape)
        axes.contour(x, y, field.T, levels=np.arange(0.125, 1, 0.125), colors="k", linewidths=0.6)
        axes.plot(*NODES[1:, :2].T, "o", color="w", markeredgecolor="k")
        axes.plot(*NODES[0, :2], "o", color="r", markeredgecolor="k")
        axes.set_title(f"{n} subdivision{'' if n == 1 else 's'}", loc="left")
        axes.set_axis_off()
    figure.colorbar(figure.axes[0].images[-1], ax=figure.axes, label="weight of the red node (grey: none)")
    figure.savefig(out / "kernels.png", dpi=110)
    return fields


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to (default: out)")
    for subdivisions, field in run(parser.parse_args().out).items():
        arm, right = np.nanmax(field[30:50, 41:52]), np.nanmax(field[65:])
        print(f"{subdivisions}: at most {arm:.3f} in the upper half of the arm, {right:.3f} at the right end")
