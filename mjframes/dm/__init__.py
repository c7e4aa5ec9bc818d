"""Soft bodies in dm_control: an entity of its composer, and tasks with it, found by names and tags.

    from mjframes import dm

    environment = dm.load("lift_steak_features", seed=0)
    time_step = environment.reset()

`dm.ALL` names the tasks, `dm.TAGS` their tags, `dm.get_environments_by_tag(tag)` those with one, as
`dm_control.manipulation` does. It needs dm_control: `pip install "mjframes[dm]"`.
"""

from __future__ import annotations

from mjframes.base.errors import MjframesError

try:
    import dm_control  # noqa: F401
except ImportError as error:
    raise MjframesError('dm_control is not installed; run pip install "mjframes[dm]".') from error

from mjframes.dm import lift, run  # noqa: F401  (their tasks enter the registry)
from mjframes.dm.registry import TASKS, get_environments_by_tag, load
from mjframes.dm.soft_entity import SoftEntity

ALL = tuple(TASKS)
TAGS = tuple(TASKS.tags())

__all__ = ["ALL", "TAGS", "SoftEntity", "get_environments_by_tag", "load"]
