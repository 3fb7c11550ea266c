"""Wave links between two processes on two sides of a WAN: real TCP and UDP, over namespaces of the kernel."""

from __future__ import annotations

import ipaddress
import struct
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ..support.nat import Nat
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


# --- a router, without any namespace


def datagram(source: tuple[str, int], destination: tuple[str, int], content: bytes) -> bytes:
    """A datagram over IPv4, with both checksums."""
    ends = b"".join(ipaddress.IPv4Address(address).packed for address, _ in (source, destination))
    udp = struct.pack(">HHHH", source[1], destination[1], 8 + len(content), 0) + content
    pseudo = ends + struct.pack(">BBH", 0, 17, len(udp))
    udp = udp[:6] + struct.pack(">H", checksum(pseudo + udp)) + content
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), 7, 0x4000, 64, 17, 0) + ends
    return head[:10] + struct.pack(">H", checksum(head)) + ends + udp


def checksum(data: bytes) -> int:
    """The checksum of the internet (RFC 1071)."""
    data += bytes(len(data) % 2)
    total = sum(struct.unpack(f">{len(data) // 2}H", data))
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    return 0xFFFF - total


@given(st.binary(max_size=60), st.integers(1, 65535), st.integers(1, 65535))
def test_a_router_changes_address_and_port_alone_and_back(content: bytes, own: int, other: int) -> None:
    router = Nat()
    inner, outer, peer = ("10.9.0.2", own), ("10.9.0.77", 20000), ("10.9.0.1", other)
    assert router.outward(datagram(inner, peer, content)) == datagram(outer, peer, content)
    assert router.inward(datagram(peer, outer, content)) == datagram(peer, inner, content)
    assert router.inward(datagram(("10.9.0.1", other % 65535 + 1), outer, content)) is None
    assert router.inward(datagram(peer, inner, content)) is None
    assert router.turned_away == 2
    router.forget()
    assert router.inward(datagram(peer, outer, content)) is None
    assert router.outward(datagram(inner, peer, content)) == datagram(("10.9.0.77", 20001), peer, content)


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


def test_datagrams_pass_a_router_that_translates_addresses_and_forgets_them() -> None:
    """The environment learns the coupling's new address from its datagrams, each time that the router changes it."""
    with wan(Wire(delay=0.02, jitter=0.005, loss=0.01, router=0.6)) as one:
        ends = run_ends(one, SECONDS)
    for end in ends.values():
        assert end["latest"] > 0.8 * end["ticks"], "no datagram came any more after the router had changed its ports"
        assert end["refused"]["forged"] == end["refused"]["unknown_path"] == 0


def test_where_no_datagram_passes_the_link_brings_the_waves() -> None:
    with wan(Wire(delay=0.04, jitter=0.01, udp=False)) as one:
        ends = run_ends(one, SECONDS)
    for end in ends.values():
        assert (end["state"], end["opened"], end["up"]) == ("down", 0, 0)
        assert end["taken"] > 0
        assert min(end["ages"]) >= 40e6
        assert not any(end["dropped"].values())
