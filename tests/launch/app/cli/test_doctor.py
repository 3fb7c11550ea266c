"""`manyhands doctor` as a process: its object, tables and exit codes; an interrupt leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from manyhands.nodes.kernel.realtime import may_raise

from ....support.commands import manyhands_command

PERCENTILES = ["p50", "p99", "p999", "max"]
DOCUMENT = Path(__file__).parents[4] / "docs" / "doctor.md"

pytestmark = pytest.mark.usefixtures("own_interrupt")


def doctor(*arguments: str) -> Result:
    return manyhands_command("doctor", *arguments)


@pytest.mark.alone  # it measures the machine
def test_the_object_has_what_was_measured_and_what_it_means() -> None:
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    result = doctor("--duration", "1", "--json")
    assert result.exit_code == 0, result.stderr
    found: dict[str, Any] = json.loads(result.stdout)
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before  # its processes are raised, it is not
    assert "measuring a tick over ipc" in result.stderr
    assert found["session"] == "example-1"
    assert found["machine"]["usable"] == sorted(os.sched_getaffinity(0))
    assert {"default_slack", "least_slack"} <= found["waking_us"].keys() <= {"default_slack", "least_slack", "fifo"}
    assert ("fifo" in found["waking_us"]) is found["granted"]["fifo"]["granted"]
    assert found["granted"]["fifo"]["granted"] <= may_raise()
    assert {"ipc", "tcp_curve"} <= found["tick"].keys()
    for spread in (*found["waking_us"].values(), *(tick["tau_us"] for tick in found["tick"].values())):
        assert list(spread) == PERCENTILES
        assert 0.0 <= spread["p50"] <= spread["p99"] <= spread["p999"] <= spread["max"]
    for tick in found["tick"].values():
        assert 0 < tick["ticks"] <= 3 * 1000  # three devices; one that falls behind leaves ticks out
        assert 0 <= tick["late"] <= tick["ticks"]
        assert tick["tau_us"]["p50"] > 0.0
    assert set(found["stiffness"]) == {"dx", "dy", "dz"}
    for device in found["stiffness"].values():
        assert device["no_delay"] == pytest.approx(2740.0)
        for way in found["tick"]:
            assert 0.0 <= device[way]["p999"] <= device[way]["p50"] <= device["no_delay"]
    assert all(one["change"] and one["buys"] for one in found["advice"])
    text = DOCUMENT.read_text()
    parts = [found, found["machine"], found["waking_us"], found["tick"], found["tick"]["ipc"], found["granted"]]
    parts += [found["granted"]["fifo"], found["stiffness"]["dx"], *found["advice"][:1]]
    for key in {key for part in parts for key in part}:
        assert f"`{key}`" in text, f"docs/doctor.md does not tell what {key!r} is"


@pytest.mark.long
@pytest.mark.alone  # it measures the machine
def test_people_get_tables_of_any_session() -> None:
    result = doctor("example1-centralised", "--duration", "1")  # one coupling with three devices
    assert result.exit_code == 0, result.stderr
    for expected in (
        "this machine",
        "how late a process wakes",
        "of a session at rest",
        "certified stiffness",
        "ipc",
        "tcp",
    ):
        assert expected in result.stdout
    assert "ipc, SCHED_FIFO" not in result.stdout or may_raise()


@pytest.mark.parametrize("seconds", ["0.5", "601", "nan", "inf", "-1"])
def test_seconds_out_of_range_are_refused(seconds: str) -> None:
    result = doctor("--duration", seconds)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: --duration: found ")
    assert "expected 1 to 600 s" in result.stderr


def test_a_session_that_is_too_large_or_not_there_is_refused(tmp_path: Path) -> None:
    names = [f"d{i}" for i in range(40)]
    session = {
        "session": "large",
        "period": 0.001,
        "devices": {name: {"dof": 1, "osp": 1.0, "driver": "simulated", "mass": 0.2} for name in names},
        "couplings": {f"c{name}": {"devices": [name]} for name in names},
        "environment": {
            "type": "network",
            "masses": {},
            "links": [{"between": [name, "ground"], "stiffness": 100.0, "damping": 0.1} for name in names],
        },
        "design": {"coupling": "spring-damper", "objective": "feasible"},
    }
    (tmp_path / "large.yaml").write_text(json.dumps(session))
    result = doctor(str(tmp_path / "large.yaml"))
    assert result.exit_code == 2, result.output
    assert "found 81 processes; expected at most 64" in result.stderr
    assert doctor(str(tmp_path / "none.yaml")).exit_code == 2


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_doctor_leaves_nothing(which: signal.Signals) -> None:
    """The fixture of all tests looks for processes, files and descriptors afterwards."""
    with subprocess.Popen(
        [sys.executable, "-P", "-m", "manyhands", "doctor", "--duration", "60"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        assert "measuring how late" in process.stderr.readline()
        process.send_signal(which)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 128 + which
    assert out == ""
    assert "interrupted" in err
    assert "Traceback" not in err


def test_help_ends_with_an_example() -> None:
    text = doctor("--help").stdout
    assert "Example: manyhands doctor" in text.split("Options")[-1]
