"""The doctor without a machine: its reading of files, its advice on figures, and processes that misbehave."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from manyhands.design.models.axis import TRANSLATING
from manyhands.design.models.environment import StateSpaceEnvironment
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import HapticLoop
from manyhands.launch.app.examination import machine_rows, of_both_forms
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.doctor import probe
from manyhands.launch.doctor.advice import Worth, advice, stiffness_object, user
from manyhands.launch.doctor.machine import Machine, examine, governors, preemption, realtime_share, virtual
from manyhands.launch.doctor.probe import (
    RATES,
    DelayRecorder,
    Form,
    Measured,
    Ticking,
    Way,
    at_rest,
    forms_of,
    measure_ticks,
    measure_waking,
)
from manyhands.launch.doctor.profile import Lateness, ProbeFailed, ProbeInterrupted, Profile
from manyhands.launch.doctor.rates import (
    NOT_MEASURED,
    FormFigures,
    certified_lines,
    form_advice,
    form_figures,
    print_rates,
    rates_object,
)
from manyhands.launch.doctor.wakeup import Spread, Waking
from manyhands.launch.plan.feel import stiffness_range
from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import Prepared, prepare, unproved
from manyhands.launch.plan.topology import placement, topology
from manyhands.launch.run import supervised
from manyhands.launch.run.outcome import Outcome
from manyhands.launch.run.processes import Interrupt
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.kernel.realtime import Grant
from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation

YES, NO = Grant(True, "as wished"), Grant(False, "found the limit; expected more")
IPC, TCP = Way("ipc", "ipc", "ipc"), Way("tcp_curve", "tcp with CURVE", "tcp")


def a_machine(**changes: object) -> Machine:
    """A machine without any finding."""
    best: dict[str, Any] = {
        "kernel": "Linux 6.12", "preemption": "PREEMPT_RT", "virtual": None, "container": False, "processors": 8,
        "usable": tuple(range(8)), "governors": ("performance",), "clock_source": "tsc", "priority_limit": 99,
        "may_raise": True, "memory_limit": None, "may_lock": True, "realtime_share": 0.95, "python": "CPython 3.12",
        "gil": True, "zeromq": "4.3.5", "pyzmq": "27", "curve": True, "ipc": True,
        "compiled": True,
    }  # fmt: skip
    return Machine(**best | changes)


def measurement(p50: float, p999: float, **refused: Grant) -> Measured:
    """A probe's result with these percentiles of tau, us."""
    grants = {"fifo": YES, "memory_locked": YES, "timer_slack": YES, "pinned": YES} | refused
    late = dict.fromkeys(("default_slack", "least_slack"), Spread(60.0, 70.0, 80.0, 90.0))
    tau = Spread(p50, (p50 + p999) / 2, p999, p999)
    return Measured(Waking(late, grants), (ticking(IPC, tau, 3),))


def ticking(way: Way, tau: Spread, late: int) -> Ticking:
    """A thousand ticks, with these percentiles for the slowest device as well."""
    return Ticking(way, tau, 1000, late, Lateness(tau.p50, tau.p99, tau.p999, tau.max), 1050.0)


@pytest.fixture(scope="module")
def loop() -> HapticLoop:
    return haptic_loop(load_named("example1"))


@pytest.fixture(scope="module")
def worth(loop: HapticLoop) -> Worth:
    return Worth.of(loop)


# --- the machine


@pytest.mark.parametrize(
    ("version", "expected"),
    [
        ("#1 SMP PREEMPT_DYNAMIC Thu Jan 1 2026", "PREEMPT_DYNAMIC"),
        ("#1 SMP PREEMPT_RT Debian 6.12", "PREEMPT_RT"),
        ("#5 SMP PREEMPT Mon", "PREEMPT"),
        ("#42-Ubuntu SMP Tue", "voluntary or none"),
    ],
)
def test_the_version_line_names_the_preemption_model(version: str, expected: str) -> None:
    assert preemption(version) == expected


