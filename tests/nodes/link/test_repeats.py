"""Repeated signals: when they are sent, and that a receiver which slept takes them for no flood."""

from __future__ import annotations

import heapq
from itertools import pairwise
from typing import Final

import numpy as np
import pytest

from manyhands.launch.session.limits import LONGEST_PERIOD, SHORTEST_PERIOD
from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.link.join import Received
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.link.repeats import LONGEST_INTERVAL, OFTEN, SHARE, TICKS_BACK, Repeats, most_strays
from manyhands.protocol.clock import Duration, Instant, from_seconds
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import PROTOCOL_VERSION, LinkHello, Role, Sample

from .test_peer_link import Ears

PERIOD: Final = from_seconds(0.001)
MOST_AT_FIRST: Final = 170  # repeats of one signal, besides those that the longest interval brings
A_MINUTE: Final = 60 * 10**9


def sent(every: Duration, wait: int, step: int, jitter: int = 0) -> list[int]:
    """The instants at which a party repeats its signal that asks at each ``step``, ns."""
    repeats = Repeats(every, Instant(0))
    rng = np.random.default_rng(1)
    asked = (now + int(rng.integers(0, jitter + 1)) for now in range(step, wait, step))
    return [now for now in asked if repeats.due(Instant(now))]


def test_they_come_once_a_period_at_first_though_its_loop_wakes_a_little_early_or_late() -> None:
    instants = sent(PERIOD, 95 * PERIOD, PERIOD, jitter=PERIOD // 3)
    assert [at // PERIOD for at in instants] == list(range(1, 95))


def test_then_they_come_ever_more_rarely_and_delay_an_answer_by_an_eighth_of_the_wait_at_most() -> None:
    instants = sent(PERIOD, A_MINUTE, PERIOD)
    for before, after in pairwise(instants):
        assert after - before <= min(LONGEST_INTERVAL, after // SHARE) + PERIOD  # its loop looks once a period
    apart = np.diff(instants)[OFTEN:]
    assert np.all(np.diff(apart) >= -PERIOD)
    assert len(instants) < MOST_AT_FIRST + A_MINUTE // LONGEST_INTERVAL


@pytest.mark.parametrize("period", [SHORTEST_PERIOD, 1e-4, 1e-3, 3e-3, LONGEST_PERIOD])
def test_no_sender_repeats_more_often_than_receivers_expect(period: float) -> None:
    """One that asks all the time, to a thousandth of the wait, repeats as soon as it may."""
    every = from_seconds(period)
    repeats, now, count = Repeats(every, Instant(0)), every // 2, 0
    while now < A_MINUTE:
        if repeats.due(Instant(now)):
            count += 1
            assert count <= MOST_AT_FIRST + 2 * now / LONGEST_INTERVAL
        now += max(every // 100, now // 1000)
    assert count > OFTEN
    assert 3 * MOST_AT_FIRST <= MAX_STRAY_FRAMES


class Sleepers:
    """A coupling that hears a device, both in simulated time; the network holds frames until an instant."""

    def __init__(self) -> None:
        self.ns = 10**9
        self.coming: list[tuple[int, int, bytes]] = []
        self.ears = Ears()
        self.values = np.zeros(1)
        own = LinkHello(PROTOCOL_VERSION, "c", "s", "cx", Role.COUPLING, ("dx",))
        peer = Peer("dx", Role.DEVICE, ("dx",), binds=True)
        self.join = PeerLink(own, peer, self, Sample, slice(0, 1), self)  # type: ignore[arg-type]

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        raise AssertionError("nothing sleeps here")

    def send(self, frame: bytes) -> bool:
        return True

    def recv(self, timeout: Duration | None) -> bytes | None:
        until = self.ns + (timeout or 0)
        if not self.coming or self.coming[0][0] > until:
            self.ns = until
            return None
        at, _, frame = heapq.heappop(self.coming)
        self.ns = max(self.ns, at)
        return frame

    def say(self, tick: int, at: int, held: int = 0) -> None:
        """The device sends the sample of ``tick`` at an instant; it arrives then, or when the network lets it."""
        frame = encode(Sample(tick, at, np.zeros(1)))
        heapq.heappush(self.coming, (max(at, held), len(self.coming) + tick * 10**6, frame))

    def run(self, ticks: int) -> int:
        """Ordinary ticks; returns the one after."""
        for tick in range(ticks):
            self.say(tick, self.ns)
            assert self.hear(tick) is Received.SIGNAL
            self.ns += PERIOD
        return ticks

    def repeat(self, tick: int, wait: int, held: int = 0) -> None:
        """The device sends its sample, and repeats it for ``wait``, ns."""
        began, order = self.ns, 0
        self.say(tick, began, held)
        repeats = Repeats(PERIOD, Instant(began))
        for now in range(began + PERIOD, began + wait, PERIOD):
            if repeats.due(Instant(now)):
                order += 1
                heapq.heappush(
                    self.coming, (max(now, held), tick * 10**6 + order, encode(Sample(tick, now, np.zeros(1))))
                )

    def hear(self, tick: int) -> Received:
        return self.join.hear(self.values, tick, Duration(2 * PERIOD), self.ears)


WAITS = pytest.mark.parametrize("seconds", [0.5, 5.0, 60.0, 3600.0])


@WAITS
def test_a_receiver_that_slept_takes_repeats_for_no_flood(seconds: float) -> None:
    stage = Sleepers()
    tick, wait = stage.run(20), int(seconds * 1e9)
    stage.repeat(tick, wait)
    stage.ns += wait
    assert stage.hear(tick) is Received.SIGNAL
    stage.say(tick + 1, stage.ns + PERIOD)
    assert stage.hear(tick + 1) is Received.SIGNAL  # behind all the repeats
    assert stage.ears.failure == ""
    assert len(stage.ears.told) > min(100, wait // PERIOD - 2)


@WAITS
def test_a_receiver_that_was_cut_off_and_looked_all_the_time_takes_repeats_for_no_flood(seconds: float) -> None:
    """All repeats come at once, behind many looks that have found nothing."""
    stage = Sleepers()
    tick, wait = stage.run(20), int(seconds * 1e9)
    back = stage.ns + wait
    stage.repeat(tick, wait, held=back)
    heard = Received.NOTHING
    while heard is Received.NOTHING:
        heard = stage.hear(tick)
    stage.say(tick + 1, stage.ns + PERIOD)
    assert stage.hear(tick + 1) is Received.SIGNAL
    assert stage.ears.failure == ""


def test_a_repeat_that_is_of_no_use_to_the_node_does_not_hide_the_sleep() -> None:
    """An environment takes the signal of a member in its pause, has no use for it, and reads the next as a new one."""
    stage = Sleepers()
    tick, wait = stage.run(20), A_MINUTE
    stage.repeat(tick, wait)
    stage.ns += wait
    for _ in range(TICKS_BACK + 1):
        assert stage.hear(tick) is Received.SIGNAL
        stage.join.tick = -1
    stage.say(tick + 1, stage.ns + PERIOD)
    assert stage.hear(tick + 1) is Received.SIGNAL
    assert stage.ears.failure == ""


@WAITS
def test_more_than_an_honest_peer_sends_is_a_flood_however_long_the_sleep(seconds: float) -> None:
    stage = Sleepers()
    tick, wait = stage.run(20), int(seconds * 1e9)
    stage.ns += wait
    most = most_strays(Duration(stage.ns - stage.join._admissions[0]))
    for at in range(most + 50):
        stage.say(tick - 1, stage.ns - most + at)
    assert stage.hear(tick) is Received.NOTHING
    assert stage.ears.failure.startswith(f"cx: dx sent {most + 1} stray frames while its signal of tick {tick} was")
    assert len(stage.coming) == 49
