"""The page's server with clients that send nothing, too little or no text: others are served as before."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest
import uvicorn

from manyhands.launch.look.page import server as application_module
from manyhands.launch.look.page import server as module
from manyhands.launch.look.page import server as server_module
from manyhands.launch.look.page.feed import Watch
from manyhands.launch.look.page.security import Doorstep, Token, is_loopback
from manyhands.launch.look.page.server import (
    ANSWERED_WITHIN,
    MOST_CONNECTIONS,
    MOST_OF_AN_ADDRESS,
    Connections,
    application,
    config_of,
    listen,
    run_until_stopped,
    without_tracebacks,
)
from manyhands.launch.run.running import Running
from manyhands.protocol.clock import Instant, RealtimeClock

from ....support.observed_session import ABOUT

CROWD = 80
TOKEN = "0123456789abcdef"
Stream = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class OpenConnection:
    """A connection."""

    def __init__(self) -> None:
        self.closed = False

    def is_closing(self) -> bool:
        return self.closed

    def abort(self) -> None:
        self.closed = True


class Test_the_connections_that_are_kept:
    @pytest.fixture
    def kept(self) -> Connections:
        return Connections(Counter())

    def opened(self, kept: Connections, host: str, *ports: int, now: int = 0) -> list[OpenConnection]:
        lines = [OpenConnection() for _ in ports]
        for port, line in zip(ports, lines, strict=True):
            kept.opened((host, port), line, Instant(now))
        return lines

    def test_of_one_address_the_longest_silent_goes_first(self, kept: Connections) -> None:
        [other] = self.opened(kept, "b", 1)
        lines = self.opened(kept, "a", *range(MOST_OF_AN_ADDRESS + 2))
        assert [line.closed for line in lines] == [True, True] + [False] * MOST_OF_AN_ADDRESS
        assert not other.closed
        assert kept.refused == {"too_many": 2}

    def test_of_all_the_longest_silent_goes_first(self, kept: Connections) -> None:
        lines = [self.opened(kept, str(host), 1)[0] for host in range(MOST_CONNECTIONS + 1)]
        assert [line.closed for line in lines] == [True] + [False] * MOST_CONNECTIONS

    def test_who_was_answered_is_silent_since_then(self, kept: Connections) -> None:
        lines = self.opened(kept, "a", *range(MOST_OF_AN_ADDRESS))
        kept.answered(("a", 0), Instant(1))
        self.opened(kept, "a", 1000, now=1)
        assert [line.closed for line in lines[:3]] == [False, True, False]

    def test_a_page_stays(self, kept: Connections) -> None:
        pages = self.opened(kept, "a", *range(MOST_OF_AN_ADDRESS))
        for port in range(MOST_OF_AN_ADDRESS):
            kept.admitted(("a", port))
        kept.answered(("a", 0), Instant(0))  # the answer to its own request for a socket
        [late] = self.opened(kept, "a", 1000)
        kept.end_overdue(Instant(ANSWERED_WITHIN + 1))
        assert late.closed
        assert not any(page.closed for page in pages)

    def test_a_deadline_for_each_request(self, kept: Connections) -> None:
        silent, asking = self.opened(kept, "a", 1, 2)
        kept.answered(("a", 2), Instant(1))
        kept.end_overdue(Instant(ANSWERED_WITHIN))
        assert not silent.closed
        kept.end_overdue(Instant(ANSWERED_WITHIN + 1))
        assert (silent.closed, asking.closed) == (True, False)
        assert kept.refused == {"too_slow": 1}

    def test_one_that_went_by_itself_takes_no_room(self, kept: Connections) -> None:
        lines = self.opened(kept, "a", *range(MOST_OF_AN_ADDRESS))
        lines[-1].closed = True
        self.opened(kept, "a", 1000)
        assert [line.closed for line in lines] == [False] * (MOST_OF_AN_ADDRESS - 1) + [True]
        assert kept.refused == {}

    def test_one_that_it_does_not_know_is_let_be(self, kept: Connections) -> None:
        kept.answered(("a", 1), Instant(0))
        kept.admitted(("a", 1))
        kept.end_overdue(Instant(2 * ANSWERED_WITHIN))
        assert kept.refused == {}


class Later(RealtimeClock):
    """The real clock, and what a test adds to it."""

    ahead = 0

    def now(self) -> Instant:
        return Instant(super().now() + self.ahead)


class Served:
    """A page that is served, and its clients."""

    def __init__(self, port: int, refused: Counter[str], clock: Later) -> None:
        self.port, self.refused, self.clock = port, refused, clock
        self.come: list[asyncio.StreamWriter] = []

    async def connect(self, said: bytes = b"") -> Stream:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        writer.write(said)
        self.come.append(writer)
        return reader, writer

    async def asks(self, path: str = "/", more: str = "") -> tuple[bytes, Stream]:
        """Ask for something; returns the first line of the answer."""
        request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\n{more}\r\n"
        stream = await self.connect(request.encode())
        return await stream[0].readline(), stream

    async def page(self) -> Stream:
        """A page's socket, opened."""
        answer, stream = await self.asks(
            "/socket",
            f"Origin: http://127.0.0.1:{self.port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n",
        )
        assert b"101" in answer
        await stream[0].readuntil(b"\r\n\r\n")
        return stream


