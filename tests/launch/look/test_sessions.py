"""Observing a session: its end, the messages meanwhile, and bounds on every wait."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.launch.look.sessions import LOOK, presence, watch
from manyhands.launch.run.running import Running
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Observation

from ...support.observed_frames import ABOUT, MS, Frames, condition, telemetry


def test_messages_are_printed_in_order_with_instants_until_the_session_ends() -> None:
    frames = Frames({10: [telemetry("d", 100)], 20: [condition()], 30: [condition("over")], 40: [telemetry("d", 200)]})
    scene = LiveSession(ABOUT)
    seen = list(watch(frames, scene, frames.clock, lambda: False))
    assert [(one.at // MS, type(one.message)) for one in seen] == [
        (10, Observation), (20, Condition), (30, Condition),
    ]  # fmt: skip
    assert scene.condition is not None
    assert (scene.condition.phase, scene.tick) == ("over", 100)


def test_silence_is_reported_and_watching_ends_with_the_supervisor() -> None:
    frames = Frames({350: [b"no message at all"], 360: [telemetry("d", 100)]})
    looks: list[int] = []

    def gone() -> bool:
        looks.append(frames.clock.now() // MS)
        return frames.clock.now() > 900 * MS

    seen = list(watch(frames, LiveSession(ABOUT), frames.clock, gone))
    assert [(one.at // MS, one.message is None) for one in seen] == [
        (200, True), (350, True), (360, False), (560, True), (760, True),
    ]  # fmt: skip
    assert looks == [200, 560, 760, 960]  # frames that have come are read before the end is noticed


def test_at_its_deadline_it_ends_even_where_frames_come_without_end() -> None:
    frames = Frames({ms: [telemetry("d", 100 + ms)] for ms in range(5000)})
    seen = list(watch(frames, LiveSession(ABOUT), frames.clock, lambda: False, Instant(1000 * MS)))
    assert seen[-1].at == 1000 * MS
    quiet = Frames({})
    list(watch(quiet, LiveSession(ABOUT), quiet.clock, lambda: False, Instant(450 * MS)))
    assert quiet.clock.now() == 450 * MS
    assert quiet.waits == [LOOK, LOOK, 50 * MS]


@pytest.fixture
def running(tmp_path: Path) -> Running:
    replace(ABOUT, pid=os.getpid()).save(tmp_path)
    return Running(tmp_path, replace(ABOUT, pid=os.getpid()))


def test_a_supervisor_is_there_while_its_directory_is(running: Running) -> None:
    with presence(running) as gone:
        assert not gone()
        (running.directory / "about.json").unlink()
        assert gone()


def test_an_ended_but_unreaped_supervisor_counts_as_gone(running: Running) -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        with presence(replace(running, about=replace(ABOUT, pid=process.pid))) as gone:
            assert not gone()
            process.kill()
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
            assert gone()
    with presence(replace(running, about=replace(ABOUT, pid=process.pid))) as gone:
        assert gone()
