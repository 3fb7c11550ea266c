"""Nodes and observers from outside: the invitation gives them a part in the session, or a clear error.

Real processes over real sockets. Nothing here waits for time to pass: guests try until the session is there, and a test
acts only at an event that was reported to it.
"""

from __future__ import annotations

import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import invite
from manyhands.launch.plan.keys import Keys, ephemeral, load_folder, make_keys
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.reach import Listen, reach
from manyhands.launch.plan.topology import roster
from manyhands.launch.run.directory import sweep_directories
from manyhands.launch.run.outcome import Outcome, Progress
from manyhands.launch.run.states import NodeState, SessionPhase
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import SUPERVISOR, load_session
from manyhands.nodes.link.process import EXIT_FAILED, EXIT_OK, EXIT_REFUSED
from manyhands.protocol.keys import save_private
from manyhands.protocol.transport.zeromq import ZmqTransport

from ..support.capture import free_ports
from ..support.commands import Command, read_until, run, started

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
OBSERVERS = """
observers:
  watch: {reads: [telemetry]}
  scope: {reads: [dx/sample, dx/force, cx/tool, cx/telemetry]}
"""
WATCH = {node: set[str]() for node in ("dx", "dy", "dz", "cx", "cy", "cz", "environment")}
SCOPE = {"dx": {"x", "f_v"}, "cx": {"p"}}
TICKS = 300  # the hands push from 100 on
PORTS = 16
PATIENCE = 60.0  # s; far more than anything here takes


@dataclass(frozen=True)
class Home:
    """The machine that launches a session.

    Attributes:
        folder: session file, certificate, keys.
        prepared: the session under its certificate.
        keys: its keys.
    """

    folder: Path
    prepared: Prepared
    keys: Keys

    def invited(self, name: str, folder: Path, clock: str = "simulated", keyed: bool = True) -> None:
        """Give a machine what it needs to join as ``name``, and nothing else."""
        invite(self.prepared, name, self.keys if keyed else None, clock, folder / f"{name}.bundle")
        if keyed:
            shutil.copy(self.folder / "keys/private" / f"{name}.key", folder)

    def supervisor(
        self,
        listen: Listen,
        *remote: str,
        clock: str = "simulated",
        ticks: int = 0,
        keyed: bool = True,
        show: Callable[[Progress], None] | None = None,
    ) -> Supervisor:
        keys = self.keys if keyed else None
        ways = reach(self.prepared, "tcp", insecure=not keyed, keys=keys, listen=listen, remote=frozenset(remote))
        return Supervisor(self.prepared, clock=clock, reach=ways, ticks=ticks, record=ticks > 0, show=show)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Home:
    """Example 1 with two observers."""
    folder = tmp_path_factory.mktemp("home")
    (folder / "session.yaml").write_text((SESSIONS / "example1.yaml").read_text() + OBSERVERS)
    run("design", folder / "session.yaml", "-o", folder / "c.json")
    run("invite", folder / "session.yaml", "--keys", folder / "keys")
    session = load_session(folder / "session.yaml")
    return Home(folder, prepare(session, folder / "c.json"), load_folder(session, folder / "keys"))


@pytest.fixture
def listen() -> Listen:
    return Listen("127.0.0.1", free_ports(PORTS)[0])


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A second machine."""
    folder = tmp_path / "machine"
    folder.mkdir()
    return folder


@contextmanager
def guest(name: str, machine: Path, listen: Listen, *options: str) -> Iterator[subprocess.Popen[str]]:
    """``manyhands node`` on another machine; killed if the test fails before it ends."""
    arguments = ["node", name, "--bundle", f"{name}.bundle", "--connect", f"tcp://{listen.host}:{listen.port}"]
    with Command(
        [*arguments, *options],
        cwd=machine,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        except BaseException:
            process.kill()
            raise


def end_of(process: subprocess.Popen[str]) -> tuple[int, str]:
    """A process's exit code and what it wrote to its error output."""
    _, err = process.communicate(timeout=PATIENCE)
    assert "Traceback" not in err
    return process.returncode, err.strip()