def framed(text: bytes) -> bytes:
    """A page's message, masked by zeros."""
    return b"\x81" + bytes([0x80 | len(text)]) + bytes(4) + text


async def frame_of(stream: Stream) -> tuple[int, bytes]:
    """The next frame: what kind, and what is in it."""
    kind, length = await stream[0].readexactly(2)
    if length >= 126:
        length = int.from_bytes(await stream[0].readexactly(2 if length == 126 else 8), "big")
    return kind & 0x0F, await stream[0].readexactly(length)


@pytest.fixture
def serving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Serve a page while something is done to it."""
    monkeypatch.setattr(server_module, "LOOK_EVERY", 0.01)

    @contextlib.asynccontextmanager
    async def served(token: Token | None, host: str) -> AsyncIterator[Served]:
        refused: Counter[str] = Counter()
        clock = Later()
        connections, watch = Connections(refused), Watch(Running(tmp_path, ABOUT), clock)
        with listen(host, 0) as listening, without_tracebacks(refused):
            port = listening.getsockname()[1]
            app = application(watch, Doorstep(host, port), token, connections)
            server = uvicorn.Server(config_of(app, connections, clock))
            task = asyncio.create_task(run_until_stopped(server, watch, connections, listening))
            made = Served(port, refused, clock)
            try:
                yield made
            finally:
                for writer in made.come:
                    writer.close()
                server.should_exit = True
                await task
                watch.close()

    def run(do: Callable[[Served], Awaitable[None]], token: Token | None = None, host: str = "127.0.0.1") -> None:
        async def all_of_it() -> None:
            async with asyncio.timeout(60), served(token, host) as page:
                await do(page)

        asyncio.run(all_of_it())

    return run


def test_a_silent_crowd_keeps_no_page_out(serving: Callable[..., None]) -> None:
    async def do(served: Served) -> None:
        for _ in range(CROWD):
            await served.connect()
        answer, _ = await served.asks()
        assert answer == b"HTTP/1.1 200 OK\r\n"
        assert served.refused["too_many"] >= CROWD - MOST_OF_AN_ADDRESS

    serving(do)


@pytest.mark.parametrize("begun", [b"", b"GET / HT", b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 9\r\n\r\n1"])
def test_a_request_that_is_never_finished_is_ended(serving: Callable[..., None], begun: bytes) -> None:
    async def do(served: Served) -> None:
        reader, _ = await served.connect(begun)
        await served.asks()  # by now it was taken
        served.clock.ahead += ANSWERED_WITHIN + 10**9
        await reader.read()  # to its end, which comes
        assert served.refused["too_slow"] >= 1

    serving(do)


def test_pages_that_never_say_their_token_keep_nobody_out(serving: Callable[..., None]) -> None:
    async def do(served: Served) -> None:
        for _ in range(CROWD):
            await served.page()
        page = await served.page()
        page[1].write(framed(b'{"token": "%s"}' % TOKEN.encode()))
        kind, told = await frame_of(page)
        assert kind == 1
        assert b'"session"' in told
        served.clock.ahead += ANSWERED_WITHIN + 10**9  # and a page stays, whatever it sends
        for _ in range(30):
            assert (await frame_of(page))[0] == 1

    serving(do, Token(TOKEN))


def test_a_page_on_every_address_needs_token_and_numeric_host(
    serving: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application_module, "WRONG_TOKEN_COSTS", 0.0)
    wrong = (b'{"token": ""}', b'{"token": "0123456789abcdeg"}', b"{}", b'{"grasp": "right", "position": [0, 0]}')

    async def do(served: Served) -> None:
        for said in wrong:
            page = await served.page()
            page[1].write(framed(said))
            kind, why = await frame_of(page)  # the first frame
            assert (kind, why[:2]) == (8, application_module.NOT_ADMITTED.to_bytes(2, "big"))
        assert served.refused == {"wrong_token": len(wrong)}
        page = await served.page()
        page[1].write(framed(b'{"token": "%s"}' % TOKEN.encode()))
        assert b'"session"' in (await frame_of(page))[1]
        reader, _ = await served.connect(b"GET / HTTP/1.1\r\nHost: elsewhere.example:%d\r\n\r\n" % served.port)
        assert b"421" in await reader.readline()

    serving(do, Token(TOKEN), host="0.0.0.0")


@pytest.mark.parametrize(
    "host", ["0.0.0.0", "::", "", "0", "127.1", "::ffff:192.0.2.7", "192.0.2.7", "localhost.example"]
)
def test_a_host_not_known_as_loopback_needs_a_token(host: str) -> None:
    assert not is_loopback(host)


def test_what_is_no_text_is_refused_and_counted_without_a_traceback(
    serving: Callable[..., None], capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    async def do(served: Served) -> None:
        for times in (1, 2):
            page = await served.page()
            page[1].write(framed(b"\xff\xfe"))
            while (frame := await frame_of(page))[0] == 1:
                pass
            assert frame == (8, (1007).to_bytes(2, "big"))
            assert served.refused == {"no_text": times}
        assert (await served.asks())[0] == b"HTTP/1.1 200 OK\r\n"

    serving(do)
    assert caplog.records == []
    assert capfd.readouterr() == ("", "")


def test_the_limits_leave_room_for_several_addresses() -> None:
    assert module.MOST_OF_AN_ADDRESS < module.MOST_CONNECTIONS