def tree(root: Path, **files: str) -> Path:
    """A machine's files; ``__`` in a name stands for a slash."""
    for name, text in files.items():
        path = root / name.replace("__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    return root


def test_a_hypervisor_shows_in_the_flags_and_in_the_firmware(tmp_path: Path) -> None:
    assert virtual(tree(tmp_path / "a", proc__cpuinfo="processor: 0\nflags\t: fpu vme tsc")) is None
    assert virtual(tree(tmp_path / "b", proc__cpuinfo="flags\t: fpu hypervisor")) == "a hypervisor"
    files = {"proc__cpuinfo": "flags : hypervisor", "sys__class__dmi__id__product_name": "KVM"}
    assert virtual(tree(tmp_path / "c", **files)) == "KVM"
    assert virtual(tree(tmp_path / "d", sys__hypervisor__type="xen")) == "xen"


def test_governors_and_the_share_of_realtime_threads_are_read(tmp_path: Path) -> None:
    cpu = "sys__devices__system__cpu__cpu{}__cpufreq__scaling_governor"
    root = tree(tmp_path, **{cpu.format(0): "powersave", cpu.format(1): "powersave", cpu.format(2): "performance"})
    assert governors(root, (0, 1)) == ("powersave",)
    assert governors(root, (0, 1, 2)) == ("performance", "powersave")
    assert governors(root, (7,)) is None
    assert realtime_share(root) is None
    tree(root, proc__sys__kernel__sched_rt_runtime_us="950000", proc__sys__kernel__sched_rt_period_us="1000000")
    assert realtime_share(root) == 0.95
    tree(root, proc__sys__kernel__sched_rt_runtime_us="-1")
    assert realtime_share(root) is None


def test_a_machine_without_information_is_examined_too(tmp_path: Path) -> None:
    found = examine(tmp_path)
    assert (found.virtual, found.governors, found.clock_source, found.realtime_share) == (None, None, None, None)
    assert set(found.usable) == os.sched_getaffinity(0)
    assert found.compiled is False, "what is edited is never compiled"
    assert all(machine_rows(found).values())
    assert found.plain()["usable"] == list(found.usable)


# --- the session of the probe


def test_the_session_at_rest_has_the_graph_of_the_users(drawn_sessions: st.SearchStrategy[Session]) -> None:
    @given(drawn_sessions)
    def check(session: Session) -> None:
        rested = at_rest(session)
        assert topology(rested) == topology(session)
        assert rested.period == session.period

    check()
    together = load_named("example1", ["colocate=true"])
    assert topology(at_rest(together)) == topology(together)


def test_nothing_moves_in_the_session_at_rest() -> None:
    recording = Simulation(unproved(at_rest(load_named("example1-centralised")))).run(300)
    assert not recording.x.any()
    assert not recording.f_v.any()


def test_the_delays_of_every_telemetry_are_kept_in_nanoseconds() -> None:
    delays = DelayRecorder()
    for node, rows in (("dx", [[250.0], [300.5]]), ("dy", [[0.125]])):
        delays.take(encode(Observation(node, 2, Figures(), {"tau_us": np.array(rows)})))
    delays.take(encode(Observation("cx", 2, Figures(), {})))
    delays.take(encode(Condition("running", 0.1, {}, (), (), (), ())))
    delays.take(None)
    assert delays.tau == [250_000, 300_500, 125]


@given(st.lists(st.integers(-1000, 10**10), min_size=1, max_size=300))
def test_percentiles_are_values_and_ordered(durations: list[int]) -> None:
    spread = Spread.of(durations)
    assert spread.p50 <= spread.p99 <= spread.p999 <= spread.max == max(durations) / 1e3
    assert spread.p50 * 1e3 >= np.median(durations) - 0.01
    assert sum(value / 1e3 <= spread.p999 + 1e-6 for value in durations) >= 0.999 * len(durations)


# --- what it means


@given(st.floats(0.0, 2e-3), st.floats(0.0, 2e-3))
def test_more_delay_leaves_less_stiffness(worth: Worth, a: float, b: float) -> None:
    less, more = sorted((a, b))
    assert worth.weakest(0.0) >= worth.weakest(less) >= worth.weakest(more)
    assert (worth.weakest(more) == 0.0) is (more > worth.loop.period)


def test_the_stiffness_of_example_1_is_that_of_the_theory(worth: Worth) -> None:
    assert worth.share == 0.0
    assert worth.weakest(0.0) == pytest.approx(2740.0)
    assert worth.weakest(0.25e-3) == pytest.approx(1.37 / (0.5e-3 + 1.5 * 0.25e-3))
    found = stiffness_object(worth, measurement(250.0, 1500.0).ticking)
    for device in ("dx", "dy", "dz"):
        assert found[device]["no_delay"] == pytest.approx(2740.0)
        assert found[device]["ipc"]["p50"] == pytest.approx(1565.7, abs=0.1)
        assert found[device]["ipc"]["p999"] == 0.0  # longer than the tick


def test_nothing_is_advised_where_nothing_is_to_be_gained(worth: Worth) -> None:
    assert advice(a_machine(), measurement(510.0, 600.0), worth, chains=3) == ()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"preemption": "PREEMPT_DYNAMIC"}, "PREEMPT_RT"),
        ({"virtual": "KVM"}, "KVM"),
        ({"usable": (0, 1)}, "3 users and an environment need 4"),
        ({"governors": ("powersave",)}, "found powersave"),
        ({"clock_source": "hpet"}, "found hpet"),
        ({"curve": False}, "CURVE"),
        ({"compiled": False}, "its tick is pure Python here"),
    ],
)
def test_each_weakness_of_the_machine_has_its_advice(changes: dict[str, object], says: str, worth: Worth) -> None:
    (one,) = advice(a_machine(**changes), measurement(510.0, 600.0), worth, chains=3)
    assert says in one.change
    assert one.buys


