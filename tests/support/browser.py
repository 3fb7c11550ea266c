"""A real browser on the page of a real session: a test starts, questions and ends it, and collects its errors."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit

import numpy as np
import yaml
from playwright.sync_api import Browser, ConsoleMessage, Page, Route, WebSocketRoute, sync_playwright

from manyhands.launch.look.page.feed import Cursor, Feed
from manyhands.launch.look.page.security import HEADERS
from manyhands.launch.look.page.server import load_assets

from .commands import read_until, started

SESSION: Final = "browser.yaml"
SLOWED: Final = ("--set", "period=0.01", "--set", "design.tau=0.004")
"""A machine whose processor also draws the page cannot keep 1 kHz."""

QUIET: Final = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-background-timer-throttling",  # of two pages one is behind the other, and holds a device all the same
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
)

SOFTWARE: Final = "GPU stall due to ReadPixels"
"""Of the one message that WebGL without a graphics card logs by itself, about its own speed."""


def is_wrong(message: ConsoleMessage) -> bool:
    """Whether a message of the browser's console is the page's error or warning."""
    return message.type in ("error", "warning") and SOFTWARE not in message.text


UNTIL: Final = """([condition, limit]) => new Promise((done, fail) => {
  const end = setTimeout(() => fail(new Error("it never became so")), limit);
  const looks = new MutationObserver(look);
  looks.observe(document, { subtree: true, attributes: true, childList: true, characterData: true });
  function look() {
    if (!holds()) return;
    clearTimeout(end);
    looks.disconnect();
    done();
  }
  function holds() {
    const { name, where, what } = condition;
    const element = document.querySelector(where);
    if (!element) return false;
    const whole = name === "text" ? element.textContent : (element.getAttribute(name) ?? "");
    const value = what.axis === undefined ? whole : (whole.split(" ")[what.axis] ?? "");
    if (what.equals !== undefined) return value === what.equals;
    if (what.has !== undefined) return value.includes(what.has);
    return value !== "" && (what.above !== undefined ? Number(value) > what.above : Number(value) < what.below);
  }
  look();
})"""
"""Waits for the page to change, not for time: its own policy forbids the evaluation that polling would need."""


def until(page: Page, where: str, name: str, **what: Any) -> None:
    """Wait until an attribute of an element, or its text: ``equals``, ``has``, or is ``above`` or ``below`` it.

    With ``axis`` it is one of several numbers.
    """
    page.evaluate(UNTIL, [{"where": where, "name": name, "what": what}, 60_000])


@contextmanager
def viewed(*options: str | Path, session: Sequence[str] = (SESSION,)) -> Iterator[tuple[str, int]]:
    """A session that can be dragged (its file, and options of its launch), and its page, served with ``options``.

    Yields the page's address and the supervisor's process id.
    """
    with started("launch", *session, *SLOWED) as launched:
        read_until(launched, "running")
        with started("view", "--running", str(launched.pid), *options) as view:
            address = re.sub(r"^page: ", "", read_until(view, "page: ").strip())
            yield address, launched.pid
            view.send_signal(signal.SIGINT)
            assert view.wait(60) == 130
        launched.send_signal(signal.SIGINT)
        launched.wait(60)


@contextmanager
def browsing(executable: str) -> Iterator[Browser]:
    """A browser that sends nothing by itself.

    Its temporary files are in a folder of their own: on a slow machine its processes end without removing them.
    """
    with sync_playwright() as playwright, tempfile.TemporaryDirectory(prefix="b") as own:
        browser = playwright.chromium.launch(
            executable_path=executable, args=list(QUIET), timeout=60_000, env={**os.environ, "TMPDIR": own}
        )
        try:
            yield browser
        finally:
            browser.close()


def open_page(browser: Browser, address: str, width: int, scheme: Any, wrong: list[str], dots: float = 1.0) -> Page:
    """Open the page and wait until its plot moves; every later error of the page is added to ``wrong``.

    The screen has so many ``dots`` in a px.
    """
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme, device_scale_factor=dots)
    page.set_default_timeout(60_000)
    host = urlsplit(address).netloc

    def requested(url: str) -> None:
        if urlsplit(url).netloc != host:
            wrong.append(f"request to {url}")

    page.on("request", lambda request: requested(request.url))
    page.on("websocket", lambda opened: requested(opened.url))
    page.on("pageerror", lambda error: wrong.append(f"error {error}"))
    page.on("console", lambda told: wrong.append(told.text) if is_wrong(told) else None)
    page.goto(address)
    until(page, "#plot", "data-points", above=100)
    tick = int(page.get_attribute("#plot", "data-last-tick") or 0)
    until(page, "#plot", "data-last-tick", above=tick)
    return page


def picture(page: Page, folder: Path, name: str) -> None:
    """Save a picture of the whole page."""
    page.screenshot(path=folder / f"{name}.png", full_page=True)


def centre(page: Page, where: str) -> tuple[float, float]:
    """The middle of an element, px."""
    page.locator(where).scroll_into_view_if_needed()
    box = page.locator(where).bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


SPACE: Final = ".space"
"""The drawing of a scene in space, which has the focus for the camera's keys."""

