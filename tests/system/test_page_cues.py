"""The cues of a page in a real browser: contact sounds and rumbles, no contact does not, nor do cues that are off."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser

from manyhands.launch.look.page.feed import Feed
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation

from ..support.browser import ShownPage, browsing, until
from ..support.observed_session import ABOUT

CHROMIUM = shutil.which("chromium")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
pytestmark = pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")

FRAME = 20  # ms
BUCKET = 0.02  # s; of a trace the page has values for shorter times than this
LIMIT = 10.0  # N, of both axes of the device together

LISTENING = """
window.heard = [];
window.shaken = [];
const { start } = OscillatorNode.prototype;
OscillatorNode.prototype.start = function (at) { window.heard.push(at); return start.call(this, at); };
const pad = { index: 0, vibrationActuator: {
  playEffect: (type, effect) => { window.shaken.push([type, effect]); return Promise.resolve("complete"); },
  reset: () => { window.shaken.push(["reset"]); return Promise.resolve("complete"); },
} };
navigator.getGamepads = () => [null, pad];
"""
"""A gamepad that writes down what it is told, and what sounds is written down as well."""


class Pressed:
    """A page of two devices, and the force on the one that can be held, *right*."""

    def __init__(self, browser: Browser) -> None:
        self.feed, self.tick = Feed(ABOUT), 0
        self.feed.take(encode(Condition("running", 1.0, dict.fromkeys(ABOUT.nodes, "running"))), Instant(0))
        self.take(*[0.0] * 300)
        self.shown = ShownPage(browser, self.feed, 1280, "light", LISTENING, stepped=True)
        self.page = self.shown.page
        self.page.locator("#cues summary").click()

    def take(self, *f: float) -> None:
        """The next ticks, in pieces as telemetry comes: the size of the force, N, by its two axes."""
        for begin in range(0, len(f), 100):
            piece = np.array(f[begin : begin + 100])
            self.tick += len(piece)
            for name, node in ABOUT.nodes.items():
                values = {}
                for topic, columns in ABOUT.topics(name).items():
                    values[topic.trace] = np.zeros((len(piece), len(columns)))
                    if name == "right" and topic.name == "force":
                        values[topic.trace] = np.outer(piece, (0.6, -0.8))
                self.feed.take(encode(Observation(name, self.tick, Figures(), values)), Instant(self.tick * 10**6))
                assert node is not None

    def go_on(self, *f: float) -> None:
        """Show these ticks, and draw until the drawing has come to their end: a machine that is busy skips no frame."""
        self.take(*f)
        self.shown.show()
        for _ in range(100):
            if self.at > self.tick * ABOUT.period - BUCKET:  # nothing of these ticks is still to be looked for
                return
            self.shown.step(FRAME)
        raise AssertionError(f"the drawing is at {self.at} s after 100 frames; expected {self.tick * ABOUT.period} s")

    @property
    def at(self) -> float:
        """The time up to which the cues were looked for, s."""
        return float(self.page.get_attribute("#cues", "data-at") or 0.0)

    def told(self, name: str) -> list[Any]:
        """What was heard or shaken so far."""
        found: list[Any] = self.page.evaluate(f"() => window.{name}")
        return found

    def press(self, button: str, on: bool) -> None:
        self.page.locator(button).click()
        until(self.page, button, "aria-pressed", equals=str(on).lower())


@pytest.fixture
def browser() -> Iterator[Browser]:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    with browsing(CHROMIUM) as found:
        yield found


REST = [0.0] * 300
BLOW = [0.0] * 100 + [2.5] * 10 + [0.0] * 190
PRESSING = [6.0] * 300
SLOW = [*np.linspace(0.0, 2.5, 300)]  # 0.17 N in 20 ms, below the threshold


def test_contact_makes_a_sound_and_no_contact_makes_none(browser: Browser) -> None:
    hand = Pressed(browser)
    hand.go_on(*BLOW)
    assert hand.told("heard") == []  # it is off until it is switched on
    hand.press("#cue-sound", True)
    hand.go_on(*REST)
    hand.go_on(*SLOW)
    assert hand.told("heard") == []
    hand.go_on(*[2.5] * 200, *[0.0] * 100)
    hand.go_on(*BLOW)
    assert len(hand.told("heard")) == 1
    hand.go_on(*BLOW)
    hand.go_on(*REST)
    assert len(hand.told("heard")) == 2
    hand.press("#cue-sound", False)
    hand.go_on(*BLOW)
    hand.go_on(*REST)
    assert len(hand.told("heard")) == 2
    assert hand.told("shaken") == []  # the other cue was never switched on
    assert hand.shown.wrong == []


def test_a_gamepad_rumbles_with_the_force(browser: Browser) -> None:
    hand = Pressed(browser)
    hand.go_on(*PRESSING)
    assert hand.told("shaken") == []
    hand.press("#cue-rumble", True)
    hand.go_on(*PRESSING)
    hand.go_on(*PRESSING)
    shaken = hand.told("shaken")
    assert {kind for kind, *_ in shaken} == {"dual-rumble"}
    effect = shaken[-1][1]
    assert effect["strongMagnitude"] == pytest.approx(6.0 / LIMIT, rel=1e-3)
    assert effect["duration"] > 100
    hand.go_on(*REST)
    hand.go_on(*REST)
    assert hand.told("shaken")[-1] == ["reset"]
    count = len(hand.told("shaken"))
    hand.go_on(*REST)
    assert len(hand.told("shaken")) == count  # at rest it is asked for nothing
    hand.go_on(*PRESSING)
    hand.press("#cue-rumble", False)
    assert hand.told("shaken")[-1] == ["reset"]
    count = len(hand.told("shaken"))
    hand.go_on(*PRESSING)
    assert len(hand.told("shaken")) == count
    assert hand.told("heard") == []
    assert hand.shown.wrong == []


def test_the_cue_is_of_the_device_that_is_chosen_or_held(browser: Browser) -> None:
    hand = Pressed(browser)
    assert hand.page.input_value("#cue-device") == "right"  # the one that can be held
    hand.page.select_option("#cue-device", "left")
    hand.press("#cue-sound", True)
    hand.go_on(*BLOW)
    hand.go_on(*REST)
    assert hand.told("heard") == []
    hand.page.locator('[data-device="right"]').focus()
    hand.page.keyboard.press("Enter")
    hand.shown.step(2 * FRAME)
    assert hand.page.input_value("#cue-device") == "right"
    hand.go_on(*BLOW)
    hand.go_on(*REST)
    assert len(hand.told("heard")) == 1
    assert hand.shown.wrong == []


LAW = """async ([rows, limit]) => {
  const { impact } = await import("/cues.js");
  const { Track } = await import("/tracks.js");
  const track = new Track({ columns: ["f"], seconds: 0.01 }, 1000);
  track.add([0, [rows.flat()]]);
  return rows.map((_, bucket) => impact(track, bucket, limit));
}"""

STRIKE = """async () => {
  const { strike } = await import("/cues.js");
  const context = new OfflineAudioContext(1, 24000, 48000);
  strike(context, 0.1, 0.5);
  const samples = (await context.startRendering()).getChannelData(0);
  const peak = (from, to) => samples.slice(from * 48000, to * 48000).reduce((m, s) => Math.max(m, Math.abs(s)), 0);
  return [peak(0, 0.1), peak(0.1, 0.11), peak(0.14, 0.15), peak(0.45, 0.5)];
}"""


def test_the_law_of_an_impact_and_of_its_sound(browser: Browser) -> None:
    """The sound is rendered by the browser itself: its peak is the loudness, and 1/e of it is left after 40 ms."""
    hand = Pressed(browser)
    laws: list[tuple[str, list[tuple[float | None, float | None]], list[float]]] = [
        ("a step", [(0, 0), (0, 2.5), (2.5, 2.5), (2.5, 2.5)], [0, 0.5, 0.5, 0]),
        ("over two buckets", [(0, 0), (0, 1), (1, 2.5), (2.5, 2.5)], [0, 0.5, 0.5, 0.3873]),
        ("below the threshold", [(0, 0), (0, 0.19), (0.19, 0)], [0, 0, 0]),
        ("through 0", [(1, 1), (-1, 1), (-1, -1)], [0, 0.3162, 0.3162]),
        ("beyond the limit", [(0, 0), (0, 90)], [0, 1]),
        ("unknown before", [(None, None), (None, None), (5, 5), (5, 5)], [0, 0, 0, 0]),
    ]
    for what, rows, expected in laws:
        assert hand.page.evaluate(LAW, [rows, LIMIT]) == pytest.approx(expected, abs=1e-4), what
    before, peak, later, end = hand.page.evaluate(STRIKE)
    assert before == 0.0
    assert peak == pytest.approx(0.5, rel=0.1)
    assert later == pytest.approx(peak / np.e, rel=0.15)
    assert end < 1e-3
    assert hand.shown.wrong == []
