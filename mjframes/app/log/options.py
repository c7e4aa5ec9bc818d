"""What a log holds, and how often."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass

from mjframes.base.errors import MjframesError

TOPICS = ("state", "energy", "contacts", "sensors", "scene", "video")


@dataclass(frozen=True)
class Log:
    """A log to write.

    path: of the file (.mcap).
    rate: entries a second of simulated time [Hz]. Unless given, numbers are logged as often as a recording keeps them,
    states and the scene as often as a film has frames, and the last state; the video always is as a film.
    topics: some of TOPICS; all of them unless given, the video only where a film is made as well.
    Raise MjframesError for a rate that is none and for unknown topics.
    """

    path: str | os.PathLike[str]
    rate: float | None = None
    topics: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise MjframesError(f"rate of the log is {self.rate!r}; it must be a positive number of entries a second.")
        if self.topics is not None and not (self.topics and set(self.topics) <= set(TOPICS)):
            raise MjframesError(
                f"topics of the log are {', '.join(self.topics) or 'none'}; give one or more of {', '.join(TOPICS)}."
            )
