"""The ends of a wave link in their nodes: neither waits for the other in real time, and lives end in order."""

from __future__ import annotations

import math
import socket
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, Common, Peer, WaveEnd, own_start
from manyhands.nodes.link.join import OwnEnd, Received
from manyhands.nodes.link.peer_link import PeerLink, handshake_of
from manyhands.nodes.wave_link.ends import AT_ONCE, CALM, JOINING, UserEnd, WaveLinks, WorldEnd, datagram_socket
from manyhands.nodes.wave_link.faces import wave_feedthrough
from manyhands.nodes.wave_link.play_out import HOLD_AFTER
from manyhands.protocol.clock import Duration, Instant
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import Reaction, Ready, Role, Rung, Start, Tool, Wave
from tests.support.message_link import MessageLink

T = 1e-3
B = np.array([[20.0]])
D_V = np.array([[1e-5]])
NOT_AT_ALL = Duration(0)
DEEP = 3.0


class Ears:
    """A listener that has nothing to hear but a flood."""

    def __init__(self) -> None:
        self.failure = ""

    def on_other_tick(self, _peer_link: PeerLink, _other: int, _awaited: int) -> bool:
        raise AssertionError("a wave is of no tick of the receiver's")

    def on_notice(self, _peer_link: PeerLink, _message: object) -> bool:
        raise AssertionError("a wave link carries no notices")

    def flooded(self, text: str) -> None:
        self.failure = text


class StoppedClock:
    """A clock that a test moves."""

    def __init__(self) -> None:
        self.ns = 10**9

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        raise AssertionError("nothing sleeps here")


def common(role: Role, clock: str, *peers: Peer) -> Common:
    return Common(
        session="s", name="c" if role is Role.COUPLING else "environment", role=role, certificate="id", period=T,
        clock=clock, transport="ipc", public={}, private="", directory="", control="memory://control", ports=("a",),
        peers=peers, telemetry_ticks=100, telemetry_first=100,
    )  # fmt: skip


ENVIRONMENT = Peer("environment", Role.ENVIRONMENT, ("a",), binds=False)
COUPLING = Peer("c", Role.COUPLING, ("a",), binds=True)


class Link:
    """Both ends, with the links between them in the test's hands."""

    def __init__(self, clock: str = REALTIME, depth: float | None = DEEP, tank: float = 0.005) -> None:
        self.time = StoppedClock()
        wave = WaveEnd(B, None, tank, T, depth)
        self.to_user, self.to_world = MessageLink(), MessageLink()
        at_user, at_world = common(Role.COUPLING, clock, ENVIRONMENT), common(Role.ENVIRONMENT, clock, COUPLING)
        self.user = UserEnd(at_user, ENVIRONMENT, self.to_user, self.time, wave, D_V)  # type: ignore[arg-type]
        self.world = WorldEnd(at_world, COUPLING, self.to_world, self.time, wave)  # type: ignore[arg-type]
        self.ears = Ears()
        self.f, self.p = [0.0], [0.0]

    def user_tick(self, k: int, p: float) -> float:
        """A tick of the coupling; returns the force that it applies."""
        self.time.ns += 10**6
        assert self.user.send(Tool, k, 0, [p])
        assert self.user.hear(self.f, k, NOT_AT_ALL, self.ears) is Received.SIGNAL
        assert self.user.tick == k
        self.user.settle(k)
        return self.f[0]

    def world_tick(self, k: int, stiffness: float) -> Received:
        """A tick of the environment, a spring to the ground, as long as the coupling is active."""
        received = self.world.hear(self.p, k, NOT_AT_ALL, self.ears)
        if received is Received.SIGNAL:
            # f = -stiffness x, x = p + D f
            D = T / B[0, 0]
            self.world.send(Reaction, k, 0, [-stiffness * self.p[0] / (1.0 + stiffness * D)])
        return received

    def carry(self, up: bool = True, down: bool = True) -> None:
        """Take what was sent to the other end, or lose it."""
        for said, link, arrives in (
            (self.to_user.said, self.to_world, up),
            (self.to_world.said, self.to_user, down),
        ):
            if arrives:
                link.say(*said)
            said.clear()


