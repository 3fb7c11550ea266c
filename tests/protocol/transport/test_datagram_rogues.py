"""Rogues before a UDP port and on the wire: every attack is refused and counted, none is answered, and moves nothing.

Two users share the environment's port. One of them, or somebody on its wire, attacks; the other one's waves are those
of a run without attacks.
"""

from __future__ import annotations

import logging
import random
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace

import pytest

from manyhands.protocol.clock import Instant, SimulatedClock
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_COUNT
from manyhands.protocol.messages import PathKey, Wave
from manyhands.protocol.path import OVERHEAD, SILENCE, Direction, NotOpened, PathEnd, PathState
from manyhands.protocol.transport.datagrams import DatagramPath, DatagramSocket, filter_of
from tests.support.datagram_relay import Relay, passed
from tests.support.memory_transport import MemoryTransport

MS = 1_000_000
TICKS = 200


@dataclass
class User:
    """A user's two ends, what stands between them, and the waves that either end took in."""

    environment: DatagramPath
    coupling: DatagramPath
    client: DatagramSocket
    relay: Relay
    heard: tuple[list[Wave], list[Wave]]


@dataclass
class Stage:
    """An environment with two users on one port, and somebody with a socket."""

    clock: SimulatedClock
    server: DatagramSocket
    victim: User
    other: User
    stranger: socket.socket

    def tick(self, tick: int) -> None:
        """A wave each way of both users; 1 ms."""
        users = (self.victim, self.other)
        for number, user in enumerate(users):
            user.coupling.send(Wave(tick, (tick + 0.25 * number,), float(tick)))
            user.relay.pump()
        self.server.read()
        for user in users:
            if (wave := user.environment.receive()) is not None:
                user.heard[0].append(wave)
            user.environment.send(Wave(tick, (-tick + 0.5,), 0.0))
            user.relay.pump()
            if (wave := user.coupling.receive()) is not None:
                user.heard[1].append(wave)
        self.clock.sleep_until(Instant(self.clock.now() + MS))

    def run(self, first: int = 0, count: int = TICKS, attack: Callable[[int], None] = lambda _: None) -> None:
        """So many ticks, with an attack before each."""
        for tick in range(first, first + count):
            attack(tick)
            self.tick(tick)

    def strike(self, datagram: bytes) -> None:
        """A datagram of the stranger to the environment."""
        self.stranger.sendto(datagram, ("127.0.0.1", self.server.port))

    def answers(self) -> int:
        """Datagrams that the stranger has received."""
        count = 0
        while select.select([self.stranger], [], [], 0)[0]:
            self.stranger.recv(65536)
            count += 1
        return count


def built(stack: ExitStack) -> Stage:
    clock, transport = SimulatedClock(), MemoryTransport()
    stack.callback(transport.close)
    server = DatagramSocket.bound("127.0.0.1", 0, clock)
    stack.callback(server.close)
    users = []
    for name in ("victim", "other"):
        bound, endpoint = transport.bind(name, name)
        link = transport.connect(endpoint, "environment")
        environment = server.offer(bound, 1)
        client, relay = DatagramSocket.unbound(clock), Relay(server.port)
        stack.callback(client.close)
        stack.callback(relay.close)
        coupling = client.take_up(replace(environment.key, port=relay.port), "127.0.0.1", link, 1)
        users.append(User(environment, coupling, client, relay, ([], [])))
    stranger = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    stranger.bind(("127.0.0.1", 0))
    return Stage(clock, server, *users, stranger)


@pytest.fixture
def stage() -> Iterator[Stage]:
    with ExitStack() as stack:
        yield built(stack)


@pytest.fixture
def quiet() -> Stage:
    """The same without attacks, after it has run."""
    with ExitStack() as stack:
        one = built(stack)
        one.run()
        return one


def require_unmoved(stage: Stage, quiet: Stage, *, both: bool = True) -> None:
    """The waves are those of a quiet run, and nobody was answered."""
    assert stage.other.heard == quiet.other.heard
    assert not any(stage.other.environment.end.refused.values())
    if both:
        assert stage.victim.heard == quiet.victim.heard
        assert stage.victim.environment.address == stage.victim.relay.address
    assert stage.answers() == 0


def refused_at(one: DatagramSocket, path: DatagramPath) -> dict[NotOpened, int]:
    """What a socket and one of its paths have refused together."""
    return {why: count for why in NotOpened if (count := one.refused.get(why, 0) + path.end.refused[why])}


def counted(path: DatagramPath) -> dict[NotOpened, int]:
    return {reason: count for reason, count in path.end.refused.items() if count}


