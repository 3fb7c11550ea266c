"""Guests at the seats of a hosted session: an invitation is all they need, and nobody feels them come or go.

Real processes over encrypted TCP and datagrams. Nothing here waits for time to pass, except for a hand to push: a test
acts when the host or a guest has said something.
"""

from __future__ import annotations

import json
import os
import random
import re
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from manyhands.launch.recordings.run import read_run, rows_of
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.wave_link.felt import round_trip, stiffness_and_mass
from manyhands.protocol.channels import ACCOUNT, ORIENTATION, TORQUE
from tests.support.slot import slot

from ..support.capture import free_ports
from ..support.commands import MANYHANDS, Command, manyhands_command
from ..support.wan import Wire, wan

DEADLINE = 60.0  # s, for anything that is awaited; far more than it takes
SEATS = {"left_seat": "left", "right_seat": "right"}
PROMISE = -1e-12  # J
PERIOD = 1e-3  # s
FELT = 0.1  # N; less would be no session worth a bound
STEP = 0.2  # N in a tick; the hands push with 1.5 N, which a user would feel at once if it were dropped
RATE = 300.0  # N/s: twice the coupling's 525 N/m at the hands' 0.2 m/s, with the ramp of 2 N in 0.1 s


class Said:
    """A command's error output, line by line, as far as it has been read."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process, self.lines = process, list[str]()
        self._unread = b""

    def until(self, words: str) -> str:
        """Read up to the line with ``words``; returns that line."""
        end = time.monotonic() + DEADLINE
        while words not in (line := self.line(end)):
            continue
        return line

    def line(self, end: float) -> str:
        """The next line, which must come before ``end``."""
        assert self.process.stderr is not None
        while b"\n" not in self._unread:
            left = end - time.monotonic()
            ready = left > 0 and select.select([self.process.stderr], [], [], left)[0]
            assert ready, f"what was awaited did not come within {DEADLINE} s, but: {self.lines}"
            chunk = os.read(self.process.stderr.fileno(), 65536)
            assert chunk, f"it ended with {self.process.wait()}, and said: {self.lines}"
            self._unread += chunk
        first, _, self._unread = self._unread.partition(b"\n")
        self.lines.append(first.decode())
        return self.lines[-1]

    def end(self, how: signal.Signals | None = None) -> int:
        """Send a signal, if any, and wait for the end; returns the exit code."""
        if how is not None:
            self.process.send_signal(how)
        _, rest = self.process.communicate(timeout=DEADLINE)
        self.lines += (self._unread + rest).decode().splitlines()
        assert "Traceback" not in "\n".join(self.lines), "\n".join(self.lines)
        return self.process.returncode


class Host(Said):
    """A hosted session, and who is there, as it has reported so far.

    Attributes:
        there: the nodes of seats that take part.
        tick: the tick that it reported last.
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        super().__init__(process)
        self.there, self.tick = set[str](), 0

    def line(self, end: float) -> str:
        """As :meth:`Said.line`; what it says of users and ticks is noted."""
        line = super().line(end)
        if found := re.match(r"(?:! )?at ([\d.]+) s: (\w+) (has joined)?", line):
            (self.there.add if found[3] else self.there.discard)(found[2])
        if found := re.match(r"running: tick (\d+)", line):
            self.tick = int(found[1])
        return line

    def joined(self, *seats: str) -> None:
        """Wait until the users of these seats are there."""
        self._until(lambda: self.there.issuperset({node for seat in seats for node in (seat, SEATS[seat])}))

    def left(self, *seats: str) -> None:
        """Wait until the users of these seats are away."""
        self._until(lambda: self.there.isdisjoint({node for seat in seats for node in (seat, SEATS[seat])}))

    def go_on(self, ticks: int) -> None:
        """Wait until the session is this many ticks further."""
        assert self.process.stderr is not None
        while b"\n" in self._unread or select.select([self.process.stderr], [], [], 0.0)[0]:
            self.line(time.monotonic() + DEADLINE)  # a line that was on its way is not news
        since = self.tick
        self._until(lambda: self.tick >= since + ticks)

    def _until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + DEADLINE
        while not done():
            self.line(end)


