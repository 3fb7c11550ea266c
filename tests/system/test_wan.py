"""Wave links between two processes on two sides of a WAN: real TCP and UDP, over namespaces of the kernel."""

from __future__ import annotations

from typing import Literal

import pytest

from ..support.path_ends import run_ends
from ..support.wan import Way, Wire, wan

PACKET = bytes.fromhex("4500") + bytes(7) + b"\x11" + bytes(30)
SECONDS = 3.0


# --- the wire, without any namespace


def sent(wire: Wire, number: int = 0, count: int = 4000) -> list[tuple[float, int]]:
    """Packets sent at 1 kHz: when each arrived that did, s, and which it is."""
    way = Way(number, wire.seed)
    out = []
    for k in range(count + 1000):
        now = k / 1000
        if k < count:
            way.put(PACKET + k.to_bytes(4, "big"), wire, now)
        out += [(now, int.from_bytes(packet[-4:], "big")) for packet in way.arrived(now)]
    assert way.next is None
    return out


def test_a_seed_says_which_packets_are_lost_and_when_the_others_arrive() -> None:
    wire = Wire(0.04, 0.01, 0.1)
    arrived = sent(wire)
    assert arrived == sent(wire)
    assert arrived != sent(wire, number=1), "the two directions have the same fate"
    assert arrived != sent(Wire(0.04, 0.01, 0.1, seed=2))
    assert 0.08 < 1.0 - len(arrived) / 4000 < 0.12
    delays = [when - which / 1000 for when, which in arrived]
    assert min(delays) >= 0.04 - 1e-9
    assert max(delays) <= 0.0511
    order = [which for _, which in arrived]
    assert order != sorted(order), "none has overtaken another"
    assert len(set(order)) == len(order)


def test_a_wire_may_let_no_datagrams_pass() -> None:
    assert sent(Wire(udp=False)) == []
    assert len(sent(Wire())) == 4000


# --- two processes


@pytest.mark.parametrize("version", [4, 6])
def test_datagrams_bring_the_waves_across_a_wan(version: Literal[4, 6]) -> None:
    with wan(Wire(delay=0.04, jitter=0.01, loss=0.02)) as one:
        ends = run_ends(one, SECONDS, version)
    for end in ends.values():
        assert end["up"] > 0  # how soon and for how long depends on the machine
        assert end["opened"] > 0
        assert min(end["ages"]) >= 40e6
        assert not any(count for reason, count in end["dropped"].items() if reason != "old_tick")
        assert end["refused"]["forged"] == end["refused"]["unknown_path"] == end["refused"]["no_datagram"] == 0
        assert end["refused"]["replayed"] > 0, "no packet has overtaken another"


def test_where_no_datagram_passes_the_link_brings_the_waves() -> None:
    with wan(Wire(delay=0.04, jitter=0.01, udp=False)) as one:
        ends = run_ends(one, SECONDS)
    for end in ends.values():
        assert (end["state"], end["opened"], end["up"]) == ("down", 0, 0)
        assert end["taken"] > 0
        assert min(end["ages"]) >= 40e6
        assert not any(end["dropped"].values())
