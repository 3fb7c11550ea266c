"""``make nat``: a guest, a host, or both behind routers that translate addresses, in namespaces with nftables.

    python -m tests.deployed.router

The WAN is that of `make wan`: two namespaces with a wire that delays, jitters and loses. Here these two are routers,
and guest and host are in further namespaces behind them. A router lets nothing in that nobody inside has asked for, and
gives every flow another port (nftables, masquerade fully-random). Its counters say which datagrams have passed.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from tests.deployed.checks import Checks, must, require_programs, require_root
from tests.support.wan import Refused, Side, Wan, Wire, open_wan
from tests.system.test_seats import Host, guest, hosted

WIRE: Final = Wire(delay=0.02, jitter=0.005, loss=0.01)
PORT: Final = 7400
PORTS: Final = f"{PORT}-{PORT + 2}"
SEAT: Final = "right_seat"
TICKS: Final = 3000
_TIMEOUT: Final = 5.0  # s, for a host at which nobody answers

_INSIDE: Final[dict[Side, str]] = {"near": "192.168.7", "far": "192.168.1"}
"""The addresses behind the router of a side: .1 is the router's, .2 that of who is behind it."""

_RULES: Final = """
table ip nat {{
    chain prerouting {{ type nat hook prerouting priority dstnat; {forwarded} }}
    chain postrouting {{ type nat hook postrouting priority srcnat; {translated} }}
}}
table ip filter {{
    counter udp_out {{ }}
    counter udp_in {{ }}
    counter udp_refused {{ }}
    chain forward {{
        type filter hook forward priority filter; policy drop;
        {blocked}
        iifname "inside" meta l4proto udp counter name udp_out accept
        iifname "inside" accept
        meta l4proto udp ct state established,related counter name udp_in accept
        ct state established,related accept
        {let_in}
    }}
}}
"""


class Router:
    """The router of one side, and the namespace behind it."""

    def __init__(self, one: Wan, side: Side, name: str) -> None:
        self._one, self._side, self._name = one, side, name
        self.address = one.address(side)
        self.inside = f"{_INSIDE[side]}.2"

    @property
    def within(self) -> list[str]:
        """What to put before a command so that it runs behind the router."""
        return ["ip", "netns", "exec", self._name]

    def rule(self, *, translates: bool = True, forwards: bool = False, datagrams: bool = True) -> None:
        """Set the router's rules anew; its counters begin at 0.

        Args:
            translates: whether it translates the addresses of what goes out.
            forwards: whether it lets the host's ports in.
            datagrams: whether it lets datagrams out.
        """
        to = f'iifname "wan" meta l4proto {{ tcp, udp }} th dport {PORTS}'
        text = _RULES.format(
            forwarded=f"{to} dnat to {self.inside};" if forwards else "",
            translated='oifname "wan" masquerade fully-random;' if translates else "",
            let_in=f"{to} accept" if forwards else "",
            blocked="" if datagrams else 'iifname "inside" meta l4proto udp counter name udp_refused drop',
        )
        must([*self._one.within(self._side), "nft", "flush", "ruleset"])
        must([*self._one.within(self._side), "nft", "-f", "-"], input=text)

    def passed(self) -> dict[str, int]:
        """How many datagrams it has let out and in, and how many it has refused."""
        text = must([*self._one.within(self._side), "nft", "list", "counters"])
        return {name: int(count) for name, count in re.findall(r"counter (udp_\w+) \{\s*packets (\d+)", text)}


@contextmanager
def router(one: Wan, side: Side) -> Iterator[Router]:
    """Make a side of the WAN a router, with a namespace behind it, while it is entered."""
    name, pair = f"mh-{os.getpid()}-{side}", f"mh{os.getpid() % 100000}{side[0]}"
    within, net = one.within(side), _INSIDE[side]
    must(["ip", "netns", "add", name])
    try:
        must(["ip", "-n", name, "link", "add", "eth0", "type", "veth", "peer", "name", pair])
        namespace = next(word.partition("=")[2] for word in within if word.startswith("--net="))
        must(["ip", "-n", name, "link", "set", pair, "netns", namespace])
        for words in (f"link set {pair} name inside", f"address add {net}.1/24 dev inside", "link set inside up"):
            must([*within, "ip", *words.split()])
        for words in (
            "link set lo up",
            f"address add {net}.2/24 dev eth0",
            "link set eth0 up",
            f"route add default via {net}.1",
        ):
            must(["ip", "-n", name, *words.split()])
        must([*within, "sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward"])
        yield Router(one, side, name)
    finally:
        subprocess.run(["ip", "netns", "delete", name], check=True)


