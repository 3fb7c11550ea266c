"""The page's server: one process with one event loop, which ends on Ctrl-C.

It serves the page's files, which are read once and served from memory, and one web socket for each page. Over it a page
receives messages (:mod:`manyhands.launch.look.page.feed`) and may hold devices
(:mod:`manyhands.launch.look.page.pointer`). Every request passes :class:`RequestGuard` first.

:class:`Connections` bounds the connections, so that silent ones do not keep out those that send requests. A connection
is *unproven* until a page has been admitted over it. Until then it has a deadline for each request and its answer, and
the oldest unproven connection is ended when there is no room for a new one. A browser sends its request as soon as it
has connected, so a crowd of silent connections displaces only itself.
"""

from __future__ import annotations

import asyncio
import json
import logging
import socket
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from manyhands.launch.look.page.feed import Cursor, Watch
from manyhands.launch.look.page.pointer import (
    MAX_DEMAND_BYTES,
    Hold,
    LetGo,
    MessageAllowance,
    Wrong,
    demand_of,
    token_of,
)
from manyhands.launch.look.page.security import HEADERS, Doorstep, Token, ViewError
from manyhands.launch.run.running import Running
from manyhands.protocol.clock import Clock, Duration, Instant, RealtimeClock, from_seconds

MOST_CONNECTIONS: Final = 64
"""Connections at a time, pages included."""

MOST_OF_AN_ADDRESS: Final = 32
"""Connections of one address at a time: a browser has six, and one for each page."""

ANSWERED_WITHIN: Final = from_seconds(10.0)
"""Longest time from the connection, or from the previous answer, until the client has taken the next answer."""


class Connection(Protocol):
    """The interface of a connection; asyncio's transports have it."""

    def is_closing(self) -> bool:
        """Whether the connection is closed, or about to be."""
        ...

    def abort(self) -> None:
        """End the connection at once."""
        ...


Client = tuple[str, int]
"""Address and port of a client."""


class Connections:
    """The connections of a server. Pure: it only calls the connections' own methods.

    Attributes:
        refused: connections that were ended, by reason.
    """

    def __init__(self, refused: Counter[str]) -> None:
        self.refused = refused
        self._all: dict[Client, Connection] = {}
        self._since: dict[Client, Instant] = {}  # the unproven ones, in the order of their waiting time

    def opened(self, client: Client, connection: Connection, now: Instant) -> None:
        """A client has connected; where there is no room, end the unproven connection that has waited longest."""
        self._forget_closed()
        self._all[client], self._since[client] = connection, now
        if sum(host == client[0] for host, _ in self._all) > MOST_OF_AN_ADDRESS:
            self._end(next(one for one in self._since if one[0] == client[0]), "too_many")
        elif len(self._all) > MOST_CONNECTIONS:
            self._end(next(iter(self._since)), "too_many")

    def answered(self, client: Client, now: Instant) -> None:
        """A request was answered; the deadline of the next request begins."""
        if self._since.pop(client, None) is not None:
            self._since[client] = now

    def admitted(self, client: Client) -> None:
        """The connection carries a page now; :class:`Pages` has the deadlines of pages."""
        self._since.pop(client, None)

    def end_overdue(self, now: Instant) -> None:
        """End the connections whose request, or its answer, takes too long."""
        self._forget_closed()
        for client in [client for client, since in self._since.items() if Duration(now - since) > ANSWERED_WITHIN]:
            self._end(client, "too_slow")

    async def keep_ending_overdue(self, clock: Clock) -> None:
        """End overdue connections again and again, until cancelled."""
        while True:
            await asyncio.sleep(LOOK_EVERY)
            self.end_overdue(clock.now())

    def _end(self, client: Client, why: str) -> None:
        self.refused[why] += 1
        del self._since[client]
        self._all.pop(client).abort()

    def _forget_closed(self) -> None:
        for client in [client for client, connection in self._all.items() if connection.is_closing()]:
            del self._all[client]
            self._since.pop(client, None)


STATIC: Final = Path(__file__).parent / "static"

TYPES: Final[Mapping[str, str]] = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
"""The types of files that are served; others in the folder (a license) are not."""

INDEX: Final = "/index.html"


@dataclass(frozen=True)
class Asset:
    """A file of the page: its media type and its content."""

    type: str
    content: bytes


def load_assets() -> dict[str, Asset]:
    """Every file of the page, by the path of its address; the page itself also by ``/``.

    Raises:
        OSError: a file cannot be read.
    """
    found = {
        f"/{path.relative_to(STATIC).as_posix()}": Asset(TYPES[path.suffix], path.read_bytes())
        for path in sorted(STATIC.rglob("*"))
        if path.suffix in TYPES
    }
    return {**found, "/": found[INDEX]}


PICTURE_EVERY: Final = 0.05
"""Time between two pictures for a page, s."""

OVER_EVERY: Final = 1.0
"""The same after the end of the session, when nothing changes any more, s."""

