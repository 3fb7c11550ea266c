"""What the page's server answers: the page's files, and one socket over which a page is told, and may hold devices.

Everything goes through :class:`Guard` first. What a page says goes through :mod:`manyhands.launch.view.demands`.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from typing import Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from manyhands.launch.view.assets import Asset, load_assets
from manyhands.launch.view.connections import Connections
from manyhands.launch.view.demands import Allowance, Hold, LetGo, Wrong, demand_of, token_of
from manyhands.launch.view.feed import Cursor
from manyhands.launch.view.security import HEADERS, Doorstep, Token
from manyhands.launch.view.watch import Watch

PICTURE_EVERY: Final = 0.05
"""How often a page is told, s."""

OVER_EVERY: Final = 1.0
"""The same when the session is over and nothing changes any more, s."""

TAKES_AT_MOST: Final = 30.0
"""How long a page may take to take a picture, or to say its token, before it is given up, s."""

MOST_PAGES: Final = 16
"""Pages at a time; those that wait to be admitted are none yet."""

WRONG_TOKEN_COSTS: Final = 1.0
"""How long the answer to a wrong token takes, s."""

TOO_MANY, NOT_ADMITTED, TOO_OFTEN, GIVEN_UP = 1013, 4401, 1008, 4408
"""Why a page's socket is closed: try again later; no token, or a wrong one; more messages than a page sends; it did
not take what it was told, or said what is no text."""


class Guard:
    """Refuses who asks by another name or from another page, and gives every answer its headers."""

    def __init__(self, app: ASGIApp, doorstep: Doorstep) -> None:
        self._app, self._doorstep = app, doorstep

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""

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
    """The pages that are open."""

    def __init__(self, watch: Watch, token: Token | None, connections: Connections) -> None:
        self._watch, self._token, self._connections = watch, token, connections
        self._count = self._last = 0

    async def serve(self, socket: WebSocket) -> None:
        """Serve one page until it goes or is given up."""
        await socket.accept()
        try:
            if await self._admitted(socket):
                await self._serve_one_of_so_many(socket)
        except TimeoutError:
            self._connections.refused["too_slow"] += 1
            await _closed(socket, "the page took too long")
        except NoText:
            self._connections.refused["no_text"] += 1
            await _closed(socket, "found bytes; expected text")
        except WebSocketDisconnect:
            return

    async def _serve_one_of_so_many(self, socket: WebSocket) -> None:
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
        telling = asyncio.create_task(self._tell(socket, page))
        hearing = asyncio.create_task(self._hear(socket, page))
        try:
            done, _ = await asyncio.wait((telling, hearing), return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
        finally:
            self._watch.holding.let_go(page)
            for task in (telling, hearing):
                task.cancel()
            await asyncio.wait((telling, hearing))
            for task in (telling, hearing):
                if not task.cancelled():
                    task.exception()  # which the first of them to end has told already

    async def _tell(self, socket: WebSocket, page: int) -> None:
        """Tell a page what is so, one picture after another; the next is made when it has taken the last."""
        feed, cursor = self._watch.feed, Cursor()
        await _told(socket, feed.session())
        while True:
            picture = feed.picture(cursor, self._watch.holding.of(page))
            await _told(socket, picture)
            await asyncio.sleep(OVER_EVERY if feed.over else PICTURE_EVERY)

    async def _hear(self, socket: WebSocket, page: int) -> None:
        """Do what a page asks, and say what is wrong with what it asks."""
        watch, allowance = self._watch, Allowance(self._watch.clock.now())
        while True:
            text = await _text(socket)
            now = watch.clock.now()
            if not allowance.spend(now):
                self._connections.refused["too_often"] += 1
                await socket.close(TOO_OFTEN, "more messages than a page sends")
                return
            if token_of(text) is not None:
                continue  # a page says the one that it has, not knowing whether it is asked for
            why: str | None = None
            match demand_of(text, watch.feed.scene.about):
                case Hold() as demand:
                    why = watch.holding.hold(page, demand, now)
                case LetGo(device):
                    watch.holding.let_go(page, device)
                case Wrong(sentence):
                    why = sentence
            if why is not None:
                await _told(socket, json.dumps({"type": "refused", "why": why}))


class NoText(Exception):
    """A page sent bytes."""


async def _text(socket: WebSocket) -> str:
    """The next message of a page.

    Raises:
        WebSocketDisconnect: it went.
        NoText: it is none of text.
    """
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    text = message.get("text")
    if not isinstance(text, str):
        raise NoText
    return text


async def _told(socket: WebSocket, text: str) -> None:
    """Tell a page, and be cancelled while it takes it: ``wait_for`` may lose that (Python 3.11), and go on for ever.

    Raises:
        TimeoutError: it does not take it.
    """
    async with asyncio.timeout(TAKES_AT_MOST):
        await socket.send_text(text)


async def _closed(socket: WebSocket, why: str) -> None:
    """Close what may be closed already."""
    try:
        await socket.close(GIVEN_UP, why)
    except (RuntimeError, WebSocketDisconnect):  # it is: starlette's word for a socket that was closed before
        return


def application(
    watch: Watch, doorstep: Doorstep, token: Token | None = None, connections: Connections | None = None
) -> ASGIApp:
    """The server's application.

    Args:
        watch: what pages are told of.
        doorstep: by which names it may be asked for.
        token: what opens a page, where something has to.
        connections: of the server, which learns here which of them carry pages, and what was refused.

    Raises:
        OSError: a file of the page cannot be read.
    """

    def file_route(path: str, asset: Asset) -> Route:
        async def answer(_request: Request) -> Response:  # a function would be run in a thread
            return Response(asset.content, media_type=asset.type)

        return Route(path, answer, methods=["GET"])

    pages = Pages(watch, token, connections or Connections(Counter()))
    routes = [file_route(path, asset) for path, asset in load_assets().items()]
    return Guard(Starlette(routes=[*routes, WebSocketRoute("/socket", pages.serve)]), doorstep)
