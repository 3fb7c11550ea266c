"""The relay before the Foxglove server: who may connect, and bytes that pass in both directions."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http import HTTPStatus

import pytest

from manyhands.launch.bridges import relay as module
from manyhands.launch.bridges.relay import (
    MAX_HEAD_BYTES,
    RefusedRequest,
    Relay,
    origin_may_connect,
    request_of,
    require_admission,
    rewritten,
)
from manyhands.launch.look.page.security import Doorstep, Token
from manyhands.launch.look.page.server import Connections
from manyhands.protocol.clock import RealtimeClock

LOOPBACK = Doorstep("127.0.0.1", 8765)
EVERYWHERE = Doorstep("0.0.0.0", 8765)
TOKEN = Token("0123456789abcdef")
SOCKET = (
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: abcd\r\n"
    "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
)


def head(target: str = "/", host: str = "127.0.0.1:8765", more: str = "") -> bytes:
    return f"GET {target} HTTP/1.1\r\nHost: {host}\r\n{SOCKET}{more}\r\n".encode()


@pytest.mark.parametrize(
    ("origins", "may"),
    [
        ([], True),  # no browser
        (["https://app.foxglove.dev"], True),
        (["file://"], True),  # a desktop application
        (["http://localhost:8080"], True),  # a page of this machine
        (["http://127.0.0.1"], True),
        (["https://evil.example"], False),
        (["http://app.foxglove.dev"], False),  # anybody on the path can be it
        (["https://app.foxglove.dev.evil.example"], False),
        (["https://app.foxglove.dev", "https://evil.example"], False),
        (["null"], False),
        (["chrome-extension://abcdefghijklmnop"], False),
        (["moz-extension://01234567"], False),
        (["https://[bad"], False),
        ([""], False),
    ],
)
def test_origins(origins: list[str], may: bool) -> None:
    assert origin_may_connect([(b"origin", origin.encode()) for origin in origins]) is may


@pytest.mark.parametrize(
    ("request_", "doorstep", "token", "status"),
    [
        (head(), LOOPBACK, None, None),
        (head("/?token=0123456789abcdef"), LOOPBACK, TOKEN, None),
        (head("/any?token=0123456789abcdef", "192.0.2.7:8765"), EVERYWHERE, TOKEN, None),
        (head(host="evil.example:8765"), LOOPBACK, None, 421),
        (head(host="127.0.0.1:80"), LOOPBACK, None, 421),
        (head(host="192.0.2.7:8765"), LOOPBACK, None, 421),
        (head().replace(b"foxglove.sdk.v1", b"foxglove.websocket.v1, foxglove.sdk.v1"), LOOPBACK, None, None),
        (head().replace(b"foxglove.sdk.v1", b"foxglove.websocket.v1"), LOOPBACK, None, 400),
        (head().replace(b"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n", b""), LOOPBACK, None, 400),
        (head(more="Origin: https://evil.example\r\n"), LOOPBACK, None, 403),
        (head(), EVERYWHERE, TOKEN, 401),
        (head("/?token=wrong"), EVERYWHERE, TOKEN, 401),
        (head("/?token=0123456789abcdef&token=wrong"), EVERYWHERE, TOKEN, 401),
        (head("/?a&b&c&d&e&f&g&h&token=0123456789abcdef"), EVERYWHERE, TOKEN, 401),
        (b"GET / HTTP/1.1\r\nHost: 127.0.0.1:8765\r\n\r\n", LOOPBACK, None, 426),
        (head().replace(b"GET", b"POST"), LOOPBACK, None, 426),
        (b"hello\r\n\r\n", LOOPBACK, None, 400),
    ],
)
def test_admission(request_: bytes, doorstep: Doorstep, token: Token | None, status: int | None) -> None:
    def admit() -> None:
        target, headers = request_of(request_)
        require_admission(target, headers, doorstep, token)

    if status is None:
        admit()
        return
    with pytest.raises(RefusedRequest) as refused:
        admit()
    assert refused.value.status == status


def test_the_server_behind_receives_no_token_no_cookie_and_no_extension() -> None:
    more = "Cookie: secret\r\nSec-WebSocket-Extensions: permessage-deflate\r\nOrigin: file://\r\n"
    _, headers = request_of(head("/?token=0123456789abcdef", more=more))
    lines = rewritten(headers, ("127.1.2.3", 99)).decode().lower().split("\r\n")
    assert lines[:2] == ["get / http/1.1", "host: 127.1.2.3:99"]
    assert sorted(lines[2:-2]) == sorted(SOCKET.lower().split("\r\n")[:-1])
    assert lines[-2:] == ["", ""]


class Echo:
    """A server that answers with what it receives; :attr:`heads` are the requests that reached it."""

    def __init__(self) -> None:
        self.heads: list[bytes] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.heads.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        try:
            while piece := await reader.read(65536):
                writer.write(piece)
                await writer.drain()
        except ConnectionError:
            return
        finally:
            writer.transport.abort()


@asynccontextmanager
async def relayed(refused: Counter[str], token: Token | None = None) -> AsyncIterator[tuple[Echo, int]]:
    """An echo behind a relay; yields it and the relay's port."""
    echo, connections = Echo(), Connections(refused)
    async with await asyncio.start_server(echo.serve, "127.0.0.1", 0) as inner:
        server = await asyncio.start_server(lambda *way: relay.serve(*way), "127.0.0.1", 0, limit=MAX_HEAD_BYTES)
        async with server:
            port = server.sockets[0].getsockname()[1]
            relay = Relay(
                Doorstep("127.0.0.1", port), token, inner.sockets[0].getsockname(), connections, RealtimeClock()
            )
            yield echo, port


