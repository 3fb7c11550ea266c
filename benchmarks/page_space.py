"""How often the page draws a scene of twenty bodies in space, in Chromium whose WebGL computes on the processor.

    python -m benchmarks.page_space [--rounds N] [--seconds S]

The page is shown a session that exists only as frames: two tools and twenty bodies of which each moves, in a room,
with telemetry of 100 ms ten times a second and pictures twenty times a second, as from a running session. Twice each
round: with the camera at rest, when the page draws at its own pace (every second frame of a screen of 60 Hz), and
with one that turns in every frame. Printed are the pictures a second, and the processor time that the browser and its
scripts take for one, which depends less on what else the machine does: medians of the rounds, with the least and the
greatest.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.proc import cpu_seconds, family
from manyhands.design.models.scene import Body, ContactScene
from manyhands.nodes.monitor.session_state import About
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Figures, Observation
from tests.support.browser import SPACE, ShownPage, browsing, until
from tests.system.test_page_drawing import Played, scene

CHROMIUM: Final = "/usr/bin/chromium"
BODIES: Final = 20
PICTURE_EVERY: Final = 0.05  # s, as the server does
SETTLING: Final = 2.0  # s

COUNTED: Final = """(() => {
  window.counted = { pictures: [], spent: [] };
  const clear = WebGL2RenderingContext.prototype.clear; // once for each picture
  WebGL2RenderingContext.prototype.clear = function (mask) {
    window.counted.pictures.push(performance.now());
    return clear.call(this, mask);
  };
  const request = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (draw) => request((now) => {
    const [begun, before] = [performance.now(), window.counted.pictures.length];
    draw(now);
    if (window.counted.pictures.length > before) window.counted.spent.push(performance.now() - begun);
  });
})()"""

TURNING: Final = """(seconds) => {
  const drawing = document.querySelector(".space");
  const end = performance.now() + 1000 * seconds;
  requestAnimationFrame(function turn(now) {
    drawing.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
    if (now < end) requestAnimationFrame(turn);
  });
}"""


def crowded() -> About:
    """The room of ``carry`` with its two tools, and twenty bodies."""
    about = scene("carry")
    found = about.scene
    assert found is not None  # noqa: S101 -- it is a scene
    places = np.random.default_rng(0).uniform(-0.15, 0.15, (BODIES, 3)) + np.array([0.0, 0.16, 0.0])
    bodies = tuple(Body(f"body {i}", 0.1, (x, y, z), 0.02) for i, (x, y, z) in enumerate(places.tolist()))
    crowd = ContactScene(found.ports, found.tools, bodies, found.obstacles, surface=found.surface)
    masses = {f"{body.name}.{axis}": 0.1 for body in bodies for axis in "xyz"}
    return replace(about, scene=crowd, masses=masses)


class Moving(Played):
    """A session whose tools and bodies swing."""

    def go(self, tick: int) -> None:
        """Until this tick."""
        while self.tick + 100 <= tick:
            self.tick += 100
            k = np.arange(self.tick - 100, self.tick)
            for name in self.about.nodes:
                values = {
                    topic.trace: 0.02 * np.sin(0.003 * k[:, None] + np.arange(len(columns)))
                    for topic, columns in self.about.topics(name).items()
                }
                self.feed.take(encode(Observation(name, self.tick, Figures(), values)), Instant(self.tick * 10**6))


class Round(NamedTuple):
    """Pictures a second; the browser's processor time for one of them, and that of the page's scripts for each, ms."""

    rate: float
    busy: float
    spent: list[float]


def measured(shown: ShownPage, played: Moving, seconds: float, turning: bool) -> Round:
    """Let it draw for so many seconds."""
    page, start = shown.page, played.tick
    if turning:
        page.evaluate(TURNING, seconds + SETTLING)
    browsers = [pid for pid in family(os.getpid()) if pid != os.getpid()]
    begun, counting, used = time.monotonic(), False, 0.0
    while (passed := time.monotonic() - begun) < SETTLING + seconds:
        if not counting and passed > SETTLING:
            page.evaluate("window.counted.pictures.length = window.counted.spent.length = 0")
            counting, used = True, cpu_seconds(browsers)
        played.go(start + round(1000 * passed))
        shown.send()
        page.wait_for_timeout(1000 * PICTURE_EVERY)
    counted: dict[str, Any] = page.evaluate("window.counted")
    at, busy = counted["pictures"], cpu_seconds(browsers) - used
    return Round(1000.0 * (len(at) - 1) / (at[-1] - at[0]), 1000.0 * busy / len(at), counted["spent"])


def rounds_of(rounds: int, seconds: float) -> Iterator[dict[bool, Round]]:
    """The measurements of each round, with the camera at rest and turning."""
    with browsing(CHROMIUM) as browser:
        played = Moving(crowded())
        played.stand(0.0, {})
        shown = ShownPage(browser, played.feed, 1280, "light", COUNTED)
        until(shown.page, SPACE, "data-camera", has=" ")
        for _ in range(rounds):
            yield {turning: measured(shown, played, seconds, turning) for turning in (False, True)}
        if shown.wrong:
            raise SystemExit("\n".join(shown.wrong))


def spread(values: list[float]) -> str:
    """The median, with the least and the greatest."""
    return f"{statistics.median(values):.1f} ({min(values):.1f} to {max(values):.1f})"


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=6.0)
    options = parser.parse_args()
    found = list(rounds_of(options.rounds, options.seconds))
    print("| camera | pictures a second | processor time of one, ms | of it scripts | scripts, 95 % |")
    print("|---|---|---|---|---|")
    for turning, name in ((False, "at rest"), (True, "turning")):
        rates, busy = [one[turning].rate for one in found], [one[turning].busy for one in found]
        spent = np.concatenate([one[turning].spent for one in found])
        print(
            f"| {name} | {spread(rates)} | {spread(busy)} | {np.median(spent):.1f} | {np.percentile(spent, 95):.1f} |"
        )
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", file=sys.stderr)


if __name__ == "__main__":
    main()
