"""Waiting for a signal while a peer sends other things: how many are read, and what is looked after meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count, repeat
from typing import TypeVar

import numpy as np
import pytest

from manyhands.nodes.bundle import Peer
from manyhands.nodes.exchange import Joint
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.gate import Gate
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import Role, Sample, Tool

TICK = 3
MS = 1_000_000
PATIENCE = Duration(5 * MS)
HONEST = encode(Sample(TICK, 0, np.array([0.5])))
STALE = encode(Sample(TICK - 1, 0, np.array([0.5])))
JUNK = b"\xc1 rubbish"

_T = TypeVar("_T")


class Time:
    """A clock that a link moves on."""

    def __init__(self) -> None:
        self.ns = 1_000 * MS

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        raise AssertionError("nothing sleeps here")


class Arriving:
    """A link on which a frame arrives now and then: so many ns after the one before was read."""

    def __init__(self, time: Time, frames: Iterator[tuple[int, bytes]]) -> None:
        self._time, self._frames = time, frames
        self._next = self._following()
        self.reads = 0

    def _following(self) -> tuple[int, bytes] | None:
        following = next(self._frames, None)
        return None if following is None else (self._time.ns + following[0], following[1])

    def recv(self, timeout: Duration | None) -> bytes | None:
        assert timeout is not None
        assert timeout > 0
        until = self._time.ns + timeout
        if self._next is None or self._next[0] > until:
            self._time.ns = until
            return None
        self._time.ns, frame = max(self._next[0], self._time.ns), self._next[1]
        self.reads += 1
        self._next = self._following()
        return frame


class Watched:
    """A life that notes when it was looked after, and ends after so many looks."""

    def __init__(self, time: Time, looks: int = 1_000_000) -> None:
        self._time, self._looks = time, looks
        self.stopping, self.failure = False, ""
        self.looked: list[int] = []
        self.glances: list[int] = []

    def look(self, now: int) -> None:
        self.glances.append(now)

    def check(self) -> None:
        self.looked.append(self._time.ns)
        self.stopping = self.stopping or len(self.looked) >= self._looks

    def fail(self, text: str) -> None:
        self.stopping, self.failure = True, self.failure or text


def waiting(
    frames: Iterator[tuple[int, bytes]], looks: int = 1_000_000
) -> tuple[Callable[[], bool], Arriving, Watched, np.ndarray, list[int]]:
    """A joint whose peer sends ``frames``: how to wait on it, its link, the life, the values, the times of silence."""
    time = Time()
    link, life, values, silences = Arriving(time, frames), Watched(time, looks), np.zeros(1), list[int]()
    joint = Joint(
        "cx",
        Peer("dx", Role.DEVICE, ("dx",), binds=True),
        link,
        Gate(Sample, 1),
        slice(0, 1),
        time,  # type: ignore[arg-type]
    )

    def wait() -> bool:
        return joint.receive_into(values, TICK, life, PATIENCE, lambda: silences.append(time.ns))  # type: ignore[arg-type]

    return wait, link, life, values, silences


def test_the_signal_is_found_behind_as_many_strays_as_are_allowed() -> None:
    wait, link, life, values, _ = waiting(iter([(0, JUNK)] * MAX_STRAY_FRAMES + [(0, HONEST)]))
    assert wait()
    assert values[0] == 0.5
    assert link.reads == MAX_STRAY_FRAMES + 1
    assert not life.stopping


def test_a_life_is_looked_after_at_every_signal_however_busy_the_loop_is() -> None:
    wait, _, life, _, _ = waiting((MS, HONEST) for _ in range(3))
    assert [wait(), wait(), wait()] == [True] * 3
    begin = Time().ns
    assert life.glances == [begin, begin + MS, begin + 2 * MS]
    assert life.looked == []


def test_one_stray_more_is_a_failure_that_names_the_peer() -> None:
    wait, link, life, values, _ = waiting(iter([(0, JUNK), (0, STALE)] * MAX_STRAY_FRAMES + [(0, HONEST)]))
    assert not wait()
    assert values[0] == 0.0
    assert link.reads == MAX_STRAY_FRAMES + 1
    assert life.stopping
    assert life.failure == (
        "cx: dx sent 513 stray frames while its signal of tick 3 was awaited (in all: malformed 257, old_tick 256); "
        "expected at most 512; see what runs as dx"
    )


def test_strays_are_counted_for_one_wait_alone() -> None:
    wait, _, life, _, _ = waiting(iter(([(0, JUNK)] * MAX_STRAY_FRAMES + [(0, HONEST)]) * 3))
    assert [wait(), wait(), wait()] == [True] * 3
    assert not life.stopping


@pytest.mark.parametrize("stray", [JUNK, STALE, encode(Tool(TICK, 0, np.array([0.5])))])
@pytest.mark.parametrize("apart", [MS // 2, 3 * MS, 5 * MS - 1])
def test_a_trickle_of_strays_is_no_sign_of_life(stray: bytes, apart: int) -> None:
    """Frames just fast enough that receiving never times out: the node is looked after as if nothing had come."""
    wait, _, life, _, silences = waiting(zip(repeat(apart), repeat(stray), strict=False), looks=4)
    assert not wait()
    begin = Time().ns
    assert life.looked == silences
    gaps = np.diff([begin, *life.looked])
    assert np.all(gaps >= PATIENCE)
    assert np.all(gaps < PATIENCE + apart)
    assert life.failure == ""


def test_the_first_patience_counts_from_the_beginning() -> None:
    """One stray after 4 of 5 ms, and then nothing: silence after 5, not after 9."""
    wait, _, _, _, silences = waiting(iter([(4 * MS, JUNK)]), looks=2)
    assert not wait()
    assert silences == [Time().ns + 5 * MS, Time().ns + 10 * MS]


def test_a_stream_that_never_ends_is_read_for_a_bounded_time() -> None:
    wait, link, life, _, _ = waiting((10_000, b"\xc1%d" % n) for n in count())
    assert not wait()
    assert link.reads == MAX_STRAY_FRAMES + 1
    assert "malformed 513" in life.failure
