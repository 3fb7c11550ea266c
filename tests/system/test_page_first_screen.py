"""What a person sees first, measured in a browser: the world on top whatever the alarms, and no text cut or broken."""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from manyhands.nodes.monitor.session_state import About
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Figures, Role

from ..support.browser import BOXES, SPACE, ShownPage, browsing, frames, until
from ..support.slot import as_told, described
from .test_page_drawing import NOTICE, SESSIONS, Played, scene

CHROMIUM = shutil.which("chromium")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
pytestmark = pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")

SCREENS: Final = [(1280, 900), (390, 844)]
LONG: Final = pytest.mark.long
DRAWING: Final = "#world-drawing :is(canvas, svg)"
LATE: Final = {"tau_breaches": 14.0, "period_breaches": 3.0, "interface_ticks": 3.0, "interface": -1e-4,
               "interface_min": -2e-4, "ledger": 0.1, "ledger_margin": -0.3, "saturated": 2.0}  # fmt: skip

SEEN: Final = """(where) => {
  const box = document.querySelector(where).getBoundingClientRect();
  const within = (low, high, most) => Math.max(0, Math.min(high, most) - Math.max(low, 0));
  const area = within(box.left, box.right, innerWidth) * within(box.top, box.bottom, innerHeight);
  const { left, top, right, bottom } = box;
  return { left, top, right, bottom, share: area / (innerWidth * innerHeight) };
}"""
"""The box of an element on the screen before anybody scrolls, and the part of the screen that it is."""

CUT: Final = """() => {
  const wrong = [];
  for (const element of document.querySelectorAll("body *")) {
    if (!element.checkVisibility() || element.closest(".skip, .aside, .unseen, .everyone, svg, #plot, thead")) continue;
    const { overflowX, overflowY, textOverflow } = getComputedStyle(element);
    const name = element.id || element.className || element.tagName;
    if (textOverflow !== "clip") wrong.push(`${name}: text-overflow`);
    const hides = [overflowX, overflowY].some((overflow) => overflow !== "visible");
    if (hides && element.scrollWidth > element.clientWidth + 1) wrong.push(`${name}: wider than its box`);
    if (hides && element.scrollHeight > element.clientHeight + 1) wrong.push(`${name}: higher than its box`);
  }
  for (const text of document.querySelectorAll("#graph-drawing text, #world-drawing text")) {
    if (text.checkVisibility() && text.textContent.includes("…")) wrong.push(`cut: ${text.textContent}`);
  }
  return wrong;
}"""
"""Elements that hide a part of what they hold, and texts that were shortened."""

BROKEN: Final = """() => {
  const wrong = [];
  const clipped = (element) => getComputedStyle(element).clipPath !== "none";
  const unseen = (element) => element !== null && (clipped(element) || unseen(element.parentElement));
  const words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = words.nextNode(); node; node = words.nextNode()) {
    const owner = node.parentElement;
    if (!owner.checkVisibility() || owner.closest("svg, noscript, script") || unseen(owner)) continue;
    for (const { 0: word, index } of node.textContent.matchAll(/[^\\s_.-]+[_.-]?/g)) {
      const range = document.createRange();
      range.setStart(node, index);
      range.setEnd(node, index + word.length);
      const boxes = [...range.getClientRects()].filter((box) => box.width > 0);
      const tops = new Set(boxes.map((box) => Math.round(box.top)));
      if (tops.size > 1) wrong.push(`${word} in ${node.textContent.trim().slice(0, 60)}`);
    }
  }
  return wrong;
}"""
"""Words on more than one line; a name of several parts may go on in the next line after a part."""

CROSSED: Final = """() => {
  const wrong = [];
  for (const drawing of document.querySelectorAll("#world-drawing svg")) {
    const texts = [...drawing.querySelectorAll("text")].filter((text) => text.checkVisibility() && text.textContent);
    const lines = drawing.querySelectorAll(".lane, .lag, .spring, .force, .axis, .hatch");
    const isDrawn = (line) => line.checkVisibility() && (line.getAttribute("d") || line.hasAttribute("x1"));
    for (const line of [...lines].filter(isDrawn)) {
      const at = line.getScreenCTM();
      const length = line.getTotalLength();
      for (let step = 0; step <= length; step += 1) {
        const { x, y } = line.getPointAtLength(step).matrixTransform(at);
        const under = texts.find((text) => {
          const box = text.getBoundingClientRect();
          return x > box.left && x < box.right && y > box.top + 2 && y < box.bottom - 2;
        });
        if (!under) continue;
        wrong.push(`${line.getAttribute("class")} crosses ${under.textContent}`);
        break;
      }
    }
  }
  return wrong;
}"""
"""Labels of the drawing on one of its lines, each followed px by px."""