def test_without_attacks_every_wave_arrives(quiet: Stage) -> None:
    for user in (quiet.victim, quiet.other):
        assert [wave.tick for wave in user.heard[0]] == list(range(TICKS))
        assert not counted(user.environment)
        assert not counted(user.coupling)


def forger(key: PathKey, sends: Direction = Direction.TO_ENVIRONMENT) -> Callable[[int], bytes]:
    """Seals whatever wave, with a key that may be wrong."""

    def forged(tick: int) -> bytes:
        datagram, _ = PathEnd(key, sends, Instant(0)).outgoing(tick, encode(Wave(tick, (1e6,), 1e6)), Instant(0))
        if datagram is None:  # an environment's end does not begin: as if it had heard one
            end = PathEnd(key, sends, Instant(0))
            hello, _ = PathEnd(key, Direction(1 - sends), Instant(0)).outgoing(0, bytes(40), Instant(0))
            assert hello is not None
            end.opens(hello, Instant(0))
            datagram, _ = end.outgoing(tick, encode(Wave(tick, (1e6,), 1e6)), Instant(0))
        assert datagram is not None
        return datagram

    return forged


FORGERIES: dict[str, tuple[Callable[[Stage, int, Direction], bytes], NotOpened]] = {
    "another key for the victim's connection": (
        lambda stage, tick, _: forger(replace(stage.victim.environment.key, secret=bytes(32)))(tick + 5),
        NotOpened.FORGED,
    ),
    "the other user's key for the victim's connection": (
        lambda stage, tick, _: forger(replace(stage.victim.environment.key, secret=stage.other.environment.key.secret))(
            tick + 5
        ),
        NotOpened.FORGED,
    ),
    "the receiver's own direction": (
        lambda stage, tick, own: forger(stage.victim.environment.key, own)(tick + 5),
        NotOpened.FORGED,
    ),
    "its latest datagram with a greater n": (
        lambda stage, tick, _: _with_n(stage.victim.relay.seen[0][-1], tick + 5),
        NotOpened.FORGED,
    ),
    "its latest datagram with the greatest n": (
        lambda stage, tick, _: _with_n(stage.victim.relay.seen[0][-1], MAX_COUNT),
        NotOpened.FORGED,
    ),
    "the other user's latest datagram for the victim's connection": (
        lambda stage, tick, _: _with_n(
            stage.other.relay.seen[0][-1], tick + 5, connection=stage.victim.environment.key.connection
        ),
        NotOpened.FORGED,
    ),
    "a copy": (lambda stage, _tick, _: stage.victim.relay.seen[0][-1], NotOpened.REPLAYED),
    "a copy of its first": (lambda stage, _tick, _: stage.victim.relay.seen[0][0], NotOpened.REPLAYED),
    "a copy that breaks off": (
        lambda stage, tick, _: _with_n(stage.victim.relay.seen[0][-1], tick + 5)[: OVERHEAD + 1],
        NotOpened.FORGED,
    ),
    "a copy with n beyond the protocol": (
        lambda stage, _tick, _: _with_n(stage.victim.relay.seen[0][-1], MAX_COUNT + 1),
        NotOpened.NO_DATAGRAM,
    ),
    "a long one": (
        lambda stage, tick, _: _with_n(stage.victim.relay.seen[0][-1], tick) + bytes(8000),
        NotOpened.NO_DATAGRAM,
    ),
    "a short one": (lambda stage, _tick, _: stage.victim.relay.seen[0][-1][:OVERHEAD], NotOpened.NO_DATAGRAM),
}


def _with_n(datagram: bytes, tick: int, connection: bytes = b"") -> bytes:
    return datagram[:1] + (connection or datagram[1:9]) + tick.to_bytes(8, "big") + datagram[17:]


@pytest.mark.parametrize("name", FORGERIES)
def test_what_somebody_else_sends_to_the_environment(stage: Stage, quiet: Stage, name: str) -> None:
    """From an address of its own, with all that can be seen on the victim's wire."""
    forge, reason = FORGERIES[name]

    def attack(tick: int) -> None:
        if tick >= 10:
            stage.strike(forge(stage, tick, Direction.TO_COUPLING))

    stage.run(attack=attack)
    assert refused_at(stage.server, stage.victim.environment) == {reason: TICKS - 10}
    require_unmoved(stage, quiet)


