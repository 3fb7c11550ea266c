"""Which delay a command designs for: stated, measured, kept, of a certificate's file, or none."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from manyhands.launch.app import start
from manyhands.launch.app.cli import app
from manyhands.launch.doctor import probe
from manyhands.launch.doctor.probe import Way
from manyhands.launch.doctor.profile import Lateness, ProbeFailed, ProbeInterrupted, Profile, keep_profile, kept_profile
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.monitor.given import MEASURE

MEASURING = "example-1: measuring the delay of a tick on this machine for 2 s"
APART = ("--set", "colocate=false")  # what these tests expect does not depend on the processors of the machine
LAUNCH = ("launch", "example1", "--duration", "1", *APART)


@dataclass
class Machine:
    """A machine with these delays, which runs nothing.

    Attributes:
        p995: of the slowest device, us.
        p99: of each device in a run, us.
        guests_p99: of each device that is not on this machine, us; longer than any design covers.
        measured: the ways that were measured.
        ran: the sessions that were run.
        fails: what the probe raises.
    """

    p995: float = 680.0
    p99: float = 500.0
    guests_p99: float = 1e6
    measured: list[Way] = field(default_factory=list)
    ran: list[Prepared] = field(default_factory=list)
    fails: Exception | None = None

    def profile(self, plan: Plan, way: Way, measured: float) -> Profile:
        tau = Lateness(self.p995 / 2, self.p995, self.p995 * 2, self.p995 * 3)
        return Profile(way.profile_key(plan), tau, 1050.0, 0.0, 2.0, measured)

    def measure(self, plan: Plan, way: Way) -> Profile:
        self.measured.append(way)
        if self.fails is not None:
            raise self.fails
        return self.profile(plan, way, time.time())

    def run(self, prepared: Prepared, _console: object, ways: Reach, _options: object) -> Outcome:
        self.ran.append(prepared)
        nodes: dict[str, Any] = {}
        for name in prepared.session.devices:
            p99 = self.guests_p99 if name in ways.remote else self.p99
            tau = {"p50": 300.0, "p99": p99, "p999": 2000.0, "max": 3000.0}
            nodes[name] = {"role": "device", "ticks": 1000, "tau_us": tau}
        report = {"session": prepared.session.name, "duration": 1.0, "clock": "realtime", "nodes": nodes}
        return Outcome(0, (), (), report, None, {}, {})

    @property
    def tau(self) -> float:
        """The delay that the only run was certified for, s."""
        (prepared,) = self.ran
        assert prepared.certificate is not None
        assert prepared.session.design.tau == prepared.certificate.tau == prepared.loop.tau
        assert prepared.session.design.period_tolerance == prepared.certificate.period_tolerance
        return prepared.certificate.tau


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Machine:
    one = Machine()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(probe, "measure_profile", one.measure)
    monkeypatch.setattr(start, "run_session", one.run)
    return one


@pytest.fixture(autouse=True)
def own_interrupt() -> Iterator[None]:
    """The command line sets a handler for Ctrl-C, as befits a process of its own."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def command(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


SOFT = "the coupling is the limit (and 2 more ports)"


def lines(result: Result) -> list[str]:
    """What was said of delays: a coupling for a long one is soft, and a line more says so."""
    assert result.exit_code == 0, result.output
    return [line for line in result.stderr.splitlines() if not line.endswith(SOFT)]


def test_a_launch_in_real_time_is_designed_for_what_was_measured(machine: Machine) -> None:
    assert lines(command(*LAUNCH)) == [
        MEASURING,
        "example-1: certified for delays up to 0.75 ms and periods up to 1.1 ms (measured here, just now: p99.5 is "
        "0.68 ms); stiffness 289.7 N/m; the limit is 817.9 N/m for these and 2740 N/m without delay",
    ]
    assert machine.tau == 0.75e-3
    assert machine.ran[0].session.design.period_tolerance == 0.1
    assert [way.transport for way in machine.measured] == ["ipc"]


def test_the_next_launch_uses_the_profile_that_is_kept(machine: Machine) -> None:
    command(*LAUNCH)
    machine.ran.clear()
    (line,) = lines(command(*LAUNCH))
    assert "measured here, just now" in line
    assert (machine.tau, len(machine.measured)) == (0.75e-3, 1)


