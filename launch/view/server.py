"""The page's server: one process, one event loop, from its address being free to Ctrl-C."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from manyhands.launch.looking.sessions import Running
from manyhands.launch.view.application import application
from manyhands.launch.view.connections import Connections
from manyhands.launch.view.demands import MAX_DEMAND_BYTES
from manyhands.launch.view.security import Doorstep, Token, ViewError
from manyhands.launch.view.watch import Watch
from manyhands.protocol.clock import Clock, RealtimeClock

LOOK_EVERY: Final = 1.0
"""How often connections that take too long are ended, s."""

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


def _http_of(connections: Connections, clock: Clock) -> type[H11Protocol]:
    """The protocol of a server that keeps these connections, and no others."""

    class Http(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as its own does
            super().connection_made(transport)
            if self.client is not None:  # it is gone already
                connections.opened(self.client, transport, clock.now())

        def on_response_complete(self) -> None:
            if self.client is not None:
                connections.answered(self.client, clock.now())
            super().on_response_complete()

    return Http


class _NoText(logging.Filter):
    """Counts messages that are no UTF-8, which uvicorn closes the socket for, and would show with a traceback each."""

    def __init__(self, refused: Counter[str]) -> None:
        super().__init__()
        self._refused = refused

    def filter(self, record: logging.LogRecord) -> bool:
        if record.exc_info is None or not isinstance(record.exc_info[1], UnicodeDecodeError):
            return True
        self._refused["no_text"] += 1
        return False


@contextmanager
def without_tracebacks(refused: Counter[str]) -> Iterator[None]:
    """Meanwhile, count messages that are no UTF-8 in place of showing them."""
    log, counting = logging.getLogger("uvicorn.error"), _NoText(refused)
    log.addFilter(counting)
    try:
        yield
    finally:
        log.removeFilter(counting)


def serve(
    running: Running, host: str, port: int, token: Token | None, ready: Callable[[str], None], refused: Counter[str]
) -> None:
    """Serve the page until a signal ends it.

    Args:
        running: the session.
        host: where to listen.
        port: likewise; 0 for any that is free.
        token: what opens the page; None where its address is enough.
        ready: called with the page's address as soon as it can be opened.
        refused: counts what was refused, by reason.

    Raises:
        ViewError: it cannot listen there.
        TransportError: the session has no gallery.
    """
    with listen(host, port) as listening, without_tracebacks(refused):
        doorstep = Doorstep(host, listening.getsockname()[1])
        watch, connections = Watch(running, RealtimeClock()), Connections(refused)
        try:
            config = config_of(application(watch, doorstep, token, connections), connections, watch.clock)
            server = _Server(config, lambda: ready(address_of(doorstep, token)))
            asyncio.run(until_told(server, watch, connections, listening))
        finally:
            watch.close()


def config_of(app: ASGIApp, connections: Connections, clock: Clock) -> uvicorn.Config:
    """How the server is run: within bounds, silent, and without what a page does not need."""
    return uvicorn.Config(
        app,
        http=_http_of(connections, clock),
        ws="websockets-sansio",
        ws_max_size=MAX_DEMAND_BYTES,
        ws_per_message_deflate=False,
        lifespan="off",
        interface="asgi3",
        timeout_graceful_shutdown=_LEAVES_WITHIN,
        server_header=False,
        proxy_headers=False,
        access_log=False,
        log_config=None,
        log_level="error",
    )


async def until_told(server: uvicorn.Server, watch: Watch, connections: Connections, listening: socket.socket) -> None:
    """Serve, look on, and end connections that take too long, until the server is asked to end."""

    async def looking() -> None:
        try:
            await watch.run()
        finally:
            server.should_exit = True  # a page that nobody keeps up to date is not served

    async def ending() -> None:
        while True:
            await asyncio.sleep(LOOK_EVERY)
            connections.end_overdue(watch.clock.now())

    beside = [asyncio.create_task(looking()), asyncio.create_task(ending())]
    try:
        await server.serve(sockets=[listening])
    finally:
        for task in beside:
            task.cancel()
        for task in beside:
            with suppress(asyncio.CancelledError):
                await task
