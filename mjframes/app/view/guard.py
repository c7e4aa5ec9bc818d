"""Who a page answers: another site in the same browser could else draw and push the scene, by DNS or by a websocket.
And what it takes from those: values that its inputs can have, and points in the scene.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from viser import ViserServer

LOCAL = ("localhost", "127.0.0.1", "::1")  # names of this machine
LARGEST = 2**22  # [bytes] of a message: a drag has a hundred, a picture of the page, which we never ask for, megabytes


def answers(served: str, host: str | None, origin: str | None) -> bool:
    """Return whether a request is answered.

    served: where the page is served.  host, origin: of the request's headers, None where it has none.
    A page for this machine alone is asked for by one of its names; one for others by any. A browser tells the origin of
    the site that asks, which is to be the page itself; a port may be another, as through a tunnel.
    """
    try:
        name = urlsplit(f"//{host or ''}").hostname
        if _is_local(served) and name not in (*LOCAL, served):
            return False
        return origin is None or urlsplit(origin).netloc.lower() == (host or "").lower()
    except ValueError:  # no address
        return False


def _is_local(served: str) -> bool:
    try:
        return served in LOCAL or ipaddress.ip_address(served).is_loopback
    except ValueError:
        return False


def possible(handle: Any, value: object) -> Any:
    """Return the value that an input of the panel takes for one that a browser gives, None for none.

    handle: of viser. A number is kept to its range; a choice is one of those that there are.
    """
    if hasattr(handle, "options"):
        return value if value in handle.options else None
    if isinstance(handle.value, str):
        return value if isinstance(value, str) else None
    if not isinstance(value, (int, float)) or isinstance(value, bool) or math.isnan(value):
        return None
    low, high = (-math.inf if handle.min is None else handle.min), (math.inf if handle.max is None else handle.max)
    kept = float(min(max(value, low), high))
    return kept if math.isfinite(kept) else None


def point_in(extent: float, value: object) -> NDArray[np.float64] | None:
    """Return the point (3,) that a browser names, not farther than `extent` along any axis, None where it is none."""
    try:
        point = np.array(value, np.float64)
    except (TypeError, ValueError):
        return None
    if point.shape != (3,) or not np.isfinite(point).all():
        return None
    return point.clip(-extent, extent)


def keep_to_values(server: ViserServer) -> None:
    """Let browsers change nothing of the panel's inputs but their values, and these to possible ones.

    viser sets whatever attribute of an input a message names.
    """
    from viser._messages import GuiUpdateMessage

    gui = server.gui

    async def heed(client: Any, message: GuiUpdateMessage) -> None:
        handle = gui._gui_input_handle_from_uuid.get(message.uuid) if isinstance(message.uuid, str) else None
        if handle is not None and isinstance(message.updates, dict):
            value = possible(handle, message.updates.get("value"))
            if value is not None:
                await gui._handle_gui_updates(client, replace(message, updates={"value": value}))

    gui._websock_interface.unregister_handler(GuiUpdateMessage)
    gui._websock_interface.register_handler(GuiUpdateMessage, heed)


@contextmanager
def guarded(served: str) -> Iterator[None]:
    """Let a server of viser that starts in this block answer those only who may ask.

    viser has no option for it, and hands on what serves its websockets and files. A connection that sends what cannot
    be read is closed, without a word.
    """
    import websockets.asyncio.server as server
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    serve = server.serve

    def serving(*arguments: Any, process_request: Callable[..., Any], **options: Any) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
            is_one = len(hosts) == 1 and len(origins) <= 1
            if not is_one or not answers(served, hosts[0], origins[0] if origins else None):
                return Response(HTTPStatus.FORBIDDEN, "Forbidden", Headers(), b"This page is not for you.\n")
            found = process_request(connection, request)
            return await found if hasattr(found, "__await__") else found

        quiet = logging.Logger("page")  # without a handler, unlike `getLogger`'s
        quiet.addHandler(logging.NullHandler())
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: None)
        return serve(*arguments, process_request=checked, **{**options, "max_size": LARGEST, "logger": quiet})

    server.serve = serving  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        server.serve = serve
