"""A WAN on one machine: two network namespaces, ``near`` and ``far``, and a wire between them that delays and loses.

Real processes run in either namespace, with the kernel's own TCP and UDP, over IPv4 and IPv6. Each namespace has a tun
device. This file is run as a program of its own that holds both devices and passes packets on: later, in any order, or
never. It needs no privilege where the kernel lets users have namespaces; :func:`wan` skips the test where it does not.
Who may have network namespaces without a user namespace gets them so, for a process in a user namespace has no right to
a real-time priority.

    with wan(Wire(delay=0.04, jitter=0.01, loss=0.02)) as one:
        subprocess.run([*one.within("far"), "ping", "-c1", one.address("near")])
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import heapq
import json
import os
import random
import select
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import IO, Any, Final, Literal

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))  # it is run as a file

from tests.support.nat import Nat

REQUIRED: Final = "MANYHANDS_REQUIRE_NAMESPACES"
"""Environment variable: set to 1 where a machine without namespaces must fail the tests rather than skip them."""

Side = Literal["near", "far"]
SIDES: Final[tuple[Side, Side]] = ("near", "far")
ADDRESSES: Final = {"near": ("10.9.0.1", "fd00:9::1"), "far": ("10.9.0.2", "fd00:9::2")}
_UDP: Final = 17
_PRIORITY: Final = 20  # of the process between the two, above any node's


@dataclass(frozen=True)
class Wire:
    """What happens to packets, the same in either direction.

    Attributes:
        delay: the least time that a packet is on its way, s.
        jitter: the greatest further time, uniform and each packet's own, s; so packets overtake each other.
        loss: the part of packets that is lost, 0 ... 1.
        udp: whether datagrams pass at all; a firewall may have something against them.
        router: how long the far side's router remembers the ports of datagrams, s (:class:`tests.support.nat.Nat`); 0
            for no router. It passes IPv4 alone.
        seed: of all of that; each direction has random numbers of its own.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    udp: bool = True
    router: float = 0.0
    seed: int = 1


class Way:
    """One direction of a wire: the packets on it. Pure."""

    def __init__(self, number: int, seed: int) -> None:
        self._chance = random.Random(f"{seed} {number}")
        self._on_it: list[tuple[float, int, bytes]] = []
        self._count = 0

    @property
    def next(self) -> float | None:
        """When the next packet arrives; None while there is none."""
        return self._on_it[0][0] if self._on_it else None

    def put(self, packet: bytes, wire: Wire, now: float) -> None:
        """Send a packet off, or lose it. Every packet takes two random numbers, whatever becomes of it."""
        lost, further = self._chance.random() < wire.loss, self._chance.random() * wire.jitter
        if not lost and (wire.udp or not _is_datagram(packet)):
            self._count += 1
            heapq.heappush(self._on_it, (now + wire.delay + further, self._count, packet))

    def arrived(self, now: float) -> Iterator[bytes]:
        """The packets that have arrived, in the order of their arrival."""
        while self._on_it and self._on_it[0][0] <= now:
            yield heapq.heappop(self._on_it)[2]


def _is_datagram(packet: bytes) -> bool:
    at = 9 if packet[0] >> 4 == 4 else 6  # protocol, or next header
    return packet[at] == _UDP


class Wan:
    """Two namespaces and the process that joins them, for as long as that runs."""

    def __init__(self, joiner: subprocess.Popen[str], wire: Wire, made: Mapping[str, Any]) -> None:
        self._joiner, self._wire = joiner, wire
        self._of_user: bool = made["of_user"]
        self._namespaces: dict[Side, int] = dict(zip(SIDES, made["net"], strict=True))

    def address(self, side: Side, version: Literal[4, 6] = 4) -> str:
        """The address of a side, which the other side reaches over the wire and the side itself at once."""
        return ADDRESSES[side][version == 6]

    def within(self, side: Side) -> list[str]:
        """What to put before a command so that it runs in the namespace of a side."""
        process = f"/proc/{self._joiner.pid}"
        of_user = [f"--user={process}/ns/user", "--preserve-credentials"] if self._of_user else []
        return ["nsenter", f"--net={process}/fd/{self._namespaces[side]}", *of_user, "--"]

    def change(self, **what: float | bool) -> None:
        """From now on the wire is different in this; packets that are on it stay as they are."""
        self._wire = replace(self._wire, **what)  # type: ignore[arg-type]
        stdin = self._joiner.stdin
        assert stdin is not None
        stdin.write(json.dumps(asdict(self._wire)) + "\n")
        stdin.flush()


