"""The relay before the Foxglove server: it decides who may connect, and passes their bytes on.

foxglove-sdk serves whoever reaches its port: any page that is open in this machine's browser could read the session.
So the server stands behind this relay, which reads the head of each request and makes the checks of the page
(:mod:`manyhands.launch.look.page.security`): Host, Origin, and on any other address than the loopback a token, as
``?token=...`` in the address. Foxglove's applications are no pages of this server, so their origins are listed here.

A request that passes is written anew, with the headers of a web socket alone. After it, bytes go both ways, each way
through one bounded buffer. A client that takes nothing for 30 s is given up.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from http import HTTPStatus
from typing import Final
from urllib.parse import parse_qs, urlsplit

import h11

from manyhands.launch.look.page.security import Doorstep, Headers, Token, header, is_loopback
from manyhands.launch.look.page.server import TAKES_AT_MOST, WRONG_TOKEN_COSTS, Connections
from manyhands.protocol.clock import Clock

MAX_HEAD_BYTES: Final = 8192
"""The longest head of a request."""

MOST_CLIENTS: Final = 16
"""Clients at a time that were let through."""

_AT_ONCE: Final = 64 * 1024  # bytes that are passed on at once
_APPLICATIONS: Final = ("https://app.foxglove.dev",)
_OF_WEB_SOCKETS: Final = (b"sec-websocket-key", b"sec-websocket-version", b"sec-websocket-protocol")


SUB_PROTOCOL: Final = "foxglove.sdk.v1"
"""The sub-protocol that foxglove-sdk speaks; its predecessor was ``foxglove.websocket.v1`` ([Foxglove2023]_)."""


class RefusedRequest(Exception):
    """A request is not let through.

    Attributes:
        status: of the answer.
        kind: the kind of refusal, to be counted.
    """

    def __init__(self, status: HTTPStatus, kind: str, why: str) -> None:
        super().__init__(why)
        self.status, self.kind = status, kind


def origin_may_connect(headers: Headers) -> bool:
    """Whether no foreign page makes the request.

    Programs that are no browser send no Origin. Desktop applications have one of their own scheme. Of web pages only
    Foxglove's own may connect, and those of this machine, whose users are trusted.
    """
    given = [value.decode("latin-1") for key, value in headers if key.lower() == b"origin"]
    if not given:
        return True
    if len(given) > 1 or given[0] in _APPLICATIONS:
        return len(given) == 1
    try:
        parts = urlsplit(given[0])
        host = parts.hostname
    except ValueError:
        return False
    if parts.scheme in ("http", "https"):
        return host is not None and is_loopback(host)
    # "null" has no scheme: a page that hides its origin; an extension of a browser is no application of this user's
    return bool(parts.scheme) and not parts.scheme.endswith("-extension")


def request_of(head: bytes) -> tuple[str, list[tuple[bytes, bytes]]]:
    """The target and the headers of a request.

    Raises:
        RefusedRequest: it is no request for a web socket.
    """
    connection = h11.Connection(h11.SERVER, max_incomplete_event_size=MAX_HEAD_BYTES)
    try:
        connection.receive_data(head)
        event = connection.next_event()
    except h11.RemoteProtocolError as error:
        raise RefusedRequest(
            HTTPStatus.BAD_REQUEST, "no_request", "found no HTTP request; expected a web socket's"
        ) from error
    if not isinstance(event, h11.Request):
        raise RefusedRequest(HTTPStatus.BAD_REQUEST, "no_request", "found a part of a request; expected a web socket's")
    headers = list(event.headers)
    if event.method != b"GET" or (header(headers, b"upgrade") or "").lower() != "websocket":
        raise RefusedRequest(
            HTTPStatus.UPGRADE_REQUIRED, "no_socket", "found no web socket; open this address in Foxglove, as ws://..."
        )
    return event.target.decode("latin-1"), headers


def require_admission(target: str, headers: Headers, doorstep: Doorstep, token: Token | None) -> None:
    """Make the checks of a request.

    Raises:
        RefusedRequest: it is for a foreign host, from a foreign page, in another sub-protocol, or without the token.
    """
    if not doorstep.host_is_ours(headers):
        why = "found another host's name; open the address as it was printed"
        raise RefusedRequest(HTTPStatus.MISDIRECTED_REQUEST, "foreign_host", why)
    if not origin_may_connect(headers):
        raise RefusedRequest(HTTPStatus.FORBIDDEN, "foreign_page", "found a page of another origin; expected Foxglove")
    offered = [one.strip() for one in (header(headers, b"sec-websocket-protocol") or "").split(",")]
    if SUB_PROTOCOL not in offered:
        why = (
            f"found the sub-protocol {', '.join(offered)[:100] or 'none'!r}; expected {SUB_PROTOCOL}, which a current "
            "Foxglove and Lichtblick after 1.21 speak: update the application"
        )
        raise RefusedRequest(HTTPStatus.BAD_REQUEST, "other_protocol", why)
    if token is not None and not token.fits(_token_in(target)):
        why = "a token is needed: open the address with ?token=... at its end"
        raise RefusedRequest(HTTPStatus.UNAUTHORIZED, "wrong_token", why)


def _token_in(target: str) -> object:
    with suppress(ValueError):
        given = parse_qs(urlsplit(target).query, max_num_fields=8).get("token", [])
        return given[0] if len(given) == 1 else None
    return None


def rewritten(headers: Headers, inner: tuple[str, int]) -> bytes:
    """The head of the request to the server behind: nothing but what a web socket needs."""
    lines = [b"GET / HTTP/1.1", b"Host: %s:%d" % (inner[0].encode(), inner[1])]
    lines += [b"Upgrade: websocket", b"Connection: Upgrade"]
    lines += [b"%s: %s" % (key, value) for key, value in headers if key.lower() in _OF_WEB_SOCKETS]
    return b"\r\n".join(lines) + b"\r\n\r\n"


class Relay:
    """Lets clients through to the server at ``inner``."""

    def __init__(
        self,
        doorstep: Doorstep,
        token: Token | None,
        inner: tuple[str, int],
        connections: Connections,
        clock: Clock,
    ) -> None:
        self._doorstep, self._token, self._inner, self._connections = doorstep, token, inner, connections
        self._clock, self._clients = clock, 0

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one connection until either end closes it."""
        peer = writer.get_extra_info("peername")
        client = (peer[0], peer[1]) if peer else ("", 0)
        self._connections.opened(client, writer.transport, self._clock.now())
        try:
            await self._serve(reader, writer, client)
        except RefusedRequest as refused:
            await self._refuse(writer, refused)
        except TimeoutError:
            self._connections.refused["too_slow"] += 1
        except (asyncio.IncompleteReadError, OSError):
            return  # it has disconnected, or was ended by Connections
        finally:
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, client: tuple[str, int]) -> None:
        try:
            head = await reader.readuntil(b"\r\n\r\n")
        except asyncio.LimitOverrunError as error:
            why = f"found more than {MAX_HEAD_BYTES} bytes of headers; expected a web socket's request"
            raise RefusedRequest(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "no_request", why) from error
        target, headers = request_of(head)
        require_admission(target, headers, self._doorstep, self._token)
        if self._clients >= MOST_CLIENTS:
            raise RefusedRequest(
                HTTPStatus.SERVICE_UNAVAILABLE, "too_many", f"found {MOST_CLIENTS} clients; try again later"
            )
        self._clients += 1
        try:
            inward, outward = await asyncio.open_connection(*self._inner, limit=_AT_ONCE)
            try:
                self._connections.admitted(client)
                outward.write(rewritten(headers, self._inner))
                await _both_ways((reader, outward), (inward, writer))
            finally:
                outward.transport.abort()
        finally:
            self._clients -= 1

    async def _refuse(self, writer: asyncio.StreamWriter, refused: RefusedRequest) -> None:
        self._connections.refused[refused.kind] += 1
        if refused.status is HTTPStatus.UNAUTHORIZED:
            await asyncio.sleep(WRONG_TOKEN_COSTS)
        body = f"{refused}\n".encode()
        head = (
            f"HTTP/1.1 {refused.status.value} {refused.status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
            f"Content-Length: {len(body)}\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n"
        )
        with suppress(OSError, TimeoutError):
            writer.write(head.encode() + body)
            writer.write_eof()
            async with asyncio.timeout(TAKES_AT_MOST):
                await writer.drain()


Way = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def _both_ways(*ways: Way) -> None:
    """Pass bytes on along all ways until one of them ends.

    Raises:
        TimeoutError: an end takes nothing for too long.
    """
    tasks = [asyncio.create_task(_one_way(*way)) for way in ways]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _one_way(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while piece := await reader.read(_AT_ONCE):
        writer.write(piece)
        async with asyncio.timeout(TAKES_AT_MOST):
            await writer.drain()
