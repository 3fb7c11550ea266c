"""The messages to a page and the server's answers, without a browser and without a session's processes."""

from __future__ import annotations

import asyncio
import json
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from starlette.websockets import WebSocketDisconnect
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.look.page import server as served
from manyhands.launch.look.page.feed import Cursor, Feed, Watch
from manyhands.launch.look.page.pointer import DEMANDS_AT_ONCE
from manyhands.launch.look.page.security import HEADERS, Doorstep, Token, ViewError
from manyhands.launch.look.page.server import STATIC, Connections, address_of, application, listen, load_assets
from manyhands.launch.run.running import Running
from manyhands.nodes.monitor.given import FIGURES
from manyhands.nodes.monitor.tracks import BUCKETS
from manyhands.protocol.clock import Instant, RealtimeClock
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Grasp, Observation, Release
from manyhands.protocol.transport.broadcast import Broadcast
from manyhands.protocol.transport.pointer import PointerInlet

from ....support.observed_session import ABOUT, conditioned, judged, moving, observed

with warnings.catch_warnings():
    # newer versions of it would rather have another client than httpx, older ones know no other
    warnings.filterwarnings("ignore", message="Using `httpx` with")
    from starlette.testclient import TestClient, WebSocketTestSession

NOW = Instant(10**9)
ADDRESS = "http://127.0.0.1:8000"
DOORSTEP = Doorstep("127.0.0.1", 8000)
ORIGIN = {"origin": ADDRESS}
OF_OTHERS = ("uplot", "three")  # folders of libraries of others
SOCKET = "ws://127.0.0.1:8000/socket"


def fed(*frames: bytes) -> Feed:
    feed = Feed(ABOUT)
    for frame in frames:
        feed.take(frame, NOW)
    feed.look(NOW)
    return feed


def picture(feed: Feed, cursor: Cursor) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(feed.picture(cursor, {}), parse_constant=pytest.fail)
    return told


def test_a_page_receives_the_session_first() -> None:
    told = json.loads(fed().session())
    assert (told["type"], told["session"], told["grips"], told["bucket"]) == ("session", "pair", ["right"], 10)
    assert told["tracks"]["right/sample"]["columns"] == ["right.x", "right.y"]
    assert told["tracks"]["right/interface"]["columns"] == ["e"]
    assert "right/instants" not in told["tracks"]  # nobody draws them


def test_a_picture_has_what_is_new() -> None:
    feed, cursor = fed(conditioned(), moving(100)), Cursor()
    first = picture(feed, cursor)
    begin, [x] = first["tracks"]["left/sample"]
    assert (begin, len(x), x[:2], x[-2:]) == (0, 20, [0.0, 0.009], [0.09, 0.099])
    assert first["nodes"]["left"]["figures"] == {"tau_worst_us": 100.0}
    assert first["nodes"]["left"]["covered"] == 0.0003
    assert first["alarms"] == []
    again = picture(feed, cursor)
    assert again["tracks"] == {}
    assert "alarms" not in again
    assert "figures" not in again["nodes"]["left"]
    feed.take(moving(200), NOW)
    begin, [x] = picture(feed, cursor)["tracks"]["left/sample"]
    assert (begin, len(x), x[-1]) == (9, 22, 0.199)  # the last one sent, and ten new ones


def test_a_picture_says_what_a_hand_was_given() -> None:
    figures = dict(zip(FIGURES, (4.0, 3.9, 10e6, 5e6, 1e6, 0.0), strict=True))
    feed = fed(conditioned(), moving(100), observed("left", 100, {}, **figures))
    told = picture(feed, Cursor())["nodes"]["left"]
    assert told["given"] == "97/40"


def test_a_picture_says_which_buttons_are_pressed() -> None:
    """Those that are held down, and those that were since the telemetry before."""
    feed, cursor = fed(moving(100)), Cursor()
    assert picture(feed, cursor)["nodes"]["left"]["pressed"] == []
    down = {"buttons_down": {"left.grip": 1.0, "left.menu": 0.0, "left.tip": 0.0}}
    events = {"pressed:left.grip@103": 1.0, "pressed:left.menu@110": 1.0, "pressed:left.tip@120": 0.0}
    feed.take(encode(Observation("left", 200, Figures(events, down), {})), NOW)
    assert picture(feed, cursor)["nodes"]["left"]["pressed"] == ["grip", "menu"]
    feed.take(encode(Observation("left", 300, Figures({}, down), {})), NOW)
    assert picture(feed, cursor)["nodes"]["left"]["pressed"] == ["grip"]


def test_a_slow_page_receives_what_is_kept_and_no_more() -> None:
    feed, cursor = fed(moving(100)), Cursor()
    picture(feed, cursor)
    for tick in range(200, 100_100, 100):
        feed.take(moving(tick), NOW)
    begin, [x] = picture(feed, cursor)["tracks"]["left/sample"]
    assert (len(x), begin) == (2 * BUCKETS, 10_000 - BUCKETS)
    assert x[-1] == 99.999


