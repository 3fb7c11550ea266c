"""Pictures of the pages of six sessions, at both widths, idle and loaded, and one sheet of all of them.

Each session is simulated in one process, and its telemetry is shown as the broadcast would send it. So the motion is
real, no process has to keep up with a clock, and a picture is the same on every machine. The figures of lateness and
the sentences of a loaded page are written here: every user is late, some are frozen, and many things have happened.

python -m tests.system.page_gallery [FOLDER [SHEET]]
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from PIL import Image
from playwright.sync_api import Browser

from manyhands.launch.audit.simulation import simulate
from manyhands.launch.look.page.feed import Feed
from manyhands.launch.plan.engine import drawing_of
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import RecordedRun
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.bundle import REALTIME
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role

from ..support.browser import SPACE, ShownPage, browsing, frames, until

SESSIONS: Final = ("example1", "carry", "peg", "mujoco", "ball", "stroke")
"""Masses and springs; two balls; a hole; a physics engine; users over wave links; a mesh."""

SCREENS: Final = ((1280, 900), (390, 844))
"""The first screen of a desktop and of a telephone, px."""

PIECE: Final = 100  # ticks of one message of telemetry
SECONDS: Final = 2.4  # of the session's time

DELAY: Final = (
    "forces came later than the certificate covers (0.3 ms): in 3.2% of the ticks, up to 1.2 ms so far; close other "
    "programs, design for what this machine needs (design.tau=auto), or compare rates (manyhands doctor)"
)


class Shown:
    """The simulated run of a session, as the messages of its broadcast."""

    def __init__(self, name: str) -> None:
        """Design the session and simulate it."""
        self._prepared: Prepared = prepare(load_named(name, []))
        self._run: RecordedRun = simulate(self._prepared, round(SECONDS / self._prepared.session.period))
        drawing = drawing_of(self._prepared.session)
        self.about = replace(describe(self._prepared, REALTIME, "ipc", 0), drawing=drawing)

    def feed(self, loaded: bool) -> Feed:
        """What a page knows at the end of the run."""
        feed, model = Feed(self.about), HealthModel(self.about.terms)
        real = 0.97 if loaded else 1.0  # the loaded one catches up
        for end in range(PIECE, round(SECONDS / self.about.period) + 1, PIECE):
            now = Instant(round(real * end * self.about.period * 1e9))
            for name in self.about.nodes:
                kept = [trace for (node, _), trace in self._run.traces.items() if node == name]
                traces = {one.topic.trace: one.values[end - PIECE : end] for one in kept}
                figures = self._figures(name, traces, loaded)
                message = Observation(name, end, figures, traces)
                model.take(name, end, figures)
                feed.take(encode(message), now)
            running = dict.fromkeys(self.about.nodes, "running")
            model.look(running, ())
            rows = model.rows({Promise.DELAY: DELAY} if loaded else {})
            notices = tuple(row.remark for row in rows if row.remark == DELAY)
            incidents = tuple(self._incidents()) if loaded else ()
            condition = Condition("running", end * self.about.period, running, (), notices, incidents, (), rows)
            feed.take(encode(condition), now)
            feed.look(now)
        return feed

    def _incidents(self) -> Iterator[str]:
        for place, (name, node) in enumerate(self.about.nodes.items()):
            if node.role is not Role.ENVIRONMENT:
                yield f"at {0.1 * place + 0.4:.1f} s: {name} was killed by SIGKILL"

    def _figures(self, name: str, traces: Mapping[str, Any], loaded: bool) -> Figures:
        """The figures of a node beside its traces: its ledger as simulated, and how late its ticks were."""
        role = self.about.nodes[name].role
        ledger = traces.get("ledger")
        found = {} if ledger is None else {"ledger": float(ledger[-1, 0]), "ledger_margin": 0.0}
        couplings = [node for node, its in self.about.nodes.items() if its.role is Role.COUPLING]
        match role:
            case Role.DEVICE:
                found |= {"tau_worst_us": 182.0, "interface": 0.004, "interface_min": 0.0}
                late = {"tau_breaches": 14.0, "period_breaches": 3.0, "interface_ticks": 9.0, "interface": -1e-3,
                        "saturated": 4.0, "tau_worst_us": 1210.0}  # fmt: skip
            case Role.COUPLING:
                late = {"ledger_margin": -0.02} if name == couplings[0] else {}
            case _:
                late = {f"frozen:{coupling}@1200": 1.0 for coupling in couplings[-1:]}
        return Figures(found | (late if loaded else {}))


def shoot(browser: Browser, folder: Path, name: str) -> None:
    """Save the first screen and the whole page of a session, idle and loaded, at both widths."""
    shown = Shown(name)
    for loaded in (False, True):
        for width, height in SCREENS:
            page = ShownPage(browser, shown.feed(loaded), width, "light", height=height)
            spatial = shown.about.scene is not None or shown.about.drawing is not None
            until(page.page, "#world-drawing", "data-view", equals="space" if spatial else "plane")
            if spatial:
                until(page.page, SPACE, "data-camera", has=" ")
            frames(page.page)
            words = f"{name}-{'loaded' if loaded else 'idle'}-{width}"
            page.page.screenshot(path=folder / f"{words}.png")
            page.page.screenshot(path=folder / f"{words}-whole.png", full_page=True)
            if page.wrong:
                raise SystemExit("\n".join(page.wrong))
            page.page.close()


def sheet(folder: Path, target: Path) -> None:
    """All first screens on one sheet: a row for each session, idle and loaded, the wide one and the narrow one."""
    scale, gap = 0.3, 8
    sizes = [(round(scale * width), round(scale * height)) for width, height in SCREENS]
    row = sum(width for width, _ in sizes) * 2 + 5 * gap
    high = max(height for _, height in sizes) + gap
    whole = Image.new("RGB", (row, high * len(SESSIONS) + gap), "white")
    for place, name in enumerate(SESSIONS):
        left = gap
        for state in ("idle", "loaded"):
            for (width, _), size in zip(SCREENS, sizes, strict=True):
                one = Image.open(folder / f"{name}-{state}-{width}.png").convert("RGB")
                whole.paste(one.resize(size, Image.Resampling.LANCZOS), (left, gap + place * high))
                left += size[0] + gap
    whole.quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(target, optimize=True)


def main(folder: Path, target: Path | None) -> None:
    """Draw them all."""
    executable = shutil.which("chromium")
    if executable is None:
        raise SystemExit("found no chromium; expected one to draw the page with")
    folder.mkdir(parents=True, exist_ok=True)
    with browsing(executable) as browser:
        for name in SESSIONS:
            shoot(browser, folder, name)
    if target is not None:
        sheet(folder, target)


if __name__ == "__main__":
    folder, *rest = map(Path, sys.argv[1:] or ["out/page"])
    main(folder, rest[0] if rest else None)