_FIELD: Final = 0.6  # rad, of the camera, from the lower to the upper edge


class Camera(NamedTuple):
    """The camera as the page states it: two angles (rad), distance and target (m), and the picture's height (px)."""

    azimuth: float
    elevation: float
    distance: float
    target: np.ndarray[Any, np.dtype[np.float64]]
    height: float

    @classmethod
    def of(cls, page: Page) -> Camera:
        """The camera of the picture that the page shows."""
        azimuth, elevation, distance, *target = map(float, (page.get_attribute(SPACE, "data-camera") or "").split())
        box = page.locator(f"{SPACE} canvas").bounding_box()
        assert box is not None
        return cls(azimuth, elevation, distance, np.array(target), box["height"])

    def moved(self, place: Any, right: float, down: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The motion, m, parallel to the picture, that moves what is at ``place`` by so many px."""
        back, to_the_right, up = self.axes
        depth = float((self.target + self.distance * back - place) @ back)
        length = 2.0 * depth * math.tan(_FIELD / 2.0) / self.height  # of a px
        return length * (right * to_the_right - down * up)

    @property
    def axes(self) -> tuple[np.ndarray[Any, np.dtype[np.float64]], ...]:
        """From what it looks at to the eye, to the right, and upwards."""
        sa, ca, se, ce = (
            math.sin(self.azimuth),
            math.cos(self.azimuth),
            math.sin(self.elevation),
            math.cos(self.elevation),
        )
        return np.array([ce * sa, se, ce * ca]), np.array([ca, 0.0, -sa]), np.array([-se * sa, ce, -se * ca])

    def seen(self, place: Any) -> tuple[float, float]:
        """How many px to the right of the picture's middle, and below it, a place is seen."""
        back, right, up = self.axes
        eye = self.target + self.distance * back
        pixels = self.height / (2.0 * float((eye - place) @ back) * math.tan(_FIELD / 2.0))
        return pixels * float((place - eye) @ right), -pixels * float((place - eye) @ up)


def camera_after(page: Page, *keys: str) -> Camera:
    """The camera after these keys, and after the frame that shows it."""
    for key in keys:
        page.keyboard.press(key)
    frames(page)
    return Camera.of(page)


def frames(page: Page) -> None:
    """Wait until two more frames are drawn."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


CARRIED: Final = (
    "carry",
    *(f"--set=devices.{device}.driver=browser" for device in ("anna", "ben")),
    *(f"--set=devices.{device}.hand={{stiffness: 300, damping: 5}}" for device in ("anna", "ben")),
)
"""The shipped session with two balls, whose users are pages."""

ANNA: Final = '[data-device="anna"]'
BEN: Final = '[data-device="ben"]'
RED: Final = '[data-mass="red"]'


def lift(pages: Sequence[Page]) -> None:
    """Two people press on the red ball of :data:`CARRIED` from both sides, each with the mouse of a page, and lift it.

    When it returns, the ball is up, and both hold on.
    """
    hands = []
    for page, device, side in zip(pages, (ANNA, BEN), (1.0, -1.0), strict=True):
        page.bring_to_front()
        page.locator(SPACE).focus()
        camera = camera_after(page, *("ArrowLeft",) * 5, *("ArrowDown",) * 3)  # level, from the front
        pixels = 1.0 / camera.moved(np.array([-0.06 * side, 0.04, 0.0]), 1.0, 0.0)[0]  # of a m
        hands.append((page, *_taken(page, device), side, pixels))
        until(page, device, "data-held", equals="here")
    until(pages[0], BEN, "data-held", equals="elsewhere")
    for inwards, upwards in ((0.05, 0.0), (0.05, 0.02), (0.05, 0.04), (0.05, 0.06)):  # m
        for page, x, y, side, pixels in hands:
            page.mouse.move(x + side * inwards * pixels, y - upwards * pixels, steps=2)
    until(pages[0], RED, "data-at", above=0.02, axis=1)  # m


def _taken(page: Page, device: str) -> tuple[float, float]:
    """Press the mouse on a device's ring, and return where; an alarm that appears just then moves the drawing away."""
    for _ in range(10):
        x, y = centre(page, device)
        page.mouse.move(x, y)
        page.mouse.down()
        if page.evaluate("(where) => document.activeElement.matches(where)", device):
            return x, y
        page.mouse.up()
    raise AssertionError(f"{device} was never below the mouse")


HAND: Final = '[data-device="hand"]'
TURNED: Final = 0.1
"""The angle between device and tool, rad, that :func:`turn` waits for."""

_TURNS: Final = 10
_LOOKS: Final = 40  # frames


def written(session: Mapping[str, Any], folder: Path) -> Path:
    """The file of a session that is written in Python."""
    path = folder / f"{session['session']}.yaml"
    path.write_text(yaml.safe_dump(dict(session), sort_keys=False))
    return path


def take_to_turn(page: Page) -> tuple[float, float]:
    """Take the bar between rails by the mouse, to turn it about the vertical; returns where it was taken, px."""
    page.locator(SPACE).focus()
    camera_after(page, *("ArrowDown",) * 7)  # level, so that upwards in the picture is the vertical
    x, y = centre(page, f"{HAND} .body")
    page.keyboard.down("Shift")
    page.mouse.move(x, y)
    page.mouse.down()
    page.keyboard.up("Shift")
    until(page, HAND, "data-held", equals="here")
    return x, y


def turn(page: Page, x: float, y: float, looking: Page) -> None:
    """Turn the bar that was taken there to and fro, until a page shows that the rails hold it back.

    A machine that also draws the pages misses ticks, after which the device lets go of what it pressed against.
    """
    for _ in range(_TURNS):
        for side in (-25, 25):  # px: by 29 degrees
            page.mouse.move(x + side, y, steps=3)
            for _ in range(_LOOKS):
                frames(looking)
                if float(looking.get_attribute('[data-force-of="hand"]', "data-angle") or 0.0) > TURNED:
                    return
    raise AssertionError("the rails never held the bar")


def seen_from(page: Page, *keys: str) -> None:
    """Move the camera by these keys while something else has the focus, which holds a device."""
    page.evaluate(
        """(keys) => {
          const frame = document.querySelector(".space");
          for (const key of keys) frame.dispatchEvent(new KeyboardEvent("keydown", { key }));
        }""",
        list(keys),
    )
    frames(page)


NOWHERE: Final = "http://127.0.0.1:9/"
"""The address of a page that no server serves: the test answers its requests itself."""

BOXES: Final = """() => {
  const wrong = [];
  const seen = (element) => element.checkVisibility() && element.textContent.trim() !== "";
  const compare = (what, elements) => {
    const boxes = elements.filter(seen).map((element) => [element.textContent.trim(), element.getBoundingClientRect()]);
    boxes.forEach(([text, a], i) => {
      for (const [other, b] of boxes.slice(i + 1)) {
        const width = Math.min(a.right, b.right) - Math.max(a.left, b.left);
        const height = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
        if (width > 1 && height > 1) wrong.push(`${what}: ${text} | ${other}`);
      }
    });
    return boxes;
  };
  for (const drawing of document.querySelectorAll("#world-drawing svg, #graph-drawing svg")) {
    const whole = drawing.getBoundingClientRect();
    for (const [text, box] of compare("drawing", [...drawing.querySelectorAll("text")])) {
      const aside = Math.max(whole.left - box.left, box.right - whole.right);
      const outside = Math.max(aside, whole.top - box.top, box.bottom - whole.bottom);
      if (outside > 1) wrong.push(`outside its drawing: ${text}`);
    }
  }
  const words = "header :is(h1, p, dt, dd), section :is(h2, button, caption), table :is(th, td), #lobby li, #forces li";
  compare("words", [...document.querySelectorAll(words)]);
  const over = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  if (over > 0) wrong.push(`the page is ${over} px wider than its window`);
  return wrong;
}"""
"""The texts that overlap, or that leave their drawing, by their boxes on the screen; and what is too wide."""


_FRAME: Final = 20  # ms
_MOST_FRAMES: Final = 500
_STANDS: Final = 3600.0  # s of the page's time, where it stands: later than it can be by itself


class ShownPage:
    """The page of a session that exists only as a feed of given frames, without a server and without processes.

    Attributes:
        page: the browser's page.
        wrong: every error and warning of the page.
        demands: the page's messages, in their order.
    """

    def __init__(
        self,
        browser: Browser,
        feed: Feed,
        width: int,
        scheme: Any,
        before: str = "",
        height: int = 900,
        stepped: bool = False,
    ) -> None:
        """Open the page, and show the feed's present state; the page's scripts run after the script ``before``.

        Where it is ``stepped``, the page's time stands still from then on, and goes on by :meth:`step` alone.
        """
        self.wrong: list[str] = []
        self.demands: list[dict[str, Any]] = []
        self._feed, self._cursor, self._sent = feed, Cursor(), 0
        self._stepped = False  # until the first picture is drawn, in its own time
        self._sockets: list[WebSocketRoute] = []
        self.page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        self.page.set_default_timeout(60_000)
        self.page.add_init_script(before)
        if stepped:
            self.page.clock.install(time=0)
        self.page.on("pageerror", lambda error: self.wrong.append(f"error {error}"))
        self.page.on("console", lambda told: self.wrong.append(told.text) if is_wrong(told) else None)
        assets = load_assets()

        def answer(route: Route) -> None:
            asset = assets.get(urlsplit(route.request.url).path)
            if asset is None:
                self.wrong.append(f"request to {route.request.url}")
                route.abort()
                return
            headers = {name.decode(): value.decode() for name, value in HEADERS}
            route.fulfill(body=asset.content, headers=headers | {"content-type": asset.type})

        def connected(socket: WebSocketRoute) -> None:
            self._sockets.append(socket)
            socket.on_message(lambda text: self.demands.append(json.loads(text)))
            socket.send(feed.session())
            self.send()

        self.page.route("**/*", answer)
        self.page.route_web_socket("**/socket", connected)
        self.page.goto(NOWHERE)
        self._await_drawing()
        self._stepped = stepped
        if stepped:
            self.page.clock.pause_at(_STANDS)

    def step(self, ms: int) -> None:
        """Let the page's time go on by so many ms, with all its frames, however long they take to draw."""
        self.page.clock.run_for(ms)

    def show(self) -> None:
        """Show what the feed has taken in since."""
        self.send()
        self._await_drawing()

    def await_demand(self, demand: dict[str, Any]) -> None:
        """Wait, frame by frame, until the page has sent this message."""
        for _ in range(3600):
            if demand in self.demands:
                return
            self.page.evaluate("() => new Promise(requestAnimationFrame)")
        raise AssertionError(f"the page has sent {self.demands}; expected {demand}")

    def send(self) -> None:
        """Send what the feed has taken in since, without waiting for the page."""
        self._sent += 1
        self._sockets[-1].send(self._feed.picture(self._cursor, {}))

    def _await_drawing(self) -> None:
        until(self.page, "body", "data-pictures", equals=str(self._sent))
        tick = str(self._feed.live.tick)
        for _ in range(_MOST_FRAMES if self._stepped else 0):
            if self.page.get_attribute("body", "data-tick") == tick:
                return
            self.step(_FRAME)
        until(self.page, "body", "data-tick", equals=tick)
