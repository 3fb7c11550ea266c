"""The page in a browser, over given frames: health, promises and seats in words, and labels that never overlap."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from playwright.sync_api import Browser

from manyhands.launch.look.page.feed import Feed
from manyhands.launch.plan.prepare import unproved
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.monitor.given import MEASURE
from manyhands.nodes.monitor.health_model import HealthModel
from manyhands.nodes.monitor.session_state import About, LinkAbout, NodeAbout, SpringAbout
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role

from ..support.browser import BOXES, ShownPage, browsing, picture, until
from ..support.figures import as_figures
from ..support.observed_session import ABOUT

CHROMIUM = shutil.which("chromium")
REQUIRED = os.environ.get("MANYHANDS_REQUIRE_BROWSER") == "1"
PICTURES = Path(os.environ.get("MANYHANDS_PAGE_OUT", Path(__file__).parents[2] / "out" / "page"))
pytestmark = pytest.mark.skipif(CHROMIUM is None and not REQUIRED, reason="no chromium on this machine")

SCREENS = [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")]
NOTICE = (
    f"forces came later than the certificate covers (0.3 ms): left in 3.2% of its ticks, up to 1.2 ms so far; {MEASURE}"
)


def crowd(users: int) -> About:
    """So many users of one axis with long names, and a mass beside each."""
    devices = [f"the_device_of_a_user_{i}" for i in range(users)]
    masses = {f"a_mass_with_a_name_{i}": 1.0 for i in range(users)}
    return replace(
        ABOUT,
        session="a_session_with_a_name_that_is_rather_long",
        nodes={
            **{name: NodeAbout(Role.DEVICE, (name,), wall=True) for name in devices},
            **{f"coupling_of_{name}": NodeAbout(Role.COUPLING, (name,)) for name in devices},
            "environment": NodeAbout(Role.ENVIRONMENT, tuple(devices)),
        },
        links=tuple(LinkAbout((name, f"coupling_of_{name}"), (name,)) for name in devices)
        + tuple(LinkAbout((f"coupling_of_{name}", "environment"), (name,)) for name in devices),
        masses=masses,
        springs=tuple(SpringAbout((name, mass), 100.0, 0.1) for name, mass in zip(devices, masses, strict=True))
        + tuple(SpringAbout((mass, "ground"), 100.0, 0.1) for mass in masses),
        grips=(),
        reach=dict.fromkeys(devices, 0.1),
    )


HOSTED = replace(ABOUT, seats={"vl": "left", "vr": "right"}, nodes=ABOUT.nodes | {
    "vl": replace(ABOUT.nodes["vl"], impedance=(20.0, 20.0)),
    "vr": replace(ABOUT.nodes["vr"], impedance=(20.0, 20.0)),
})  # fmt: skip
CHAIN = replace(
    ABOUT,
    masses={"the_first_mass_of_a_chain": 1.0, "the_second_mass_of_a_chain": 1.0},
    springs=(
        SpringAbout(("left", "the_first_mass_of_a_chain"), 100.0, 0.1),
        SpringAbout(("the_first_mass_of_a_chain", "the_second_mass_of_a_chain"), 100.0, 0.1),
    ),
)


def scene(name: str) -> About:
    """A shipped scene, uncertified: as its run would describe itself."""
    return describe(
        unproved(load_named(name, ["design={coupling: given, stiffness: 900, damping: 0.2}"])), "simulated", "ipc", 0
    )


SESSIONS = {"pair": ABOUT, "crowd": crowd(7), "hosted": HOSTED, "chain": CHAIN} | {
    name: scene(name) for name in ("carry", "tray")
}


class Played:
    """A session whose bodies stand at given places, with a supervisor that judges it."""

    def __init__(self, about: About) -> None:
        self.about, self.feed, self.model, self.tick = about, Feed(about), HealthModel(about.terms), 0

    def stand(
        self,
        at: float,
        figures: Mapping[str, Mapping[str, float]],
        told: Mapping[str, Sequence[float]] = MappingProxyType({}),
        **states: str,
    ) -> None:
        """All bodies stand at ``at``, m, for a second and more, and these are the figures of each node.

        ``told`` has the columns of traces that have others.
        """
        for _ in range(20):
            self.tick += 100
            for name, node in self.about.nodes.items():
                values = {
                    topic.trace: np.full((100, 1), 1.0) * told[topic.trace]
                    if topic.trace in told
                    else np.full((100, len(columns)), 50.0 * at if topic.trace == "f_v" else at)
                    for topic, columns in self.about.topics(name).items()
                }
                self.take(Observation(name, self.tick, as_figures(figures.get(node.role.value, {})), values))
        running = dict.fromkeys(self.about.nodes, "running") | states
        self.model.look(running, ())
        rows = self.model.rows({Promise.DELAY: NOTICE})
        notices = (NOTICE,) if any(row.remark == NOTICE for row in rows) else ()
        self.take(Condition("running", 1.0, running, (), notices, (), (), rows))
        self.feed.look(Instant(self.tick * 10**6))

    def take(self, message: Observation | Condition) -> None:
        """As a frame of the broadcast."""
        if isinstance(message, Observation):
            self.model.take(message.node, message.tick, message.figures)
        self.feed.take(encode(message), Instant(self.tick * 10**6))


@pytest.fixture
def browser() -> Iterator[Browser]:
    assert CHROMIUM is not None, "MANYHANDS_REQUIRE_BROWSER is set, and there is no chromium"
    PICTURES.mkdir(parents=True, exist_ok=True)
    with browsing(CHROMIUM) as found:
        yield found


@pytest.mark.parametrize(
    "name", [name if name in ("pair", "tray") else pytest.param(name, marks=pytest.mark.long) for name in SESSIONS]
)
def test_no_label_overlaps_another_wherever_the_bodies_are(name: str, browser: Browser) -> None:
    about = SESSIONS[name]
    late = {"tau_breaches": 14.0, "interface_ticks": 3.0, "interface": -1e-4, "interface_min": -2e-4, "ledger": 0.1,
            "ledger_margin": 0.0}  # fmt: skip
    lags = {f"{figure}_{seat}": 1e3 for seat in about.seats for figure in ("wave_lag_us", "wave_tank")}
    lags |= {
        f"{figure}_{seat}": 0.0 for seat in about.seats for figure in ("wave_clipped", "wave_silences", "wave_holding")
    }
    own = {"wave_lag_us": 2500.0, "wave_tank": 0.01, "wave_clipped": 0.0, "wave_silences": 0.0, "wave_holding": 0.0}
    couplings = [node for node, known in about.nodes.items() if known.role is Role.COUPLING]
    frozen = {f"frozen:{coupling}@50": 1.0 for coupling in couplings[1:]}
    free = {node: "free" for seat in list(about.seats)[1:] for node in (seat, about.seats[seat])}
    figures = {"device": late, "coupling": own if about.seats else {"saturated": 2.0}, "environment": frozen | lags}
    for width, scheme in SCREENS:
        played = Played(about)
        played.stand(0.02, figures, **free)
        shown = ShownPage(browser, played.feed, width, scheme)
        for at in (0.02, -0.02, 0.0):
            played.stand(at, figures, **free)
            shown.show()
            until(shown.page, "[data-tool]", "data-at", has=f"{at:g}")
            assert shown.page.evaluate(BOXES) == []
        picture(shown.page, PICTURES, f"{name}-{width}-{scheme}")
        assert shown.wrong == []
        shown.page.close()


def test_the_page_names_who_and_since_when_in_the_sessions_time(browser: Browser) -> None:
    played = Played(ABOUT)
    played.stand(0.0, {})
    played.stand(0.0, {"environment": {"frozen:vl@3400": 1.0}, "device": {"tau_breaches": 14.0}})
    shown = ShownPage(browser, played.feed, 1280, "light")  # opened after all of it
    page = shown.page
    until(page, "#health", "text", equals="frozen")
    until(page, "#health-why", "text", has="presence enforced (vl)")
    until(page, "#alarms-list", "text", has="vl is frozen")
    until(page, "#alarms-list", "text", has="since 3.4 s")
    until(page, '[data-promise="presence"][data-state="enforced"]', "text", has="vl3.4 s")
    until(page, '[data-promise="delay"][data-state="enforced"] .who', "text", equals="left")
    until(page, "#certificate-table", "text", has="all proved")
    until(page, '[data-node="vl"]', "data-health", equals="frozen")
    until(page, '[data-force-of="right"]', "text", equals="right: f x 0 N, y 0 N")
    played.stand(0.0, {"environment": {"returned:vl@4100": 1.0}, "device": {"tau_breaches": 14.0}})
    played.stand(0.0, {"device": {"tau_breaches": 14.0}})
    played.stand(0.0, {"device": {"tau_breaches": 14.0}})
    shown.show()
    until(page, "#health", "text", equals="ok")
    until(page, '[data-promise="presence"][data-state="enforced"]', "text", has="3.4 s to 4.1 s")
    assert shown.wrong == []
    page.close()


def test_the_lobby_shows_who_is_in_and_which_seat_is_free(browser: Browser) -> None:
    played = Played(HOSTED)
    own = {"wave_lag_us": 4e3, "wave_tank": 0.01, "wave_clipped": 0.0, "wave_silences": 0.0, "wave_holding": 0.0}
    of_world = Figures({}, {f"{name}_of": {"vl": value} for name, value in (own | {"wave_lag_us": 1e3}).items()})
    played.stand(0.0, {"environment": of_world, "coupling": own}, vr="free", right="free")
    shown = ShownPage(browser, played.feed, 390, "dark")
    until(shown.page, "#lobby li:nth-child(1)", "text", equals="seat vl: in, R = 5 ms, K = 8000 N/m, M = 50 g, ok")
    until(shown.page, "#lobby li:nth-child(2)", "text", equals="seat vr: free")
    until(shown.page, "#health", "text", equals="ok")
    until(shown.page, '[data-node="vr"]', "data-health", equals="free")
    assert shown.wrong == []
    shown.page.close()


def test_a_rate_above_that_of_the_period_says_that_it_catches_up(browser: Browser) -> None:
    played = Played(ABOUT)
    for tick in range(100, 1600, 100):
        played.feed.take(encode(Observation("environment", tick, Figures(), {})), Instant(9 * tick * 10**5))
    shown = ShownPage(browser, played.feed, 390, "light")
    until(shown.page, "#rate", "text", equals="1111 of 1000 / s, catching up")
    assert shown.wrong == []
    shown.page.close()