async def asked(port: int, request: bytes) -> bytes:
    """All that is answered until the connection ends."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    try:
        async with asyncio.timeout(60):
            return await reader.read()
    except ConnectionResetError:
        return b""
    finally:
        writer.transport.abort()


def test_bytes_pass_in_both_directions_until_the_client_ends() -> None:
    async def conversation() -> None:
        refused: Counter[str] = Counter()
        async with relayed(refused) as (echo, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(head(host=f"127.0.0.1:{port}"))
            assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 101")
            data = bytes(range(256)) * 4096
            sending = asyncio.create_task(_sent(writer, data))
            assert await reader.readexactly(len(data)) == data
            await sending
            writer.close()
            await writer.wait_closed()
        assert len(echo.heads) == 1
        assert not refused

    asyncio.run(conversation())


async def _sent(writer: asyncio.StreamWriter, data: bytes) -> None:
    writer.write(data)
    await writer.drain()


async def _sent_for_ever(writer: asyncio.StreamWriter) -> None:
    while True:
        await _sent(writer, bytes(65536))


def test_refusals_are_answered_with_a_sentence_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WRONG_TOKEN_COSTS", 0.0)

    async def conversation() -> None:
        refused: Counter[str] = Counter()
        async with relayed(refused, TOKEN) as (echo, port):
            host = f"127.0.0.1:{port}"
            for request, status, words in (
                (head(host=host), HTTPStatus.UNAUTHORIZED, b"a token is needed"),
                (head("/?token=wrong", host), HTTPStatus.UNAUTHORIZED, b"a token is needed"),
                (head(host="evil.example"), HTTPStatus.MISDIRECTED_REQUEST, b"another host"),
                (head(host=host, more="Origin: null\r\n"), HTTPStatus.FORBIDDEN, b"another origin"),
                (
                    head(host=host).replace(b"foxglove.sdk.v1", b"foxglove.websocket.v1"),
                    HTTPStatus.BAD_REQUEST,
                    b"found the sub-protocol 'foxglove.websocket.v1'; expected foxglove.sdk.v1, which a current ",
                ),
                (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", HTTPStatus.UPGRADE_REQUIRED, b"in Foxglove"),
                (b"x" * (MAX_HEAD_BYTES + 10), HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, b"headers"),
            ):
                answer = await asked(port, request)
                assert answer.startswith(f"HTTP/1.1 {status.value} ".encode()), answer
                assert words in answer
            assert not echo.heads
        kinds = {
            "wrong_token": 2,
            "foreign_host": 1,
            "foreign_page": 1,
            "other_protocol": 1,
            "no_socket": 1,
            "no_request": 1,
        }
        assert refused == kinds

    asyncio.run(conversation())


def test_more_clients_than_there_is_room_for_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_CLIENTS", 1)

    async def conversation() -> None:
        refused: Counter[str] = Counter()
        async with relayed(refused) as (_, port):
            host = f"127.0.0.1:{port}"
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(head(host=host))
            await reader.readuntil(b"\r\n\r\n")
            assert (await asked(port, head(host=host))).startswith(b"HTTP/1.1 503")
            writer.close()
            await writer.wait_closed()
            assert refused == {"too_many": 1}

    asyncio.run(conversation())


def test_a_client_that_takes_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TAKES_AT_MOST", 0.05)

    async def conversation() -> None:
        refused: Counter[str] = Counter()
        async with relayed(refused) as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
            writer.write(head(host=f"127.0.0.1:{port}"))
            await reader.readuntil(b"\r\n\r\n")
            with pytest.raises(ConnectionError):
                await _sent_for_ever(writer)  # what is echoed is never read here
            writer.transport.abort()
        assert refused == {"too_slow": 1}

    asyncio.run(conversation())
