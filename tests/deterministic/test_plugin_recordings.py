"""Sessions with a driver of another package, recorded in virtual time: rate, delays, accounts, and what is said of it.

The driver is the counterpart of :mod:`tests.support.plugin_drivers`, in whose hand a person may push.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.audit.audit import Audit, audit
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.run import read_run
from manyhands.launch.session import load_session
from manyhands.nodes.monitor.health import PromiseState, missed, verdict
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.rows import figures as names
from manyhands.nodes.rows.promises import Promise
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Observation, PromiseStatus, Telemetry
from tests.support.simulated_recordings import START, attachments_of, recorded_of

from .late import PERIOD, LateSession

HERE = Path(__file__).parent
TICKS = 600
LATENCY = {"sample_age": 5e-4, "actuation_delay": 2e-4}


def prepared_with(
    parameters: Mapping[str, Any],
    timing: Mapping[str, float] | None = None,
    kind: str = "Counterpart",
    device: Mapping[str, Any] | None = None,
    tree: Sequence[str] = (),
    **limits: float,
) -> Prepared:
    """The session of one user and a wall, whose device is a driver's."""
    driver = "tests.support.plugin_drivers:" + kind
    timing = timing or {}
    keys = {"age": timing.get("sample_age", 0.0), "delay": timing.get("actuation_delay", 0.0)}
    given = {**keys, "timing": {**timing}, **parameters}
    whole = {
        "dof": 1, "osp": 1.37, "driver": driver, "parameters": given, **timing,
        "limits": {"force": 8.0, "displacement": 0.2, "speed": 2.0, **limits}, **(device or {}),
    }  # fmt: skip
    usual = ["design.tau=0.0009", "design.ladder=[]", "faults.breach=warn", f"devices.d={whole}"]
    return prepare(load_session(HERE / "plugin.yaml", [*usual, *tree]))


def audited(path: Path, prepared: Prepared, told: Mapping[str, Sequence[Telemetry]]) -> Audit:
    core = RecorderCore(recorded_of(prepared, "realtime"), attachments_of(prepared), START)
    for node, messages in told.items():
        for message in messages:
            core.take(encode(Observation(node, message.tick, message.figures, message.traces)), START)
    path.write_bytes(core.cut() + core.end())
    return audit(path, read_run(path), lambda text: None, lambda tick: None)


def sampled(session: LateSession) -> np.ndarray:
    return np.concatenate([message.traces[names.INSTANTS][:, 0] for message in session.told["d"]])


@pytest.mark.parametrize("slow", [0.1, 0.45], ids=["in time", "beyond tau, and after the next sample"])
def test_a_device_that_is_late_by_itself_keeps_the_rate_and_its_record_holds(tmp_path: Path, slow: float) -> None:
    """Two sessions that differ only in what the device states: both go at 1 kHz, and nobody is late."""
    counts, taus = [], []
    for timing in ({}, LATENCY):
        prepared = prepared_with({"push": 1.0}, timing)
        session = LateSession(prepared, TICKS, {"d": lambda _tick: slow})
        assert session.violations == []
        figures = session.told["d"][-1].figures
        assert np.median(np.diff(sampled(session))) == PERIOD
        counts.append((figures[names.LATE], session.told["d"][-1].tick))
        taus.append(session.taus("d"))
        done = audited(tmp_path / "r.mcap", prepared, session.told)
        assert [check for check in done.broken if check.party != "session"] == []
        assert figures[names.INTERFACE_LEAST] >= -5e-3
    assert counts[0] == counts[1]
    assert np.nanmedian(taus[1] - taus[0]) == pytest.approx(700.0, abs=1.0)


def run_of(prepared: Prepared, path: Path) -> tuple[LateSession, Audit]:
    session = LateSession(prepared, TICKS, {})
    return session, audited(path, prepared, session.told)


def rows_of_promise(done: Audit, promise: Promise) -> list[PromiseStatus]:
    return [row for row in done.promises if row.promise == promise]


