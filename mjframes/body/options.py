"""What may be asked of `build`, and whether it is possible: the arguments, checked once, before any stage runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjframes.base.choices import COMPLIANCE, COROTATIONAL, EVEN, LAWS, MASSES, METRICS, MODES, PAPER, WHOLE_BODY
from mjframes.base.errors import MjframesError
from mjframes.frames.supports import Support, supports_of
from mjframes.volume.volume import Volume
from mjframes.weights.weights import Weights, weights_of

PAPER_FRAMES = 3  # of the paper's method, which knows no error to choose by, unless given
REACH_LIMIT = 10.0  # [voxels] a contact that reaches farther no longer follows the surface


@dataclass(frozen=True)
class Paper:
    """The paper's stiffness: a sum over at most `samples` regions, its integration samples."""

    samples: int = 10


@dataclass(frozen=True, eq=False)
class Options:
    """The arguments of `build`, as the stages take them.

    frames: how many, None where it is `at` or an error that says so.
    error: that the fewest frames are to keep [-].
    is_open: whether nothing says how many frames.
    paper: None for the whole body's stiffness.
    metric: in which frames are spread.
    """

    frames: int | None
    error: float | None
    is_open: bool
    paper: Paper | None
    metric: str
    weights: Weights
    supports: tuple[Support, ...]
    damping: tuple[float, float]


def checked(
    volume: Volume,
    frames: int | None,
    error: float | None,
    at: ArrayLike | None,
    method: str | Paper,
    frame_type: str | Sequence[str],
    metric: str | None,
    weights: str | Weights,
    law: str,
    mass: str | None,
    mode: str,
    damping: tuple[float, float],
    contact_reach: float | None,
    supports: Support | Sequence[Support],
    seed: int,
) -> Options:
    """Return the options of a body. Raise MjframesError for the first argument that is wrong."""
    if not isinstance(volume, Volume):
        raise MjframesError(
            f"volume is a {type(volume).__name__}; give a Volume, as Volume.from_labels(labels, spacing, materials)."
        )
    if not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise MjframesError(f"seed is {seed!r}; it must be a whole number from 0 on.")
    held = supports_of(supports)
    for name, value, choices in (
        ("metric", metric, (None, *METRICS)),
        ("mass", mass, (None, *MASSES)),
        ("law", law, (COROTATIONAL, *LAWS)),
        ("mode", mode, MODES),
    ):
        if value not in choices:
            raise MjframesError(f"{name} is {value!r}; it must be one of {', '.join(map(repr, choices))}.")
    paper = _method(method)
    _check_number_of_frames(frames, error, at, paper)
    if contact_reach is not None and not 0 < contact_reach <= REACH_LIMIT * np.min(volume.spacing):
        raise MjframesError(
            f"contact_reach is {contact_reach!r}; it must be positive and at most {REACH_LIMIT:g} voxels, "
            f"{REACH_LIMIT * np.min(volume.spacing):g} m."
        )
    if law == COROTATIONAL:
        _refuse_constants(volume)
    elif "point" in frame_type:
        raise MjframesError(
            f"frame_type has 'point' frames, which cannot turn: the law {law!r} would take a rotation for a "
            "strain; use other frames, or the corotational law."
        )
    metric = metric or (COMPLIANCE if paper else EVEN)
    if frames is None and at is None and error is None:
        frames = len(frame_type) if not isinstance(frame_type, str) else PAPER_FRAMES if paper else None
    is_open = frames is None and at is None and error is None
    return Options(frames, error, is_open, paper, metric, weights_of(weights), held, _damping(damping))


def _method(method: str | Paper) -> Paper | None:
    if method == PAPER:
        return Paper()
    if method != WHOLE_BODY and not isinstance(method, Paper):
        raise MjframesError(f"method is {method!r}; it must be {WHOLE_BODY!r}, {PAPER!r} or as mf.Paper(samples=20).")
    return method if isinstance(method, Paper) else None


def _damping(damping: tuple[float, float]) -> tuple[float, float]:
    try:
        alpha, beta = map(float, damping)
    except (TypeError, ValueError):
        alpha = beta = np.nan
    if not (np.isfinite([alpha, beta]).all() and min(alpha, beta) >= 0):
        raise MjframesError(f"damping is {damping!r}; it must be two rates (alpha [1/s], beta [s]), both ≥ 0.")
    return alpha, beta


def _check_number_of_frames(frames: int | None, error: float | None, at: ArrayLike | None, paper: Paper | None) -> None:
    if error is not None and not (isinstance(error, (int, float)) and 0 < error < 1):
        raise MjframesError(f"error is {error!r}; it must be a number between 0 and 1, as 0.05 for 5 %.")
    if sum(given is not None for given in (frames, at, error)) > 1 and (error is not None or at is None):
        raise MjframesError("more than one of frames, at and error is given; give one of them.")
    if frames == 0:
        raise MjframesError("frames is 0; a body needs one or more besides what holds it.")
    if error is not None and paper is not None:
        raise MjframesError(f"error is {error!r}, but only the whole body knows its error; give frames.")


def _refuse_constants(volume: Volume) -> None:
    for label, material in volume.materials.items():
        if material.law_constants:
            raise MjframesError(
                f"material {material.name or label!r} has law_constants {dict(material.law_constants)!r}, but the "
                f"corotational law has none but those of Young's modulus and Poisson's ratio; leave them out, or "
                f"choose law={LAWS[1]!r} or another."
            )
