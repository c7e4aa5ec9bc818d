"""The fewest frames that keep an error: tried in ascending number, from where their coordinates alone may reach it."""

from __future__ import annotations

from collections.abc import Callable

from mjframes.base.errors import MjframesError
from mjframes.body.frames import Frames
from mjframes.volume.grid import Grid
from mjframes.whole_body.build import Condensed, FiniteElements
from mjframes.whole_body.error import BodyError, expected

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40)  # frames that are tried
# Coordinates that miss an error by more than this factor are not tried: bodies turn out 0.6 to 1.7 times as far off
HOPE = 2.0  # [-]


def fewest_frames(
    error: float,
    grid: Grid,
    finite: FiniteElements,
    most: int,
    place: Callable[[int], Frames],
    condense: Callable[[Frames], Condensed],
) -> tuple[Frames, Condensed]:
    """Return the first of COUNTS, up to `most`, whose body has an error of at most `error` [-], and that body.

    place, condense: make the frames of a number, and the body of those.
    Raise MjframesError if none has.
    """
    best: tuple[float, int, BodyError] | None = None
    for count in [some for some in COUNTS if some <= most]:
        frames = place(count)
        guess = expected(grid, frames.shapes.weights, frames.shapes.control, finite.held, finite.cases, finite.exact)
        if guess.largest > HOPE * error and count != COUNTS[-1]:
            continue
        made = condense(frames)
        if made.error.largest <= error:
            return frames, made
        if best is None or made.error.largest < best[0]:
            best = made.error.largest, count, made.error
    if best is None:
        raise MjframesError(f"error is {error!r}, but the body has room for {most} frames only; give frames.")
    weight = "" if best[2].weight is None else f"under its own weight {best[2].weight:.2g}, "
    raise MjframesError(
        f"error is {error!r}, but of up to {COUNTS[-1]} frames {best[1]} do best, with {best[0]:.2g} ({weight}under "
        f"pushes {best[2].pushes:.2g}); ask for no less than that, or give frames."
    )