TAKES_AT_MOST: Final = 30.0
"""Longest time that a page may take to receive a picture, or to send its token, s; then its socket is closed."""

MOST_PAGES: Final = 16
"""Pages at a time, without those that have not been admitted yet."""

WRONG_TOKEN_COSTS: Final = 1.0
"""Delay of the answer to a wrong token, s."""

TOO_MANY, NOT_ADMITTED, TOO_OFTEN, GIVEN_UP = 1013, 4401, 1008, 4408
"""Codes with which a page's socket is closed: too many pages, try again later; no token or a wrong one; more messages
than a page sends; the page took too long, or sent something other than text."""


class RequestGuard:
    """Refuses requests to a foreign host name or from a foreign page, and adds the headers to every answer."""

    def __init__(self, app: ASGIApp, doorstep: Doorstep) -> None:
        self._app, self._doorstep = app, doorstep

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", ()), *HEADERS]}
            await send(message)

        if scope["type"] not in ("http", "websocket"):
            return
        named = self._doorstep.host_is_ours(scope["headers"])
        if scope["type"] == "http":
            misdirected = PlainTextResponse("found another host's name; open the address as it was printed", 421)
            await (self._app if named else misdirected)(scope, receive, with_headers)
        elif named and self._doorstep.origin_is_ours(scope["headers"]):
            await self._app(scope, receive, send)
        else:
            await send({"type": "websocket.close", "code": TOO_OFTEN})  # before it is accepted: 403


class Pages:
    """The open pages, each with its own web socket."""

    def __init__(self, watch: Watch, token: Token | None, connections: Connections) -> None:
        self._watch, self._token, self._connections = watch, token, connections
        self._count = self._last = 0

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it disconnects, or its socket is closed."""
        await socket.accept()
        try:
            if await self._admitted(socket):
                await self._serve_within_limit(socket)
        except TimeoutError:
            self._connections.refused["too_slow"] += 1
            await _close(socket, "the page took too long")
        except NoText:
            self._connections.refused["no_text"] += 1
            await _close(socket, "found bytes; expected text")
        except WebSocketDisconnect:
            return

    async def _serve_within_limit(self, socket: WebSocket) -> None:
        if self._count >= MOST_PAGES:
            self._connections.refused["too_many"] += 1
            await socket.close(TOO_MANY, "too many pages")
            return
        if socket.client is not None:
            self._connections.admitted((socket.client.host, socket.client.port))
        self._count += 1
        self._last += 1
        try:
            await self._serve(socket, self._last)
        finally:
            self._count -= 1

    async def _admitted(self, socket: WebSocket) -> bool:
        if self._token is None:
            return True
        async with asyncio.timeout(TAKES_AT_MOST):
            given = token_of(await _text(socket))
        if self._token.fits(given):
            return True
        self._connections.refused["wrong_token"] += 1
        await asyncio.sleep(WRONG_TOKEN_COSTS)
        await socket.close(NOT_ADMITTED, "a token is needed: open the address with #token=... at its end")
        return False

    async def _serve(self, socket: WebSocket, page: int) -> None:
        sender = asyncio.create_task(self._send_pictures(socket, page))
        receiver = asyncio.create_task(self._receive(socket, page))
        try:
            done, _ = await asyncio.wait((sender, receiver), return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._watch.holding.let_go(page)
            for task in (sender, receiver):
                task.cancel()
            await asyncio.wait((sender, receiver))
            for task in (sender, receiver):
                if not task.cancelled():
                    task.exception()  # marks it as retrieved; the first task to end has raised it already

    async def _send_pictures(self, socket: WebSocket, page: int) -> None:
        """Send one picture after another; a picture is made only when the page has taken the last one."""
        feed, cursor = self._watch.feed, Cursor()
        await _send(socket, feed.session())
        while True:
            picture = feed.picture(cursor, self._watch.holding.of(page))
            await _send(socket, picture)
            await asyncio.sleep(OVER_EVERY if feed.over else PICTURE_EVERY)

    async def _receive(self, socket: WebSocket, page: int) -> None:
        """Carry out a page's requests, and answer a wrong request with the reason."""
        watch, allowance = self._watch, MessageAllowance(self._watch.clock.now())
        while True:
            text = await _text(socket)
            now = watch.clock.now()
            if not allowance.spend(now):
                self._connections.refused["too_often"] += 1
                await socket.close(TOO_OFTEN, "more messages than a page sends")
                return
            if token_of(text) is not None:
                continue  # a page sends its token even where none is required
            why: str | None = None
            match demand_of(text, watch.feed.live.about):
                case Hold() as demand:
                    why = watch.holding.hold(page, demand, now)
                case LetGo(device):
                    watch.holding.let_go(page, device)
                case Wrong(sentence):
                    why = sentence
            if why is not None:
                await _send(socket, json.dumps({"type": "refused", "why": why}))


class NoText(Exception):
    """A page sent bytes instead of text."""


async def _text(socket: WebSocket) -> str:
    """The next message of a page.

    Raises:
        WebSocketDisconnect: the page has disconnected.
        NoText: the message is not text.
    """
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    text = message.get("text")
    if not isinstance(text, str):
        raise NoText
    return text


