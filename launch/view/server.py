"""The page's server: one process, one event loop, from its address being free to Ctrl-C."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import uvicorn

from manyhands.launch.looking.sessions import Running
from manyhands.launch.view.application import application
from manyhands.launch.view.demands import MAX_DEMAND_BYTES
from manyhands.launch.view.security import Doorstep, Token, ViewError
from manyhands.launch.view.watch import Watch
from manyhands.protocol.clock import RealtimeClock

MOST_CONNECTIONS: Final = 64
"""Connections at a time, of which pages are some; who comes then is told to come later."""

_LEAVES_WITHIN: Final = 2  # s that open pages have to notice that the server ends


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens there; 0 is any free port.

    Raises:
        ViewError: it cannot.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
        return socket.create_server((host, port), family=family)
    except (OSError, UnicodeError, OverflowError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise ViewError(
            f"--host {host} --port {port}: cannot listen there: {why}; expected an address of this machine and a port "
            "that is free, 0 for any"
        ) from error


def address_of(doorstep: Doorstep, token: Token | None) -> str:
    """What is opened in a browser; the token stands where no server and no log sees it."""
    host = socket.gethostname() if doorstep.host in ("", "0.0.0.0", "::") else doorstep.host  # noqa: S104 -- compared
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{doorstep.port}/" + ("" if token is None else f"#token={token.told()}")


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()


def serve(running: Running, host: str, port: int, token: Token | None, ready: Callable[[str], None]) -> None:
    """Serve the page until a signal ends it.

    Args:
        running: the session.
        host: where to listen.
        port: likewise; 0 for any that is free.
        token: what opens the page; None where its address is enough.
        ready: called with the page's address as soon as it can be opened.

    Raises:
        ViewError: it cannot listen there.
        TransportError: the session has no gallery.
    """
    with listen(host, port) as listening:
        doorstep = Doorstep(host, listening.getsockname()[1])
        watch = Watch(running, RealtimeClock())
        try:
            config = uvicorn.Config(
                application(watch, doorstep, token),
                http="h11",
                ws="websockets-sansio",
                ws_max_size=MAX_DEMAND_BYTES,
                ws_per_message_deflate=False,
                lifespan="off",
                interface="asgi3",
                limit_concurrency=MOST_CONNECTIONS,
                timeout_graceful_shutdown=_LEAVES_WITHIN,
                server_header=False,
                proxy_headers=False,
                access_log=False,
                log_config=None,
                log_level="error",
            )
            server = _Server(config, lambda: ready(address_of(doorstep, token)))
            asyncio.run(_until_told(server, watch, listening))
        finally:
            watch.close()


async def _until_told(server: uvicorn.Server, watch: Watch, listening: socket.socket) -> None:
    async def looking() -> None:
        try:
            await watch.run()
        finally:
            server.should_exit = True  # a page that nobody keeps up to date is not served

    watching = asyncio.create_task(looking())
    try:
        await server.serve(sockets=[listening])
    finally:
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching
