"""What a datagram costs: to seal and send, to receive and open, to refuse; and an environment's port under floods.

    python benchmarks/datagrams.py [--rounds N] [--count N] [--seconds S]

Costs are of processor time, per datagram, on the loopback, the least over the rounds: other processes only add to it.
A flood comes from a second process as fast as that can send, while an environment's loop with one user ticks at 1 kHz.
"""

from __future__ import annotations

import argparse
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Final

from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from manyhands.protocol.clock import Instant, RealtimeClock, from_seconds
from manyhands.protocol.codec import WaveWriter
from manyhands.protocol.gate import WaveGate
from manyhands.protocol.messages import Wave
from manyhands.protocol.path import PROBE, Direction, PathEnd
from manyhands.protocol.transport.datagrams import DatagramPath, DatagramSocket

PERIOD: Final = from_seconds(0.001)


class NoLink:
    """A ZeroMQ link that takes everything and brings nothing."""

    def send(self, _frame: bytes) -> bool:
        """Take a frame."""
        return True


def pair(width: int, clock: RealtimeClock) -> tuple[DatagramSocket, DatagramPath, DatagramSocket, DatagramPath]:
    """Both ends of a path that is up; ticks from 10 on are free."""
    server, client = DatagramSocket.bound("127.0.0.1", 0, clock), DatagramSocket.unbound(clock)
    environment = server.offer(NoLink(), width)  # type: ignore[arg-type]
    coupling = client.take_up(environment.key, "127.0.0.1", NoLink(), width)  # type: ignore[arg-type]
    for tick in range(4):
        coupling.send(wave(tick, width))
        server.read()
        environment.send(wave(tick, width))
        coupling.receive()
        clock.sleep_until(Instant(clock.now() + PROBE))
    return server, environment, client, coupling


def wave(tick: int, width: int) -> Wave:
    """A wave of ``width`` ports."""
    return Wave(tick, (0.5,) * width, float(tick))


def least(rounds: int, count: int, act: Callable[[int], None]) -> float:
    """The least time of ``act`` over the rounds, us, for numbers that rise from 10 on."""
    found, number = [], 10
    for _ in range(rounds):
        began = time.process_time_ns()
        for number in range(number, number + count):  # noqa: B020 -- it rises from round to round
            act(number)
        number += 1
        found.append((time.process_time_ns() - began) / count / 1e3)
    return min(found)


def costs(width: int, rounds: int, count: int) -> dict[str, float]:
    """The costs of one datagram with a wave of ``width`` ports, us."""
    clock = RealtimeClock()
    server, environment, client, coupling = pair(width, clock)
    writer, gate = WaveWriter(width), WaveGate(width, PERIOD, clock)
    frame, aead, nonce, header = writer.frame(1, (0.5,) * width, 0.0), ChaCha20Poly1305(bytes(32)), bytes(12), bytes(17)
    sealed = aead.encrypt(nonce, frame, header)
    frames = [writer.frame(k, (0.5,) * width, 0.0) for k in range(10 + rounds * (count + 1))]
    now = clock.now()
    found = {
        "seal alone": least(rounds, count, lambda _: aead.encrypt(nonce, frame, header) and None),
        "open alone": least(rounds, count, lambda _: aead.decrypt(nonce, sealed, header) and None),
        "write a wave": least(rounds, count, lambda k: writer.frame(k, (0.5,) * width, 0.0) and None),
        "admit a wave": least(rounds, count, lambda k: gate.admitted(frames[k]) and None),
    }

    def both(tick: int) -> None:
        coupling.send(wave(tick, width))
        server.read()
        environment.receive()
        if tick % 50 == 0:  # so that the path stays up
            environment.send(wave(tick, width))
            coupling.receive()

    bare = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bare.bind(("127.0.0.1", 0))
    found["a tick's send, read and receive"] = least(rounds, count, both)
    found["of this the kernel's sendto, recvfrom and one recvfrom in vain"] = least(
        rounds, count, lambda _: _bare(bare, sealed)
    )
    found["an empty read"] = least(rounds, count, lambda _: server.read())
    bare.close()
    newest = environment.end
    # n far ahead: neither is refused for its n
    forged = PathEnd(environment.key, Direction.TO_ENVIRONMENT, now)
    datagram, _ = forged.outgoing(10**12, frame, now)
    if datagram is None:
        raise SystemExit("found no datagram; expected the first one to be due")
    wrong = datagram[:-1] + bytes([datagram[-1] ^ 1])
    old = datagram[:9] + bytes(8) + datagram[17:]
    found["refuse a forged one"] = least(rounds, count, lambda _: newest.opens(wrong, now) and None)
    found["refuse a copy"] = least(rounds, count, lambda _: newest.opens(old, now) and None)
    server.close()
    client.close()
    return found


