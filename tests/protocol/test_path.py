"""The pure part of a datagram path: what opens, what is refused and why, and what carries the waves."""

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from hypothesis import given
from hypothesis import strategies as st

from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_COUNT, MAX_DATAGRAM_BYTES
from manyhands.protocol.messages import PathKey, Wave
from manyhands.protocol.path import (
    CARRIERS,
    KEEP_ALIVE,
    MOST_PORTS,
    NO_TOKEN,
    OVERHEAD,
    PROBE,
    SILENCE,
    TRANSITIONS,
    Address,
    Direction,
    NotOpened,
    PathEnd,
    PathEvent,
    PathState,
    Replies,
    connection_of,
)

MS = 1_000_000
START = Instant(5 * 10**9)
KEY = PathKey(bytes(range(8)), bytes(range(32)), 7400)


def after(ms: float) -> Instant:
    return Instant(START + round(ms * MS))


def frame_of(tick: int, ports: int = 1) -> bytes:
    return encode(Wave(tick, (0.5,) * ports, 0.25))


def ends(key: PathKey = KEY) -> tuple[PathEnd, PathEnd]:
    """The coupling's and the environment's."""
    return PathEnd(key, Direction.TO_ENVIRONMENT, START), PathEnd(key, Direction.TO_COUPLING, START)


def sealed(end: PathEnd, tick: int, now: Instant = START) -> bytes:
    """The datagram with the wave of ``tick``, which is due."""
    datagram, _ = end.outgoing(tick, frame_of(tick), now)
    assert datagram is not None
    return datagram


def counted(end: PathEnd) -> dict[NotOpened, int]:
    return {reason: count for reason, count in end.refused.items() if count}


# --- the seal


def test_a_datagram_opens_once_at_the_other_end_alone() -> None:
    coupling, environment = ends()
    datagram = sealed(coupling, 7)
    assert len(datagram) == len(frame_of(7)) + OVERHEAD
    assert connection_of(datagram) == KEY.connection
    assert environment.opens(datagram, START) == frame_of(7)
    assert environment.opens(datagram, START) is None
    assert coupling.opens(datagram, START) is None  # reflected
    assert counted(environment) == {NotOpened.REPLAYED: 1}
    assert counted(coupling) == {NotOpened.FORGED: 1}
    assert (coupling.opened, environment.opened) == (0, 1)


def test_the_seal_is_that_of_rfc_8439() -> None:
    """Nonce and additional data as SPEC.md has them, by hand."""
    coupling, environment = ends()
    header = b"\x00" + KEY.connection + (258).to_bytes(8, "big") + NO_TOKEN
    seal = ChaCha20Poly1305(KEY.secret)
    assert sealed(coupling, 258) == header + seal.encrypt(bytes(4) + (258).to_bytes(8, "big"), frame_of(258), header)
    back = b"\x01" + header[1:]
    answer = back + seal.encrypt(bytes(3) + b"\x01" + (258).to_bytes(8, "big"), frame_of(258), back)
    assert coupling.opens(answer, START) == frame_of(258)
    assert coupling.state(START) is PathState.UP
    assert environment.opened == 0


def test_every_byte_counts() -> None:
    coupling, _ = ends()
    datagram = sealed(coupling, 7)
    for place in range(len(datagram)):
        for bit in (1, 0x80):
            _, environment = ends()
            changed = datagram[:place] + bytes([datagram[place] ^ bit]) + datagram[place + 1 :]
            assert environment.opens(changed, START) is None
            (reason,) = counted(environment)
            expected = {NotOpened.FORGED}
            if place == 0:
                expected = {NotOpened.NO_DATAGRAM, NotOpened.FORGED}
            elif place < 9:
                expected = {NotOpened.UNKNOWN_PATH}
            elif place == 9 and bit == 0x80:
                expected = {NotOpened.NO_DATAGRAM}
            assert reason in expected
            assert environment.opens(datagram, START) is not None  # a forged n has not moved the window


def test_every_truncation_and_every_longer_one_is_refused() -> None:
    coupling, environment = ends()
    datagram = sealed(coupling, 7)
    for length in range(len(datagram)):
        assert environment.opens(datagram[:length], START) is None
    for tail in (b"\x00", datagram, bytes(MAX_DATAGRAM_BYTES)):
        assert environment.opens(datagram + tail, START) is None
    assert set(counted(environment)) == {NotOpened.NO_DATAGRAM, NotOpened.FORGED}
    assert environment.opens(datagram, START) is not None


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (replace(KEY, secret=bytes(32)), NotOpened.FORGED),  # a user that took the connection of a different one
        (replace(KEY, connection=bytes(8)), NotOpened.UNKNOWN_PATH),
        (PathKey(bytes(8), bytes(32), 7400), NotOpened.UNKNOWN_PATH),  # an earlier life
    ],
)
def test_a_datagram_of_any_other_key_is_refused(other: PathKey, reason: NotOpened) -> None:
    _, environment = ends()
    rogue, _ = ends(other)
    assert environment.opens(sealed(rogue, 1), START) is None
    assert counted(environment) == {reason: 1}
    assert environment.state(START) is PathState.DOWN