def main() -> int:
    """Join across each kind of router; returns the exit code."""
    require_root()
    require_programs({"nft": "nftables", "ip": "iproute2", "ss": "iproute2", "nsenter": "util-linux"})
    checks = Checks()
    try:
        with tempfile.TemporaryDirectory(prefix="mh-nat-") as name, open_wan(WIRE) as one:
            folder = Path(name)
            with router(one, "far") as of_guest:
                _host_reachable(checks, one, of_guest, folder)
                with router(one, "near") as of_host:
                    _host_behind_one_as_well(checks, one, of_guest, of_host, folder)
    except Refused as reason:
        raise SystemExit(f"error: {reason}") from reason
    return checks.end()


def _host_reachable(checks: Checks, one: Wan, of_guest: Router, folder: Path) -> None:
    home = folder / "home"
    with hosted(home, f"{one.address('near')}:{PORT}", within=one.within("near")) as host:
        of_guest.rule()
        _joins(checks, "a guest behind a router", host, home, folder / "a", of_guest, seen_by=one)
        of_guest.rule(datagrams=False)
        _joins(
            checks, "behind a router that lets no datagrams out", host, home, folder / "b", of_guest, datagrams=False
        )
        of_guest.rule(translates=False)
        _cannot(
            checks,
            "behind a router that does not translate, no answer comes, and join says so",
            home,
            folder / "c",
            of_guest,
        )
        checks.that("the host ends on Ctrl-C", host.end(signal.SIGINT) == 130)


def _host_behind_one_as_well(checks: Checks, one: Wan, of_guest: Router, of_host: Router, folder: Path) -> None:
    home = folder / "behind"
    of_guest.rule()
    of_host.rule()
    public = f"{of_host.address}:{PORT}"
    with hosted(home, f"{of_host.inside}:{PORT}", "--address", public, within=of_host.within) as host:
        _cannot(
            checks,
            "a host behind a router that forwards nothing is not reached, and join says so",
            home,
            folder / "d",
            of_guest,
        )
        of_host.rule(forwards=True)
        _joins(checks, f"with the ports {PORTS} forwarded to the host", host, home, folder / "e", of_guest)
        checks.that("that host ends on Ctrl-C", host.end(signal.SIGINT) == 130)


def _others(one: Wan) -> set[str]:
    """The addresses that are connected to the host's ports, but for its own."""
    ports = f"( sport >= :{PORT} and sport <= :{PORT + 2} )"
    lines = must([*one.within("near"), "ss", "-Htn", "state", "established", ports]).splitlines()
    return {line.split()[-1].rpartition(":")[0] for line in lines} - {one.address("near")}


def _joins(
    checks: Checks,
    what: str,
    host: Host,
    home: Path,
    machine: Path,
    of_guest: Router,
    *,
    datagrams: bool = True,
    seen_by: Wan | None = None,
) -> None:
    """A guest takes the seat and stays for some seconds."""
    with guest(SEAT, home, machine, "--yes", within=of_guest.within) as one:
        line = one.until(f"{SEAT}: in, at")
        host.joined(SEAT)
        before = of_guest.passed()
        host.go_on(TICKS)
        if seen_by is not None:
            others = _others(seen_by)
            own = of_guest.address
            checks.that("the host sees the router's address alone", others == {own}, ", ".join(sorted(others)))
        counts = {name: count - before[name] for name, count in of_guest.passed().items()}
        code = one.end(signal.SIGINT)
    host.left(SEAT)
    checks.that(
        f"{what}: it is in, and out on Ctrl-C", code == 130, line.partition(", ")[2].replace("; Ctrl-C leaves", "")
    )
    out, back, refused = (counts[f"udp_{way}"] for way in ("out", "in", "refused"))
    if datagrams:
        right = out > TICKS / 2 and back > TICKS / 2
        checks.that(f"{what}: the waves of {TICKS} ticks go by datagrams, both ways", right, f"{out} out, {back} in")
    else:
        right = refused > 0 and out == back == 0
        checks.that(f"{what}: no datagram passes, and ZeroMQ brings the waves", right, f"{refused} refused")


def _cannot(checks: Checks, what: str, home: Path, machine: Path, of_guest: Router) -> None:
    """A guest cannot reach the host."""
    options = ("--yes", "--timeout", f"{_TIMEOUT:g}")
    with guest(SEAT, home, machine, *options, within=of_guest.within) as one:
        code = one.end()
    errors = [line for line in one.lines if line.startswith("error: ")]
    checks.that(what, code != 0 and len(errors) == 1, errors[0] if errors else f"exit code {code}: {one.lines}")


if __name__ == "__main__":
    raise SystemExit(main())
