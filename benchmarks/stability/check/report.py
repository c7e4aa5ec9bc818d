"""What the runs gave: a table to print, and a CSV."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.stability.check.cases import FREE
from benchmarks.stability.check.trial import Outcome
from benchmarks.tables import table_of, write_table

COLUMNS = ("runs", "survive", "recover", "gain, free", "gain, loaded", "of motion")
HEADER = (
    *("body", "young_Pa", "timestep_s", "disturbance", "survives", "recovers"),
    *("gain", "gain_of_motion", "shape_error", "warning"),
)


def table(outcomes: Sequence[Outcome]) -> Table:
    """Return a table with a line for each body, and one for all."""
    shown = table_of("Stability", *COLUMNS)
    bodies = groupby(outcomes, lambda outcome: outcome.case.kind.name)
    for name, some in [*((name, list(own)) for name, own in bodies), ("all", outcomes)]:
        free = [o.gain for o in some if o.case.disturbance in FREE]
        loaded = [o.gain for o in some if o.case.disturbance not in FREE]
        counts = len(some), sum(o.survives for o in some), sum(o.recovers for o in some)
        gains = max(free, default=np.nan), max(loaded, default=np.nan), max(o.motion for o in some)
        shown.add_row(name, *map(str, counts), *("–" if np.isnan(gain) else f"{gain:.3g}" for gain in gains))
    return shown


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return one line on all outcomes."""
    survive, recover = sum(o.survives for o in outcomes), sum(o.recovers for o in outcomes)
    return f"{len(outcomes)} runs: {survive} survive, {recover} recover their shape of rest."


def write(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write every run (.csv)."""
    write_table(path, HEADER, [_line(outcome) for outcome in outcomes])


def _line(o: Outcome) -> tuple[object, ...]:
    place = (o.case.kind.name, f"{o.case.young:g}", f"{o.case.timestep:.6g}", o.case.disturbance)
    numbers = (f"{value:.4g}" for value in (o.gain, o.motion, o.error))
    return *place, int(o.survives), int(o.recovers), *numbers, o.warning