LINES: Final = """() => [...document.querySelectorAll("#alarms-list > li")].map((line) => {
  const summary = line.querySelector("summary") ?? line;
  const high = parseFloat(getComputedStyle(summary).lineHeight);
  const { top, bottom } = summary.getBoundingClientRect();
  return { text: summary.textContent, lines: Math.round((bottom - top) / high), bottom };
})"""


class Crowded(Played):
    """A session whose every party fails, and of which much is told."""

    def hurt(self) -> None:
        """All devices are late and break their promises, all couplings but one are frozen, all were killed once."""
        couplings = [name for name, node in self.about.nodes.items() if node.role is Role.COUPLING]
        frozen = {f"frozen:{coupling}@50": 1.0 for coupling in couplings[1:]}
        own = {"ledger_margin": -0.2, "saturated": 1.0}
        self.stand(0.01, {"device": LATE, "coupling": own, "environment": frozen | own})
        rows = self.model.rows({})
        killed = tuple(
            f"at {0.1 * i + 1:.1f} s: {name} was killed by SIGKILL" for i, name in enumerate(self.about.nodes)
        )
        faults = tuple(f"{name} was killed by SIGKILL; it stays away: its 3 restarts are used up" for name in couplings)
        running = dict.fromkeys(self.about.nodes, "running")
        self.take(Condition("running", 2.0, running, (), (NOTICE,), killed, faults, rows))
        self.feed.look(Instant(self.tick * 10**6))


def rested(about: About) -> Crowded:
    """A session that is well."""
    played = Crowded(about)
    played.stand(0.01, {})
    return played


def drawn(shown: ShownPage) -> Page:
    """The page once its world is drawn, and its words as well."""
    page = shown.page
    if shown.page.locator("#view-switch").is_visible():
        until(page, SPACE, "data-camera", has=" ")
    frames(page)
    return page


@pytest.fixture
def browser() -> Iterator[Browser]:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    with browsing(CHROMIUM) as found:
        yield found


@pytest.mark.parametrize(("width", "height"), SCREENS)
@pytest.mark.parametrize("name", ["crowd", "carry"])
def test_the_world_is_first_whatever_the_alarms(name: str, width: int, height: int, browser: Browser) -> None:
    played = rested(SESSIONS[name])
    shown = ShownPage(browser, played.feed, width, "light", height=height)
    page = drawn(shown)
    before = page.evaluate(SEEN, DRAWING)
    assert before["top"] < 0.16 * height
    assert before["share"] >= 0.5
    played.hurt()
    shown.show()
    drawn(shown)
    assert page.evaluate(SEEN, DRAWING) == before
    assert page.evaluate("() => scrollY") == 0
    lines = page.evaluate(LINES)
    assert lines[0]["bottom"] <= height  # the gravest one is seen without scrolling
    assert shown.wrong == []
    page.close()


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_a_cause_has_one_line_and_nothing_is_cut_or_broken(width: int, height: int, browser: Browser) -> None:
    played = rested(SESSIONS["crowd"])
    played.hurt()
    shown = ShownPage(browser, played.feed, width, "light", height=height)
    page = drawn(shown)
    lines = page.evaluate(LINES)
    assert len([line for line in lines if "killed" in line["text"]]) == 2  # what failed the run, and what it survived
    assert len([line for line in lines if "passivity" in line["text"]]) == 1
    most = 1 if width > 600 else 2
    assert [line for line in lines if line["lines"] > most] == []
    for opened in (False, True):
        for problems in (page.evaluate(CUT), page.evaluate(BROKEN), page.evaluate(BOXES)):
            assert problems == [], opened
        for summary in page.locator("#alarms-list details:not([open]) > summary").all()[::-1]:
            summary.click()
    assert page.locator("#alarms-list .text").first.is_visible()
    of_all = page.locator("#alarms-list li", has_text="passivity").locator(".parties")
    assert of_all.inner_text().split(", ") == [*played.about.nodes]  # the line has their number
    assert shown.wrong == []
    page.close()


@pytest.mark.parametrize(("width", "height"), SCREENS)
@pytest.mark.parametrize(
    "name", ["pair", "crowd", *(pytest.param(one, marks=LONG) for one in ("chain", "carry", "tray"))]
)
def test_no_line_crosses_a_label(name: str, width: int, height: int, browser: Browser) -> None:
    played = rested(SESSIONS[name])
    shown = ShownPage(browser, played.feed, width, "light", height=height)
    page = drawn(shown)
    for at in (0.01, -0.008, 0.0):
        played.stand(at, {})
        shown.show()
        until(page, "[data-tool]", "data-at", has=f"{at:g}")
        drawn(shown)
        assert page.evaluate(CROSSED) == []
        hidden = set(page.locator("#world-drawing text[display=none]").all_text_contents())
        assert hidden <= {"x", "y", "z"}  # a name has room somewhere; an axis may have none in a crowd
    assert shown.wrong == []
    page.close()