@pytest.mark.parametrize(("tau", "said"), [("0.0009", 1), ("0", 0)])
def test_a_launch_says_where_the_coupling_is_the_limit(tau: str, said: int, machine: Machine) -> None:
    found = command(*LAUNCH, "--set", f"design.tau={tau}").stderr.splitlines()
    about = [line for line in found if line.endswith(SOFT)]
    assert len(about) == said
    assert all("a contact of 3800 N/m will feel like" in line and "(and 1 more" not in line for line in about)


def test_an_old_profile_says_how_old_it_is(machine: Machine) -> None:
    plan = Plan(load_named("example1"))
    way = Way.of_run(plan)
    keep_profile(
        machine.profile(plan, way, time.time() - 3 * 3600.0),
    )
    (line,) = lines(command(*LAUNCH))
    assert "(measured here, 3 h ago: p99.5 is 0.68 ms)" in line
    keep_profile(machine.profile(plan, way, time.time() - 25 * 3600.0))
    assert lines(command(*LAUNCH))[0] == MEASURING


@pytest.mark.parametrize(
    ("arguments", "tau", "says"),
    [
        (("--set", "design.tau=0"), 0.0, "certified for delays up to 0 ms (not measured here)"),
        (("--set", "design.tau=0.0003"), 0.3e-3, "certified for delays up to 0.3 ms (not measured here)"),
        (("--clock", "simulated"), 0.0, ""),
    ],
)
def test_nothing_is_measured_for_a_stated_delay_or_a_simulated_clock(
    arguments: tuple[str, ...], tau: float, says: str, machine: Machine
) -> None:
    assert says in "".join(lines(command(*LAUNCH, *arguments)))
    assert machine.tau == tau
    assert machine.measured == []


def test_a_kept_profile_is_shown_beside_a_stated_delay(machine: Machine) -> None:
    command(*LAUNCH)
    (line,) = lines(command(*LAUNCH, "--set", "design.tau=0"))
    assert (
        "up to 0 ms (measured here, just now: p99.5 is 0.68 ms, which is longer); stiffness 1110 N/m; the limit" in line
    )


@pytest.mark.parametrize("asked", [("--clock", "simulated"), ()])
def test_a_session_may_ask_for_the_measurement(asked: tuple[str, ...], machine: Machine) -> None:
    command(*LAUNCH, *asked, "--set", "design.tau=auto")
    assert machine.tau == 0.75e-3
    assert len(machine.measured) == 1


def test_delays_of_the_ladder_that_are_covered_anyway_are_left_out(machine: Machine) -> None:
    command(*LAUNCH, "--set", "design.ladder=[0.0005, 0.00075, 0.001]")
    (prepared,) = machine.ran
    assert prepared.ladder is not None
    assert prepared.ladder.taus == (0.75e-3, 1e-3)