@pytest.mark.parametrize("name", FORGERIES)
def test_what_somebody_else_sends_to_the_coupling(stage: Stage, quiet: Stage, name: str) -> None:
    """The same where the victim's own wire brings it, reflected at the coupling."""
    forge, reason = FORGERIES[name]

    def attack(tick: int) -> None:
        if tick >= 10:
            stage.victim.relay.insert(forge(stage, tick, Direction.TO_ENVIRONMENT))

    stage.run(attack=attack)
    assert refused_at(stage.victim.client, stage.victim.coupling) == {reason: TICKS - 10}
    require_unmoved(stage, quiet)


def test_strangers_wake_nobody_and_are_not_answered(stage: Stage, quiet: Stage) -> None:
    """Before the port, without a connection's number: the kernel drops them."""
    chance = random.Random(5)
    struck = 0

    def attack(_tick: int) -> None:
        nonlocal struck
        for datagram in (
            b"", b"\x00", bytes(100), chance.randbytes(chance.randrange(17, 1500)),
            b"\x00" + chance.randbytes(8) + bytes(56), encode(Wave(1, (1.0,), 0.0)),
        ):  # fmt: skip
            stage.strike(datagram)
            struck += 1
        assert not select.select([stage.server], [], [], 0)[0], "a stranger has woken the process"

    stage.run(attack=attack)
    require_unmoved(stage, quiet)
    assert stage.server.dropped_by_kernel() == struck
    assert not any(stage.server.refused.values())


def test_without_the_kernels_filter_strangers_are_counted(stage: Stage, quiet: Stage) -> None:
    stage.server._socket.setsockopt(socket.SOL_SOCKET, 27, 0)  # SO_DETACH_FILTER

    def attack(_tick: int) -> None:
        stage.strike(bytes(100))
        stage.strike(b"junk")

    stage.run(attack=attack)
    require_unmoved(stage, quiet)
    assert stage.server.refused == {NotOpened.NO_DATAGRAM: TICKS, NotOpened.UNKNOWN_PATH: TICKS}