@pytest.mark.parametrize(
    ("refused", "says"),
    [
        ("fifo", f"write '{user()} - rtprio 10' into"),
        ("memory_locked", f"'{user()} - memlock unlimited'"),
        ("timer_slack", "PR_SET_TIMERSLACK"),
    ],
)
def test_each_refusal_has_its_advice_with_the_kernels_reason(refused: str, says: str, worth: Worth) -> None:
    (one,) = advice(a_machine(), measurement(510.0, 600.0, **{refused: NO}), worth, chains=3)
    assert says in one.change
    assert NO.answer in one.change


@pytest.mark.parametrize(
    ("refused", "says"), [("fifo", "--ulimit rtprio=10 --ulimit nice=30"), ("memory_locked", "--ulimit memlock=-1")]
)
def test_a_container_is_given_its_rights_when_it_starts(refused: str, says: str, worth: Worth) -> None:
    """limits.conf is read at a login, and nobody logs into a container."""
    (one,) = advice(a_machine(container=True), measurement(510.0, 600.0, **{refused: NO}), worth, chains=3)
    assert f"start this container with {says} (" in one.change
    assert "limits" not in one.change.replace(NO.answer, "")
    page = (Path(__file__).parents[3] / "docs" / "installing.md").read_text()
    assert set(says.split("--ulimit ")) - {""} <= {word + " " for word in page.split()} | set(page.split())


def test_one_processor_per_chain_and_one_for_the_environment_suffice(worth: Worth) -> None:
    assert advice(a_machine(usable=(0, 1, 2, 3)), measurement(510.0, 600.0), worth, chains=3) == ()
    (one,) = advice(a_machine(usable=(0, 1, 2)), measurement(510.0, 600.0), worth, chains=3)
    assert one.change == "give it more processors: 3 usable, 3 users and an environment need 4"


def test_the_forms_that_are_compared_have_the_sessions_period_and_were_measured_long_enough() -> None:
    long = Profile({}, Lateness(1.0, 2.0, 3.0, 4.0), 1000.0, 0.0, 1.0, 0.0)
    forms = {
        Form(1e-3, False): long,
        Form(1e-3, True): replace(long, seconds=0.5),
        Form(5e-4, True): long,
        Form(2e-3, True): "no tick got a force",
    }
    assert of_both_forms(forms, 1e-3) == {False: long}


def test_the_cost_of_a_tail_is_reported_in_newtons(worth: Worth) -> None:
    (one,) = advice(a_machine(virtual="KVM"), measurement(510.0, 600.0), worth, chains=3)
    even, now = (1.37 / (0.5e-3 + 1.5 * tau) for tau in (510e-6, 600e-6))
    assert f"{now:.0f} -> {even:.0f} N/m" in one.buys


