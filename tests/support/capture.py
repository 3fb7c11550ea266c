"""The traffic on the wire as an eavesdropper sees it: tshark on the loopback interface, joined again by stream.

Nothing here waits for time to pass. Marker datagrams in tshark's output show that the capture has begun, and that it
has seen everything. Sequence numbers without a hole show that it has lost nothing.
"""

from __future__ import annotations

import os
import queue
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, NoReturn

import pytest

REQUIRED = "MANYHANDS_REQUIRE_CAPTURE"
"""Environment variable: set to 1 where a machine that lacks a tool must fail the tests rather than skip them."""

_MARKER_WAIT = 0.2  # s, after which a marker was sent before anybody listened: send another
_PATIENCE = 150  # markers, 30 s
_FIELDS = ("tcp.stream", "tcp.srcport", "tcp.flags", "tcp.seq", "tcp.payload", "udp.payload")
_SYN, _FIN = 0x02, 0x01


def missing(what: str) -> NoReturn:
    """Skip the test for want of ``what``, or fail it where :data:`REQUIRED` is set."""
    if os.environ.get(REQUIRED) == "1":
        pytest.fail(f"{what}, and {REQUIRED}=1 requires it")
    pytest.skip(f"{what}; install it to run this test")


class IncompleteCapture(Exception):
    """The capture lacks a part of what was sent, so it supports no conclusion."""


@dataclass(frozen=True)
class Segment:
    """One TCP segment; ``sequence`` counts from the connection's first, 0 being the SYN's."""

    stream: int
    source: int
    flags: int
    sequence: int
    payload: bytes


def reassembled(segments: Iterable[Segment]) -> dict[tuple[int, int], bytes]:
    """The bytes sent in each direction, by stream and source port, in order; retransmitted bytes appear once.

    Raises:
        IncompleteCapture: a direction's beginning, or a part of it, is missing.
    """
    directions: dict[tuple[int, int], list[Segment]] = {}
    for segment in segments:
        directions.setdefault((segment.stream, segment.source), []).append(segment)
    return {key: _joined(key, parts) for key, parts in directions.items()}


def _joined(key: tuple[int, int], parts: list[Segment]) -> bytes:
    where = f"stream {key[0]} from port {key[1]}"
    sent = [part for part in parts if part.payload or part.flags & _FIN]
    if sent and not any(part.flags & _SYN for part in parts):
        raise IncompleteCapture(f"{where}: the capture began after the connection")
    out = bytearray()
    for part in sorted(sent, key=lambda part: part.sequence):
        begin = part.sequence - 1  # the SYN takes one number
        if begin > len(out):
            raise IncompleteCapture(f"{where}: {begin - len(out)} bytes are missing after {len(out)}")
        out += part.payload[len(out) - begin :]
    return bytes(out)


class Capture:
    """A running tshark: use it as a context, produce the traffic, then call :meth:`finish`.

    Sees the TCP connections to or from the given ports of the loopback interface.
    """

    def __init__(self, ports: range) -> None:
        """``ports`` are consecutive; the context starts tshark."""
        self._ports = ports
        self._segments: list[Segment] = []
        self._markers: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._sent = 0

    def __enter__(self) -> Capture:
        """Start tshark; returns once it sees the traffic.

        Skips or fails the test where there is no tshark, or capturing is not permitted; see :func:`missing`.
        """
        tshark = shutil.which("tshark")
        if tshark is None:
            missing("no tshark was found")
        self._marker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._marker.bind(("127.0.0.1", 0))
        udp = self._marker.getsockname()[1]
        wanted = f"(tcp portrange {self._ports[0]}-{self._ports[-1]}) or (udp port {udp})"
        self._log: IO[bytes] = tempfile.TemporaryFile()  # closed in __exit__
        self._process = subprocess.Popen(
            [tshark, "-i", "lo", "-f", wanted, "-n", "-l", "-B", "16", "-T", "fields", *_as_options(_FIELDS)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._log,
        )
        self._reader = threading.Thread(target=self._read, name="tshark's output")
        self._reader.start()
        try:
            if not self._marked():
                missing(f"tshark cannot capture on this machine ({self._last_words()})")
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        """End it, if that has not been done."""
        self._end()

    def finish(self) -> dict[tuple[int, int], bytes]:
        """End the capture and return everything sent until now in each direction, as :func:`reassembled` does.

        Raises:
            IncompleteCapture: something was lost.
        """
        if not self._marked():  # on this interface packets are seen in the order in which they were sent
            raise IncompleteCapture(f"tshark ended before its time: {self._last_words()}")
        self._end()
        return reassembled(self._segments)

    def _marked(self) -> bool:
        """Send markers until one appears; False if tshark has ended instead."""
        first = self._sent
        for _ in range(_PATIENCE):
            self._marker.sendto(self._sent.to_bytes(8, "big"), self._marker.getsockname())
            self._sent += 1
            try:
                while (marker := self._markers.get(timeout=_MARKER_WAIT)) is not None:
                    if int(marker, 16) >= first:
                        return True
                return False
            except queue.Empty:
                continue
        return False

    def _read(self) -> None:
        """Read tshark's output in a thread of its own, because a full pipe would stop tshark."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            stream, source, flags, sequence, payload, datagram = line.decode().rstrip("\n").split("\t")
            if datagram:
                self._markers.put(datagram)
            else:
                self._segments.append(
                    Segment(int(stream), int(source), int(flags, 16), int(sequence), bytes.fromhex(payload))
                )
        self._markers.put(None)

    def _last_words(self) -> str:
        self._log.seek(0)
        return " ".join(self._log.read().decode(errors="replace").split())[-600:] or "it said nothing"

    def _end(self) -> None:
        if self._log.closed:
            return
        self._process.send_signal(signal.SIGINT)  # so that it removes its temporary file
        self._process.wait()
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._marker.close()
        self._log.close()


def _as_options(fields: Iterable[str]) -> list[str]:
    return [word for field in fields for word in ("-e", field)]


def free_ports(count: int) -> range:
    """Consecutive unused TCP ports of 127.0.0.1, below those that the system assigns by itself."""
    lowest_given = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    share = (min(lowest_given, 32_768) - 10_000) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    lowest = 10_000 + worker * share  # processes of one test run have no port in common
    choose = random.Random(os.getpid())  # test runs beside each other begin elsewhere
    for _ in range(100):
        first = choose.randrange(lowest, lowest + share - count)
        ports = range(first, first + count)
        if all(_is_free(port) for port in ports):
            return ports
    raise RuntimeError(f"found no {count} free ports in a row")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
