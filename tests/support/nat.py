"""A router that translates addresses (NAT), between the far side of a WAN and the near one. Pure.

The near side sees the router's address and a port of the router's. Only whom the far side has sent something to can
reach it, at that port: the strictest kind of router (RFC 4787: address- and port-dependent mapping and filtering). A
router may forget its mappings of datagrams, and then chooses other ports.
"""

from __future__ import annotations

import ipaddress
import struct
from typing import Final

ROUTER: Final = ipaddress.IPv4Address("10.9.0.77").packed
"""The router's address on the near side."""

_FIRST_PORT: Final = 20000
_CHECKSUM_AT: Final = {6: 16, 17: 6}  # in the heads of TCP and UDP

_Flow = tuple[int, bytes, int, bytes, int]  # protocol, source, its port, destination, its port


class Nat:
    """The mappings of one router.

    Attributes:
        forgotten: how often it has forgotten those of datagrams.
        turned_away: packets from the near side for which there was no mapping.
    """

    def __init__(self) -> None:
        self._ports: dict[_Flow, int] = {}
        self._flows: dict[int, _Flow] = {}
        self._next = _FIRST_PORT
        self.forgotten = self.turned_away = 0

    def forget(self) -> None:
        """Forget all mappings of datagrams, as after a time of silence or a change of the line."""
        gone = [flow for flow in self._ports if flow[0] == 17]
        for flow in gone:
            del self._flows[self._ports.pop(flow)]
        self.forgotten += bool(gone)

    def outward(self, packet: bytes) -> bytes | None:
        """A packet of the far side as the near side sees it; None for what such a router does not pass."""
        flow = _flow_of(packet)
        if flow is None:
            return None
        if flow not in self._ports:
            self._ports[flow], self._flows[self._next] = self._next, flow
            self._next += 1
        return _rewritten(packet, 12, ROUTER, 0, self._ports[flow])

    def inward(self, packet: bytes) -> bytes | None:
        """A packet of the near side as the far side sees it; None where no mapping lets it in."""
        back = _flow_of(packet)
        mapped = None if back is None or back[3] != ROUTER else self._flows.get(back[4])
        if back is None or mapped is None or (back[0], back[1], back[2]) != (mapped[0], mapped[3], mapped[4]):
            self.turned_away += 1
            return None
        return _rewritten(packet, 16, mapped[1], 2, mapped[2])


def _flow_of(packet: bytes) -> _Flow | None:
    """Between whom a packet of TCP or UDP over IPv4 is; None for any other, and for the rest of one that was cut up."""
    if len(packet) < 20 or packet[0] >> 4 != 4 or packet[9] not in _CHECKSUM_AT:
        return None
    head, cut = 4 * (packet[0] & 15), struct.unpack_from(">H", packet, 6)[0] & 0x1FFF
    if cut or len(packet) < head + 8:
        return None
    source, destination = struct.unpack_from(">HH", packet, head)
    return packet[9], packet[12:16], source, packet[16:20], destination


def _rewritten(packet: bytes, at: int, address: bytes, port_at: int, port: int) -> bytes:
    """The packet with another address and port, and checksums that fit (RFC 1624)."""
    out, head, protocol = bytearray(packet), 4 * (packet[0] & 15), packet[9]
    before = packet[at : at + 4] + packet[head + port_at : head + port_at + 2]
    after = address + struct.pack(">H", port)
    out[at : at + 4], out[head + port_at : head + port_at + 2] = address, after[4:]
    _fit(out, 10, before[:4], after[:4])
    place = head + _CHECKSUM_AT[protocol]
    if protocol == 6 or out[place : place + 2] != b"\0\0":  # a datagram may have none
        _fit(out, place, before, after)
    return bytes(out)


def _fit(packet: bytearray, at: int, before: bytes, after: bytes) -> None:
    total = 0xFFFF - struct.unpack_from(">H", packet, at)[0]
    words = f">{len(before) // 2}H"
    for old, new in zip(struct.unpack(words, before), struct.unpack(words, after), strict=True):
        total += (0xFFFF - old) + new
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    struct.pack_into(">H", packet, at, 0xFFFF - total)