def form(worth: Worth, p995: float | None, period: float, colocated: bool) -> FormFigures:
    """The figures of a form of Example 1, measured unless ``p995`` (us) is None."""
    if p995 is None:
        (found,) = form_figures(worth, {Form(period, colocated): "not measured"})
    else:
        profile = Profile({}, Lateness(p995 / 2, p995, p995, p995), period * 1.0e6, 0.0, 2.0, 0.0)
        (found,) = form_figures(worth, {Form(period, colocated): profile})
    return found


@pytest.mark.parametrize(
    ("own", "other", "change", "buys"),
    [
        # 1.37/(1.05 T/2 + 3 tau/2), tau in steps of T/20 and one more; a longer period leaves less, and is not advised
        ((400.0, 1e-3, False), (400.0, 2e-3, False), None, ""),
        ((400.0, 1e-3, False), (250.0, 1e-3, True), "--set colocate=true", "1142 -> 1405 N/m"),
        ((400.0, 1e-3, True), (250.0, 5e-4, False), "--set period=0.0005 --set colocate=false", "1142 -> 2030 N/m"),
        # no more than two measurements of one form differ by; or never measured
        ((400.0, 1e-3, False), (399.0, 1e-3, True), None, ""),
        ((400.0, 1e-3, False), (None, 5e-4, True), None, ""),
        # where nothing covers a tick, a longer period that does is something
        ((1800.0, 1e-3, False), (1800.0, 1.9e-3, False), "--set period=0.0019", "none -> 356 N/m"),
        ((1800.0, 1e-3, False), (1800.0, 1e-3, True), None, ""),
    ],
)
def test_a_form_is_advised_where_it_was_measured_and_leaves_more(
    worth: Worth, own: Any, other: Any, change: str | None, buys: str
) -> None:
    session = load_named("example1", [f"colocate={str(own[2]).lower()}"])
    found = form_advice(session, [form(worth, *own), form(worth, *other)])
    if change is None:
        assert found == ()
        return
    (one,) = found
    assert (one.change, one.tried) == (f"run it with {change}", True)
    assert one.buys.startswith(buys)


def test_a_form_that_the_session_cannot_have_is_not_advised(worth: Worth) -> None:
    stated = load_named("example1", ["colocate=false", "design.tau=0.0008"])  # longer than the period of 2 kHz
    assert form_advice(stated, [form(worth, 400.0, 1e-3, False), form(worth, 100.0, 5e-4, False)]) == ()


def test_the_best_way_is_the_one_that_is_judged(worth: Worth) -> None:
    good = measurement(510.0, 600.0)
    bad = ticking(TCP, Spread(900.0, 2000.0, 9000.0, 9000.0), 500)
    assert advice(a_machine(), Measured(good.waking, (bad, *good.ticking)), worth, chains=3) == ()


def test_what_a_process_found_is_read_back_as_it_was() -> None:
    found = Waking({"least_slack": Spread(1.0, 2.5, 3.0, 4.0)}, {"fifo": NO, "pinned": YES})
    assert Waking.from_json(found.to_json()) == found


# --- processes and sessions that do not do as they should


def waking(directory: Path, interrupt: Interrupt) -> Waking:
    return measure_waking(1e-3, 0.1, min(os.sched_getaffinity(0)), directory, interrupt)


def test_a_process_that_fails_is_reported_with_its_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "FIFO_PRIORITY", -1)
    with Interrupt() as interrupt, pytest.raises(ProbeFailed, match=r"(?s)waking: ended with 2 .* it wrote:\nusage: "):
        waking(tmp_path, interrupt)


def test_a_silent_process_has_a_deadline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probe, "ANSWER_TIME", Duration(0))
    monkeypatch.setattr(probe, "SLOWEST", 0)
    with Interrupt() as interrupt, pytest.raises(ProbeFailed, match="waking: no answer within 0 s"):
        waking(tmp_path, interrupt)


def test_ctrl_c_ends_every_wait(tmp_path: Path) -> None:
    with Interrupt() as interrupt:
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(ProbeInterrupted) as caught:
            waking(tmp_path, interrupt)
    assert caught.value.signal is signal.SIGINT


