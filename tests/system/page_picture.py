"""Draws the pictures of docs/page.md and docs/worlds.md: pages of three sessions, while devices are dragged or turned.

page.png shows browser.yaml; page-space.png and page-space-narrow.png show carry.yaml, whose ball two pages lift;
page-turning.png and page-turning-narrow.png show a bar that is turned between two rails, in a simulated run.

python -m tests.system.page_picture [FOLDER]
"""

from __future__ import annotations

import math
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.look.page.feed import Feed
from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session import Session
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Grasp, Observation

from ..support.browser import CARRIED, SPACE, ShownPage, browsing, centre, lift, open_page, seen_from, until, viewed
from ..support.slot import rail

LEFT, BALL = '[data-device="left"]', '[data-mass="ball"]'
DOTS = 1.5  # of the screen of the pictures in space, in a px
ROUNDS = 3  # times that the hand goes to and fro


def dragged(browser: Browser, target: Path, wrong: list[str]) -> None:
    """Drag the left device to and fro, and take the picture while it is held."""
    with viewed() as (address, _):
        page = open_page(browser, address, 1280, "light", wrong)
        x, y = centre(page, LEFT)
        page.mouse.move(x, y)
        page.mouse.down()
        for _ in range(ROUNDS):
            page.mouse.move(x + 70, y, steps=8)
            until(page, BALL, "data-at", above=0.004)
            page.mouse.move(x - 60, y, steps=8)
            until(page, BALL, "data-at", below=-0.003)
        page.mouse.move(x + 60, y, steps=8)
        until(page, BALL, "data-at", above=0.0035)
        page.screenshot(path=target, full_page=True)
        page.close()


def carried(browser: Browser, wide: Path, narrow: Path, wrong: list[str]) -> None:
    """Two pages lift a ball, and their worlds are taken: one from the side where it begins, one from nearer."""
    with viewed(session=CARRIED) as (address, _):
        pages = [open_page(browser, address, *screen, wrong, DOTS) for screen in ((1280, "light"), (390, "dark"))]
        lift(pages)
        for page, keys, target in zip(pages, (["Home", "+"], ["Home", "+", "+", "+"]), (wide, narrow), strict=True):
            page.bring_to_front()
            page.locator(SPACE).focus()
            for key in keys:
                page.keyboard.press(key)
            page.evaluate("document.activeElement.blur()")
            page.locator("#world").screenshot(path=target)
        for page in pages:
            page.close()


def turning(browser: Browser, wide: Path, narrow: Path, wrong: list[str]) -> None:
    """A person has turned a bar about the vertical until rails hold it, in a simulated run: the first screens of it."""
    for width, height, scheme, target in ((1280, 900, "light", wide), (390, 844, "dark", narrow)):
        shown = ShownPage(browser, turned(0.5), width, scheme, height=height)
        until(shown.page, SPACE, "data-camera", has=" ")
        seen_from(shown.page, *("ArrowUp",) * 3)
        shown.page.screenshot(path=target)
        wrong += shown.wrong
        shown.page.close()


def turned(angle: float) -> Feed:
    """The page's feed of three seconds in which a hand turns the bar by this angle, rad."""
    prepared = prepare(Session.from_dict(rail()))
    simulation = Simulation(prepared)
    simulation.devices["hand"].driver._hand._source._inlet = Turner(angle)  # type: ignore[attr-defined]
    traces = simulation.traces(TICKS)
    simulation.run(TICKS, traces=traces)
    about = describe(prepared, "realtime", "ipc", 0)
    about = replace(about, drawing=drawing_of(prepared.session))
    feed, model = Feed(about), HealthModel(about.terms)
    running = dict.fromkeys(about.nodes, "running")
    for end in range(10, TICKS + 1, 10):  # a tenth of a second
        now = Instant(round(end * about.period * 1e9))
        for node in about.nodes:
            rows = {kept.topic.trace: kept.values[end - 10 : end] for kept in traces.by_node[node]}
            feed.take(encode(Observation(node, end, Figures(), rows)), now)
            model.take(node, end, Figures())
        model.look(running, ())
        feed.take(encode(Condition("running", now * 1e-9, running, (), (), (), (), model.rows({}))), now)
    return feed


TICKS = 300


class Turner:
    """A pointer that holds the bar where it began, turned by an angle about the vertical."""

    malformed = 0

    def __init__(self, angle: float) -> None:
        """Turn by ``angle``, rad."""
        self._said = Grasp(np.array([0.0, 0.0, 0.0, math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)]))

    def latest(self) -> Grasp:
        """Always the same."""
        return self._said

    def close(self) -> None:
        """Nothing is open."""


def main(folder: Path) -> None:
    """Draw them all."""
    executable = shutil.which("chromium")
    if executable is None:
        raise SystemExit("found no chromium; expected one to draw the page with")
    wrong: list[str] = []
    with browsing(executable) as browser:
        dragged(browser, folder / "page.png", wrong)
        carried(browser, folder / "page-space.png", folder / "page-space-narrow.png", wrong)
        turning(browser, folder / "page-turning.png", folder / "page-turning-narrow.png", wrong)
    if wrong:
        raise SystemExit("\n".join(wrong))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[2] / "docs" / "images")