@pytest.mark.parametrize("asked", ["design.tau=auto", "design.coupling=spring-damper"])
def test_a_certificate_runs_as_what_it_is(asked: str, machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    assert command("design", "example1", "--set", "design.tau=0.0004", "-o", path).exit_code == 0
    (line,) = lines(command(*LAUNCH, "--set", asked, "--certificate", path))
    assert "certified for delays up to 0.4 ms (not measured here)" in line
    assert machine.tau == 0.4e-3
    assert machine.measured == []
    assert command("verify", path, "--session", "example1.yaml").exit_code == 0


def test_a_stated_delay_is_still_compared_with_the_certificates(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    command("design", "example1", "--set", "design.tau=0.0004", "-o", path)
    result = command(*LAUNCH, "--set", "design.tau=0", "--certificate", path)
    assert (result.exit_code, machine.ran) == (3, [])
    assert "the delay inside the tick differs" in result.stderr


def test_an_uncertified_run_is_not_measured(machine: Machine) -> None:
    assert lines(command("launch", "example1-uncoupled", "--duration", "1", "--uncertified", *APART)) == []
    assert machine.measured == []
    assert command("launch", "example1-uncoupled", "--duration", "1").exit_code == 3
    assert command("launch", "example1-uncoupled", "--duration", "1", "--set", "design.tau=auto").exit_code == 3
    assert machine.measured == []


def test_a_machine_that_is_too_slow_is_designed_for_a_whole_period_and_says_so(machine: Machine) -> None:
    machine.p995 = 1800.0
    last = lines(command(*LAUNCH))[-1]
    assert machine.tau == 1e-3
    assert last == (
        "example-1: one tick in 200 takes longer than 1.8 ms here, and no certificate covers more than the period of "
        f"1 ms; {MEASURE}"  # no longer period: its limit is below this one's, and nobody has measured its ticks
    )


@pytest.mark.parametrize(
    ("processors", "colocate", "says"),
    [
        (2, True, "couplings run in their devices' processes: 4 processes on 2 processors (colocate: false has 7)"),
        (7, False, "couplings run in processes of their own: 7 processes on 7 processors (colocate: true has 4)"),
    ],
)
def test_a_launch_says_once_which_form_the_machine_was_given(
    processors: int, colocate: bool, says: str, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {*range(processors)})
    launch = LAUNCH[: -len(APART)]
    measuring, certified, said = lines(command(*launch))
    assert (measuring, said) == (MEASURING, f"example-1: {says}")
    assert "certified for delays up to" in certified
    assert machine.ran[0].session.colocate is colocate
    assert len(machine.ran[0].graph.carriers) == (3 if colocate else 0)
    for stated in ("true", "false"):
        assert "processes" not in "".join(lines(command(*launch, "--set", f"colocate={stated}")))
        assert machine.ran[-1].session.colocate is (stated == "true")
    assert lines(command(*launch, "--clock", "simulated")) == []
    assert machine.ran[-1].session.colocate is False


def test_a_machine_whose_separate_processes_were_measured_to_be_faster_keeps_them(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    machine.p99 = 200.0
    for colocate, machine.p995 in ((True, 600.0), (False, 300.0)):
        plan = Plan(load_named("example1").with_colocation(colocate))
        keep_profile(machine.profile(plan, Way.of_run(plan), time.time()))
    certified, said = lines(command(*LAUNCH[: -len(APART)]))
    assert "p99.5 is 0.3 ms" in certified
    assert said.endswith(
        "7 processes on 2 processors (colocate: true has 4), p99.5 of a tick 0.3 ms in place of 0.6 ms"
    )
    assert machine.measured == []


def test_nodes_elsewhere_have_processes_of_their_own(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    assert command("invite", "example1", "--keys", tmp_path / "keys").exit_code == 0
    invited = ("--transport", "tcp", "--listen", "127.0.0.1:7400", "--keys", tmp_path / "keys")
    launch = ("launch", "example1-uncoupled", "--duration", "1", "--uncertified")
    said = lines(command("launch", "example1", *LAUNCH[2:4], *invited, "--remote", "dx"))
    assert "in their devices' processes" not in "".join(said)
    assert machine.ran[-1].session.colocate is False
    command("invite", "example1-uncoupled", "--keys", tmp_path / "others")
    lines(command(*launch, *invited[:-1], tmp_path / "others"))  # an observer's bundle has the id of this form
    assert machine.ran[-1].session.colocate is False


def test_a_coupling_that_is_too_stiff_for_the_machine_is_refused(machine: Machine) -> None:
    given = ("--set", "design.coupling=given", "--set", "design.stiffness=1200")
    assert command(*LAUNCH, *given, "--set", "design.tau=0").exit_code == 0
    result = command(*LAUNCH, *given)
    assert result.exit_code == 3
    hint = (
        "; the delay of 0.75 ms is this machine's (measured here, just now: p99.5 is 0.68 ms): the same command "
        "measures it anew; design.tau=0 asks for a certificate without any"
    )
    assert result.stderr.splitlines()[-1].endswith(hint)


GIVEN = ("--set", "design.coupling=given", "--set", "design.stiffness=800")
LATE = ("--set", "devices.dx={dof: 1, osp: 1.37, driver: some.package:factory, actuation_delay: 0.0004}")


def kept(machine: Machine, p995: float, age: float) -> None:
    """A profile that was measured ``age`` s ago, when the machine took so long for a tick, us."""
    before, machine.p995 = machine.p995, p995
    plan = Plan(load_named("example1"))
    keep_profile(machine.profile(plan, Way.of_run(plan), time.time() - age))
    machine.p995 = before


@pytest.mark.parametrize("asked", [GIVEN, LATE], ids=["too stiff", "too late a device"])
def test_what_was_measured_long_ago_is_measured_anew_before_it_refuses(
    asked: tuple[str, ...], machine: Machine
) -> None:
    kept(machine, 5000.0, 3 * 3600.0)
    machine.p995 = 300.0
    said = lines(command(*LAUNCH, *asked))
    assert said[:2] == [
        "example-1: is refused for a delay that was measured 3 h ago, so the delay is measured anew", MEASURING
    ]  # fmt: skip
    assert "(measured here, just now: p99.5 is 0.3 ms" in said[2]
    assert len(machine.measured) == len(machine.ran) == 1
    assert machine.ran[0].loop.tau >= 0.3e-3  # what was measured last is covered


@pytest.mark.parametrize("asked", [GIVEN, LATE], ids=["too stiff", "too late a device"])
def test_what_refuses_a_session_is_measured_once_and_not_kept(asked: tuple[str, ...], machine: Machine) -> None:
    kept(machine, 5000.0, 3 * 3600.0)
    machine.p995 = 4000.0  # the machine is still busy
    result = command(*LAUNCH, *asked)
    assert (result.exit_code, len(machine.measured), machine.ran) == (3, 1, [])
    assert "just now" in result.stderr.splitlines()[-1]
    assert "the same command measures it anew" in result.stderr.splitlines()[-1]
    machine.p995 = 300.0
    assert command(*LAUNCH, *asked).exit_code == 0
    assert len(machine.measured) == 2


@pytest.mark.parametrize("asked", [GIVEN, LATE], ids=["too stiff", "too late a device"])
def test_what_was_measured_a_moment_ago_refuses_and_says_how_old_it_is(
    asked: tuple[str, ...], machine: Machine
) -> None:
    kept(machine, 5000.0, 120.0)
    machine.p995 = 300.0
    result = command(*LAUNCH, *asked)
    assert (result.exit_code, machine.measured, machine.ran) == (3, [], [])
    assert "(measured here, 2 min ago: p99.5 is 5 ms)" in result.stderr
    assert command(*LAUNCH, *asked).exit_code == 0, "the same command measures it anew"
    assert len(machine.measured) == 1


@pytest.mark.parametrize(
    ("fails", "code", "says"),
    [
        (
            ProbeFailed("dx: ended with 1"),
            1,
            "error: the delay of a tick could not be measured: dx: ended with 1; state",
        ),
        (ProbeInterrupted(signal.SIGTERM), 143, MEASURING),
    ],
)
def test_a_measurement_that_fails_ends_the_launch(fails: Exception, code: int, says: str, machine: Machine) -> None:
    machine.fails = fails
    result = command(*LAUNCH)
    assert (result.exit_code, machine.ran) == (code, [])
    assert says in result.stderr


def test_a_cache_that_cannot_be_written_is_a_warning(machine: Machine, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    assert re.match(r"warning: the measurement is not kept: .*/cache/manyhands", lines(command(*LAUNCH))[1])
    assert machine.tau == 0.75e-3


def test_a_run_that_was_slower_lets_the_next_one_measure(machine: Machine) -> None:
    machine.p99 = 900.0
    command(*LAUNCH)
    plan = Plan(load_named("example1"))
    assert kept_profile(Way.of_run(plan).profile_key(plan), time.time()) is None


def test_other_machines_are_not_measured(machine: Machine, tmp_path: Path) -> None:
    assert command("invite", "example1.yaml", "--keys", tmp_path / "keys").exit_code == 0
    far = ("--transport", "tcp", "--listen", "127.0.0.1:7400", "--keys", tmp_path / "keys", "--remote", "dx")
    lines(command(*LAUNCH, *far))
    assert machine.tau == 0.0
    result = command(*LAUNCH, *far, "--set", "design.tau=auto")
    assert result.exit_code == 2
    assert "--remote: found design.tau: auto, which measures this machine alone, and no --certificate" in result.stderr
    assert machine.measured == []


def test_the_links_of_the_run_are_measured(machine: Machine) -> None:
    command(*LAUNCH, "--transport", "tcp")
    command(*LAUNCH, "--transport", "tcp", "--insecure")
    assert [(way.transport, way.encrypted) for way in machine.measured] == [("tcp", True), ("tcp", False)]


def test_design_simulate_and_budget_measure_where_they_are_asked_to(machine: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    for arguments in (
        ("design", "example1", "-o", path),
        ("simulate", "example1", "--duration", "0.1"),
        ("budget", "example1"),
    ):
        assert command(*arguments).exit_code == 0
        assert machine.measured == []
        assert command(*arguments, "--set", "design.tau=auto").exit_code == 0
        assert len(machine.measured) == 1
        machine.measured.clear()
        for file in (tmp_path / "cache").rglob("*.json"):
            file.unlink()
    assert "0.00075 s" in command("design", "example1", "--set", "design.tau=auto").stdout


def test_budget_shows_what_is_kept(machine: Machine) -> None:
    before = command("budget", "example1").stdout
    assert "1 kHz, 1 kHz co-located, 2 kHz, 2 kHz co-located, 4 kHz, 4 kHz co-located: not measured" in before
    command(*LAUNCH)
    after = command("budget", "example1").stdout
    assert re.search(r"1 kHz │ separate +│ +340 │ +680 │ +2040 │ +0.0% │ +0.75 │ +1.1 │ +818 │ +none │ +2740", after)
    assert "1 kHz co-located, 2 kHz" in after


HOST = (
    "host",
    "ball",
    "--listen",
    "127.0.0.1:7400",
    "--duration",
    "1",
    "--set",
    "couplings.left_seat={devices: [left]}",
)


def test_the_users_of_a_hosted_session_who_are_here_are_measured_once(machine: Machine, tmp_path: Path) -> None:
    first = lines(command(*HOST, "-o", tmp_path))
    assert first[0] == "ball: measuring the delay of a tick on this machine for 2 s"
    assert "ball, in-tick: certified for delays up to 0.75 ms" in "\n".join(first)
    certificates = {path: path.read_bytes() for path in tmp_path.glob("certificate*.json")}
    lines(command(*HOST, "-o", tmp_path, "--set", "design.tau=auto"))
    assert [way.transport for way in machine.measured] == ["tcp"]
    delays = [prepared.parts["in-tick"].tau for prepared in machine.ran]
    assert delays == [0.75e-3, 0.75e-3]
    assert {prepared.parts["right_seat"].tau for prepared in machine.ran} == {0.3e-3}
    assert {path: path.read_bytes() for path in certificates} == certificates


@pytest.mark.parametrize(("p995", "expected"), [(780.0, 0.85e-3), (280.0, 0.75e-3)])
def test_a_host_designs_anew_for_a_delay_that_is_longer_alone(
    p995: float, expected: float, machine: Machine, tmp_path: Path
) -> None:
    machine.p99 = 900.0  # longer than the design covers, so the profile is not kept
    said = lines(command(*HOST, "-o", tmp_path))
    assert "ball: the delays were not those measured before; the next host measures them anew" in said
    machine.p995 = p995
    lines(command(*HOST, "-o", tmp_path))
    assert (len(machine.measured), machine.ran[-1].parts["in-tick"].tau) == (2, expected)


def test_a_host_says_why_it_has_measured_nothing(machine: Machine, tmp_path: Path) -> None:
    seat = ("--set", "couplings.right_seat={devices: [right], wave_link: {b: 10}}")
    said = "\n".join(lines(command(*HOST, *seat, "-o", tmp_path)))
    assert "in-tick: certified for delays up to 0 ms (not measured here)" in said
    assert "the delay of the users here is not measured, for right_seat states no wave_link.tau" in said
    result = command(*HOST, *seat, "-o", tmp_path, "--set", "design.tau=auto")
    assert (result.exit_code, machine.measured) == (2, [])
    assert "expected couplings.right_seat.wave_link.tau" in result.stderr