def test_the_work_of_a_person_on_a_driver_of_another_package_is_their_own(tmp_path: Path) -> None:
    """4 N to and fro: the ledger falls by joules, nobody is broken, and it is stated what the user has put in."""
    prepared = prepared_with({"push": 4.0, "hertz": 1.5})
    session, done = run_of(prepared, tmp_path / "r.mcap")
    least = min(message.figures[names.LEDGER_MIN] for message in session.told["d"])
    assert least < -0.02
    assert verdict(done.promises).startswith("all promises kept")
    assert done.holds
    row, of_all = rows_of_promise(done, Promise.PASSIVITY)
    assert (of_all.state, of_all.who) == (PromiseState.KEPT, ())
    assert (row.state, row.who) == (PromiseState.UNJUDGED, ("d",))
    assert row.cost["J"] == pytest.approx(-least, abs=5e-3)
    assert "a person's hand holds d, and its work is its own; it has put in at least" in row.remark
    (word,) = rows_of_promise(done, Promise.DRIVER)
    assert (word.state, word.who) == (PromiseState.UNJUDGED, ("d",))
    assert "rests on the word of its driver tests.support.plugin_drivers:Counterpart" in word.remark
    assert "its own measurement of the force" in word.remark


@pytest.mark.parametrize("kind", ["Threefold", "LateForce", "NoRelease"])
def test_a_driver_that_measures_what_it_was_not_given_is_named_and_not_its_user(tmp_path: Path, kind: str) -> None:
    prepared = prepared_with({"push": 4.0, "hertz": 6.0, "measures": True}, kind=kind)
    assert prepared.certificate is not None
    # no force comes for a while, so that the device has to let go
    session = LateSession(prepared, TICKS, {}, stopped={"environment": (200, 60)} if kind == "NoRelease" else None)
    done = audited(tmp_path / "r.mcap", prepared, session.told)
    assert not done.holds
    (row,) = rows_of_promise(done, Promise.DRIVER)
    assert (row.state, row.who) == (PromiseState.BROKEN, ("d",))
    assert f"the driver tests.support.plugin_drivers:{kind} exerted forces that it had not been given" in row.remark
    assert row.cost["N"] > 0.4
    text = verdict(done.promises)
    assert text.startswith("worst: driver's word: broken by d")
    assert "The driver is wrong, and not its user" in text
    assert Promise.PASSIVITY not in {row.promise for row in missed(done.promises) if row.state == PromiseState.BROKEN}


def test_a_driver_that_measures_nothing_is_taken_at_its_word_and_that_is_said(tmp_path: Path) -> None:
    _, done = run_of(prepared_with({"push": 1.0}, kind="Threefold"), tmp_path / "r.mcap")
    (row,) = rows_of_promise(done, Promise.DRIVER)
    assert (row.state, row.who) == (PromiseState.UNJUDGED, ("d",))
    held = "that it holds the force at the tip from tick to tick"
    assert row.remark.endswith(f"its damping (osp), {held}, and that it exerts the force that it was given")
    assert verdict(done.promises).endswith("not judged: passivity (d), driver's word (d)")


BELOW: dict[str, Any] = {
    "device": {"osp": 0.5, "step": 2e-5, "friction": {"least": 0.4}},
    "parameters": {"damping": 0.5, "step": 2e-5, "friction": 0.4, "hertz": 2.0},
    "tree": ["design.speed=0.1"],
}