def _bare(one: socket.socket, datagram: bytes) -> None:
    one.setblocking(False)
    one.sendto(datagram, one.getsockname())
    one.recvfrom(2048)
    try:
        one.recvfrom(2048)
    except BlockingIOError:
        return


def flooded(kind: str, seconds: float) -> dict[str, float]:
    """An environment's loop with one user at 1 kHz, and what a flood costs it.

    Args:
        kind: "none"; "stranger", with a random connection; "forger", with the user's own, as seen on the wire.
        seconds: for how long, s.
    """
    clock = RealtimeClock()
    server, environment, client, coupling = pair(1, clock)
    connection = environment.key.connection.hex() if kind == "forger" else os.urandom(8).hex()
    # the same busy process without a flood: what it takes from the processors is not the flood's own doing
    to = 9 if kind == "none" else server.port
    rogue = subprocess.Popen(  # noqa: S603 -- this very script
        [sys.executable, __file__, "--flood", str(to), "--connection", connection], stdout=subprocess.PIPE, text=True
    )
    if rogue.stdout is None or not rogue.stdout.readline():
        raise SystemExit("found no word of the flood; expected it to have begun")
    reads: list[int] = []
    received = 0
    began = clock.now()
    ticks = from_seconds(seconds) // PERIOD
    for tick in range(10, 10 + ticks):
        clock.sleep_until(Instant(began + (tick - 10) * PERIOD))
        coupling.send(wave(tick, 1))
        environment.send(wave(tick, 1))
        before = time.thread_time_ns()
        server.read()
        received += environment.receive() is not None
        reads.append(time.thread_time_ns() - before)
        coupling.receive()
    took = clock.now() - began
    rogue.kill()
    rogue.communicate()
    refused = sum(environment.end.refused.values()) + sum(server.refused.values())
    result = {
        "refused": refused / took * 1e9,
        "dropped": server.dropped_by_kernel() / took * 1e9,
        "received": received / ticks,
        "rate": ticks / took * 1e9,
        "p50": statistics.median(reads) / 1e3,
        "max": statistics.quantiles(reads, n=1000)[-1] / 1e3,
    }
    server.close()
    client.close()
    return result


def flood(port: int, connection: bytes) -> None:
    """Send forged datagrams to a port of the loopback until killed."""
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.connect(("127.0.0.1", port))
    print("begun", flush=True)
    number = 2**60
    while True:
        number += 1
        try:
            one.send(b"\x01" + connection + number.to_bytes(8, "big") + bytes(56))
        except ConnectionRefusedError:  # nobody has the port: the kernel says so
            continue


def main() -> None:
    """Measure, and print two tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--flood", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--connection", type=bytes.fromhex, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.flood:
        flood(arguments.flood, arguments.connection)
    widths = (1, 3, 50)
    columns = [costs(width, arguments.rounds, arguments.count) for width in widths]
    print(f"| us of processor time, ports: | {' | '.join(map(str, widths))} |\n|---|---|---|---|")
    for name in columns[0]:
        print(f"| {name} | {' | '.join(f'{column[name]:.1f}' for column in columns)} |")
    heads = ("flood", "dropped by the kernel/s", "refused/s", "own waves received", "read p50, p99.9, us", "ticks/s")
    print(f"\n| {' | '.join(heads)} |")
    print("|---|---|---|---|---|---|")
    for kind in ("none", "stranger", "forger"):
        one = flooded(kind, arguments.seconds)
        print(
            f"| {kind} | {one['dropped']:.0f} | {one['refused']:.0f} | {one['received']:.1%} | "
            f"{one['p50']:.0f}, {one['max']:.0f} | {one['rate']:.0f} |"
        )


if __name__ == "__main__":
    main()