def test_the_user_is_free_until_the_world_is_there_and_then_feels_it() -> None:
    link = Link()
    assert [link.user_tick(k, 0.01) for k in range(5)] == [0.0] * 5
    link.carry()
    assert link.world_tick(0, 1000.0) is Received.SIGNAL
    assert link.p[0] == pytest.approx(0.01, rel=1e-12)  # where the user's tool is
    for k in range(5, 800):
        link.carry()
        f = link.user_tick(k, 0.01)
        link.carry()
        link.world_tick(k, 1000.0)
    # at rest the spring, the wave link's 2 b/R and the block's D_V are in series
    R = (link.user.figures()["wave_lag_us"] + link.world.figures()["wave_lag_us"]) * 1e-6
    assert f == pytest.approx(-0.01 / (1.0 / 1000.0 + R / (2.0 * B[0, 0]) + D_V[0, 0]), rel=0.01)
    assert link.user.face.ledger + link.world.face.ledger >= -0.01


def test_neither_end_waits_when_nothing_comes() -> None:
    link = Link()
    for k in range(3):
        assert link.world_tick(k, 1000.0) is Received.NOTHING
    for k in range(200):
        link.user_tick(k, 0.001 * k)
        link.carry(down=False)
        assert link.world_tick(k + 3, 1000.0) is Received.SIGNAL
    for k in range(200, 400):  # no wave comes any more: the world's end holds the tool where it is
        link.user_tick(k, 0.2)
        link.carry(up=False, down=False)
        assert link.world_tick(k + 3, 1000.0) is Received.SIGNAL
    assert link.world.figures()["wave_holding"] == 1.0
    held = link.p[0]
    link.world_tick(500, 1000.0)
    assert link.p[0] == pytest.approx(held, abs=1e-4)


def test_an_end_that_measures_keeps_its_clutch_open_until_it_knows() -> None:
    link = Link(depth=None)
    wait = math.ceil(JOINING / T)
    for k in range(wait + 1):
        link.user_tick(k, 0.01)
        link.carry()
        received = link.world_tick(k, 1000.0)
        assert received is (Received.NOTHING if k < wait - 1 else Received.SIGNAL), k
    # every wave came within its tick
    assert link.world.face.latency <= 4e-3


def test_a_depth_follows_what_comes_late_again_and_again_and_no_single_outage() -> None:
    link = Link(depth=None)

    def seconds(number: int, late: int) -> float:
        """Seconds in which the waves of the first ``late`` ticks come together; the depth after them, ticks."""
        for _ in range(number):
            for k in range(1000):
                tick = len(ticks)
                ticks.append(tick)
                link.user_tick(tick, 0.01)
                if k >= late - 1:
                    link.carry()
                link.world_tick(tick, 1000.0)
        return link.world.face.wanted_depth

    ticks: list[int] = []
    settled = seconds(3, 0)
    assert settled <= 2.0
    assert seconds(1, 20) == settled  # once is an outage
    assert 8.0 < seconds(1, 20) < 12.0  # and again and again it is what the depth covers, except in 1 % of the ticks
    seconds(1, 250)
    assert seconds(1, 250) == HOLD_AFTER / T  # who hears nothing for so long holds the tool
    assert seconds(CALM + 1, 0) <= 2.0


def test_an_outage_while_joining_makes_the_depth_deep_for_a_second_and_not_for_ten() -> None:
    link = Link(depth=None)
    depths = []
    for k in range(math.ceil(JOINING / T) + 1500):
        link.user_tick(k, 0.01)
        if not 50 <= k < 90:
            link.carry()
        link.world_tick(k, 1000.0)
        depths.append(link.world.face.wanted_depth)
    assert max(depths) > 20.0
    assert depths[-1] <= 2.0


