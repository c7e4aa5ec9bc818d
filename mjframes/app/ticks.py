"""Times at which something is due: 0, 1 / rate, 2 / rate, …"""

from __future__ import annotations


class Ticks:
    """Counts the times that have come.

    rate: times a second.  early: how much before its time one counts already [s], half a step of what asks.
    """

    def __init__(self, rate: float, early: float) -> None:
        self.rate, self.early, self.count = rate, early, 0

    def due(self, now: float) -> int:
        """Return how many times came since the last call, up to `now` [s]."""
        came = 0
        while now >= self.count / self.rate - self.early:
            self.count += 1
            came += 1
        return came
