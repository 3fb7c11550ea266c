"""Two runs of one session at once: at least one of them says so."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from manyhands.launch.run.directory import run_directory
from manyhands.launch.run.running import Running, running_sessions, twins
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED

from ...support.observed_session import ABOUT


@contextmanager
def run(pid: int, clock: str = REALTIME, session: str = ABOUT.session) -> Iterator[Running]:
    with run_directory() as directory:
        about = replace(ABOUT, pid=pid, clock=clock, session=session)
        about.save(directory)
        yield Running(directory, about)


def test_a_second_run_names_the_first_and_tells_both_apart() -> None:
    with run(7) as one:
        assert list(twins(one)) == []
        with run(os.getpid()) as two:
            assert len(running_sessions()) == 2
            (said,) = twins(two)
            (back,) = twins(one)
        assert list(twins(one)) == [], "the other is over"
    assert said.startswith(f"{ABOUT.session} runs here twice, the other time as process 7: ")
    assert said.endswith(f"--running 7 names the other, --running {os.getpid()} this one")
    assert f"as process {os.getpid()}: " in back


def test_two_in_one_process_cannot_be_told_apart_by_it() -> None:
    with run(7), run(7) as two:
        (said,) = twins(two)
    assert "--running" not in said


@pytest.mark.parametrize("other", [{"clock": SIMULATED}, {"session": "another"}])
def test_a_simulation_beside_it_and_another_session_are_no_twins(other: dict[str, str]) -> None:
    with run(7, **other) as one, run(8) as two:
        assert list(twins(two)) == []
        assert list(twins(one)) == []