@contextmanager
def command(
    *arguments: str | Path,
    cwd: Path,
    within: Sequence[str] = (),
    answer: str | None = None,
    program: Sequence[str] = MANYHANDS,
) -> Iterator[subprocess.Popen[bytes]]:
    """A command that runs beside the test; killed if the test fails before it ends.

    Its input has the line ``answer``; an empty one never comes, and without one there is no input.
    """
    kind, first = (Command, ()) if program is MANYHANDS and not within else (subprocess.Popen, (*within, *program))
    with kind(
        [*first, *map(str, arguments)],
        cwd=cwd,
        stdin=subprocess.DEVNULL if answer is None else subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        bufsize=0,
    ) as process:
        try:
            if answer is not None:
                assert process.stdin is not None
                process.stdin.write(answer.encode())
                if answer:
                    process.stdin.close()
                    process.stdin = None
            yield process
        except BaseException:
            process.kill()
            raise


@contextmanager
def hosted(
    folder: Path, address: str, *options: str | Path, within: Sequence[str] = (), session: str = "ball"
) -> Iterator[Host]:
    """A session with seats, the shipped one, running; its files are in ``folder``."""
    folder.mkdir(exist_ok=True)
    options = ("--report", "run.json", *options)
    with command("host", session, "--listen", address, "-o", "ball", *options, cwd=folder, within=within) as one:
        host = Host(one)
        host.until(": running")
        yield host


def invitation_to(seat: str, home: Path, machine: Path) -> Path:
    """Hand an invitation over to another machine; returns its file there."""
    machine.mkdir(exist_ok=True)
    path = machine / f"{seat}.invitation"
    path.touch(mode=0o600)
    path.write_bytes((home / "ball" / path.name).read_bytes())
    return path


@contextmanager
def guest(seat: str, home: Path, machine: Path, *options: str, within: Sequence[str] = ()) -> Iterator[Said]:
    path = invitation_to(seat, home, machine)
    with command("join", path.name, *(options or ("--yes",)), cwd=machine, within=within) as one:
        yield Said(one)


def kept(home: Path) -> dict[str, bytes]:
    """The certificates of the hosted session."""
    return {path.name: path.read_bytes() for path in (home / "ball").glob("certificate*.json")}


