"""Many worlds in one log: topics /world_42/state, and a record of metadata for each world."""

from __future__ import annotations

import re

WORLD = "world"  # name of the records of what was drawn for a world


def world_topic(world: int, topic: str) -> str:
    """Return the topic of a world's messages of `topic`."""
    return f"/world_{world}/{topic}"


def world_of(topic: str) -> tuple[int, str] | None:
    """Return the world of a topic, and the topic that it would have alone, /state; None for topics of no world."""
    found = re.fullmatch(r"/world_(\d+)(/.+)", topic)
    return (int(found[1]), found[2]) if found else None