@pytest.mark.parametrize(("push", "faster"), [(0.8, False), (8.0, True)])
def test_a_device_with_an_encoder_is_certified_below_a_speed_and_its_account_follows(
    tmp_path: Path, push: float, faster: bool
) -> None:
    """Its friction counts as damping, by the least way that its samples allow, whatever they toggle."""
    parameters = {**BELOW["parameters"], "push": push}
    prepared = prepared_with(parameters, device=BELOW["device"], tree=BELOW["tree"])
    session, done = run_of(prepared, tmp_path / "r.mcap")
    figures = session.told["d"][-1].figures
    assert (figures[names.BEYOND] > 0.0) == faster
    assert figures[names.FASTEST] > 0.02
    assert [check for check in done.broken if check.party != "session"] == []
    (account,) = [check for check in done.checks if (check.name, check.party) == ("interface", "d")]
    assert (account.verdict, account.tolerance) == ("holds", 0.0)
    assert account.numbers > TICKS - 20
    (row,) = [row for row in rows_of_promise(done, Promise.SPEED) if row.who or not faster]
    assert row.state == (PromiseState.ENFORCED if faster else PromiseState.KEPT)
    if faster:
        assert "d may have moved at up to" in row.remark
    assert figures[names.INTERFACE_LEAST] >= -5e-3 * (1.0 + 1e-9)


def test_an_account_that_counts_every_step_as_a_way_is_another_than_was_recorded(tmp_path: Path) -> None:
    """The audit makes the same play of the recorded displacements, to the last bit."""
    parameters = {**BELOW["parameters"], "push": 3.0}
    prepared = prepared_with(parameters, device=BELOW["device"], tree=BELOW["tree"])
    session = LateSession(prepared, TICKS, {})
    finer = prepared_with(parameters, device={**BELOW["device"], "step": 1.9e-5}, tree=BELOW["tree"])
    done = audited(tmp_path / "r.mcap", prepared, session.told)
    assert [check for check in done.broken if check.party == "d"] == []
    account = next(
        check for check in audited(tmp_path / "f.mcap", finer, session.told).checks if check.name == "interface"
    )
    assert account.verdict == "broken"


JOINTED = "tests.support.jointed_drivers:"


def jointed(kind: str, *more: str) -> Prepared:
    more = more or ("devices.d.step=0.00001",)
    return prepare(load_session(HERE / "jointed.yaml", [f"devices.d.driver={JOINTED}{kind}", *more]))


def test_the_work_that_a_driver_told_is_that_of_its_linkage_along_its_motion(tmp_path: Path) -> None:
    _, done = run_of(jointed("Jointed"), tmp_path / "r.mcap")
    assert done.holds
    (check,) = [check for check in done.checks if check.name == "torques"]
    assert (check.party, check.verdict) == ("d", "holds")
    assert check.numbers > 2 * TICKS - 20
    assert 0.0 < check.tolerance < 2e-3
    (word,) = rows_of_promise(done, Promise.DRIVER)
    assert word.state == PromiseState.UNJUDGED


@pytest.mark.parametrize("kind", ["Against", "Halved"])
def test_a_driver_that_tells_another_work_is_named_by_the_audit(tmp_path: Path, kind: str) -> None:
    """Its account follows from what it told, and so nothing else in the recording contradicts it."""
    _, done = run_of(jointed(kind), tmp_path / "r.mcap")
    assert [check.name for check in done.broken if check.party == "d"] == ["torques"]
    (row,) = rows_of_promise(done, Promise.DRIVER)
    assert (row.state, row.who) == (PromiseState.BROKEN, ("d",))
    assert f"the driver {JOINTED}{kind} told another work of its motors than its linkage does" in row.remark
    assert "The driver is wrong, and not its user" in verdict(done.promises)


@pytest.mark.parametrize(
    ("more", "lacks"),
    [("devices.d.linkage={kappa: 20}", "kappa is stated, and no kinematics"), ("devices.d.mass=0.2", "no step")],
)
def test_a_work_that_nothing_follows_for_is_believed_and_the_audit_says_so(
    tmp_path: Path, more: str, lacks: str
) -> None:
    _, done = run_of(jointed("Halved", more), tmp_path / "r.mcap")
    assert done.holds
    (check,) = [check for check in done.checks if check.name == "torques"]
    assert check.verdict == "unchecked"
    assert lacks in check.gaps[0].why
    (word,) = rows_of_promise(done, Promise.DRIVER)
    assert word.state == PromiseState.UNJUDGED