async def _send(socket: WebSocket, text: str) -> None:
    """Send a text to a page.

    This uses ``timeout``, since ``wait_for`` may lose a cancellation (Python 3.11) and then continue for ever.

    Raises:
        TimeoutError: the page does not take the text within :data:`TAKES_AT_MOST`.
    """
    async with asyncio.timeout(TAKES_AT_MOST):
        await socket.send_text(text)


async def _close(socket: WebSocket, why: str) -> None:
    """Close a socket that may be closed already."""
    try:
        await socket.close(GIVEN_UP, why)
    except (RuntimeError, WebSocketDisconnect):  # starlette's errors for a socket that was closed before
        return


def application(
    watch: Watch, doorstep: Doorstep, token: Token | None = None, connections: Connections | None = None
) -> ASGIApp:
    """The server's application.

    Args:
        watch: the session that the pages show.
        doorstep: the address of the page.
        token: the token that pages must send; None where none is required.
        connections: the server's connections, which learn from the application which of them carry pages.

    Raises:
        OSError: a file of the page cannot be read.
    """

    def file_route(path: str, asset: Asset) -> Route:
        async def answer(_request: Request) -> Response:  # a plain function would run in a thread
            return Response(asset.content, media_type=asset.type)

        return Route(path, answer, methods=["GET"])

    pages = Pages(watch, token, connections or Connections(Counter()))
    routes = [file_route(path, asset) for path, asset in load_assets().items()]
    return RequestGuard(Starlette(routes=[*routes, WebSocketRoute("/socket", pages.serve)]), doorstep)


LOOK_EVERY: Final = 1.0
"""How often connections that take too long are ended, s."""

_LEAVES_WITHIN: Final = 2  # s, for open pages to notice that the server ends


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens at ``host`` and ``port``; port 0 stands for any free one.

    Raises:
        ViewError: the address is not this machine's, or the port is not free.
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
    """The page's address for a browser; the token is its fragment, which browsers send to no server."""
    host = socket.gethostname() if doorstep.host in ("", "0.0.0.0", "::") else doorstep.host  # noqa: S104 -- compared
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{doorstep.port}/" + ("" if token is None else f"#token={token.reveal()}")


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()


def _http_of(connections: Connections, clock: Clock) -> type[H11Protocol]:
    """The protocol class of a server that reports its connections to ``connections``."""

    class Http(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as its own does
            super().connection_made(transport)
            if self.client is not None:  # None where it has disconnected already
                connections.opened(self.client, transport, clock.now())

        def on_response_complete(self) -> None:
            if self.client is not None:
                connections.answered(self.client, clock.now())
            super().on_response_complete()

    return Http


class _NoText(logging.Filter):
    """Counts messages that are not UTF-8; uvicorn closes their socket, and would log a traceback for each."""

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
    """While entered, messages that are not UTF-8 are counted in ``refused``, and not logged."""
    log, counting = logging.getLogger("uvicorn.error"), _NoText(refused)
    log.addFilter(counting)
    try:
        yield
    finally:
        log.removeFilter(counting)


def serve(
    running: Running, host: str, port: int, token: Token | None, ready: Callable[[str], None], refused: Counter[str]
) -> None:
    """Serve the page until a signal ends the server.

    Args:
        running: the session.
        host: the name or address to listen at.
        port: the port to listen at; 0 for any free one.
        token: the token that opens the page; None where its address is enough.
        ready: called with the page's address as soon as the page can be opened.
        refused: counts refused connections and messages, by reason.

    Raises:
        ViewError: the server cannot listen at this address.
        TransportError: the session's broadcast cannot be received.
    """
    with listen(host, port) as listening, without_tracebacks(refused):
        doorstep = Doorstep(host, listening.getsockname()[1])
        watch, connections = Watch(running, RealtimeClock()), Connections(refused)
        try:
            config = config_of(application(watch, doorstep, token, connections), connections, watch.clock)
            server = _Server(config, lambda: ready(address_of(doorstep, token)))
            asyncio.run(run_until_stopped(server, watch, connections, listening))
        finally:
            watch.close()


def config_of(app: ASGIApp, connections: Connections, clock: Clock) -> uvicorn.Config:
    """The server's configuration: bounded, silent, and without features that the page does not need."""
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


async def run_until_stopped(
    server: uvicorn.Server, watch: Watch, connections: Connections, listening: socket.socket
) -> None:
    """Serve, follow the session, and end connections that take too long, until the server is asked to end."""

    async def follow() -> None:
        try:
            await watch.run()
        finally:
            server.should_exit = True  # a page without updates is not served

    beside = [asyncio.create_task(follow()), asyncio.create_task(connections.keep_ending_overdue(watch.clock))]
    try:
        await server.serve(sockets=[listening])
    finally:
        for task in beside:
            task.cancel()
        for task in beside:
            with suppress(asyncio.CancelledError):
                await task