class Refused(Exception):
    """There are no namespaces here; the message says why."""


@contextmanager
def wan(wire: Wire) -> Iterator[Wan]:
    """A WAN, while it is entered; skips the test, with the reason, where the machine permits none.

    Processes in it must have ended before it is left.
    """
    import pytest

    try:
        with open_wan(wire) as one:
            yield one
    except Refused as reason:
        if os.environ.get(REQUIRED) == "1":
            pytest.fail(f"{reason}, and {REQUIRED}=1 requires it")
        pytest.skip(f"{reason}")


@contextmanager
def open_wan(wire: Wire) -> Iterator[Wan]:
    """A WAN, while it is entered.

    Raises:
        Refused: the machine permits none.
    """
    command = [sys.executable, str(Path(__file__)), json.dumps(asdict(wire))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as joiner:
        assert joiner.stdout is not None
        said = joiner.stdout.readline()
        try:
            if not said.startswith("{"):
                raise Refused(said.strip() or "the namespaces' process has ended")
            yield Wan(joiner, wire, json.loads(said))
        finally:
            joiner.communicate()  # its end of input is its end


# --- the process that joins the two


def main() -> None:
    """Make the namespaces, report their descriptors in a line, and pass packets on until the end of the input."""
    try:
        of_user = not _may_unshare()
        descriptors, devices = _namespaces(of_user)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.stdout.write(f"no namespaces with a tun device: {error}\n")
        return
    sys.stdout.write(json.dumps({"of_user": of_user, "net": descriptors}) + "\n")
    sys.stdout.flush()
    with contextlib.suppress(PermissionError):  # a real wire does not wait for this machine's processors
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    _join(devices, Wire(**json.loads(sys.argv[1])), sys.stdin)


def _may_unshare() -> bool:
    """Whether this process may have a network namespace without a user namespace; it then has one."""
    try:
        _unshare(_CLONE_NEWNET)
    except PermissionError:
        return False
    return True


def _namespaces(of_user: bool) -> tuple[list[int], list[int]]:
    """Descriptors of two network namespaces, in a user namespace or not, and of the tun device in each."""
    if of_user:
        user, group = os.getuid(), os.getgid()
        _unshare(_CLONE_NEWUSER)
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    descriptors, devices = [], []
    for side in SIDES:
        _unshare(_CLONE_NEWNET)
        descriptors.append(os.open("/proc/self/ns/net", os.O_RDONLY))
        device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH", b"wan", _IFF_TUN | _IFF_NO_PI))
        devices.append(device)
        four, six = ADDRESSES[side]
        for line in (
            "link set lo up",
            f"address add {four}/24 dev wan",
            f"address add {six}/64 dev wan nodad",
            "link set wan txqueuelen 10000 up",
        ):
            subprocess.run(["ip", *line.split()], check=True, capture_output=True)
    return descriptors, devices


def _join(devices: Sequence[int], wire: Wire, orders: IO[str]) -> None:
    ways = [Way(number, wire.seed) for number in range(2)]
    router, remembers = Nat(), time.monotonic()
    translated = (router.inward, router.outward)
    while True:
        due = min((way.next for way in ways if way.next is not None), default=None)
        wait = None if due is None else max(0.0, due - time.monotonic())
        ready, _, _ = select.select([*devices, orders], [], [], wait)
        now = time.monotonic()
        for number, device in enumerate(devices):
            if wire.router and now > remembers + wire.router:
                remembers = now
                router.forget()
            if device in ready:
                for packet in _read(device):
                    ways[number].put(packet, wire, time.monotonic())  # not before it was there to be read
            for packet in ways[number].arrived(now):
                passed = translated[number](packet) if wire.router else packet
                if passed is not None:
                    os.write(devices[1 - number], passed)
        if orders in ready:
            line = orders.readline()
            if not line:
                return
            wire = Wire(**json.loads(line))


def _read(device: int) -> Iterator[bytes]:
    while True:
        try:
            yield os.read(device, 65536)
        except BlockingIOError:
            return


def _unshare(what: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(what):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), "unshare")


_CLONE_NEWUSER: Final = 0x10000000  # linux/sched.h
_CLONE_NEWNET: Final = 0x40000000
_TUNSETIFF: Final = 0x400454CA  # linux/if_tun.h
_IFF_TUN: Final = 0x0001
_IFF_NO_PI: Final = 0x1000

if __name__ == "__main__":
    main()