def once(when: Callable[[Progress], bool], then: Callable[[], object]) -> Callable[[Progress], None]:
    """Act at the first progress that meets a condition."""
    done: list[bool] = []

    def show(progress: Progress) -> None:
        if not done and when(progress):
            done.append(True)
            then()

    return show


def interrupt_when_ended(process: subprocess.Popen[str]) -> Callable[[Progress], None]:
    return once(lambda _: process.poll() is not None, lambda: os.kill(os.getpid(), signal.SIGINT))


def is_running(progress: Progress) -> bool:
    return progress.phase is SessionPhase.RUNNING and len(progress.telemetry) == len(WATCH)


def assert_as_simulated(outcome: Outcome, home: Home) -> None:
    assert outcome.faults == ()
    assert outcome.code == 0
    assert outcome.recording is not None
    expected = Simulation(home.prepared).run(TICKS)
    assert outcome.recording.x.tobytes() == expected.x.tobytes()
    assert outcome.recording.f_v.tobytes() == expected.f_v.tobytes()


def test_from_keys_to_a_run_with_a_guest(tmp_path: Path, machine: Path, listen: Listen) -> None:
    """As two people do it, by the command line alone; the private key has left the launching machine."""
    run("design", "example1.yaml", "-o", tmp_path / "c.json")
    run("invite", "example1.yaml", "--keys", tmp_path / "keys")
    invitation = ("--keys", tmp_path / "keys", "--certificate", tmp_path / "c.json", "--clock", "simulated")
    run("invite", "example1.yaml", "dx", *invitation, "-o", machine / "dx.bundle")
    (tmp_path / "keys/private/dx.key").rename(machine / "dx.key")
    launch = (
        *("launch", "example1.yaml", "--transport", "tcp", "--listen", f"{listen.host}:{listen.port}"),
        *("--remote", "dx", *invitation, "--duration", str(TICKS / 1000)),
        *("--record", tmp_path / "run.npz", "--report", tmp_path / "run.json"),
    )
    with started(*launch) as launched, guest("dx", machine, listen) as dx:
        assert end_of(dx) == (EXIT_OK, "")
        assert end_of(launched)[0] == EXIT_OK
    run(
        "simulate",
        "example1.yaml",
        "--certificate",
        tmp_path / "c.json",
        "--duration",
        str(TICKS / 1000),
        "--record",
        tmp_path / "s.npz",
    )
    with np.load(tmp_path / "run.npz") as found, np.load(tmp_path / "s.npz") as expected:
        assert np.max(np.abs(expected["x"])) > 0.0
        for signal_name in ("x", "f_v", "ports", "certificate"):
            assert found[signal_name].tobytes() == expected[signal_name].tobytes()
    report = json.loads((tmp_path / "run.json").read_text())
    assert {name: node["ticks"] for name, node in report["nodes"].items()} == dict.fromkeys(WATCH, TICKS)
    assert "refused" not in report
    assert sorted(path.name for path in machine.iterdir()) == ["dx.bundle", "dx.key"]


@pytest.mark.parametrize(
    ("names", "keyed"),
    [(("dx", "dz"), False), (("cx", "environment"), True)],
    ids=["devices, insecure", "those others connect to"],
)
def test_several_guests_give_the_simulations_numbers(
    names: tuple[str, ...], keyed: bool, home: Home, machine: Path, listen: Listen
) -> None:
    with ExitStack() as stack:
        guests = []
        for name in names:
            home.invited(name, machine, keyed=keyed)
            guests.append(stack.enter_context(guest(name, machine, listen, "--address", "127.0.0.1")))
        outcome = home.supervisor(listen, *names, ticks=TICKS, keyed=keyed).run()
        assert [end_of(process) for process in guests] == [(EXIT_OK, "")] * len(names)
    assert_as_simulated(outcome, home)
    assert outcome.refused == {}


