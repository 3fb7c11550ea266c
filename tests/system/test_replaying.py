"""A whole session is recorded, run again and audited; a file changed afterwards is reported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from manyhands.launch.recordings.run import read_run
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Observation

from ..support.commands import forked, run

TRACES = ("x", "f_v", "ledger", "tau_us", "instants", "interface")  # what a device in wall time owes in every tick
TICKS = 250  # no multiple of the ticks between two telemetry messages


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    run("launch", "example1-operator", "--clock", "simulated", "--duration", f"{TICKS / 1000}", "--record", path)
    return path


def told(code: int, *arguments: str | Path) -> str:
    """The output of a command that ends with ``code``."""
    done = forked(*arguments)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


def test_a_recorded_session_is_the_same_again_and_holds(recording: Path) -> None:
    # x, f_v of three axes and a ledger; p, f_v and a ledger of three couplings; x_e, q and a ledger
    numbers = TICKS * (7 + 9 + 5)
    assert (
        run("replay", recording).strip() == f"{recording}: identical: {numbers} numbers of {TICKS} ticks, bit for bit"
    )
    audit = json.loads(run("audit", recording, "--json"))
    assert (audit["holds"], audit["ticks"], audit["clock"], audit["damage"]) == (True, TICKS, "simulated", [])
    assert {check["verdict"] for check in audit["checks"]} == {"holds"}
    ledgers = {check["party"]: check["numbers"] for check in audit["checks"] if check["name"] == "ledger"}
    assert ledgers == dict.fromkeys(("d", "cx", "cy", "cz", "environment"), TICKS)


def test_a_session_in_real_time_audits_to_the_end(tmp_path: Path) -> None:
    """However late a busy machine makes it: what the certificate assumes of delays is a finding of its own."""
    path = tmp_path / "real.mcap"
    run("launch", "example1", "--duration", "1", "--record", path, "--set", "design.tau=0.001")
    out = run("audit", path)
    for device in ("dx", "dy", "dz"):
        assert f"{device}: lateness put in no more than its tank of 5 mJ and 1 mW: least account " in out
    audit = json.loads(run("audit", path, "--json"))
    found = {(check["party"], check["name"]): check for check in audit["checks"]}
    for device in ("dx", "dy", "dz"):
        for name in ("signal", "exerted", "interface", "ended", "instants", "account", "ledger"):
            assert (found[device, name]["verdict"], found[device, name]["unchecked"]) == ("holds", []), found[
                device, name
            ]
        # of the ticks that it owed: a busy machine may leave its coupling out for a while, and the last may be unsent
        owed = found[device, "rows"]["numbers"] / len(TRACES)
        assert found[device, "interface"]["numbers"] > 0.9 * owed > 0.0
        assert found[device, "interface"]["tolerance"] == 0.0


def test_one_changed_byte_is_located(recording: Path, tmp_path: Path) -> None:
    data = bytearray(recording.read_bytes())
    at = len(data) // 3
    data[at] ^= 1
    path = tmp_path / "changed.mcap"
    path.write_bytes(data)
    for command in ("replay", "audit"):
        first = told(1, command, path).splitlines()[0]
        assert first.startswith(f"{path}: damaged: bytes ")
        begin, end = map(int, first.split("bytes ")[1].split(":")[0].split(" to "))
        assert begin <= at <= end


def test_a_forged_ledger_is_found_at_its_tick_and_party(recording: Path, tmp_path: Path) -> None:
    path = forged(recording, tmp_path / "forged.mcap", "cy", "ledger", 137, 1e-3)
    out = told(1, "audit", path)
    (line,) = [line for line in out.splitlines() if line.startswith("broken: ")]
    assert line.startswith("broken: cy: ledger: differs first at tick 137, E: recorded ")
    assert "damaged" not in out  # every checksum is right again
    assert told(1, "replay", path).startswith("cy/ledger differs first at tick 137, E: recorded ")


def forged(source: Path, target: Path, node: str, topic: str, tick: int, by: float) -> Path:
    """The recording once more, written by a recorder, with one number changed."""
    run_ = read_run(source)
    values = run_.traces[node, topic].values
    values[tick, 0] += by
    core = RecorderCore(run_.recorded, run_.attachments, 10**18)
    for name in run_.recorded.roles:
        begin = 0
        for until, figures in run_.figures[name]:
            rows = {
                trace.topic.trace: trace.values[begin:until] for (of, _), trace in run_.traces.items() if of == name
            }
            core.take(encode(Observation(name, until, figures, rows)), 10**18)
            begin = until
    assert core.refused == 0
    target.write_bytes(core.cut() + core.end())
    return target