def ended(
    monkeypatch: pytest.MonkeyPatch,
    code: int,
    *faults: str,
    told: Mapping[str, list[float]] = MappingProxyType({}),
    periods: Mapping[str, float] = MappingProxyType({}),
    rested: Prepared | None = None,
) -> Callable[[], Ticking]:
    """A probe whose session ends like this, after devices have ``told`` these delays, us; by default without a tick.

    ``periods`` has the p99 of the time between two samples of devices, us.
    """

    class Ended:
        def __init__(self, *_: object, recorder: DelayRecorder, **__: object) -> None:
            self.recorder = recorder

        def run(self) -> Outcome:
            for node, delays in told.items():
                self.recorder.take(encode(Observation(node, len(delays), Figures(), {"tau_us": np.array([delays]).T})))
            nodes = {node: {"late": 0, "period_us": {"p99": p99}} for node, p99 in periods.items()}
            return Outcome(code, faults, (), {"nodes": nodes}, None, {}, {})

    monkeypatch.setattr(supervised, "Supervisor", Ended)
    session = rested or unproved(at_rest(load_named("example1")))
    return lambda: measure_ticks(session, IPC, 50)


def test_a_session_that_fails_is_reported_with_its_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ProbeFailed, match=r"^dx: ended with 1; cx: silent$"):
        ended(monkeypatch, 1, "dx: ended with 1", "cx: silent")()


def test_an_interrupted_session_interrupts_the_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ProbeInterrupted) as caught:
        ended(monkeypatch, 128 + signal.SIGTERM)()
    assert caught.value.signal is signal.SIGTERM


def test_a_session_without_an_answered_tick_has_no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ProbeFailed, match="ipc: found no tick that got a force"):
        ended(monkeypatch, 0)()


def test_devices_of_each_period_have_their_own_delays(monkeypatch: pytest.MonkeyPatch) -> None:
    links = [f"couplings.{name}.wave_link={{b: 10, period: {T}}}" for name, T in (("cx", 25e-5), ("cy", 1e-3))]
    delays = {"dx": [80.0, 90.0], "dy": [300.0, 310.0], "dz": [200.0]}
    rested = unproved(at_rest(load_named("example1", [*links, "couplings.cz.wave_link={b: 10, period: 0.001}"])))
    ticking = ended(monkeypatch, 0, told=delays, periods={"dx": 260.0, "dy": 1200.0, "dz": 900.0}, rested=rested)()
    assert ticking.period == pytest.approx(300.0)  # dy's is the longest part of its period
    assert (ticking.slowest.p995, {T: own.p995 for T, own in ticking.others.items()}) == (90.0, {1e-3: 310.0})
    with pytest.raises(ProbeFailed, match="ipc: found no tick that got a force"):  # of a device that sets the rate
        ended(monkeypatch, 0, told={"dy": [300.0]}, rested=rested)()