def test_alarms_are_sent_when_they_change_with_the_sessions_time() -> None:
    feed, cursor = fed(moving(12_300), conditioned(faults=("vl was killed",))), Cursor()
    [alarm] = picture(feed, cursor)["alarms"]
    assert (alarm["text"], alarm["level"], alarm["since"], alarm["cleared"]) == ("vl was killed", "fault", 12.3, None)
    assert alarm["earlier"] is True  # this page has just been opened


def test_a_promise_that_is_not_kept_has_the_time_of_its_beginning_on_every_page() -> None:
    broken = judged(observed("vl", 3400, {}, ledger_margin=-0.25), observed("left", 9000, {}))
    told = picture(fed(moving(9000), broken), Cursor())
    [alarm] = told["alarms"]
    assert (alarm["since"], alarm["earlier"]) == (3.4, False)
    assert told["health"] == "broken"
    assert ["passivity", "broken", "vl", "3.4 s", "250 mJ"] in [row["cells"] for row in told["promises"]]


def test_health_is_never_ok_beside_a_warning() -> None:
    for frame in (
        observed("left", 100, {}, clipped=3.0),
        observed("vl", 100, {}, saturated=3.0),
        observed("environment", 100, {}, **{"frozen:vl@90": 1.0}),
        observed(
            "environment",
            100,
            {},
            Figures({}, {"waited_ticks": {"vl": 53.0}, "waited_us": {"vl": 117e3}, "frozen_late": {"vl": 2.0}}),
        ),
        conditioned(silent=("vr",)),
        conditioned(lost=("vr",)),
    ):
        told = picture(fed(moving(100), frame, judged(frame)), Cursor())
        assert told["alarms"] != []
        assert told["health"] != "ok", told["alarms"]


def test_the_page_learns_the_end_and_strange_frames_are_counted() -> None:
    feed = fed(conditioned("over"), b"strange", observed("nobody", 1, {}))
    assert picture(feed, Cursor())["over"] is True
    assert feed.live.malformed == 2


@pytest.fixture
def watch(tmp_path: Path) -> Iterator[Watch]:
    watch = Watch(Running(tmp_path, ABOUT), RealtimeClock())
    yield watch
    watch.close()


def client_of(watch: Watch, token: Token | None = None) -> TestClient:
    return TestClient(application(watch, DOORSTEP, token), base_url=ADDRESS)


@pytest.fixture
def client(watch: Watch) -> TestClient:
    return client_of(watch)


