"""A run beside the program: the real processes live as long as the block, and nothing is left of them."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest

import manyhands as mh
from manyhands.launch.files import TargetError
from manyhands.launch.run.outcome import Progress
from manyhands.launch.run.processes import EndRequest

WITHIN = 60.0  # s, of a test for what must come


WALL = {
    "session": "wall",
    "period": 1e-3,
    "devices": {
        "d": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2, "hand": {"force": "pulse(t, 0, 0.1)"}}
    },
    "couplings": {"c": {"devices": ["d"]}},
    "environment": {"type": "network", "links": [{"between": ["d", "ground"], "stiffness": 2000}]},
    "design": {"coupling": "spring-damper", "ladder": []},
    "faults": {"restarts": 0},
}


@pytest.fixture(scope="module")
def certificate() -> mh.Certificate:
    return mh.certify(WALL)


def ticked(now: Progress) -> bool:
    return "d" in now.telemetry


def test_a_run_ends_by_itself_and_is_that_of_the_simulation(certificate: mh.Certificate, tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with mh.run(WALL, 0.3, clock="simulated", certificate=certificate, record=file) as run:
        assert run.wait(WITHIN)
        assert run.outcome is not None
    assert run.outcome.faults == ()
    assert run.report["duration"] == pytest.approx(0.3)
    assert set(run.report["nodes"]) == {"d", "c", "environment"}
    assert repr(run) == "BackgroundRun(wall, simulated clock, over after 0.3 s, 0 faults)"
    recorded, simulated = mh.read(file), mh.simulate(WALL, 0.3, certificate=certificate)
    assert np.array_equal(recorded.x, simulated.x)
    assert np.array_equal(recorded.f_v, simulated.f_v)
    assert recorded.certificate == certificate.id


def test_leaving_the_block_ends_an_endless_run(certificate: mh.Certificate, tmp_path: Path) -> None:
    with mh.run(WALL, clock="simulated", certificate=certificate, directory=tmp_path / "kept") as run:
        assert run.wait_for(ticked, WITHIN)
        assert run.outcome is None
        assert set(run.progress.states.values()) == {"running"}
        assert len(run.progress.pids) == 3
    assert run.outcome is not None
    assert run.outcome.faults == ()
    assert run.report["nodes"]["d"]["ticks"] > 0
    assert {path.name for path in (tmp_path / "kept").iterdir()} >= {"session.yaml", "certificate.json", "report.json"}


def test_stop_ends_it_before_the_block_is_left(certificate: mh.Certificate, tmp_path: Path) -> None:
    file = tmp_path / "run.npz"
    with mh.run(WALL, clock="simulated", certificate=certificate, record=file) as run:
        assert run.wait_for(ticked, WITHIN)
        assert not run.wait(0.0)
        run.stop()
        assert run.wait(WITHIN)
        run.stop()  # of a run that is over: nothing
    assert mh.read(file).x.shape[0] == run.report["nodes"]["d"]["ticks"]


def test_an_exception_of_the_block_ends_the_run_and_goes_on(certificate: mh.Certificate) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        mh.run(WALL, clock="simulated", certificate=certificate) as run,
    ):
        _ = 1 / 0
    assert run.outcome is not None


def test_a_process_that_fails_is_an_error_of_the_block(certificate: mh.Certificate) -> None:
    run = mh.run(WALL, clock="simulated", certificate=certificate)

    def kill_the_device() -> None:
        with run:
            os.kill(run.progress.pids["d"], signal.SIGKILL)
            assert run.wait(WITHIN)

    with pytest.raises(mh.RunFailed, match=r"^wall: d") as caught:
        kill_the_device()
    assert run.outcome is not None
    assert run.outcome.faults == caught.value.faults


def test_a_run_is_entered_once_and_from_any_thread(certificate: mh.Certificate) -> None:
    """Only the main thread may handle signals; a run beside a program needs none."""
    run = mh.run(WALL, 0.1, clock="simulated", certificate=certificate)
    assert repr(run) == "BackgroundRun(wall, simulated clock, not started)"
    with pytest.raises(RuntimeError, match="the run has not begun"):
        run.progress  # noqa: B018
    with pytest.raises(RuntimeError, match="the run is not over"):
        run.report  # noqa: B018

    def work() -> None:
        with run:
            run.wait(WITHIN)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(WITHIN)
    assert run.report["duration"] == pytest.approx(0.1)
    with pytest.raises(RuntimeError, match="a run is entered once"), run:
        pass


def test_files_that_cannot_be_written_are_refused_before_anything_starts(
    certificate: mh.Certificate, tmp_path: Path
) -> None:
    nowhere = tmp_path / "none" / "run.mcap"
    with pytest.raises(TargetError, match="found no folder"):
        mh.run(WALL, 0.1, clock="simulated", certificate=certificate, record=nowhere)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(TargetError, match="found a folder that is not empty"):
        mh.run(WALL, 0.1, clock="simulated", certificate=certificate, directory=tmp_path / "full")


def test_an_uncertified_session_is_refused() -> None:
    with pytest.raises(mh.NotCertified, match="example-1-uncoupled is not certified"):
        mh.run("example1-uncoupled", 0.1, clock="simulated")


def test_a_request_before_the_wait_is_seen_and_one_after_it_harms_nobody() -> None:
    request = EndRequest()
    request.ask()
    with request:
        assert request.signal is signal.SIGINT
        assert os.read(request.fd, 9) == b"\0"
        request.ask()
        assert os.read(request.fd, 9) == b"\0"
    request.ask()
    assert request.fd == -1