def test_a_process_ends_with_the_one_that_started_it(tmp_path: Path) -> None:
    """In the midst of its task, with no process left to kill it."""
    code = f"""
from pathlib import Path
from manyhands.launch.run.processes import Processes
processes = Processes(Path({str(tmp_path)!r}))
processes.spawn(["long"], "manyhands.launch.doctor.wakeup", ["1000000", "1000000", "0"])
print(processes.pids["long"], flush=True)
input()
"""
    with subprocess.Popen([sys.executable, "-P", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        part = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
    try:
        assert select.select([part], [], [], 60.0)[0], "it outlived its parent"
    finally:
        os.close(part)


# --- the rates


def test_a_session_is_measured_at_its_own_rate_and_three_others() -> None:
    forms = forms_of(load_named("example1", ["period=0.002"]))
    assert [(form.period, form.colocated) for form in forms] == [
        (period, colocated) for period in (2e-3, 1e-3, 0.5e-3, 0.25e-3) for colocated in (False, True)
    ]
    assert forms_of(load_named("example1-centralised")) == tuple(Form(period, False) for period in RATES)


def test_a_form_has_the_graph_that_the_session_would_have() -> None:
    session = load_named("example1")
    for form in forms_of(session):
        other = load_named("example1", [f"period={form.period}", f"colocate={str(form.colocated).lower()}"])
        assert Way.of_run(form.plan(session)).profile_key(form.plan(session)) == Way.of_run(Plan(other)).profile_key(
            Plan(other)
        )


@pytest.mark.parametrize(("lasts", "longer"), [(900.0, ()), (1800.0, (1.9e-3,))])
def test_where_a_tick_does_not_fit_a_longer_period_is_measured_too(
    lasts: float, longer: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both forms of it: what is advised has been measured."""
    monkeypatch.setattr(probe, "measure_waking", lambda *_: measurement(1.0, 2.0).waking)
    monkeypatch.setattr(probe, "measure_ticks", lambda _, way, __: ticking(way, Spread(1.0, lasts, lasts, lasts), 0))
    monkeypatch.setattr(probe, "usual_placement", lambda graph: placement(graph, (0, 1, 2, 3), raised=True))
    session = load_named("example1")
    found = probe.measure(Plan(session), 10.0, (0, 1, 2, 3), False, lambda _: None)
    assert set(found.forms) == {*forms_of(session), *(Form(T, own) for T in longer for own in (False, True))}


def test_no_delay_is_without_a_tolerance_too() -> None:
    """One limit, in the doctor's tables and its object, whatever the session's period tolerance."""
    worth = Worth.of(haptic_loop(load_named("example1", ["design.period_tolerance=0.5"])))
    assert worth.no_delay == pytest.approx(2740.0)
    assert worth.weakest(0.0) == pytest.approx(2740.0 / 1.5)
    assert stiffness_object(worth, ())["dx"]["no_delay"] == pytest.approx(2740.0)


@pytest.mark.parametrize("refused", [False, True], ids=["as launched", "a right that the kernel refuses"])
def test_each_form_is_measured_once(refused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The session's own is one of the ways, unless none of them is placed as a run would be."""
    asked: list[tuple[Form, str]] = []

    def measured(rested: Prepared, way: Way, _: int) -> Ticking:
        form = Form(rested.session.period, rested.session.colocate)
        asked.append((form, way.transport))
        if form.period < 5e-4:
            raise ProbeFailed("no tick")
        return ticking(way, Spread(1.0, 2.0, 3.0, 4.0), 0)

    monkeypatch.setattr(probe, "measure_waking", lambda *_: measurement(1.0, 2.0).waking)
    monkeypatch.setattr(probe, "measure_ticks", measured)
    if refused:
        monkeypatch.setattr(probe, "usual_placement", lambda *_: {"environment": 77})
    else:
        monkeypatch.setattr(probe, "usual_placement", lambda graph: placement(graph, (0, 1, 2, 3), raised=True))
    session = load_named("example1")
    shown: list[str] = []
    found = probe.measure(Plan(session), 10.0, (0, 1, 2, 3), False, shown.append)
    assert tuple(found.forms) == forms_of(session)
    assert len(asked) == 2 + len(forms_of(session)) - (not refused)
    assert [text for text in found.forms.values() if isinstance(text, str)] == ["no tick", "no tick"]
    assert "a tick at 2 kHz, separate processes" in " ".join(shown)
    assert found.each == pytest.approx(10.0 * 0.85 / 7)


def figures(worth: Worth, p995: float, period: float, worst: float = 0.0) -> FormFigures:
    profile = Profile({}, Lateness(p995 / 2, p995, p995, worst or p995), period * 1.05e6, 0.0, 2.0, 0.0)
    (found,) = form_figures(worth, {Form(period, False): profile})
    return found


def test_each_form_has_the_stiffness_of_its_own_period(worth: Worth) -> None:
    found = figures(worth, 280.0, 0.5e-3)
    tau, longest = 0.325e-3, 1.1 * 0.5e-3  # 12 steps of 25 us and one; 1 step and one
    assert found.certified == pytest.approx(1.37 / (longest / 2 + 1.5 * tau))
    assert found.no_delay == pytest.approx(5480.0)
    assert found.at_worst == found.certified  # the longest delay is within what is designed for
    assert figures(worth, 280.0, 0.5e-3, 480.0).at_worst == pytest.approx(1.37 / (longest / 2 + 1.5 * 0.48e-3))
    assert figures(worth, 280.0, 0.5e-3, 510.0).at_worst == 0.0


def test_a_form_whose_ticks_are_longer_than_a_tick_has_none(worth: Worth) -> None:
    assert figures(worth, 501.0, 0.5e-3).certified == 0.0
    assert figures(worth, 501.0, 1e-3).certified != 0.0


def test_an_environment_in_discrete_time_has_its_own_period_alone() -> None:
    ports = ("dx", "dy", "dz")
    wall = StateSpace.static(np.diag([500.0] * 3))
    loop = replace(haptic_loop(load_named("example1")), environment=StateSpaceEnvironment(ports, wall, None))
    assert figures(Worth(loop, 0.0), 280.0, 0.5e-3).no_delay is None
    assert figures(Worth(loop, 0.0), 280.0, 1e-3).no_delay == pytest.approx(2740.0)


def test_the_table_names_what_is_missing_and_what_is_too_slow(worth: Worth) -> None:
    slow = Profile({}, Lateness(400.0, 900.0, 1000.0, 1100.0), 520.0, 0.281, 2.0, 0.0)
    found = list(
        form_figures(worth, {Form(1e-3, False): NOT_MEASURED, Form(5e-4, True): slow, Form(2.5e-4, True): NOT_MEASURED})
    )
    out = Console(file=StringIO(), width=160)
    print_rates(out, "example-1", TRANSLATING, found)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert re.search(
        r"2 kHz │ co-located │ +400 │ +900 │ +1100 │ 28.1% │ longer than a tick │ +0.55 │ +none │ +none │ +5480", text
    )
    assert text.splitlines()[-1] == f"example-1 on this machine: 1 kHz, 4 kHz co-located: {NOT_MEASURED}"
    assert len([line for line in text.splitlines() if "kHz │" in line]) == 1, "a form without figures has no row"
    print_rates(nothing_yet := Console(file=StringIO(), width=160), "example-1", TRANSLATING, [found[0]])
    shown = nothing_yet.file.getvalue()  # type: ignore[attr-defined]
    assert shown == f"example-1 on this machine: 1 kHz: {NOT_MEASURED}\n", "no empty table"
    first, second, _ = rates_object(found)
    nothing = {"certified": None, "at_worst": None}
    assert first == {"period": 1e-3, "colocate": False, "no_delay": pytest.approx(2740.0), **nothing}
    assert (second["tau"], second["covered"], second["tau_us"]["p995"], second["late"]) == (5e-4, False, 900.0, 0.281)
    assert json.loads(json.dumps([first | {"no_delay": 0.0}, second])) == [first | {"no_delay": 0.0}, second]


# --- what a run is certified for


@pytest.mark.parametrize(
    ("name", "overrides", "text"),
    [
        ("example1", ["design.tau=0"], "stiffness 1110 N/m; the limit is 2740 N/m without delay"),
        ("example1", ["design.tau=0", "design.coupling=given", "design.stiffness=[300, 400, 500]"], "300 to 500 N/m"),
    ],
)
def test_the_stiffness_of_a_run_is_that_of_its_couplings(name: str, overrides: list[str], text: str) -> None:
    prepared = prepare(load_named(name, overrides))
    assert prepared.certificate is not None
    (line,) = certified_lines(prepared, prepared.session, None, 0.0)
    assert line.startswith("example-1: certified for delays up to 0 ms (not measured here); stiffness ")
    assert text in line


def test_linear_couplings_have_a_static_stiffness() -> None:
    matrices = "{c: {A: [[0.5]], B: [[0.0005]], C: [[1.0]], D: [[0.001]]}}"
    alone = ["devices={d: {dof: 1, osp: 1.37, driver: simulated, mass: 0.2}}", "couplings={c: {devices: [d]}}",
             "environment={type: network, links: [{between: [d, ground], stiffness: 100}]}",
             f"design={{coupling: given, matrices: {matrices}}}"]  # fmt: skip
    certificate = prepare(load_named("example1", alone)).certificate
    assert certificate is not None
    assert stiffness_range(certificate) == (pytest.approx(500.0), pytest.approx(500.0))
