"""Example 1 in real time while a rogue in a second process sends as fast as it can: what the honest nodes feel of it.

    python benchmarks/flood.py [--rounds N] [--seconds S] [--json FILE]

Every round runs the session once without a rogue and once with each, in a shuffled order, over encrypted TCP on the
loopback. The figure is the median over the rounds of the devices' median tau (from sampling x to applying f_v), and its
ratio to the round without a rogue. ``spins`` is no attack: a process that only computes takes as much of a processor
from the session as any rogue on the same machine does, so that what is beyond it is the attack's own doing.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import secrets
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

from manyhands.launch.plan.keys import load_folder
from manyhands.launch.plan.topology import topology
from manyhands.launch.session import load_session
from manyhands.protocol.codec import encode
from manyhands.protocol.keys import KeyPair, new_pair
from manyhands.protocol.messages import Figures, Telemetry

MANYHANDS = [sys.executable, "-P", "-m", "manyhands"]
JUNK = b"\xc1" + bytes(63)
OBSERVER = "watch"
EVERY = 1.0  # s, between two words of a rogue on how much it has sent


# --- the rogues: each sends for ever, and reports how many frames or connections it has tried


def keyed(kind: int, endpoint: str, server: str, pair: KeyPair) -> zmq.Socket[bytes]:
    """A connected socket that proves ``pair`` to the holder of ``server``."""
    one = zmq.Context.instance().socket(kind)
    one.setsockopt(zmq.LINGER, 0)
    one.curve_serverkey = server.encode()
    one.curve_publickey = pair.public.encode()
    one.curve_secretkey = pair.secret.encode()
    one.connect(endpoint)
    return one


def knocks(endpoints: list[str]) -> Callable[[], int]:
    """Opens TCP connections, sends bytes that are no greeting, and leaves."""
    addresses = [(e.split("//")[1].split(":")[0], int(e.rsplit(":", 1)[1])) for e in endpoints]

    def step() -> int:
        for address in addresses:
            try:
                with socket.create_connection(address, timeout=0.05) as one:
                    one.send(JUNK)
            except OSError:
                continue  # the door is shut
        return len(addresses)

    return step


def opens(endpoints: list[str]) -> Callable[[], int]:
    """Opens TCP connections and leaves them open, as many as the system lets it."""
    held: list[socket.socket] = []
    addresses = [(e.split("//")[1].split(":")[0], int(e.rsplit(":", 1)[1])) for e in endpoints]

    def step() -> int:
        for address in addresses:
            try:
                held.append(socket.create_connection(address, timeout=0.05))
            except OSError:
                while held:
                    held.pop().close()
        return len(addresses)

    return step


def handshakes(endpoints: dict[str, str], servers: dict[str, str]) -> Callable[[], int]:
    """Proves new unknown keys without end."""

    def step() -> int:
        for name, endpoint in endpoints.items():
            one = keyed(zmq.PAIR, endpoint, servers[name], new_pair())
            one.poll(2)
            one.close()
        return len(endpoints)

    return step


def floods(one: zmq.Socket[bytes], frames: list[bytes]) -> Callable[[], int]:
    """Sends frames on one connection as fast as they are taken."""

    def step() -> int:
        sent = 0
        for frame in frames:
            try:
                one.send(frame, zmq.NOBLOCK)
                sent += 1
            except zmq.Again:
                time.sleep(0)  # its own queue is full: the receiver does not read that fast
        return sent

    return step


def rogue(kind: str, folder: Path, port: int) -> None:
    """Be the rogue ``kind``, until killed."""
    session = load_session(folder / "session.yaml")
    keys = load_folder(session, folder / "keys")
    public = keys.public.keys
    graph = topology(session)
    hub = f"tcp://127.0.0.1:{port}"
    links = {link.binder: f"tcp://127.0.0.1:{port + 1 + i}" for i, link in enumerate(graph.links)}
    links["cx"] = next(
        f"tcp://127.0.0.1:{port + 1 + i}"
        for i, link in enumerate(graph.links)
        if (link.binder, link.connector) == ("cx", "dx")
    )
    observer = f"tcp://127.0.0.1:{port + 1 + len(graph.links)}"
    doors = [hub, *links.values()]
    telemetry = encode(Telemetry(1, Figures(), {}))
    step: Callable[[], int]
    match kind:
        case "spins":
            step = lambda: sum(range(100)) * 0  # noqa: E731
        case "knocks":
            step = knocks(doors)
        case "opens":
            step = opens(doors)
        case "unknown-keys":
            step = handshakes({"supervisor": hub, **links}, dict(public))
        case "neighbour":  # dy's key at the link that is dx's: refused again and again
            step = floods(keyed(zmq.PAIR, links["cx"], public["cx"], keys.pair("dy")), [JUNK] * 100)
        case "second-dx":  # dx's own key, stolen: the link has its peer
            step = floods(keyed(zmq.PAIR, links["cx"], public["cx"], keys.pair("dx")), [JUNK] * 100)
        case "member":  # dz's key at the hub: junk, and telemetry in between
            step = floods(keyed(zmq.DEALER, hub, public["supervisor"], keys.pair("dz")), [JUNK, telemetry] * 50)
        case "observer-hub":
            step = floods(keyed(zmq.DEALER, hub, public["supervisor"], keys.pair(OBSERVER)), [JUNK] * 100)
        case "observer-link":
            step = floods(keyed(zmq.PAIR, observer, public["supervisor"], keys.pair(OBSERVER)), [JUNK] * 100)
        case _:
            raise SystemExit(f"found the rogue {kind!r}; expected one of {', '.join(ROGUES)}")
    total, began = 0, time.monotonic()
    told = began
    while True:
        total += step()
        now = time.monotonic()
        if now - told > EVERY:
            told = now
            print(total / (now - began), flush=True)


ROGUES = (
    "spins", "knocks", "opens", "unknown-keys", "neighbour", "second-dx", "member", "observer-hub", "observer-link",
)  # fmt: skip


# --- the measurement


def free_port() -> int:
    """The first of a dozen ports that are free now."""
    while True:
        first = secrets.choice(range(20000, 30000))
        try:
            for port in range(first, first + 12):
                with socket.socket() as one:
                    one.bind(("127.0.0.1", port))
        except OSError:
            continue
        return first


def one_run(folder: Path, kind: str | None, seconds: float) -> dict[str, Any]:
    """One session, with a rogue from its first tick to its last or without; the report and the rogue's rate."""
    port, report = free_port(), folder / "report.json"
    launch = subprocess.Popen(  # noqa: S603 -- our own command
        [*MANYHANDS, "launch", str(folder / "session.yaml"), "--transport", "tcp", "--listen", f"127.0.0.1:{port}",
         "--keys", str(folder / "keys"), "--certificate", str(folder / "certificate.json"),
         "--duration", str(seconds), "--report", str(report)],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    lines: list[str] = []
    attacker = None
    for line in launch.stderr or ():
        lines.append(line)
        if ": running" in line and attacker is None and kind is not None:
            attacker = subprocess.Popen(  # noqa: S603 -- this very script
                [sys.executable, __file__, "--rogue", kind, "--folder", str(folder), "--port", str(port)],
                stdout=subprocess.PIPE, text=True,
            )  # fmt: skip
    code = launch.wait()
    rate = 0.0
    if attacker is not None:
        attacker.kill()
        told = attacker.communicate()[0].split()
        rate = float(told[-1]) if told else 0.0
    if code:
        raise SystemExit(f"{kind}: the session ended with exit code {code}:\n{''.join(lines)}")
    return {**json.loads(report.read_text()), "rate": rate}


def figures(report: dict[str, Any]) -> dict[str, Any]:
    """What is compared: tau of the devices (us), late ticks, the least ledger of anybody (J), and what was refused."""
    devices = [node for node in report["nodes"].values() if node["role"] == "device"]
    refused: dict[str, int] = dict(report.get("refused", {}))
    for node in report["nodes"].values():
        for group in ("refused", "dropped"):
            for name, count in node.get(group, {}).items():
                refused[name] = refused.get(name, 0) + count
    return {
        "tau_p50": statistics.median(device["tau_us"]["p50"] for device in devices),
        "tau_p99": statistics.median(device["tau_us"]["p99"] for device in devices),
        "late": sum(device["late"] for device in devices) / sum(device["ticks"] for device in devices),
        "ticks": min(device["ticks"] for device in devices),
        "ledger": min(node["ledger"]["min"] for node in report["nodes"].values()),
        "rate": report["rate"],
        "refused": refused,
    }


def main() -> None:
    """Measure, print a table, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--kinds", nargs="*", default=list(ROGUES))
    parser.add_argument("--rogue", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--port", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.rogue:
        rogue(arguments.rogue, arguments.folder, arguments.port)
    shipped = Path(__file__).parents[1] / "launch" / "sessions" / "example1.yaml"
    runs: dict[str, list[dict[str, Any]]] = {name: [] for name in ("alone", *arguments.kinds)}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "session.yaml").write_text(
            f"{shipped.read_text()}\nobservers: {{{OBSERVER}: {{reads: [telemetry]}}}}\ncolocate: false\n"
        )
        for command, option, target in (("invite", "--keys", "keys"), ("design", "-o", "certificate.json")):
            subprocess.run(  # noqa: S603 -- our own command
                [*MANYHANDS, command, str(folder / "session.yaml"), option, str(folder / target)],
                check=True,
                capture_output=True,
            )
        shuffler = random.Random(0)  # noqa: S311 -- an order, no secret
        for number in range(arguments.rounds):
            order = list(runs)
            shuffler.shuffle(order)
            for name in order:
                found = figures(one_run(folder, None if name == "alone" else name, arguments.seconds))
                runs[name].append(found)
                print(f"round {number + 1}: {name}: {found}", file=sys.stderr, flush=True)
    table(runs, arguments.rounds, arguments.seconds)
    if arguments.json is not None:
        content = {"rounds": arguments.rounds, "seconds": arguments.seconds, "cores": os.cpu_count(), "runs": runs}
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


def table(runs: dict[str, list[dict[str, Any]]], rounds: int, seconds: float) -> None:
    """Print medians over the rounds, and the ratio of tau to the same round without a rogue (and its range)."""
    print(f"{rounds} rounds of {seconds:g} s, {os.cpu_count()} cores; medians")
    print(
        "| rogue | tries or frames a second | tau p50 [us] | ratio (range) | tau p99 [us] | late | least ledger [J] |"
    )
    print("|---|---|---|---|---|---|---|")
    for name, found in runs.items():
        ratios = [one["tau_p50"] / alone["tau_p50"] for one, alone in zip(found, runs["alone"], strict=True)]
        cell = f"{statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
        middle = {key: statistics.median(one[key] for one in found) for key in ("rate", "tau_p50", "tau_p99", "late")}
        print(
            f"| {name} | {middle['rate']:.0f} | {middle['tau_p50']:.0f} | {cell} | {middle['tau_p99']:.0f} | "
            f"{middle['late']:.1%} | {min(one['ledger'] for one in found):.2g} |"
        )


if __name__ == "__main__":
    main()