def observations(process: subprocess.Popen[str]) -> Iterator[dict[str, Any]]:
    assert process.stdout is not None
    for line in process.stdout:
        yield json.loads(line)


def seen(process: subprocess.Popen[str], nodes: set[str]) -> list[dict[str, Any]]:
    """What an observer prints until it has seen each of ``nodes``."""
    lines, left = [], set(nodes)
    for line in observations(process):
        lines.append(line)
        left.discard(line["node"])
        if not left:
            return lines
    raise AssertionError(f"it ended with {process.wait()} before it had seen {left}")


def test_observers_get_exactly_what_their_role_lists_and_come_and_go(home: Home, machine: Path, listen: Listen) -> None:
    for name in ("dx", "watch", "scope"):
        home.invited(name, machine)
    launch = (
        *("launch", home.folder / "session.yaml", "--transport", "tcp", "--keys", home.folder / "keys"),
        *("--certificate", home.folder / "c.json", "--clock", "simulated", "--remote", "dx"),
        *("--listen", f"{listen.host}:{listen.port}", "--report", machine / "run.json"),
    )
    visits: dict[str, list[dict[str, Any]]] = {"watch": [], "scope": []}
    with started(*launch) as launched, guest("dx", machine, listen) as dx:
        with guest("watch", machine, listen) as watch:
            for _ in range(2):
                with guest("scope", machine, listen) as scope:
                    visits["scope"] += seen(scope, set(SCOPE))
                    scope.send_signal(signal.SIGINT)
                    assert end_of(scope) == (128 + signal.SIGINT, "")
            visits["watch"] += seen(watch, set(WATCH))
            launched.send_signal(signal.SIGINT)
            assert end_of(launched)[0] == 128 + signal.SIGINT
            visits["watch"] += observations(watch)  # to the last one
            assert end_of(watch) == (EXIT_OK, "")  # the session is over: so is looking on
        assert end_of(dx) == (EXIT_OK, "")
    assert "refused" not in json.loads((machine / "run.json").read_text())
    for line in visits["watch"]:
        assert line["traces"] == {}
        assert line["figures"].keys() & {"speed", "ledger"}
    assert {line["node"] for line in visits["watch"]} == set(WATCH)
    for line in visits["scope"]:
        assert set(line["traces"]) == SCOPE[line["node"]]
        assert bool(line["figures"]) == (line["node"] == "cx")
    assert {line["node"] for line in visits["scope"]} == set(SCOPE)
    in_both = [line for line in visits["scope"] if line["node"] == "dx"]
    first = in_both[0]
    simulated = Simulation(home.prepared).run(first["tick"])
    for trace, expected in (("x", simulated.x), ("f_v", simulated.f_v)):
        found = np.array(first["traces"][trace])
        assert found.tobytes() == np.ascontiguousarray(expected[-len(found) :, :1]).tobytes()
    assert in_both[-1]["tick"] > first["tick"]


def test_a_killed_guest_ends_a_session_without_restarts(home: Home, machine: Path, listen: Listen) -> None:
    session = load_session(home.folder / "session.yaml", ["faults.restarts=0"])
    brittle = replace(home, prepared=replace(home.prepared, session=session))
    brittle.invited("dx", machine)
    with guest("dx", machine, listen) as dx:
        outcome = brittle.supervisor(listen, "dx", show=once(is_running, dx.kill)).run()
        assert end_of(dx) == (-signal.SIGKILL, "")
    assert outcome.code == 1
    assert outcome.faults == ("dx fell silent while running",)


