"""trimesh, imported whole: it can do without some of its modules, and takes an interrupt that comes while it imports
one of them for a sign that this one is missing. The interrupt would be lost, and the module too.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

WAITING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let WAITING come to this thread, if it is the one that they come to, when the block has ended."""
    came: list[int] = []
    before = {}
    if threading.current_thread() is threading.main_thread():  # a handler that is None is not Python's
        before = {number: handler for number in WAITING if (handler := signal.getsignal(number)) is not None}
    try:
        for number in before:
            signal.signal(number, lambda number, _: came.append(number))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    for number in came:
        signal.raise_signal(number)


with uninterrupted():
    import trimesh as trimesh