def test_ticks_that_a_process_was_too_late_for_are_counted() -> None:
    link = Link()
    for k in range(1000):
        link.user_tick(k, 0.01)
        link.carry()
        link.world_tick(k, 1000.0)
    before, n = link.f[0], (link.user.face.n, link.world.face.n)
    link.time.ns += 5 * 10**6
    f = link.user_tick(1000, 0.01)
    link.carry()
    link.world_tick(1000, 1000.0)
    assert (link.user.face.n, link.world.face.n) == (n[0] + 6, n[1] + 6)
    assert f == pytest.approx(before, rel=5e-3)


@pytest.mark.parametrize("where", ["127.0.0.1:*", "127.0.0.2:*"])
def test_datagrams_arrive_where_users_elsewhere_can_reach(where: str) -> None:
    """The socket is beside a link to another machine, whichever link comes first; 127.0.0.2 stands for one."""
    peers = [Peer(name, Role.COUPLING, ("a",), True, address) for name, address in (("c", "127.0.0.1:*"), ("d", where))]
    carried = replace(common(Role.ENVIRONMENT, REALTIME, *peers), transport="tcp", public={"c": "key"})
    waves = {peer.name: WaveEnd(B, None, 0.005, T) for peer in peers}
    datagrams = datagram_socket(OwnEnd(carried, StoppedClock(), waves=waves))  # type: ignore[arg-type]
    assert datagrams is not None
    with socket.fromfd(datagrams.fileno(), socket.AF_INET, socket.SOCK_DGRAM) as same:
        host = same.getsockname()[0]
    datagrams.close()
    assert host == where.partition(":")[0]


class CountedReads:
    """A socket for datagrams of which only the reading is counted."""

    def __init__(self) -> None:
        self.reads, self.closed = 0, False

    def read(self) -> None:
        self.reads += 1

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("alone", [True, False])
def test_a_world_of_wave_links_alone_reads_them_together(alone: bool) -> None:
    """Elsewhere each end reads its own link when the tick hears it; the datagrams are read once a tick in either."""
    others = () if alone else (Peer("d", Role.COUPLING, ("a",), True),)
    own = OwnEnd(
        common(Role.ENVIRONMENT, REALTIME, COUPLING, *others),
        StoppedClock(),  # type: ignore[arg-type]
        waves={"c": WaveEnd(B, None, 0.005, T, DEEP)},
    )
    kind, datagrams, coming = WaveLinks(own), CountedReads(), MessageLink()
    kind._datagrams = datagrams  # type: ignore[assignment]
    end = kind.join(COUPLING, coming)  # type: ignore[arg-type]
    assert isinstance(end, WorldEnd)
    coming.say(Wave(1, (0.1,), 0.0))
    kind.read()
    assert (len(coming.coming), datagrams.reads) == (0 if alone else 1, 1)
    assert end.hear([0.0], 0, NOT_AT_ALL, Ears()) is Received.SIGNAL
    kind.close()
    assert datagrams.closed


def test_a_second_call_in_a_tick_moves_nothing() -> None:
    link = Link()
    link.user_tick(0, 0.01)
    link.carry()
    assert link.world_tick(0, 0.0) is Received.SIGNAL
    n = link.world.face.n
    assert link.world.hear(link.p, 0, NOT_AT_ALL, link.ears) is Received.NOTHING
    assert link.world.face.n == n


def test_a_coupling_that_is_not_active_is_stepped_without_force() -> None:
    link = Link()
    for k in range(20):
        link.user_tick(k, 0.01)
        link.carry()
        assert link.world.hear(link.p, k, NOT_AT_ALL, link.ears) is Received.SIGNAL  # and no force follows
    assert link.world.face.n == 19
    assert link.p[0] == pytest.approx(0.01, rel=1e-9)


def test_a_lost_peer_ends_a_life_and_the_next_begins_with_a_handshake() -> None:
    link = Link()
    for k in range(300):
        link.user_tick(k, 0.01)
        link.carry()
        link.world_tick(k, 1000.0)
        link.carry()
    assert link.user_tick(300, 0.01) < -5.0
    link.user.lose()
    assert not link.user.here
    forces = [link.user_tick(k, 0.01) for k in range(301, 500)]
    assert forces[-1] == 0.0
    steps = np.abs(np.diff(forces))
    assert np.max(steps) < 0.5  # it fades
    again = MessageLink()
    link.user.greet(again, handshake_of(link.user))  # type: ignore[arg-type]
    link.user_tick(500, 0.01)
    assert not [message for message in again.said if isinstance(message, Wave)]  # not before hands are shaken
    assert link.world.tick == 299
    link.world.lose()
    assert link.world.tick == -1  # or its last position would count for a tick in which nothing came
    assert link.world_tick(300, 1000.0) is Received.NOTHING
    # waves of the life before change nothing in the next one
    assert link.world.face.n == 0