def test_no_tick_is_sealed_twice() -> None:
    coupling, _ = ends()
    sealed(coupling, 7)
    for tick in (7, 6, 0, -1):
        with pytest.raises(ValueError, match=rf"found the tick {tick}; expected 8 to"):
            coupling.outgoing(tick, frame_of(7), after(1000))
    with pytest.raises(ValueError, match="found the tick 9223372036854775808"):
        coupling.outgoing(MAX_COUNT + 1, frame_of(7), after(1000))


def test_an_exhausted_n_ends_the_path_and_never_wraps() -> None:
    coupling, environment = ends()
    datagram = sealed(coupling, MAX_COUNT)
    assert environment.opens(datagram, START) == frame_of(MAX_COUNT)
    with pytest.raises(ValueError, match="found the tick 0"):
        coupling.outgoing(0, frame_of(0), after(1000))
    other, _ = ends()
    assert environment.opens(sealed(other, 0), START) is None
    assert counted(environment) == {NotOpened.REPLAYED: 1}


def test_the_widest_link_fits_and_a_wider_one_is_refused() -> None:
    def pressed(k: int, ports: int) -> bytes:
        return encode(Wave(k, (0.5,) * ports, 0.0, buttons=1))

    coupling, environment = ends()
    datagram, _ = coupling.outgoing(0, pressed(0, MOST_PORTS), START)
    assert datagram is not None
    assert MAX_DATAGRAM_BYTES - 8 < len(datagram) <= MAX_DATAGRAM_BYTES
    assert environment.opens(datagram, START) == pressed(0, MOST_PORTS)
    with pytest.raises(ValueError, match="found a frame of 1164 bytes; expected at most 1159"):
        coupling.outgoing(1, pressed(1, MOST_PORTS + 1), after(1000))


@given(st.lists(st.binary(max_size=90), max_size=20), st.randoms(use_true_random=False))
def test_whatever_else_comes_the_honest_datagrams_open_once_in_rising_order(
    noise: list[bytes], chance: random.Random
) -> None:
    coupling, environment = ends()
    honest = [sealed(coupling, k, after(k * 200)) for k in range(6)]
    arrivals = [*honest, *honest, *noise, *[h[: chance.randrange(len(h))] for h in honest]]
    chance.shuffle(arrivals)
    opened = [frame for datagram in arrivals if (frame := environment.opens(datagram, START)) is not None]
    ticks = [honest.index(d) for d in arrivals if d in honest]
    expected = [t for i, t in enumerate(ticks) if t > max(ticks[:i], default=-1)]
    assert opened == [frame_of(tick) for tick in expected]
    assert environment.opened + sum(environment.refused.values()) == len(arrivals)


# --- the state


def test_every_event_in_every_state_has_a_successor_and_a_carrier() -> None:
    assert set(TRANSITIONS) == {(state, event) for state in PathState for event in PathEvent}
    assert set(CARRIERS) == set(PathState)
    assert all(carriers.link or carriers.datagrams for carriers in CARRIERS.values()), "a wave would get lost"
    assert {state for (_, event), state in TRANSITIONS.items() if event is PathEvent.SILENCE} == {PathState.DOWN}


Pass = Callable[[int], bool]


def converse(
    both: tuple[PathEnd, PathEnd], first: int, count: int, up: Pass = lambda _: True, down: Pass = lambda _: True
) -> list[tuple[bool, bool]]:
    """A wave each way in every ms; which datagrams pass is for ``up`` and ``down``. Returns what went over the link."""
    coupling, environment = both
    over = []
    for k in range(first, first + count):
        now = after(k)
        sent = coupling.outgoing(k, frame_of(k), now)
        if sent.datagram is not None and up(k):
            assert environment.opens(sent.datagram, now) == frame_of(k)
        answered = environment.outgoing(k, frame_of(k), now)
        if answered.datagram is not None and down(k):
            assert coupling.opens(answered.datagram, now) == frame_of(k)
        over.append((sent.link, answered.link))
    return over


def test_a_path_opens_within_two_exchanges_and_then_carries_everything() -> None:
    both = ends()
    over = converse(both, 0, 500)
    assert [end.state(after(499)) for end in both] == [PathState.UP] * 2
    used = [k for k, (up, down) in enumerate(over) if up or down]
    assert used == [0], "the link carries the first waves only"
    assert [end.changes for end in both] == [1, 2]


