"""How good the regions are: error, eigenvalues of K_e, and the natural frequencies √eig(M⁻¹ K) / 2π of the body."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mjframes.app.pictures.keys import categorical
from mjframes.app.pictures.page import draw_title
from mjframes.body.soft_body import SoftBody
from mjframes.elasticity.regions import fit_errors
from mjframes.volume.grid import voxel_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NULL = 1e-9  # [-] of the largest eigenvalue: smaller ones are motions without energy


def region_spectra(body: SoftBody) -> list[NDArray[np.float64]]:
    """Return the eigenvalues (3m,) of each region's K_e [N/m], ascending."""
    return [linalg.eigvalsh(matrix) for matrix in body.stiffness.matrix]


def natural_frequencies(body: SoftBody) -> NDArray[np.float64]:
    """Return those of small motions about rest [Hz], ascending, fixed frames held; 0 where motion takes no energy."""
    k = len(body.control.mass)
    stiffness = np.zeros((3 * k, 3 * k))
    for points, matrix in zip(body.stiffness.points, body.stiffness.matrix, strict=True):
        freedom = (3 * points[:, None] + np.arange(3)).ravel()
        stiffness[np.ix_(freedom, freedom)] += matrix
    mass = np.diag(body.control.mass)
    for points, difference in zip(body.stiffness.points, body.mass_difference, strict=False):
        mass[np.ix_(points, points)] += difference
    free = body.control.frame >= body.held
    # K φ = ω² M φ turned around: null modes of the weights have no mass, but they are held
    moving = np.repeat(free, 3)
    stiffness, mass = stiffness[np.ix_(moving, moving)], np.kron(mass[np.ix_(free, free)], np.eye(3))
    shift = np.trace(stiffness) / np.trace(mass)
    inverse = linalg.eigvalsh(mass, stiffness + shift * mass)
    eigenvalues = np.sort(1 / np.maximum(inverse, np.finfo(float).tiny) - shift)
    eigenvalues = eigenvalues[inverse[::-1] > NULL * inverse[-1]]
    eigenvalues[eigenvalues < NULL * eigenvalues[-1]] = 0
    return np.sqrt(eigenvalues) / (2 * np.pi)


def draw_spectrum(figure: Figure, body: SoftBody, caption: str) -> None:
    """Draw three graphs on an empty figure."""
    from matplotlib.ticker import MaxNLocator

    draw_title(figure, "Regions: error and stiffness", caption)
    grid = figure.add_gridspec(
        2, 2, width_ratios=(2, 1), left=0.06, right=0.98, bottom=0.08, top=0.86, wspace=0.18, hspace=0.2
    )
    quality = figure.add_subplot(grid[0, 0])
    stiffness = figure.add_subplot(grid[1, 0], sharex=quality)
    modes = figure.add_subplot(grid[:, 1])

    number = np.arange(len(body.stiffness.points))
    values, title = _quality(body, len(number))
    quality.bar(number, values, color=categorical(len(number)), edgecolor="0.3", linewidth=0.5)
    _label(quality, title, "[-]")

    spectra = region_spectra(body)
    null = [int(np.sum(values < NULL * values[-1])) for values in spectra]
    for e, (values, color) in enumerate(zip(spectra, categorical(len(number)), strict=True)):
        shown = values[null[e] :]
        stiffness.scatter(np.full(len(shown), e), shown, s=60, marker="_", color=color * [0.85, 0.85, 0.85, 1])
    stiffness.set_yscale("log")
    stiffness.set_xlabel("region")
    stiffness.xaxis.set_major_locator(MaxNLocator(integer=True))
    zero = f"{min(null)}" if min(null) == max(null) else f"{min(null)} to {max(null)}"
    _label(stiffness, f"eigenvalues of K ({zero} more a region are 0: motions without energy)", "[N/m]")

    frequency = natural_frequencies(body)
    moving = frequency[frequency > 0]
    modes.plot(np.arange(1, len(moving) + 1), moving, ".-", color="tab:blue", linewidth=0.8)
    modes.set_yscale("log")
    modes.set_xlabel("mode")
    _label(modes, f"natural frequencies ({len(frequency) - len(moving)} more are 0)", "[Hz]")


def _quality(body: SoftBody, regions: int) -> tuple[NDArray[np.float64], str]:
    """What tells most of each region (r,), and its name."""
    label, error = body.fields.region, body.fields.error
    if error is None:
        fit = fit_errors(voxel_grid(body.fields.volume), body.fields.weights, label, regions)
        return fit, "fit error: rms distance of the weights from a linear function"
    square = np.bincount(label, error**2, minlength=regions) / np.maximum(np.bincount(label, minlength=regions), 1)
    return np.sqrt(square), "error: rms over the load cases, to that of all displacements"


def _label(axes: Axes, title: str, unit: str) -> None:
    axes.set_title(title, size=10, loc="left")
    axes.set_ylabel(unit)
    axes.grid(alpha=0.3, linewidth=0.5)
