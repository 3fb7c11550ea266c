"""A wait for a signal while the peer sends other frames: how many are read, and what else is attended to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count, repeat
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.bundle import Peer
from manyhands.nodes.link.join import Received, await_all, join_of
from manyhands.nodes.link.peer_link import PeerLink, handshake_of
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import (
    PROTOCOL_VERSION,
    Absent,
    Force,
    LinkHello,
    Message,
    Ready,
    Refusal,
    RefusalCode,
    Role,
    Rung,
    Sample,
    Tool,
    Welcome,
)

TICK = 3
MS = 1_000_000
PATIENCE = Duration(5 * MS)
HONEST = encode(Sample(TICK, 0, np.array([0.5])))
STALE = encode(Sample(TICK - 1, 0, np.array([0.5])))
JUNK = b"\xc1 rubbish"

_T = TypeVar("_T")


class LinkClock:
    """A clock that a link moves on."""

    def __init__(self) -> None:
        self.ns = 1_000 * MS

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        raise AssertionError("nothing sleeps here")


class Arriving:
    """A link on which a frame arrives now and then: so many ns after the one before was read."""

    def __init__(self, time: LinkClock, frames: Iterator[tuple[int, bytes]]) -> None:
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


class Ears:
    """A listener that notes every notice."""

    def __init__(self, turns: bool = False) -> None:
        self._turns = turns
        self.failure = ""
        self.told: list[tuple[int, int]] = []
        self.words: list[object] = []

    def on_other_tick(self, _peer_link: PeerLink, other: int, awaited: int) -> bool:
        self.told.append((other, awaited))
        return self._turns

    def on_notice(self, _peer_link: PeerLink, message: object) -> bool:
        self.words.append(message)
        return self._turns

    def flooded(self, text: str) -> None:
        self.failure = text


def waiting(
    frames: Iterator[tuple[int, bytes]], turns: bool = False
) -> tuple[Callable[[], Received], Arriving, Ears, np.ndarray, LinkClock]:
    """A peer link whose peer sends ``frames``: how to wait on it, its link, its listener, the values, the time."""
    time = LinkClock()
    link, ears, values = Arriving(time, frames), Ears(turns), np.zeros(1)
    peer = Peer("dx", Role.DEVICE, ("dx",), binds=True)
    own = LinkHello(PROTOCOL_VERSION, "c", "s", "cx", Role.COUPLING, ("dx",))
    join = PeerLink(own, peer, link, Sample, slice(0, 1), time)  # type: ignore[arg-type]
    return lambda: join.hear(values, TICK, PATIENCE, ears), link, ears, values, time


def test_the_signal_is_found_behind_as_many_strays_as_are_allowed() -> None:
    wait, link, ears, values, _ = waiting(iter([(0, JUNK)] * MAX_STRAY_FRAMES + [(0, HONEST)]))
    assert wait() is Received.SIGNAL
    assert values[0] == 0.5
    assert link.reads == MAX_STRAY_FRAMES + 1
    assert ears.failure == ""


def test_one_stray_more_is_a_failure_that_names_the_peer() -> None:
    wait, link, ears, values, _ = waiting(iter([(0, JUNK), (0, STALE)] * MAX_STRAY_FRAMES + [(0, HONEST)]))
    assert wait() is Received.NOTHING
    assert values[0] == 0.0
    assert link.reads == MAX_STRAY_FRAMES + 1
    assert ears.failure == (
        "cx: dx sent 513 stray frames while its signal of tick 3 was awaited (in all: malformed 257, old_tick 256); "
        "expected at most 512. See what runs as dx"
    )


def test_strays_are_counted_for_one_wait_alone() -> None:
    wait, _, ears, _, _ = waiting(iter(([(0, JUNK)] * MAX_STRAY_FRAMES + [(0, HONEST)]) * 3))
    assert [wait(), wait(), wait()] == [Received.SIGNAL] * 3
    assert ears.failure == ""


@pytest.mark.parametrize("stray", [JUNK, STALE, encode(Tool(TICK, 0, np.array([0.5])))])
@pytest.mark.parametrize("apart", [MS // 2, 3 * MS, 5 * MS - 1])
def test_a_trickle_of_strays_is_no_sign_of_life(stray: bytes, apart: int) -> None:
    """Frames just fast enough that receiving never times out: the wait ends as if nothing had come."""
    wait, _, ears, _, time = waiting(zip(repeat(apart), repeat(stray), strict=False))
    for _ in range(4):
        begin = time.ns
        assert wait() is Received.NOTHING
        assert PATIENCE <= time.ns - begin <= PATIENCE + apart
    assert ears.failure == ""


def test_the_timeout_counts_from_the_beginning() -> None:
    """One stray after 4 of 5 ms, and then nothing: silence a timeout after the stray at the latest."""
    wait, _, _, _, time = waiting(iter([(4 * MS, JUNK)]))
    assert wait() is Received.NOTHING
    assert time.ns <= LinkClock().ns + 9 * MS


def test_a_stream_that_never_ends_is_read_for_a_bounded_time() -> None:
    wait, link, ears, _, _ = waiting((10_000, b"\xc1%d" % n) for n in count())
    assert wait() is Received.NOTHING
    assert link.reads <= MAX_STRAY_FRAMES + 1
    assert ears.failure == "" or "malformed 513" in ears.failure


def test_a_proper_signal_of_another_tick_reaches_the_listener() -> None:
    frames = [encode(Sample(TICK - 1, 0, np.array([0.5]))), encode(Sample(TICK + 4, 0, np.array([0.0]))), HONEST]
    wait, _, ears, values, _ = waiting(iter([(0, frame) for frame in frames]))
    assert wait() is Received.SIGNAL
    assert ears.told == [(TICK - 1, TICK), (TICK + 4, TICK)]
    assert values[0] == 0.5


@pytest.mark.parametrize("frame", [STALE, encode(Rung(1)), encode(Absent("dx"))])
def test_a_listener_may_end_the_wait(frame: bytes) -> None:
    wait, link, ears, _, _ = waiting(iter([(0, frame), (0, HONEST)]), turns=True)
    assert wait() is Received.DECLINED
    assert link.reads == 1
    assert (ears.told, ears.words) in (([(TICK - 1, TICK)], []), ([], [Rung(1)]), ([], [Absent("dx")]))
    assert wait() is Received.SIGNAL


@pytest.mark.parametrize("junk", [b"\x92\x0f\x10", b"\x92\x0b\xc0", encode(Tool(TICK, 0, np.array([0.5]))), JUNK])
def test_what_only_looks_like_a_word_is_a_stray(junk: bytes) -> None:
    wait, _, ears, _, _ = waiting(iter([(0, junk), (0, HONEST)]), turns=True)
    assert wait() is Received.SIGNAL
    assert not ears.words
    assert not ears.told


class FrameLink:
    """A link whose other end a test holds: frames to come, and frames sent."""

    def __init__(self, *coming: bytes, room: int = 10**6) -> None:
        self.coming, self.room = deque(coming), room
        self.said: list[bytes] = []
        self.closed = False

    def recv(self, _timeout: Duration | None) -> bytes | None:
        return self.coming.popleft() if self.coming else None

    def send(self, frame: bytes) -> bool:
        if self.room == 0:
            return False
        self.room -= 1
        self.said.append(frame)
        return True

    def close(self) -> None:
        self.closed = True


DEVICE = Peer("dx", Role.DEVICE, ("dx",), binds=True)
OWN = LinkHello(PROTOCOL_VERSION, "c", "s", "cx", Role.COUPLING, ("dx",))
HIS = LinkHello(PROTOCOL_VERSION, "c", "s", "dx", Role.DEVICE, ("dx",))


def joined(link: FrameLink | None, binds: bool = True) -> PeerLink:
    return PeerLink(OWN, replace(DEVICE, binds=binds), link, Sample, slice(0, 1), LinkClock())  # type: ignore[arg-type]


def heard_by(join: PeerLink, ears: Ears, values: np.ndarray, tick: int = TICK) -> Received:
    return join.hear(values, tick, Duration(0), ears)


class Test_a_peer_that_comes_back:
    @pytest.mark.parametrize("binds", [True, False])
    def test_reconnects_and_is_then_received(self, binds: bool) -> None:
        join, ears, values = joined(FrameLink(HONEST), binds), Ears(), np.zeros(1)
        assert heard_by(join, ears, values) is Received.SIGNAL
        join.lose()
        answer = [encode(HIS), encode(Welcome())] if binds else [encode(HIS)]
        fresh = FrameLink(*answer, encode(Sample(9, 0, np.array([0.25]))))
        join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
        assert (join.reachable, join.here, join.new) == (True, False, False)
        assert heard_by(join, ears, values, 9) is Received.RECONNECTED
        assert (join.reachable, join.here, join.new) == (True, True, True)
        assert join.hello == HIS
        said = [decode(frame, MAX_CONTROL_BYTES) for frame in fresh.said]
        assert said == ([OWN] if binds else [OWN, Welcome()])
        assert heard_by(join, ears, values, 9) is Received.SIGNAL
        assert (values[0], join.tick) == (0.25, 9)

    def test_receives_nothing_before_its_handshake(self) -> None:
        join = joined(FrameLink())
        join.send(Sample, TICK, 0, np.zeros(1))
        fresh = FrameLink()
        join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
        assert not join.send(Sample, TICK, 0, np.zeros(1))
        join.send_again()
        join.send_zero(Force, TICK)
        join.notify(Rung(1))
        assert fresh.said == []

    def test_is_not_answered_for_the_one_before(self) -> None:
        """The last signal on the old link is not repeated on the new one."""
        join = joined(FrameLink())
        join.send(Sample, TICK, 0, np.zeros(1))
        fresh = FrameLink(encode(HIS), encode(Welcome()))
        join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
        assert heard_by(join, Ears(), np.zeros(1)) is Received.RECONNECTED
        before = list(fresh.said)
        join.send_again()
        assert fresh.said == before

    def test_is_another_for_the_gate_which_goes_on_counting(self) -> None:
        join, ears = joined(FrameLink(JUNK, STALE)), Ears()
        heard_by(join, ears, np.zeros(1))
        join.greet(FrameLink(encode(HIS), encode(Welcome())), handshake_of(join))  # type: ignore[arg-type]
        gate = join.gate
        assert heard_by(join, ears, np.zeros(1)) is Received.RECONNECTED
        assert join.gate is not gate  # a step from the last signal of the one before would be no step
        assert (join.gate.dropped["malformed"], join.gate.dropped["old_tick"]) == (1, 1)

    @pytest.mark.parametrize(
        "wrong",
        [HIS, Ready(), Welcome(), Sample(TICK, 0, np.zeros(1)), Refusal(RefusalCode.NAME, "no"), None],
        ids=["another certificate", "ready", "welcome first", "signal", "refusal", "junk"],
    )
    def test_is_absent_if_it_is_not_the_one(self, wrong: Message | None) -> None:
        wrong = replace(HIS, certificate="other") if wrong is HIS else wrong
        join, fresh = joined(FrameLink()), FrameLink(JUNK if wrong is None else encode(wrong), HONEST)
        join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
        assert heard_by(join, Ears(), np.zeros(1)) is Received.NOTHING
        assert not join.reachable
        assert fresh.closed
        refused = [isinstance(decode(frame, MAX_CONTROL_BYTES), Refusal) for frame in fresh.said]
        assert any(refused) == (not isinstance(wrong, Refusal))

    def test_is_absent_if_it_goes_in_the_middle_of_it(self) -> None:
        join, fresh = joined(FrameLink()), FrameLink(encode(HIS), room=0)
        join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
        assert heard_by(join, Ears(), np.zeros(1)) is Received.NOTHING
        assert not join.reachable

    def test_closes_the_waiting_link_if_the_peer_is_lost_again(self) -> None:
        join, first, second = joined(FrameLink()), FrameLink(), FrameLink()
        join.greet(first, handshake_of(join))  # type: ignore[arg-type]
        join.greet(second, handshake_of(join))  # type: ignore[arg-type]
        assert (first.closed, second.closed) == (True, False)


def test_a_lost_peer_is_nobody_to_hear_or_to_tell() -> None:
    link = FrameLink(HONEST)
    join = joined(link)
    join.lose()
    join.lose()
    assert link.closed
    assert (join.reachable, join.here) == (False, False)
    assert heard_by(join, Ears(), np.zeros(1)) is Received.NOTHING
    assert not join.send(Sample, TICK, 0, np.zeros(1))
    join.send_again()
    join.send_zero(Force, TICK)
    join.notify(Absent("dx"))


def test_the_last_signal_is_sent_again_unchanged() -> None:
    link = FrameLink()
    join = joined(link)
    join.send_again()  # no signal was sent yet
    join.send(Sample, TICK, 7, np.array([0.5]))
    join.notify(Rung(1))
    join.send_zero(Force, TICK + 3)
    join.send_again()
    assert [decode(frame, MAX_CONTROL_BYTES) for frame in (link.said[0], link.said[3])] == [Sample(TICK, 7, [0.5])] * 2


def test_a_zero_force_carries_the_finished_tick_and_no_stamp() -> None:
    link = FrameLink()
    join = joined(link)
    join.send_zero(Force, -1)  # before the first tick nothing is over
    join.send_zero(Force, 4)
    assert [decode(frame, MAX_CONTROL_BYTES) for frame in link.said] == [Force(4, 0, [0.0])]


@pytest.mark.parametrize(("values", "zero"), [([0.0], True), ([-0.0], True), ([5e-324], False)])
def test_whether_a_signal_of_another_tick_is_a_zero_force(values: list[float], zero: bool) -> None:
    join = joined(FrameLink(encode(Sample(TICK + 2, 0, np.array(values)))))
    heard_by(join, Ears(), np.zeros(1))
    assert (join.other_tick, join.other_zero) == (TICK + 2, zero)


def test_a_peer_behind_may_say_the_same_again_and_again() -> None:
    """Tick by tick this is no flood; junk of one tick adds up over several waits, until the tick is there."""
    join, ears = joined(FrameLink(*[STALE] * (3 * MAX_STRAY_FRAMES))), Ears()
    heard_by(join, ears, np.zeros(1))
    assert "sent 513 stray frames" in ears.failure  # in one wait it does
    link, ears = FrameLink(), Ears()
    join = joined(link)
    for _ in range(3):
        link.coming.extend([STALE] * MAX_STRAY_FRAMES)
        assert heard_by(join, ears, np.zeros(1)) is Received.NOTHING
    assert ears.failure == ""
    for _ in range(2):
        link.coming.extend([JUNK] * (MAX_STRAY_FRAMES // 2 + 1))
        heard_by(join, ears, np.zeros(1))
    assert "sent 513 stray frames" in ears.failure


def test_peer_links_are_found_by_their_peers() -> None:
    join = joined(None)
    assert join_of([join], "dx") is join
    assert join_of([join], "dz") is None


frames = st.one_of(
    st.binary(max_size=40),
    st.sampled_from(
        [HONEST, STALE, JUNK, b"", encode(HIS), encode(Welcome()), encode(Rung(3)), encode(Absent("dx"))]
        + [encode(Sample(TICK + 1, 0, np.array([value]))) for value in (0.0, 1.0)]
        + [encode(Tool(TICK, 0, np.zeros(1))), encode(Refusal(RefusalCode.ROLE, "no"))]
    ),
    st.integers(0, 7).map(lambda n: encode(HIS)[: 3 * n]),
)


@given(coming=st.lists(frames, max_size=20), turns=st.booleans(), greets=st.booleans())
def test_no_frame_raises_and_only_the_ticks_signal_is_admitted(coming: list[bytes], turns: bool, greets: bool) -> None:
    join, ears, values = joined(FrameLink()), Ears(turns), np.array([7.0])
    link = FrameLink(*coming)
    if greets:
        join.greet(link, handshake_of(join))  # type: ignore[arg-type]
    else:
        join.link = link  # type: ignore[assignment]
    while link.coming and join.reachable:
        before, left = values.copy(), len(link.coming)
        shaking = join.handshake is not None
        heard = heard_by(join, ears, values)
        assert len(link.coming) < left
        if heard is Received.SIGNAL:
            assert (values[0], join.tick) == (0.5, TICK)
        else:
            assert values[0] == before[0]
        assert heard is not Received.RECONNECTED or (shaking and join.hello == HIS)
        assert heard is not Received.SIGNAL or not shaking
    assert all(count >= 0 for count in join.gate.dropped.values())


@pytest.mark.parametrize("indices", [slice(1, 3), np.array([2, 0])], ids=["a slice", "scattered"])
def test_a_links_ports_are_where_they_belong_among_the_nodes(indices: slice | np.ndarray) -> None:
    time = LinkClock()
    own = LinkHello(PROTOCOL_VERSION, "c", "s", "cx", Role.COUPLING, ("a", "b"))
    link = Arriving(time, iter([(0, encode(Sample(TICK, 7, np.array([0.5, -1.0]))))]))
    sent: list[bytes] = []
    link.send = lambda frame: sent.append(frame) or True  # type: ignore[method-assign, func-returns-value]
    join = PeerLink(own, Peer("d", Role.DEVICE, ("a", "b"), binds=True), link, Sample, indices, time)  # type: ignore[arg-type]
    values, expected = [10.0, 11.0, 12.0, 13.0], np.array([10.0, 11.0, 12.0, 13.0])
    expected[indices] = [0.5, -1.0]
    assert join.hear(values, TICK, PATIENCE, Ears()) is Received.SIGNAL
    assert values == expected.tolist()
    forces = [20.0, 21.0, 22.0, 23.0]
    assert join.send(Force, TICK, 7, forces)
    assert sent == [encode(Force(TICK, 7, np.array(forces)[indices]))]


class ScriptedPeerLink:
    """A link of which it is written what comes of it, one thing each time that it is listened to."""

    def __init__(self, name: str, script: list[Received], listened: list[str]) -> None:
        self.name, self._script, self._listened = name, script, listened
        self.tick = -1

    def hear(self, _values: object, tick: int, _timeouts: Duration, _listener: object) -> Received:
        self._listened.append(self.name)
        heard = self._script.pop(0)
        if heard is Received.SIGNAL:
            self.tick = tick
        return heard


def awaited(
    scripts: dict[str, list[Received]], rounds: int, moved: Callable[[Received, int], int] = lambda _heard, tick: tick
) -> tuple[int | None, str]:
    """The result of :func:`await_all` after b was read last, with so many rounds allowed; and the links read."""
    listened: list[str] = []
    links: Any = [ScriptedPeerLink(name, script, listened) for name, script in scripts.items()]
    left = iter([Duration(1)] * rounds)
    found = await_all(
        links, links[1], [], 7, Ears(), lambda _link, heard, tick: moved(heard, tick), lambda _tick: next(left, None)
    )
    return found, "".join(listened)


def test_all_are_awaited_in_turn_behind_the_last() -> None:
    script = {
        "a": [Received.SIGNAL],
        "b": [Received.RECONNECTED, Received.SIGNAL],
        "c": [Received.NOTHING, Received.SIGNAL],
    }
    assert awaited(script, 9) == (7, "cabcb")


def test_the_wait_ends_when_no_round_is_left() -> None:
    assert awaited({"a": [Received.SIGNAL], "b": [Received.NOTHING], "c": [Received.SIGNAL]}, 1) == (None, "cab")


def test_at_another_tick_all_are_awaited_anew() -> None:
    script = {
        "a": [Received.DECLINED, Received.SIGNAL],
        "b": [Received.SIGNAL],
        "c": [Received.SIGNAL, Received.SIGNAL],
    }
    moved = awaited(script, 9, lambda heard, tick: tick + (heard is Received.DECLINED))
    assert moved == (8, "cabca")