def report_of(home: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((home / "run.json").read_text())
    return found


def excess_steps(home: Path) -> dict[str, float]:
    """By device, by how much the largest step of the force on its hand exceeds the bound, N; a hand away feels 0 N."""
    recorded, found = read_run(home / "run.mcap"), {}
    for device in SEATS.values():
        force = recorded.traces[device, "force"].values[:, 0]
        instants = recorded.traces[device, "instants"]
        sampled, applied = (instants.values[:, instants.columns.index(at)] * 1e-9 for at in ("sampled", "applied"))
        # a late tick brings the step of all the time since the sample before
        elapsed = np.nan_to_num(applied[1:] - sampled[:-1], nan=PERIOD)
        steps = np.abs(np.diff(np.nan_to_num(force)))
        assert np.nanmax(np.abs(force)) > FELT, f"{device} felt nothing"
        found[device] = float(np.max(steps - STEP - RATE * elapsed))
    return found


def require_sound(home: Path, certificates: dict[str, bytes]) -> dict[str, Any]:
    """What holds after every hosting; returns its report."""
    assert kept(home) == certificates
    report = report_of(home)
    assert all(node["ledger"]["margin"] >= PROMISE for node in report["nodes"].values() if "ledger" in node)
    assert all(node["interface"]["margin"] >= PROMISE for node in report["nodes"].values() if "interface" in node)
    assert max(excess_steps(home).values()) <= 0.0
    return report


def require_unaccused(recording: Path) -> None:
    """The audit accuses nobody: a busy machine is late, which is enforced, and rows that were lost are not checked."""
    told = json.loads(manyhands_command("audit", recording, "--json").stdout)
    innocent = ("holds", "enforced", "missing", "unchecked")
    accused = [check for check in told["checks"] if check["verdict"] not in innocent]
    assert accused == []


@pytest.mark.alone
def test_two_guests_come_and_go_by_their_invitations_alone(tmp_path: Path) -> None:
    home, here, there = tmp_path / "home", tmp_path / "here", tmp_path / "there"
    address = f"127.0.0.1:{free_ports(4)[0]}"
    with ExitStack() as stack:
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", "--address", "localhost"))
        certificates = kept(home)
        assert certificates.keys() == {"certificate.json", *(f"certificate.{seat}.json" for seat in SEATS)}
        path = invitation_to("left_seat", home, here)
        asked = Said(stack.enter_context(command("join", path.name, cwd=here, answer="yes\n")))
        right = stack.enter_context(guest("right_seat", home, there))
        host.joined(*SEATS)
        for one in (asked, right):
            one.until(": in, ")
        host.go_on(3100)  # more than one line of progress, of which the last before may be a second old
        assert asked.end(signal.SIGINT) == 130
        host.left("left_seat")
        assert host.end(signal.SIGINT) == 130
        assert right.end() == 0
    for lines, seat in ((asked.lines, "left_seat"), (right.lines, "right_seat")):
        [entered] = [line for line in lines if line.startswith(f"{seat}: in, ")]
        assert re.fullmatch(
            r"\w+: in, at 1000 ticks a second, round trip R of about [\d.]+ ms; Ctrl-C leaves", entered.strip()
        )
        [gone] = [line for line in lines if line.startswith(f"{seat}: out, ")]
        assert float(gone.split("after ")[1].split()[0]) > 1.0
    felt = "".join(asked.lines)
    assert "take the seat left_seat? [y/N]" in felt
    assert "K = " in felt
    assert "M = " in felt
    report = require_sound(home, certificates)
    assert report["nodes"].keys() == {*SEATS, *SEATS.values(), ENVIRONMENT}
    visits = [re.sub(r"after \d+ ticks", "after some ticks", text.partition(": ")[2]) for text in report["visits"]]
    came = [f"{node} has joined" for nodes in SEATS.items() for node in nodes]
    assert sorted(visits) == sorted([*came, "left left after some ticks", "left_seat left after some ticks"])
    assert not any("has joined" in text or " left after " in text for text in report.get("incidents", ()))
    assert sorted(path.name for path in here.iterdir()) == ["left_seat.invitation"]
    # the seats were free at first, and one of them at the end: no tick is missing for that, where nothing was lost
    assert not [line for line in host.lines if "missing from the recording" in line]
    require_unaccused(home / "run.mcap")
    told = json.loads(manyhands_command("audit", home / "run.mcap", "--json").stdout)
    rows = {check["party"]: check["verdict"] for check in told["checks"] if check["name"] == "rows"}
    # what the left user's processes did in the last moments before they left may not have been told
    assert {rows[party] for party in ("environment", "right", "right_seat")} == {"holds"}


def test_an_invitation_outlives_every_change_of_the_session(tmp_path: Path) -> None:
    """The right user's stays good when the ball becomes heavier, and when its own device changes; it comes by paste."""
    home, there = tmp_path / "home", tmp_path / "there"
    address = f"127.0.0.1:{free_ports(4)[0]}"
    with hosted(home, address) as host:
        first = kept(home)
        assert host.end(signal.SIGINT) == 130
    line = (home / "ball" / "right_seat.invitation").read_text()
    there.mkdir()
    for change, anew in (
        ("environment.masses.ball=0.8", {"certificate.json"}),
        ("devices.right.osp=1.5", {"certificate.json", "certificate.right_seat.json"}),
    ):
        with ExitStack() as stack:
            host = stack.enter_context(hosted(home, address, "--set", change))
            assert any("designed anew, for the session has changed: " in line for line in host.lines)
            right = Said(stack.enter_context(command("join", "--yes", cwd=there, answer=line)))
            host.joined("right_seat")
            assert right.end(signal.SIGINT) == 130
            host.left("right_seat")
            assert host.end(signal.SIGINT) == 130
        now = kept(home)
        assert {name for name, content in now.items() if content != first[name]} == anew
        assert (home / "ball" / "right_seat.invitation").read_text() == line
        first = now
    assert list(there.iterdir()) == []
    secret = line.strip().rpartition("/")[2]
    assert not any(secret in said for said in (*host.lines, *right.lines))


PORT = 7400


@pytest.mark.long
@pytest.mark.alone
def test_across_a_wan_a_link_that_is_lost_for_a_while_comes_back(tmp_path: Path) -> None:
    """The right user is 20 ms away, and loses the network for one second, for six, and for 14."""
    home, far = tmp_path / "home", tmp_path / "far"
    with wan(Wire(delay=0.02, jitter=0.002, loss=0.01)) as net, ExitStack() as stack:
        address = f"{net.address('near')}:{PORT}"
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", within=net.within("near")))
        certificates = kept(home)
        stack.enter_context(guest("left_seat", home, tmp_path / "near", within=net.within("near")))
        right = stack.enter_context(guest("right_seat", home, far, within=net.within("far")))
        trip = float(right.until("round trip").split("about ")[1].split()[0])
        host.joined(*SEATS)
        host.go_on(2100)
        for outage in (1.0, 6.0, 14.0):
            net.change(loss=1.0)
            time.sleep(outage)
            net.change(loss=0.01)
            if outage > 3.0:
                host.left("right_seat")
                host.joined("right_seat")
            host.go_on(3000)
        assert right.end(signal.SIGINT) == 130
        host.left("right_seat")
        assert host.end(signal.SIGINT) == 130
    assert 40.0 < trip < 200.0
    assert sum("joining again" in line for line in right.lines) == 2, "the outage of a second was no reason to leave"
    report = require_sound(home, certificates)
    assert report["wave_links"]["right_seat"]["silences"] > 0
    assert report["wave_links"]["right_seat"]["mass"] < 0.5
    require_unaccused(home / "run.mcap")


@pytest.mark.long
@pytest.mark.alone
def test_a_guest_turns_a_tool_of_an_engine_whose_seat_was_empty(tmp_path: Path) -> None:
    """What rides goes by datagrams with the waves; the world began with nobody at its tools."""
    pytest.importorskip("mujoco")
    home, far = tmp_path / "home", tmp_path / "far"
    home.mkdir()
    plain = slot(
        couplings={"seat": {"devices": ["pen"], "wave_link": {"b": 20}}},
        design={"coupling": "spring-damper", "tau": 0.001},
    )
    (home / "slot.yaml").write_text(yaml.safe_dump(plain))
    address = f"127.0.0.1:{free_ports(3)[0]}"
    with ExitStack() as stack:
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", session="slot.yaml"))
        pen = stack.enter_context(guest("seat", home, far))
        host.until("pen has joined")
        host.go_on(2100)
        assert pen.end(signal.SIGINT) == 130
        host.until("pen left")
        assert host.end(signal.SIGINT) == 130
    run = read_run(home / "run.mcap")
    turned, torque, account = (rows_of(run, "pen", trace) for trace in (ORIENTATION, TORQUE, ACCOUNT))
    assert np.nanmax(np.abs(torque)) > 0.01  # N·m: the slot holds it about z
    assert np.nanmax(np.abs(turned[:, 1])) > 0.1
    assert np.nanmin(account[:, 0] - account[:, 1] + account[:, 2]) >= PROMISE
    assert report_of(home)["nodes"]["pen"]["orientation"]["margin"] >= PROMISE
    require_unaccused(home / "run.mcap")


@pytest.mark.long
@pytest.mark.alone
def test_a_guest_is_told_the_round_trip_that_the_host_sees(tmp_path: Path) -> None:
    """That of `top` a moment later. On a busy machine it goes on changing, so it is one of those that were recorded."""
    home = tmp_path / "home"
    with wan(Wire(delay=0.02, jitter=0.005, loss=0.01)) as net, ExitStack() as stack:
        near, address = net.within("near"), f"{net.address('near')}:{PORT}"
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", within=near))
        right = stack.enter_context(guest("right_seat", home, tmp_path / "far", within=net.within("far")))
        told = right.until("both ends measure")
        look = [*near, *MANYHANDS, "top", "--once", "--json"]
        top = json.loads(subprocess.run(look, check=True, capture_output=True, cwd=home).stdout)["wave_links"]
        assert right.end(signal.SIGINT) == 130
        assert host.end(signal.SIGINT) == 130
    assert not any("no datagram comes through" in line for line in right.lines)
    R, K, M = (float(figure) for figure in re.findall(r"(?:R of|K =|M =) ([\d.]+)", told))
    assert R > 40.0, "it is no shorter than the network's"
    figures = read_run(home / "run.mcap").figures
    seen = []
    for tick, user in figures["right_seat"]:
        _, world = min(figures[ENVIRONMENT], key=lambda told, at=tick: abs(told[0] - at))  # type: ignore[misc]
        seen.append(1e3 * round_trip("right_seat", user, world))
    assert min(abs(R - one) for one in seen) < 0.01 * R, seen
    b = load_named("ball").impedance_of("right_seat")
    assert b is not None
    assert pytest.approx(stiffness_and_mass(b, 1e-3 * R), rel=0.01) == (K, 1e-3 * M)
    assert top["right_seat"]["round_trip"] == pytest.approx(1e-3 * R, rel=0.3)


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.minutes
def test_twenty_joins_and_leaves_under_link_faults(tmp_path: Path) -> None:
    """At random instants, by Ctrl-C, by SIGTERM, by SIGKILL, and with a network that fails meanwhile."""
    home, chance = tmp_path / "home", random.Random(17)
    with wan(Wire(delay=0.01, jitter=0.005, loss=0.02)) as net, ExitStack() as stack:
        address = f"{net.address('near')}:{PORT}"
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", within=net.within("near")))
        certificates = kept(home)
        stack.enter_context(guest("left_seat", home, tmp_path / "near", within=net.within("near")))
        host.joined("left_seat")
        for _ in range(20):
            how = chance.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
            with guest("right_seat", home, tmp_path / "far", within=net.within("far")) as one:
                host.joined("right_seat")
                net.change(loss=chance.choice([0.0, 0.02, 0.1]), jitter=chance.choice([0.0, 0.005, 0.02]))
                time.sleep(chance.uniform(0.0, 2.0))  # the random instant, and the length of the fault
                if chance.random() < 0.3:
                    net.change(loss=1.0)
                    time.sleep(chance.uniform(0.2, 1.5))
                net.change(loss=0.02)
                code = one.end(how)
            assert code == (-how if how is signal.SIGKILL else 128 + how), one.lines
            host.left("right_seat")
        assert host.end(signal.SIGINT) == 130
        assert sorted(path.name for path in (tmp_path / "far").iterdir()) == ["right_seat.invitation"]
    require_sound(home, certificates)
    require_unaccused(home / "run.mcap")


PHASES = {
    "it fetches its part": "going to take the seat",
    "it measures": "a tick every",
    "it asks its user": "free space will weigh",
    "it joins": "joining; Ctrl-C leaves",
    "it takes part": "",
}
"""By phase of a guest, what it says when that begins; the host says the last."""


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.minutes
def test_a_guest_that_ends_in_any_phase_ends_its_own_part_alone(tmp_path: Path) -> None:
    """By Ctrl-C, SIGTERM, SIGKILL and the loss of its network; the seat is free then, and the left user goes on."""
    home, far = tmp_path / "home", tmp_path / "far"
    with wan(Wire(delay=0.01, jitter=0.002)) as net, ExitStack() as stack:
        address = f"{net.address('near')}:{PORT}"
        host = stack.enter_context(hosted(home, address, "--record", "run.mcap", within=net.within("near")))
        certificates = kept(home)
        stack.enter_context(guest("left_seat", home, tmp_path / "near", within=net.within("near")))
        host.joined("left_seat")
        for phase, words in PHASES.items():
            for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL, None):
                options = () if phase == "it asks its user" else ("--yes",)
                invitation_to("right_seat", home, far)
                with command(
                    "join", "right_seat.invitation", *options, cwd=far, within=net.within("far"), answer=""
                ) as process:
                    one = Said(process)
                    if words:
                        one.until(words)
                    else:
                        host.joined("right_seat")
                    if how is None:
                        net.change(loss=1.0)
                        time.sleep(4.0)  # longer than the silence after which a guest is away
                        net.change(loss=0.0)
                    code = one.end(how or signal.SIGINT)
                    assert code in (-9, 130, 143), (phase, how, one.lines)
                assert not any("error" in line for line in one.lines), (phase, how, one.lines)
                host.left("right_seat")
                assert {"left", "left_seat"} <= host.there, (phase, how)
        last = stack.enter_context(guest("right_seat", home, far, within=net.within("far")))
        host.joined(*SEATS)
        host.go_on(1000)
        assert last.end(signal.SIGINT) == 130
        assert host.end(signal.SIGINT) == 130
    assert "left" in require_sound(home, certificates)["nodes"]