def test_a_guest_that_is_interrupted_leaves_and_the_others_go_on(home: Home, machine: Path, listen: Listen) -> None:
    home.invited("dx", machine)
    seen_without: list[int] = []

    def show(progress: Progress) -> None:
        leave(progress)
        if progress.states["dx"] == NodeState.LOST.value:
            seen_without.append(progress.telemetry["dy"].tick)
            if seen_without[-1] > seen_without[0] + 100:
                end(progress)

    with guest("dx", machine, listen) as dx:
        leave = once(is_running, lambda: dx.send_signal(signal.SIGINT))
        end = once(lambda _: True, lambda: os.kill(os.getpid(), signal.SIGINT))
        outcome = home.supervisor(listen, "dx", show=show).run()
        assert end_of(dx) == (128 + signal.SIGINT, "")
    assert (outcome.code, outcome.faults) == (128 + signal.SIGINT, ())
    (incident,) = outcome.incidents
    assert re.fullmatch(r"at \S+ s: dx left after \d+ ticks", incident)
    ticks = {name: node["ticks"] for name, node in outcome.report["nodes"].items()}
    assert 0 < ticks["dx"] < ticks["dy"]


def test_a_guest_interrupted_before_the_first_tick_is_awaited_again(home: Home, machine: Path, listen: Listen) -> None:
    """It has joined and waits for a second guest that never comes."""
    home.invited("dx", machine)
    ended: list[tuple[int, str]] = []

    def show(progress: Progress) -> None:
        leave(progress)
        if progress.incidents:
            end(progress)

    with guest("dx", machine, listen) as dx:
        leave = once(lambda p: p.states["dx"] == NodeState.WELCOMED.value, lambda: dx.send_signal(signal.SIGINT))
        end = once(lambda _: True, lambda: ended.append(end_of(dx)) or os.kill(os.getpid(), signal.SIGINT))
        outcome = home.supervisor(listen, "dx", "dy", show=show).run()
    assert ended == [(128 + signal.SIGINT, "")]
    assert (outcome.code, outcome.faults) == (128 + signal.SIGINT, ())
    assert outcome.incidents == ("dx: its user ended it before the first tick; the session waits for dx again",)


@pytest.mark.alone
def test_ctrl_c_at_home_ends_the_guest(home: Home, machine: Path, listen: Listen) -> None:
    home.invited("dx", machine, clock="realtime")
    with guest("dx", machine, listen) as dx:
        interrupt = once(is_running, lambda: os.kill(os.getpid(), signal.SIGINT))
        outcome = home.supervisor(listen, "dx", clock="realtime", show=interrupt).run()
        assert end_of(dx) == (EXIT_OK, "")
    assert outcome.code == 130
    assert outcome.faults == ()
    assert set(outcome.report["nodes"]) == set(WATCH)


def test_a_guest_ends_when_the_supervisor_is_killed(home: Home, machine: Path, listen: Listen) -> None:
    home.invited("dx", machine)
    launch = (
        *("launch", home.folder / "session.yaml", "--transport", "tcp", "--keys", home.folder / "keys"),
        *("--certificate", home.folder / "c.json", "--clock", "simulated", "--remote", "dx"),
        *("--listen", f"{listen.host}:{listen.port}"),
    )
    with started(*launch) as launched, guest("dx", machine, listen) as dx:
        read_until(launched, ": running")
        nodes = [int(p) for p in Path(f"/proc/{launched.pid}/task/{launched.pid}/children").read_text().split()]
        assert len(nodes) == len(WATCH) - 1
        descriptors = [os.pidfd_open(pid) for pid in nodes]
        launched.kill()
        launched.communicate()
        assert end_of(dx) == (EXIT_FAILED, f"dx: lost the supervisor at tcp://{listen.host}:{listen.port}")
        for descriptor in descriptors:
            assert select.select([descriptor], [], [], PATIENCE)[0], "a node outlived its supervisor"
            os.close(descriptor)
    sweep_directories()  # as the next run does: the killed one could not remove its folder


def test_a_guest_with_another_certificate_gets_the_reason(home: Home, machine: Path, listen: Listen) -> None:
    home.invited("dx", machine)
    bundle = machine / "dx.bundle"
    bundle.write_text(bundle.read_text().replace(home.prepared.id, "0" * 64))
    with guest("dx", machine, listen) as dx:
        outcome = home.supervisor(listen, "dx").run()
        code, err = end_of(dx)
    text = (
        f"supervisor refused dx: found the certificate {'0' * 64}; expected {home.prepared.id}; "
        "start all nodes of the session from one certificate file, or have the invitation renewed"
    )
    assert (code, err) == (EXIT_REFUSED, text)
    assert outcome.faults == (text,)
    assert outcome.code == 1


