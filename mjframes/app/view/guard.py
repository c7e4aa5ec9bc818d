"""Who a page answers: another site in the same browser could else draw and push the scene, by DNS or by a websocket."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

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


@contextmanager
def guarded(served: str) -> Iterator[None]:
    """Let a server of viser that starts in this block answer those only who may ask.

    viser has no option for it, and hands on what serves its websockets and files.
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

        return serve(*arguments, process_request=checked, **{**options, "max_size": LARGEST})

    server.serve = serving  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        server.serve = serve
