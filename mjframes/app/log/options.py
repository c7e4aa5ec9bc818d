"""What a log holds, and how often."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from mjframes.app.log import numbers
from mjframes.base.errors import MjframesError

TOPICS = ("state", *numbers.TOPICS, "scene", "video")


@dataclass(frozen=True)
class Log:
    """A log to write, for `record`.

    Parameters
    ----------
    path
        File (.mcap).
    rate
        Entries per simulated second [Hz]. By default numbers are logged as often as a recording keeps them, states and
        the scene as often as a film has frames. The video always has the frames of the film.
    topics
        What to log: some of "state", "energy", "contacts", "sensors", "scene" and "video". The default is all of them,
        and "video" only if a film is made as well.

    Raises
    ------
    MjframesError
        For another ending of the file, a rate that is not positive and for unknown topics.
    """

    path: str | os.PathLike[str]
    rate: float | None = None
    topics: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if Path(self.path).suffix.lower() != ".mcap":
            raise MjframesError(f"{os.fspath(self.path)}: a log is written as .mcap; give the path this ending.")
        if self.rate is not None and not (math.isfinite(self.rate) and self.rate > 0):
            raise MjframesError(f"rate of the log is {self.rate!r}; it must be a positive number of entries a second.")
        if self.topics is not None and not (self.topics and set(self.topics) <= set(TOPICS)):
            raise MjframesError(
                f"topics of the log are {', '.join(self.topics) or 'none'}; give one or more of {', '.join(TOPICS)}."
            )
