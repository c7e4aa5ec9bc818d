"""The tasks by name: functions of a seed that return a `composer.Environment`, with tags."""

from __future__ import annotations

from dm_control import composer
from dm_control.utils import containers

from mjframes.base.errors import MjframesError

FEATURES, VISION = "features", "vision"

TASKS = containers.TaggedTasks()


def load(name: str, seed: int | None = None) -> composer.Environment:
    """Return the environment of a task.

    seed: of all that is drawn at random in its episodes; None draws one.
    Raise MjframesError for a name that is not one of `ALL`.
    """
    if name not in TASKS:
        raise MjframesError(f"name is {name!r}; it must be one of {', '.join(map(repr, TASKS))}.")
    return TASKS[name](seed)


def get_environments_by_tag(tag: str) -> tuple[str, ...]:
    """Return the names of the tasks that have a tag, one of `TAGS`. Raise MjframesError for another one."""
    if tag not in TASKS.tags():
        raise MjframesError(f"tag is {tag!r}; it must be one of {', '.join(map(repr, TASKS.tags()))}.")
    return tuple(TASKS.tagged(tag))