@pytest.mark.parametrize(("width", "height"), SCREENS)
@pytest.mark.parametrize("name", ["stroke", pytest.param("peg", marks=LONG)])
def test_the_first_view_in_space_is_filled(name: str, width: int, height: int, browser: Browser) -> None:
    shown = ShownPage(browser, rested(scene(name)).feed, width, "light", height=height)
    wide, high = filled(drawn(shown))
    assert 0.8 < max(wide, high) < 1.0  # and nothing is outside
    assert shown.wrong == []
    shown.page.close()


def filled(page: Page) -> tuple[float, float]:
    """The parts of the drawing's width and height that its solids extend over: what is much darker than the ground."""
    page.evaluate(
        "() => { for (const one of document.querySelectorAll('.space svg, .buttons')) one.style.display = 'none' }"
    )
    frames(page)
    data = np.array(Image.open(io.BytesIO(page.locator(f"{SPACE} canvas").screenshot())).convert("RGB"), dtype=np.int64)
    used = np.abs(data - 255).sum(axis=2) > 200
    wide, high = (float((np.ptp(np.flatnonzero(used.any(axis=axis))) + 1) / used.shape[1 - axis]) for axis in (0, 1))
    return wide, high


UP, R, Q = (1.0, 0.0, 0.0, 0.0), (0.6, 0.0, 0.8, 0.0), (0.8, 0.0, 0.0, 0.6)
RISEN = (0.5**0.5, 0.0, -(0.5**0.5), 0.0)  # x is upwards, where the name is at first
DOWN = Figures({}, {"buttons_down": {"pen.grip": 1.0}})


@pytest.mark.parametrize(("width", "height"), SCREENS)
def test_no_name_is_on_a_rod_or_an_arc(width: int, height: int, browser: Browser) -> None:
    played = Played(described())
    played.stand(0.0, {"device": DOWN}, as_told(UP, UP, (0.001, 0.02, 0.0)))
    page = ShownPage(browser, played.feed, width, "light", height=height)
    until(page.page, SPACE, "data-camera", has=" ")
    shown = 0
    # more than half a circle in the plane of the picture, as the first view has it, which ends beside the name
    poses = [(UP, UP, (side * 0.0083, side * -0.0178, side * 0.0138)) for side in (1.0, -1.0)]
    poses += [(one, other, (0.001, 0.02, -0.008)) for one in (R, RISEN, UP) for other in (Q, RISEN)]
    for i, pose in enumerate(poses):
        played.stand(0.004 * (i % 3 - 1), {"device": DOWN}, as_told(*pose))
        page.show()
        until(page.page, '[data-tool="pen"]', "data-at", has=f"{0.004 * (i % 3 - 1):g}")
        frames(page.page)
        assert page.page.evaluate(BOXES) == []
        boxes = page.page.evaluate(NAMES)
        shown += len(boxes)
        painted = coloured(page.page)
        for text, (left, top, right, bottom) in boxes:
            assert not painted[round(top) + 2 : round(bottom) - 2, round(left) : round(right)].any(), text
    assert shown >= 3 * len(poses)  # the tool, the scales, and axes that have room
    assert page.wrong == []
    page.page.close()


SHOW = "(how) => { for (const one of document.querySelectorAll('.space svg, .buttons')) one.style.display = how }"
NAMES = """() => {
  const { left, top } = document.querySelector(".space canvas").getBoundingClientRect();
  return [...document.querySelectorAll(".space text")].filter((text) => text.checkVisibility()).map((text) => {
    const box = text.getBoundingClientRect();
    return [text.textContent, [box.left - left, box.top - top, box.right - left, box.bottom - top]];
  });
}"""
"""Names and scales of the drawing, with their boxes in it."""


def coloured(page: Page) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """The pixels of the drawing that are of a colour: of tools, rods and arrows, and not of what stands still."""
    hide = (
        "(shown) => { for (const one of document.querySelectorAll('.space svg, .buttons')) one.style.display = shown }"
    )
    page.evaluate(hide, "none")
    frames(page)
    data = page.locator(f"{SPACE} canvas").screenshot()
    page.evaluate(SHOW, "")
    rgb = np.array(Image.open(io.BytesIO(data)).convert("RGB"), dtype=np.int64)
    return np.asarray(np.ptp(rgb, axis=2) > 60)
