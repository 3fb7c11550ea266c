"""A recorded session run again is identical to the last bit, or the first difference is reported."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.audit.replay import GivenMotion, Replayed, replay
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.recording import RecordingError
from manyhands.launch.recordings.run import read_run
from manyhands.launch.session import load_session
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, SESSION_FILE
from manyhands.protocol.channels import DISPLACEMENT, FORCE, LEDGER

from ...support.simulated_recordings import (
    SESSIONS,
    TICKS,
    attachments_of,
    forged,
    prepared_as,
    recorded_of,
    simulated,
    written,
)


def replayed(prepared: Prepared, path: Path) -> Replayed:
    return replay(prepared, read_run(path))


@pytest.mark.parametrize("name", ["example1-operator", "linear", "enforced", "carry", "steering", "stroke"])
def test_every_number_is_the_same(name: str, tmp_path: Path) -> None:
    prepared = prepared_as(name)
    rows = simulated(prepared, TICKS)
    found = replayed(prepared, written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows))
    assert found.identical
    assert found.numbers == sum(values.size for (_, trace), values in rows.items() if trace != "tau_us")
    assert (found.ticks, found.missing, found.deviations, found.differing) == (TICKS, {}, (), 0)


@pytest.mark.parametrize("uncertified", [False, True])
def test_a_session_without_masses_is_replayed(tmp_path: Path, uncertified: bool) -> None:
    links = ", ".join(f"{{between: [{one}, ground], stiffness: 2600, damping: 0.5}}" for one in ("dx", "dy", "dz"))
    overrides = ["environment.masses={}", f"environment.links=[{links}]", "design.ladder=[]"]
    prepared = prepare(load_session(SESSIONS / "example1.yaml", overrides), uncertified=uncertified)
    rows = simulated(prepared, TICKS)
    path = written(tmp_path / "r.mcap", recorded_of(prepared), attachments_of(prepared), rows)
    assert ("environment", "q") not in rows
    assert replayed(prepared, path).identical


def test_traces_are_what_the_recording_of_a_simulation_holds(prepared: Prepared) -> None:
    simulation = Simulation(prepared)
    traces = simulation.traces(TICKS)
    recording = simulation.run(TICKS, traces=traces)
    x, f = (np.hstack([traces.by_node[name][i].values for name in prepared.session.devices]) for i in (0, 1))
    np.testing.assert_array_equal(x, recording.x)
    np.testing.assert_array_equal(f, recording.f_v)
    for name, ledger in simulation.ledgers.items():
        assert traces.by_node[name][-1].topic.trace == LEDGER
        assert traces.by_node[name][-1].values[-1, 0] == ledger.total
    np.testing.assert_array_equal(Simulation(prepared).run(TICKS).x, recording.x)


def test_a_silent_coupling_sends_nothing(prepared: Prepared) -> None:
    rows = simulated(prepared, TICKS, [Silence("cx", 100, 150)])
    told = np.isfinite(rows["cx", "p"]).all(axis=1)
    assert np.flatnonzero(~told).tolist() == list(range(100, 150))
    assert np.isfinite(rows["dx", "x"]).all()


@pytest.mark.parametrize(
    ("node", "trace", "topic", "tick"),
    [
        ("dx", DISPLACEMENT, "sample", 0),
        ("dy", FORCE, "force", 200),
        ("dz", LEDGER, "ledger", TICKS - 1),
        ("cy", FORCE, "reaction", 250),
        ("environment", "x_e", "tools", 222),
        ("environment", "q", "masses", 223),
    ],
)
def test_one_number_in_its_last_place_is_found(
    prepared: Prepared, recording: Path, tmp_path: Path, node: str, trace: str, topic: str, tick: int
) -> None:
    run = read_run(recording)

    def change(rows: dict[tuple[str, str], np.ndarray]) -> None:
        rows[node, trace][tick, 0] = np.nextafter(rows[node, trace][tick, 0], 1.0)

    found = replayed(prepared, forged(tmp_path / "forged.mcap", run, change))
    assert not found.identical
    assert found.differing == 1
    (deviation,) = found.deviations
    first = deviation.first
    assert (deviation.node, deviation.topic, first.tick) == (node, topic, tick)
    assert first.recorded == np.nextafter(first.recomputed, 1.0)
    assert first.column == {"sample": "dx", "force": "dy", "ledger": "E", "reaction": "dy"}.get(topic, first.column)


def test_missing_ticks_are_reported(prepared: Prepared, recording: Path, tmp_path: Path) -> None:
    def change(rows: dict[tuple[str, str], np.ndarray]) -> None:
        for (node, _), values in rows.items():
            if node == "cx":
                values[100:130] = np.nan

    found = replayed(prepared, forged(tmp_path / "holes.mcap", read_run(recording), change))
    assert found.missing == {"cx/tool": 30, "cx/reaction": 30, "cx/ledger": 30}
    assert (found.deviations, found.identical) == ((), False)


def test_nodes_that_end_at_different_ticks_are_no_gap(prepared: Prepared, recording: Path, tmp_path: Path) -> None:
    def change(rows: dict[tuple[str, str], np.ndarray]) -> None:
        for (node, _), values in rows.items():
            if node == "environment":
                values[TICKS - 3 :] = np.nan

    found = replayed(prepared, forged(tmp_path / "shorter.mcap", read_run(recording), change))
    assert found.identical
    assert found.numbers == replayed(prepared, recording).numbers - 3 * 5


def test_a_given_motion_is_taken_as_it_was(prepared: Prepared) -> None:
    rows = simulated(prepared, TICKS)
    again = Simulation(prepared, {"dx": GivenMotion(rows["dx", "x"])})
    traces = again.traces(TICKS)
    again.run(TICKS, traces=traces)
    np.testing.assert_array_equal(traces.by_node["dx"][1].values, rows["dx", "f_v"])
    np.testing.assert_array_equal(traces.by_node["environment"][0].values, rows["environment", "x_e"])
    assert not np.array_equal(traces.by_node["dx"][2].values, rows["dx", "ledger"])  # the hand's work is unknown


def test_a_given_motion_goes_as_far_as_its_first_gap() -> None:
    x = np.zeros((5, 2))
    assert GivenMotion(x).ticks == 5
    x[3, 1] = np.nan
    assert (GivenMotion(x).ticks, GivenMotion(x).axes) == (3, 2)


def invoke(*arguments: str | Path) -> tuple[int, str, str]:
    found = CliRunner().invoke(app, [*map(str, arguments)])
    return found.exit_code, found.stdout, found.stderr


def test_the_command_prints_identical(recording: Path) -> None:
    code, out, _ = invoke("replay", recording)
    assert (code, out.strip()) == (0, f"{recording}: identical: {23 * TICKS} numbers of {TICKS} ticks, bit for bit")
    code, out, _ = invoke("replay", recording, "--json")
    told = json.loads(out)
    assert (code, told["identical"], told["numbers"], told["damage"]) == (0, True, 23 * TICKS, [])


def test_the_command_prints_where_it_differs(recording: Path, tmp_path: Path) -> None:
    def change(rows: dict[tuple[str, str], np.ndarray]) -> None:
        rows["cz", "p"][301, 0] += 1e-9
        rows["dy", LEDGER][217, 0] += 1e-6

    path = forged(tmp_path / "forged.mcap", read_run(recording), change)
    code, out, _ = invoke("replay", path)
    assert code == 1
    first, second, last = out.splitlines()
    assert first.startswith("dy/ledger differs first at tick 217, E: recorded ")
    assert second.startswith("cz/tool differs first at tick 301, dz: recorded ")
    assert last.endswith(f"not identical: 2 of {23 * TICKS} numbers of {TICKS} ticks differ")


def test_a_changed_byte_is_reported_first(recording: Path, tmp_path: Path) -> None:
    data = bytearray(recording.read_bytes())
    at = len(data) // 2
    data[at] ^= 0x10
    (tmp_path / "damaged.mcap").write_bytes(data)
    code, out, _ = invoke("replay", tmp_path / "damaged.mcap")
    assert code == 1
    begin, end = map(int, out.splitlines()[0].split("bytes ")[1].split(":")[0].split(" to "))
    assert begin <= at <= end


def test_real_time_is_refused(prepared: Prepared, recording: Path, tmp_path: Path) -> None:
    run = read_run(recording)
    run = dataclasses.replace(run, recorded=recorded_of(prepared, "realtime"))
    path = forged(tmp_path / "rt.mcap", run, lambda rows: rows["dx", "tau_us"].fill(1.0))
    code, out, err = invoke("replay", path)
    assert (code, out) == (2, "")
    assert "found a session in real time" in err
    assert f"manyhands audit {path}" in err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda parts: parts.pop(SESSION_FILE), "found no session in it; expected the attachment session.yaml"),
        (lambda parts: parts.pop(CERTIFICATE_FILE), "found no certificate in it; expected "),
        (lambda parts: parts.update({SESSION_FILE: b"period: 3"}), "in it: session.yaml:1: found no key "),
        (lambda parts: parts.update({CERTIFICATE_FILE: b"{}"}), "certificate.json: not a certificate"),
    ],
)
def test_what_cannot_be_prepared_is_refused(prepared: Prepared, tmp_path: Path, change: object, words: str) -> None:
    parts = attachments_of(prepared)
    change(parts)  # type: ignore[operator]  # one of the four above
    path = written(tmp_path / "r.mcap", recorded_of(prepared), parts, simulated(prepared, 5))
    code, out, err = invoke("replay", path)
    assert (code, out) == (2, "")
    assert words in err
    assert str(path) in err
    assert "recorded-" not in err  # not the folder, which is gone by then


def test_a_session_of_another_shape_is_refused(prepared: Prepared, tmp_path: Path) -> None:
    recorded = dataclasses.replace(recorded_of(prepared), period=0.002)
    path = written(tmp_path / "r.mcap", recorded, attachments_of(prepared), simulated(prepared, 5))
    code, _, err = invoke("replay", path)
    assert code == 2
    assert "found a session with the period" in err


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_bytes(b"nothing of the kind")
    for command in ("replay", "audit"):
        code, out, err = invoke(command, tmp_path / "no.mcap")
        assert (code, out) == (2, "")
        assert "expected an .mcap recording" in err
    with pytest.raises(RecordingError):
        read_run(tmp_path / "no.mcap")