def served(process: subprocess.Popen[str], listen: Listen, keys: Keys | None) -> tuple[int, str]:
    """The end of a guest at a supervisor with these keys (None: without) that answers and does nothing more."""
    ring = None if keys is None else keys.ring(SUPERVISOR, ["dx"])
    transport = ZmqTransport.tcp(ring)
    descriptor = os.pidfd_open(process.pid)
    try:
        hub, _ = transport.bind_hub("control", ["dx"], f"{listen.host}:{listen.port}")
        while descriptor not in hub.wait(None, [descriptor], frames=False):
            pass
    finally:
        os.close(descriptor)
        transport.close()
    return end_of(process)


def told(listen: Listen, trouble: str) -> tuple[int, str]:
    return EXIT_REFUSED, (
        f"dx: cannot join the supervisor at tcp://{listen.host}:{listen.port}: {trouble}; see that the session runs "
        "there, and that what you were given, bundle and key or invitation, is of its present keys"
    )


NOT_PROVED = "the other side does not hold the key expected of it, or one side is encrypted and the other is not"


def test_a_guest_with_an_outdated_key_gets_the_reason(
    home: Home, machine: Path, listen: Listen, tmp_path: Path
) -> None:
    shutil.copytree(home.folder / "keys", tmp_path / "keys")
    make_keys(home.prepared.session, tmp_path / "keys", renew=["dx"])
    home.invited("dx", machine)
    with guest("dx", machine, listen) as dx:
        found = served(dx, listen, load_folder(home.prepared.session, tmp_path / "keys"))
    assert found == told(listen, "the other side does not admit this key")


def test_a_guest_does_not_join_somebody_elses_supervisor(home: Home, machine: Path, listen: Listen) -> None:
    """A supervisor that knows the guest's key, and has a key of its own."""
    home.invited("dx", machine)
    impostor = ephemeral(roster(home.prepared.session), home.prepared.session.name)
    (machine / "dx.key").unlink()
    save_private(impostor.pair("dx"), home.prepared.session.name, "dx", machine / "dx.key")
    bundle = machine / "dx.bundle"
    bundle.write_text(
        bundle.read_text().replace(home.keys.public.keys["dx"], impostor.public.keys["dx"])  # the supervisor's stays
    )
    with guest("dx", machine, listen) as dx:
        assert served(dx, listen, impostor) == told(listen, NOT_PROVED)


@pytest.mark.parametrize("keyed", [True, False], ids=["keyed guest", "plain guest"])
def test_plain_and_encrypted_do_not_meet(keyed: bool, home: Home, machine: Path, listen: Listen) -> None:
    home.invited("dx", machine, keyed=keyed)
    with guest("dx", machine, listen) as dx:
        assert served(dx, listen, None if keyed else home.keys) == told(listen, NOT_PROVED)


def test_where_nobody_listens_a_guest_gives_up_in_the_end(home: Home, machine: Path, listen: Listen) -> None:
    """After a minute; here the timeout is a hundredth of that."""
    home.invited("dx", machine)
    impatient = (
        "import sys\n"
        "from pathlib import Path\n"
        "from manyhands.nodes.guest import remote as guest\n"
        "from manyhands.nodes.link import supervisor_line as control\n"
        "control._JOINING_WAITS //= 100\n"
        "sys.exit(guest.join('dx', Path('dx.bundle'), None, sys.argv[1], None))\n"
    )
    endpoint = f"tcp://{listen.host}:{listen.port}"
    command = [sys.executable, "-P", "-c", impatient, endpoint]
    done = subprocess.run(command, cwd=machine, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr.strip()) == told(listen, "nobody listens there")