@pytest.mark.parametrize("way", ["up", "down", "both"])
def test_a_path_that_breaks_falls_back_in_time_and_comes_back(way: str) -> None:
    both = ends()
    converse(both, 0, 300)
    broken = {name: (lambda _: False) for name in (("up", "down") if way == "both" else (way,))}
    over = converse(both, 300, 1500, **broken)
    silent = [k for k, links in enumerate(over) if not all(links)]
    assert silent == list(range(silent[-1] + 1)), "no way back while it is broken"
    assert SILENCE / MS - 2 <= silent[-1] + 1 <= 2 * SILENCE / MS + 2
    assert PathState.UP not in {end.state(after(1799)) for end in both}
    over = converse(both, 1800, 500)
    assert [end.state(after(2299)) for end in both] == [PathState.UP] * 2
    assert not any(any(links) for links in over[250:])


def test_nothing_is_sent_where_nothing_was_heard() -> None:
    """An environment has no address before, and its coupling may have lost the one that it had."""
    _, environment = ends()
    for k in range(2000):
        assert environment.outgoing(k, frame_of(k), after(k)) == (None, True)
        assert environment.repeated(after(k)) is None


def test_a_path_that_is_down_is_probed_at_its_rate() -> None:
    coupling, _ = ends()
    times = [k for k in range(2000) if coupling.outgoing(k, frame_of(k), after(k)).datagram is not None]
    assert times[0] == 0
    assert {later - earlier for earlier, later in pairwise(times)} == {PROBE // MS}


def test_a_quiet_coupling_keeps_its_address_alive_by_copies() -> None:
    coupling, environment = ends()
    assert coupling.repeated(START) is None
    datagram = sealed(coupling, 3)
    assert environment.opens(datagram, START) == frame_of(3)
    late = Instant(START + KEEP_ALIVE)
    assert coupling.repeated(Instant(late - 1)) is None
    assert coupling.repeated(late) == datagram
    assert coupling.repeated(Instant(late + KEEP_ALIVE - 1)) is None
    assert coupling.repeated(Instant(late + KEEP_ALIVE)) == datagram
    assert environment.opens(datagram, late) is None
    assert environment.state(late) is PathState.DOWN, "a copy proves nothing"


def test_half_of_the_datagrams_is_enough_to_stay_up() -> None:
    both = ends()
    chance = random.Random(3)
    converse(both, 0, 300)
    over = converse(both, 300, 10_000, up=lambda _: chance.random() < 0.5, down=lambda _: chance.random() < 0.5)
    assert not any(any(links) for links in over)


HERE, THERE, ELSEWHERE = ("192.0.2.1", 7), ("192.0.2.2", 7), ("192.0.2.3", 7)


def replies() -> Replies:
    """Tokens 1, 2, ...: none of them NO_TOKEN."""
    made = iter(range(1, 1000))
    return Replies(lambda length: next(made).to_bytes(length, "big"))


def test_an_address_gets_no_more_than_came_from_it_until_it_has_proved_itself() -> None:
    known = replies()
    assert (known.departs(90), known.certain) == (None, False)
    known.arrived(HERE, 100, NO_TOKEN)
    assert known.departs(60) == HERE
    assert (known.departs(60), known.certain) == (None, False)
    known.arrived(HERE, 20, known.token)
    assert known.certain
    assert [known.departs(1200) for _ in range(100)] == [HERE] * 100


def test_a_token_proves_the_address_that_it_was_sent_to_and_no_other() -> None:
    known = replies()
    known.arrived(HERE, 100, NO_TOKEN)
    first = known.token
    known.arrived(HERE, 100, first)
    known.arrived(THERE, 100, first)  # the proof of another address
    assert (known.address, known.certain, known.proved) == (THERE, False, HERE)
    second = known.token
    known.arrived(ELSEWHERE, 100, second)
    assert not known.certain
    assert len({first, second, known.token}) == 3
    known.arrived(HERE, 1, NO_TOKEN)  # the proved one again: what came between was a copy from elsewhere
    assert (known.address, known.certain, known.token) == (HERE, True, first)


@given(st.lists(st.tuples(st.sampled_from([HERE, THERE, ELSEWHERE]), st.integers(1, 1200), st.integers(1, 1200))))
def test_whoever_cannot_read_the_tokens_gets_back_at_most_what_it_sent(moves: list[tuple[Address, int, int]]) -> None:
    known, came, went = Replies(), Counter[Address](), Counter[Address]()
    for source, length, answer in moves:
        known.arrived(source, length, NO_TOKEN)
        came[source] += length
        for _ in range(3):
            if (to := known.departs(answer)) is not None:
                went[to] += answer
    assert all(went[address] <= came[address] for address in went)
