"""What may be asked of `build`: its arguments, each declared once and checked before any stage runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from mjframes.base import texts
from mjframes.base.choices import (
    COMPLIANCE,
    COROTATIONAL,
    EVEN,
    FRAME_TYPES,
    IMPLICIT,
    MASSES,
    METHODS,
    METRICS,
    MODES,
    PAPER,
    WHOLE_BODY,
)
from mjframes.base.constants import LEAST_VERTICES, VERTICES
from mjframes.base.errors import MjframesError
from mjframes.base.numbers import is_number, is_whole
from mjframes.base.options import option, require_choices
from mjframes.elasticity.law_table import ALL_LAWS, LAWS
from mjframes.frames.supports import Support, supports_of
from mjframes.volume.volume import Volume
from mjframes.weights.kernels import KERNELS, VORONOI, Weights, weights_of

PAPER_FRAMES = 3  # of the paper's method, which knows no error to choose by, unless given
REACH_LIMIT = 10.0  # [voxels] a contact that reaches farther no longer follows the surface
FREEDOM = ", ".join(f"{name} {kind.freedom}" for name, kind in FRAME_TYPES.items())

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Paper:
    """The paper's method for the stiffness: sums over regions, its integration samples.

    Parameters
    ----------
    samples
        Largest number of integration samples.
    """

    samples: int = field(
        default=10,
        metadata=option("at most how many integration samples the paper's method has", reads=texts.count, metavar="N"),
    )


@dataclass(frozen=True, eq=False)
class BuildOptions:
    """The arguments of `build`; a field is also an option of `mjframes build`, if a text can say it.

    Raise MjframesError for the first one that is wrong.
    """

    volume: Volume | str | os.PathLike[str] = field(
        metadata=option("a `Volume`, or a file of one that contains its materials")
    )
    frames: int | None = field(
        default=None,
        metadata=option(
            "number of frames; the default is the smallest number up to 20 with an error below 15 %, or the one that "
            "comes nearest; with a sequence of frame types as many as it has; 3 by the paper's method",
            reads=texts.count,
            metavar="N",
        ),
    )
    _: KW_ONLY
    error: float | None = field(
        default=None,
        metadata=option(
            "take the fewest frames with an error below this, 0.05 for 5 % [-]; all errors in `body.error` count",
            reads=texts.share,
            metavar="E",
            instead_of="frames",
        ),
    )
    at: ArrayLike | None = field(
        default=None,
        metadata=option("positions of the frames (f, 3) in volume coordinates [m], in place of their number"),
    )
    supports: Support | Sequence[Support] = field(
        default=(),
        metadata=option(
            "pieces that stand still in the body that the soft body is attached to (`Fixed`), or move with a named one "
            "(`Attached`); each piece is one more frame"
        ),
    )
    frame_type: str | Sequence[str] = field(
        default="affine",
        metadata=option(
            f"type of all frames, in Python also a sequence with one for each; degrees of freedom: {FREEDOM} "
            "(translations only, for small rotations)",
            choices=tuple(FRAME_TYPES),
            many=True,
        ),
    )
    method: str | Paper = field(
        default=WHOLE_BODY,
        metadata=option(
            "how the frames get their stiffness: from finite elements on all voxels, or summed over the paper's "
            "integration samples",
            choices=METHODS,
            kinds={PAPER: Paper},
        ),
    )
    metric: str | None = field(
        default=None,
        metadata=option(
            "distance by which frames are spread: within the body, or the paper's; the default depends on the method",
            choices=METRICS,
        ),
    )
    weights: str | Weights = field(
        default=VORONOI,
        metadata=option("how the frames share the voxels between them", choices=tuple(KERNELS), kinds=KERNELS),
    )
    law: str = field(
        default=COROTATIONAL,
        metadata=option(
            f"law of elasticity; all but {COROTATIONAL} are for large strains, and take constants from "
            "`Material.law_constants`; those that are missing follow from Young's modulus and Poisson's ratio",
            choices=ALL_LAWS,
        ),
    )
    mass: str | None = field(
        default=None,
        metadata=option(
            "mass matrix; the default is consistent if all frames are affine or points, or else lumped", choices=MASSES
        ),
    )
    mode: str = field(
        default=IMPLICIT,
        metadata=option(
            "implicit is stable at any step; explicit is cheaper, for steps shorter than the stiffest vibration and "
            "for RK4",
            choices=MODES,
        ),
    )
    damping: tuple[float, float] = field(
        default=(0.0, 0.0),
        metadata=option("Rayleigh damping α [1/s] and β [s]", reads=texts.rates, metavar="ALPHA,BETA"),
    )
    contact_reach: float | None = field(
        default=None,
        metadata=option(
            "height above the deepest point of a contact beyond which a vertex has no share in it [m]; the default is "
            "half a voxel",
            reads=texts.length,
            metavar="LENGTH",
        ),
    )
    skin_vertices: int | None = field(
        default=None,
        metadata=option(
            f"about how many vertices the drawn skin has, {LEAST_VERTICES} or more; the default is {VERTICES}; contact "
            "does not depend on it",
            reads=texts.count,
            metavar="N",
        ),
    )
    seed: int = field(default=0, metadata=option("seed of the frame placement", reads=texts.seed, metavar="N"))
    progress: Progress | None = field(
        default=None,
        metadata=option('function that is called with the name of each stage, and as "stage: 25%" within long ones'),
    )

    def __post_init__(self) -> None:
        if isinstance(self.volume, (str, os.PathLike)):
            object.__setattr__(self, "volume", Volume.load(self.volume))
        if not isinstance(self.volume, Volume):
            raise MjframesError(
                f"volume is a {type(self.volume).__name__}; give a Volume, as Volume.from_labels(labels, spacing, "
                "materials)."
            )
        if not (is_whole(self.seed) and self.seed >= 0):
            raise MjframesError(f"seed is {self.seed!r}; it must be a whole number from 0 on.")
        if not (self.progress is None or callable(self.progress)):
            raise MjframesError(f"progress is {self.progress!r}; give a function that takes a text, as print.")
        types = self.frame_type
        if not isinstance(types, (str, Sequence, np.ndarray)) or not len(types):
            raise MjframesError(f"frame_type is {types!r}; give one type, or a sequence with one for each frame.")
        require_choices(self)
        supports_of(self.supports)
        weights_of(self.weights)
        self._check_method()
        self._check_number_of_frames()
        self._check_damping()
        self._check_reach(float(REACH_LIMIT * np.min(self.volume.spacing)))
        self._check_skin()
        self._check_law(self.volume)

    @property
    def paper(self) -> Paper | None:
        """Return the paper's method, None for the whole body's stiffness."""
        return Paper() if self.method == PAPER else self.method if isinstance(self.method, Paper) else None

    @property
    def number(self) -> int | None:
        """Return how many frames there are besides the held ones, None where it is `at` or an error that says so."""
        if self.frames is not None or self.at is not None or self.error is not None:
            return self.frames
        if not isinstance(self.frame_type, str):
            return len(self.frame_type)
        return PAPER_FRAMES if self.paper else None

    @property
    def is_open(self) -> bool:
        """Return whether nothing says how many frames."""
        return self.number is None and self.at is None and self.error is None

    @property
    def metric_of_frames(self) -> str:
        """Return the distance by which frames are spread."""
        return self.metric or (COMPLIANCE if self.paper else EVEN)

    def _check_method(self) -> None:
        if self.method not in METHODS and not isinstance(self.method, Paper):
            raise MjframesError(
                f"method is {self.method!r}; it must be {WHOLE_BODY!r}, {PAPER!r} or as mf.Paper(samples=20)."
            )

    def _check_number_of_frames(self) -> None:
        error, frames, at = self.error, self.frames, self.at
        if error is not None and not (is_number(error) and 0 < error < 1):
            raise MjframesError(f"error is {error!r}; it must be a number between 0 and 1, as 0.05 for 5 %.")
        if sum(given is not None for given in (frames, at, error)) > 1 and (error is not None or at is None):
            raise MjframesError("more than one of frames, at and error is given; give one of them.")
        if frames is not None and not is_whole(frames):
            raise MjframesError(
                f"frames is {frames!r}, a {type(frames).__name__}; it must be a whole number from 1 on."
            )
        if frames == 0:
            raise MjframesError("frames is 0; a body needs one or more besides what holds it.")
        if error is not None and self.paper is not None:
            raise MjframesError(f"error is {error!r}, but only the whole body knows its error; give frames.")

    def _check_damping(self) -> None:
        try:
            alpha, beta = map(float, self.damping)
        except (TypeError, ValueError):
            alpha = beta = np.nan
        if not (np.isfinite([alpha, beta]).all() and min(alpha, beta) >= 0):
            raise MjframesError(f"damping is {self.damping!r}; it must be two rates (alpha [1/s], beta [s]), both ≥ 0.")
        object.__setattr__(self, "damping", (alpha, beta))

    def _check_reach(self, most: float) -> None:
        if self.contact_reach is not None and not 0 < self.contact_reach <= most:
            raise MjframesError(
                f"contact_reach is {self.contact_reach!r}; it must be positive and at most {REACH_LIMIT:g} voxels, "
                f"{most:g} m."
            )

    def _check_skin(self) -> None:
        count = self.skin_vertices
        if count is not None and not (is_whole(count) and count >= LEAST_VERTICES):
            raise MjframesError(f"skin_vertices is {count!r}; it must be a whole number from {LEAST_VERTICES} on.")

    def _check_law(self, volume: Volume) -> None:
        if self.law != COROTATIONAL:
            if "point" in self.frame_type:
                raise MjframesError(
                    f"frame_type has 'point' frames, which cannot turn: the law {self.law!r} would take a rotation for "
                    "a strain; use other frames, or the corotational law."
                )
            return
        for label, material in volume.materials.items():
            if material.law_constants:
                raise MjframesError(
                    f"material {material.name or label!r} has law_constants {dict(material.law_constants)!r}, but the "
                    f"corotational law has none but those of Young's modulus and Poisson's ratio; leave them out, or "
                    f"choose law={list(LAWS)[1]!r} or another."
                )