def test_a_process_in_the_place_of_a_lost_one_begins_with_an_empty_tank() -> None:
    link = Link()
    assert link.user.face.tank.level == 0.005
    link.user.resume()
    assert link.user.face.tank.level == 0.0


@pytest.mark.parametrize("end", ["user", "world"])
def test_a_flood_ends_the_link_alone_or_the_user_and_a_few_strays_are_counted(end: str) -> None:
    link = Link()
    link.user_tick(0, 0.01)
    link.carry()
    link.world_tick(0, 0.0)
    link.carry()
    coming = (link.to_user if end == "user" else link.to_world).coming

    def tick(k: int) -> Any:
        if end == "user":
            link.user.send(Tool, k, 0, [0.01])
            return link.user.hear(link.f, k, NOT_AT_ALL, link.ears)
        return link.world.hear(link.p, k, NOT_AT_ALL, link.ears)

    coming.extend([b"\xc1 rubbish"] * 5)
    assert tick(1) is Received.SIGNAL
    assert link.ears.failure == ""
    dropped = (link.user if end == "user" else link.world).dropped
    assert dropped["malformed"] == 5
    coming.extend([b"\xc1 rubbish"] * (MAX_STRAY_FRAMES + 1))
    heard = [tick(k) for k in range(2, 4 + MAX_STRAY_FRAMES // AT_ONCE)]  # some in each tick
    if end == "user":
        assert "stray frames" in link.ears.failure
    else:  # nobody waits for a user behind a wave link, and nobody else ends for it
        assert (heard.count(Received.FLOODED), link.world.link, link.ears.failure) == (1, None, "")


def test_what_belongs_to_the_tick_is_not_sent_on_a_wave_link() -> None:
    link = Link()
    for message in (
        lambda: link.world.send_zero(Reaction, 3),
        lambda: link.world.notify(Rung(1)),
        link.user.send_again,
    ):
        message()
    assert link.to_user.said == []
    assert link.to_world.said == []
    link.to_world.say(Ready())
    link.world_tick(0, 0.0)
    assert link.world.dropped["wrong_kind"] + link.world.dropped["malformed"] == 1


def test_under_the_simulated_clock_each_waits_for_the_waves_that_are_due() -> None:
    link = Link(SIMULATED, depth=None)
    link.user.send(Tool, 0, 0, [0.01])
    assert link.user.hear(link.f, 0, NOT_AT_ALL, link.ears) is Received.NOTHING
    assert link.world_tick(0, 1000.0) is Received.NOTHING
    link.carry()
    assert link.world_tick(0, 1000.0) is Received.SIGNAL
    assert link.world_tick(1, 1000.0) is Received.NOTHING
    link.carry()
    assert link.user.hear(link.f, 0, NOT_AT_ALL, link.ears) is Received.SIGNAL


def test_the_hello_states_the_feedthrough_of_the_worlds_face() -> None:
    link = Link()
    assert link.user.own.feedthrough == tuple(map(tuple, wave_feedthrough(B, T).tolist()))
    assert link.world.own.feedthrough is None
    np.testing.assert_array_equal(link.world._face.D_V, wave_feedthrough(B, T))  # the digest is over every bit


def test_a_site_counts_its_own_ticks_from_its_own_instant() -> None:
    at = replace(common(Role.COUPLING, REALTIME, ENVIRONMENT), rate=4.0, phase=0.0005)
    assert own_start(at, Start(10**9, 1000, 3)) == Start(10**9 + 500_000, 4000, 12)
    assert own_start(replace(at, rate=1.0, phase=0.0), Start(7, 0, 0)) == Start(7, 0, 0)