def heard(page: WebSocketTestSession, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first message that ``wanted`` accepts; earlier ones are pictures."""
    while True:
        message: dict[str, Any] = json.loads(page.receive_text())
        if wanted(message):
            return message


@pytest.mark.parametrize("path", sorted(load_assets()))
def test_every_file_is_served_with_its_headers(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 200
    assert answer.content == load_assets()[path].content
    for name, value in HEADERS:
        assert answer.headers[name.decode()] == value.decode()


@pytest.mark.parametrize(
    "path", ["/nothing", "/../server.py", "/%2e%2e/server.py", "/uplot/LICENSE", "/three/VERSION", "/docs"]
)
def test_nothing_else_is_served(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404
    assert answer.headers["cache-control"] == "no-store"


def test_the_page_names_no_other_host_and_has_no_inline_script() -> None:
    for path in STATIC.rglob("*"):
        if path.suffix not in (".html", ".js", ".css") or path.parent.name in OF_OTHERS:
            continue
        text = path.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "http:" not in text, path
        assert "https:" not in text, path
        assert "innerHTML" not in text, path
    index = (STATIC / "index.html").read_text()
    assert all("src=" in tag.split(">")[0] for tag in index.split("<script")[1:])
    assert "style=" not in index


def test_three_js_is_the_one_that_its_version_names() -> None:
    folder = STATIC / "three"
    version = (folder / "VERSION").read_text()
    stated = dict(re.findall(r"^sha256 (\S+) ([0-9a-f]{64})$", version, re.MULTILINE))
    shipped = {path.name: sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.js")}
    published = {"build/three.module.js", "build/three.core.js"}
    assert {name: digest for name, digest in stated.items() if name not in published} == shipped
    assert published < stated.keys()
    number = re.search(r"three\.js 0\.(\d+)\.\d+ \(r\1\)", version)
    assert number is not None
    (text,) = (path.read_text() for path in folder.glob("*.js"))
    revision = re.search(rf'([\w$]+)="{number[1]}"', text)
    assert revision is not None
    assert f"{revision[1]} as REVISION" in text
    assert "SPDX-License-Identifier: MIT" in text
    assert "\nimport" not in text  # nothing else is loaded


def test_another_hosts_name_is_misdirected(client: TestClient) -> None:
    answer = client.get("/", headers={"host": "evil.example:8000"})
    assert answer.status_code == 421
    assert answer.headers["content-security-policy"]
    assert "<title>" not in answer.text


@pytest.mark.parametrize("headers", [{}, {"origin": "http://evil.example"}, {**ORIGIN, "host": "evil.example:8000"}])
def test_a_foreign_page_gets_no_socket(client: TestClient, headers: dict[str, str]) -> None:
    with pytest.raises(WebSocketDisconnect):
        with client.websocket_connect(SOCKET, headers=headers):
            pass


def test_a_page_holds_a_device_until_it_goes(client: TestClient, tmp_path: Path) -> None:
    inlet = PointerInlet(tmp_path, "right")
    try:
        with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
            assert json.loads(page.receive_text())["type"] == "session"
            page.send_text('{"grasp": "right", "position": [0.01, 9]}')
            heard(page, lambda message: message.get("held") == {"right": "here"})
            held = inlet.latest()
            assert isinstance(held, Grasp)
            assert held.position.tolist() == [0.01, 0.05]
            page.send_text('{"grasp": "left", "position": [0.0]}')
            refused = heard(page, lambda message: message["type"] == "refused")
            assert "expected a device that can be held: right" in refused["why"]
        assert inlet.latest() == Release()
    finally:
        inlet.close()


def test_a_token_that_nobody_asked_for_is_no_mistake(client: TestClient) -> None:
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        page.send_text('{"token": ""}')
        page.send_text("?")
        answer = heard(page, lambda message: message["type"] == "refused")
        assert "found no message of a page" in answer["why"]
        page.send_text('{"token": ""}')
        page.send_text('{"release": "left"}')
        answer = heard(page, lambda message: message["type"] == "refused")
        assert "expected a device that can be held" in answer["why"]


def test_a_page_that_sends_too_much_is_closed(client: TestClient) -> None:
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        for _ in range(3 * DEMANDS_AT_ONCE):
            page.send_text("?")
        with pytest.raises(WebSocketDisconnect) as closed:
            heard(page, lambda _message: False)
    assert closed.value.code == served.TOO_OFTEN


def test_a_message_that_is_no_text_closes_the_page(client: TestClient) -> None:
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        page.send_bytes(b"\0")
        with pytest.raises(WebSocketDisconnect) as closed:
            heard(page, lambda _message: False)
    assert closed.value.code == served.GIVEN_UP


def test_more_pages_than_so_many_come_later(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "MOST_PAGES", 1)
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        page.receive_text()
        with client.websocket_connect(SOCKET, headers=ORIGIN) as other:
            with pytest.raises(WebSocketDisconnect) as closed:
                other.receive_text()
    assert closed.value.code == served.TOO_MANY


def test_a_token_opens_the_page(watch: Watch) -> None:
    client = client_of(watch, Token("0123456789abcdef"))
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        page.send_text('{"token": "0123456789abcdef"}')
        assert json.loads(page.receive_text())["type"] == "session"


@pytest.mark.parametrize("first", ['{"token": "0123456789abcdeg"}', '{"grasp": "right", "position": [0, 0]}', "{}"])
def test_without_it_nothing_is_sent(watch: Watch, monkeypatch: pytest.MonkeyPatch, first: str) -> None:
    monkeypatch.setattr(served, "WRONG_TOKEN_COSTS", 0.0)
    client = client_of(watch, Token("0123456789abcdef"))
    with client.websocket_connect(SOCKET, headers=ORIGIN) as page:
        page.send_text(first)
        with pytest.raises(WebSocketDisconnect) as closed:
            page.receive_text()
    assert closed.value.code == served.NOT_ADMITTED


class Deaf:
    """A page's socket that never takes what it is sent, and counts how much is waiting."""

    def __init__(self) -> None:
        self.waiting = self.most = 0
        self.closed: int | None = None

    async def accept(self) -> None:
        """As a socket does."""

    client = None

    async def receive(self) -> dict[str, Any]:
        """Nothing comes."""
        await asyncio.Event().wait()
        return {}

    async def send_text(self, _text: str) -> None:
        """It is not taken."""
        self.waiting += 1
        self.most = max(self.most, self.waiting)
        try:
            await asyncio.Event().wait()
        finally:
            self.waiting -= 1

    async def close(self, code: int, _why: str) -> None:
        """As a socket does."""
        self.closed = code


def test_a_page_that_does_not_read_is_given_up(watch: Watch, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "TAKES_AT_MOST", 0.05)
    page = Deaf()
    asyncio.run(served.Pages(watch, None, Connections(Counter())).serve(page))  # type: ignore[arg-type]  # as much of a socket as is used
    assert (page.most, page.waiting, page.closed) == (1, 0, served.GIVEN_UP)


def test_a_watch_receives_what_a_broadcast_shows_and_its_end(tmp_path: Path) -> None:
    read, write = os.pipe()
    child = os.posix_spawnp(
        "cat", ["cat"], {}, file_actions=[(os.POSIX_SPAWN_DUP2, read, 0), (os.POSIX_SPAWN_CLOSE, write)]
    )
    os.close(read)
    broadcast = Broadcast(tmp_path)
    watch = Watch(Running(tmp_path, replace(ABOUT, pid=child)), RealtimeClock())

    async def until(what: Callable[[], bool]) -> None:
        while not what():
            await asyncio.sleep(0.005)

    async def look() -> None:
        watching = asyncio.create_task(watch.run())
        tick = 0
        while watch.feed.live.tick == 0:  # a visitor that is just coming in misses what is shown meanwhile
            tick += 100
            broadcast.show(moving(tick))
            await asyncio.sleep(0.005)
        assert not watch.feed.over
        os.close(write)  # and so the process ends
        await until(lambda: watch.feed.over)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)

    try:
        asyncio.run(asyncio.wait_for(look(), 60.0))
        assert watch.feed.live.tick > 0
    finally:
        os.waitpid(child, 0)
        watch.close()
        broadcast.close()


