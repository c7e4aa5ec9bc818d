"""The fewest frames that keep an error: tried in ascending number, from where their coordinates alone may reach it.

Where nothing is asked for, KEPT is kept with few trials: a body's error under small loads is about as many times that
of its coordinates alone, whatever the number of its frames, and one trial says how many. That in far bends falls about
with the square of the number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from mjframes.base.errors import MjframesError
from mjframes.body.frames import Frames
from mjframes.volume.grid import Grid
from mjframes.whole_body.build import Condensed, FiniteElements
from mjframes.whole_body.error import BodyError, expected

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40)  # frames that are tried
# Coordinates that miss an error by more than this factor are not tried: bodies turn out 0.6 to 1.7 times as far off
HOPE = 2.0  # [-]
KEPT = 0.15  # [-] error that is kept where neither frames nor error is given …
MOST = 20  # … by up to so many frames: a step takes a millisecond or two with them
RATIO = 1.5  # [-] errors to those of coordinates alone before any is known: 0.6 to 4 in bodies, mostly 1.2 to 2
NOTHING = 1e-12  # [-] error of bodies and coordinates that move exactly


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
    told = ", ".join(f"{where} {part:.2g}" for where, part in best[2].parts.items())
    raise MjframesError(
        f"error is {error!r}, but of up to {COUNTS[-1]} frames {best[1]} do best, with {best[0]:.2g} ({told}); "
        "ask for no less than that, or give frames."
    )


def default_counts(most: int) -> list[int]:
    """Return the numbers that are tried where none is given, ascending, of a body with room for `most` frames."""
    return [count for count in COUNTS if count <= min(MOST, most)] or [1]


def sufficiency(frames: int, error: BodyError) -> str:
    """Return the sentence on the number of frames that was chosen where none was given."""
    if error.largest <= KEPT:
        taken = f"{frames} {'is' if frames == 1 else 'are'} taken"
        return f"frames are not given: {taken}, the fewest found with an error of at most {KEPT:.0%}: {error}."
    return f"frames are not given: of up to {MOST}, {frames} come nearest to an error of {KEPT:.0%}: {error}."


def sufficient_frames(
    grid: Grid,
    finite: FiniteElements,
    counts: Sequence[int],
    place: Callable[[int], Frames],
    condense: Callable[[Frames], Condensed],
) -> tuple[Frames, Condensed]:
    """Return the frames of the fewest of `counts`, ascending, that keep KEPT, or of that which comes nearest to it.

    place, condense: as in `fewest_frames`; numbers for which they raise MjframesError are left out.
    Raise MjframesError if all are.
    """
    errors: dict[int, BodyError] = {}
    best: tuple[Frames, Condensed] | None = None

    @cache
    def guess(count: int) -> float:
        try:
            shapes = place(count).shapes
        except MjframesError:
            return np.inf
        some = expected(grid, shapes.weights, shapes.control, finite.held, finite.cases, finite.exact)
        return max(some.largest, NOTHING)

    left = list(counts)
    while (count := _promising(left, guess, errors)) is not None:
        try:
            frames = place(count)
            made = condense(frames)
        except MjframesError:
            left.remove(count)
            if not left:
                raise
            continue
        errors[count] = made.error
        if best is None or _rank(count, errors) == min(_rank(some, errors) for some in errors):
            best = frames, made
    assert best is not None
    return best


def _promising(counts: Sequence[int], guess: Callable[[int], float], errors: Mapping[int, BodyError]) -> int | None:
    """The next number to try, by what is expected of it after those that are known; None for no other.

    guess: the error of a number's coordinates [-].
    """
    known = sorted(errors)
    ratios = [max(errors[count].weight or 0.0, errors[count].pushes, NOTHING) / guess(count) for count in known]

    def forecast(count: int) -> float:
        small = guess(count) * (np.interp(np.log(count), np.log(known), ratios) if known else RATIO)
        bends = min(((errors[some].bends or 0.0) * (some / count) ** 2 for some in known), default=0.0)
        return max(small, bends)

    enough = min((count for count in known if errors[count].largest <= KEPT), default=None)
    fewer = [count for count in counts if count not in errors and (enough is None or count < enough)]
    if (found := next((count for count in fewer if forecast(count) <= KEPT), None)) is not None:
        return found
    least = min(counts, key=forecast)
    return least if enough is None and least not in errors else None


def _rank(count: int, errors: Mapping[int, BodyError]) -> tuple[bool, float]:
    """Those that keep KEPT come first, fewer before more, then the others, by their errors."""
    return (True, errors[count].largest) if errors[count].largest > KEPT else (False, count)