def test_a_flood_is_read_in_bounded_numbers(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """By somebody who knows the victim's connection: one read takes so many and no more, whatever waits."""
    stage.run(count=20)
    forged = FORGERIES["another key for the victim's connection"][0](stage, 500, Direction.TO_COUPLING)
    for _ in range(200):
        stage.strike(forged)
    opened = stage.victim.environment.end.refused
    before = opened[NotOpened.FORGED]
    stage.server.read()
    assert opened[NotOpened.FORGED] - before == 64 + 4 * 2
    stage.server.read()
    assert opened[NotOpened.FORGED] - before == 2 * (64 + 4 * 2)


def test_nothing_is_logged_or_printed_of_a_forged_datagram(
    stage: Stage, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    caplog.set_level(logging.DEBUG)
    stage.run(
        attack=lambda tick: stage.strike(FORGERIES["a copy"][0](stage, tick, Direction.TO_COUPLING)) if tick else None
    )
    assert caplog.records == []
    assert capfd.readouterr() == ("", "")


def test_reordered_doubled_and_held_back(stage: Stage, quiet: Stage) -> None:
    """On the victim's wire: only newer waves arrive, each once, and the other user does not notice."""
    chance = random.Random(7)
    stage.run(count=20)
    for way in ("up", "down"):
        held: list[bytes] = []

        def shuffled(datagram: bytes, held: list[bytes] = held) -> list[bytes]:
            held += [datagram] * chance.choice((1, 1, 2))
            chance.shuffle(held)
            out = [held.pop() for _ in range(chance.randrange(len(held) + 1))]
            return out

        setattr(stage.victim.relay, way, shuffled)
    stage.run(first=20, count=TICKS - 20)
    for heard in stage.victim.heard:
        ticks = [wave.tick for wave in heard]
        assert ticks == sorted(set(ticks))
        assert len(ticks) > TICKS / 4
    assert stage.victim.environment.end.refused[NotOpened.REPLAYED] > 0
    assert counted(stage.victim.environment).keys() == {NotOpened.REPLAYED}
    require_unmoved(stage, quiet, both=False)


def test_somebody_on_the_wire_moves_the_address_for_a_while_at_most(stage: Stage) -> None:
    """It holds back datagrams of the victim and delivers them itself, from an address of its own."""
    stage.run(count=20)
    captured: list[bytes] = []

    def capture(datagram: bytes) -> tuple[bytes, ...]:
        captured.append(datagram)
        return ()

    stage.victim.relay.up = capture
    stage.run(first=20, count=1)
    stage.strike(captured[-1])
    stage.run(first=21, count=1000)
    # its own wave got through, and so did answers until the victim was silent for too long; none after that
    assert 1 <= stage.answers() <= SILENCE / MS + 1
    stage.victim.relay.up = passed
    stage.run(first=1021, count=500)
    assert stage.victim.environment.address == stage.victim.relay.address
    assert stage.victim.environment.state is PathState.UP
    assert stage.answers() == 0


def test_a_coupling_sends_to_its_host_alone(stage: Stage) -> None:
    """Whoever delivers the environment's datagrams, from whatever address."""
    stage.run(count=20)
    captured: list[bytes] = []

    def capture(datagram: bytes) -> tuple[bytes, ...]:
        captured.append(datagram)
        return ()

    stage.victim.relay.down = capture
    stage.run(first=20, count=1)
    stage.stranger.sendto(captured[-1], ("127.0.0.1", stage.victim.client.port))
    before = stage.victim.coupling.end.opened
    stage.run(first=21, count=100)
    assert stage.victim.coupling.end.opened == before + 1
    assert stage.answers() == 0


def test_an_answer_is_no_longer_than_what_was_asked(stage: Stage) -> None:
    """Nobody uses the environment to send more to an address than it has received from there."""
    stage.run()
    up, down = stage.victim.relay.seen
    assert {len(datagram) for datagram in up} == {len(datagram) for datagram in down}
    assert len(down) <= len(up)


def test_an_exhausted_n_is_the_end_of_its_own_path_alone(stage: Stage, quiet: Stage) -> None:
    """A member that jumps to the last n has no further one: its own link stands still, and nothing else."""
    stage.run(count=20)
    last = Wave(MAX_COUNT, (0.0,), 1e9)
    stage.victim.coupling.send(last)
    for tick in range(20, TICKS):
        with pytest.raises(ValueError, match=f"found the tick {tick}; expected"):
            stage.victim.coupling.send(Wave(tick, (1.0,), 1e9))
        stage.victim.relay.pump()
        stage.other.coupling.send(Wave(tick, (tick + 0.25,), float(tick)))
        stage.other.relay.pump()
        stage.server.read()
        assert stage.victim.environment.receive() in (None, last)
        wave = stage.other.environment.receive()
        assert wave is not None
        stage.other.heard[0].append(wave)
        stage.clock.sleep_until(Instant(stage.clock.now() + MS))
    assert stage.other.heard[0] == quiet.other.heard[0]
    assert stage.victim.environment.gate.newest == last


def test_a_former_life_opens_nothing(stage: Stage, quiet: Stage) -> None:
    """All that was recorded of the victim's former life, after it has come back with a new key."""
    recorded = ExitStack()
    with recorded:
        former = built(recorded)
        former.run()
        old = [*former.victim.relay.seen[0], *former.victim.relay.seen[1]]
    taken = stage.victim.environment.key.connection
    stage.run(attack=lambda tick: stage.strike(_with_n(old[tick], tick + 5, connection=taken)))
    assert counted(stage.victim.environment) == {NotOpened.FORGED: TICKS}
    require_unmoved(stage, quiet)


def test_the_kernels_filter_accepts_what_names_a_connection() -> None:
    """The program, run by hand: what it accepts of packets with a UDP header."""
    chance = random.Random(2)
    names = [chance.randbytes(8) for _ in range(40)]
    names.append(names[0][:4] + names[1][4:])
    program = filter_of(names)
    for name in names:
        assert accepts(program, bytes(8) + b"\x00" + name + bytes(60))
        assert not accepts(program, bytes(8) + b"\x00" + name[:7])
        assert not accepts(program, bytes(8) + b"\x00" + name[:4] + chance.randbytes(4) + bytes(60))
        assert not accepts(program, bytes(8) + name + bytes(61))
    assert not accepts(filter_of([]), bytes(100))
    assert accepts(filter_of([chance.randbytes(8) for _ in range(801)]), bytes(100)), "too many to filter: all pass"
    assert len(filter_of([bytes(8)] * 801)) <= 8 * 4096


def accepts(program: bytes, packet: bytes) -> bool:
    """What the kernel does with a classic BPF program of loads, jumps and returns."""
    at, loaded = 0, 0
    while True:
        code, true, false = (
            int.from_bytes(program[8 * at : 8 * at + 2], "little"),
            program[8 * at + 2],
            program[8 * at + 3],
        )
        operand = int.from_bytes(program[8 * at + 4 : 8 * at + 8], "little")
        at += 1
        match code:
            case 0x20:
                if operand + 4 > len(packet):
                    return False
                loaded = int.from_bytes(packet[operand : operand + 4], "big")
            case 0x15:
                at += true if loaded == operand else false
            case 0x06:
                return operand > 0
            case _:
                raise AssertionError(f"found the instruction {code:#x}")