def test_the_address_that_is_printed() -> None:
    assert address_of(DOORSTEP, None) == "http://127.0.0.1:8000/"
    assert address_of(Doorstep("::1", 80), None) == "http://[::1]:80/"
    assert address_of(DOORSTEP, Token("0123456789abcdef")) == "http://127.0.0.1:8000/#token=0123456789abcdef"
    assert "0.0.0.0" not in address_of(Doorstep("0.0.0.0", 80), None)


def test_a_taken_port_is_reported() -> None:
    with listen("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ViewError, match=rf"--port {port}: cannot listen there: .*expected an address"):
            listen("127.0.0.1", port)


@pytest.mark.parametrize("host", ["192.0.2.7", "a" * 300])
def test_a_host_of_another_machine_is_reported(host: str) -> None:
    with pytest.raises(ViewError, match="cannot listen there"):
        listen(host, 0)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Token | None]]:
    """The calls by which the command would serve its page."""
    served_: list[tuple[str, Token | None]] = []

    def serve(
        _running: Running,
        host: str,
        _port: int,
        token: Token | None,
        ready: Callable[[str], None],
        refused: Counter[str],
    ) -> None:
        served_.append((host, token))
        ready(address_of(Doorstep(host, 80), token))
        refused.update({"too_slow": 1, "too_many": 3})

    monkeypatch.setattr("manyhands.launch.look.page.server.serve", serve)
    monkeypatch.setattr("manyhands.launch.look.sessions.running_sessions", lambda: [Running(Path("/nowhere"), ABOUT)])
    return served_


def test_on_loopback_the_address_is_enough(told: list[tuple[str, Token | None]]) -> None:
    done = CliRunner().invoke(app, ["view"])
    assert (done.exit_code, told) == (0, [("127.0.0.1", None)])
    first, page, waiting, *_ = done.output.splitlines()
    assert first.endswith(": starting its page"), "said before the libraries of the server are imported"
    assert page == "page: http://127.0.0.1:80/"
    assert waiting.endswith(": waiting for a browser to open this address; Ctrl-C ends")
    assert done.output.endswith("refused: too_many 3, too_slow 1\n")


def test_elsewhere_a_token_is_drawn_and_printed_once(told: list[tuple[str, Token | None]]) -> None:
    done = CliRunner().invoke(app, ["view", "--host", "192.0.2.7"])
    [(_, token)] = told
    assert token is not None
    assert done.output.count(token.reveal()) == 1
    assert f"page: http://192.0.2.7:80/#token={token.reveal()}" in done.output
    assert "without encryption" in done.output


def test_a_token_of_a_file_counts_on_loopback_too(told: list[tuple[str, Token | None]], tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.touch(0o600)
    path.write_text("0123456789abcdef")
    done = CliRunner().invoke(app, ["view", "--token-file", str(path)])
    assert done.exit_code == 0
    assert "0123456789abcdef" not in done.output  # whose it is has it
    assert "page: http://127.0.0.1:80/\n" in done.output
    [(_, token)] = told
    assert token is not None
    assert token.fits("0123456789abcdef")


@pytest.mark.parametrize(
    "arguments", [["--running", "other"], ["--token-file", "/nowhere/token"], ["--port", "-1"], ["--port", "65536"]]
)
def test_bad_input_is_refused(told: list[tuple[str, Token | None]], arguments: list[str]) -> None:
    done = CliRunner().invoke(app, ["view", *arguments])
    assert (done.exit_code, told) == (2, [])
