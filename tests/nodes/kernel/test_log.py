"""A process's log: every line is whole, nothing is raised, and its length is bounded on any disk."""

from __future__ import annotations

import json
import math
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.nodes.kernel.log import LEVELS, MAX_VALUE, QUEUE_EVENTS, Log, LogEvent, LogLevel, log_path
from manyhands.protocol.clock import Instant, SimulatedClock

WALL = 1_767_323_045_678_901_234  # 2026-01-02 03:04:05.678901234 UTC


def log(path: Path | None, most_bytes: int = 10_000) -> Log:
    clock = SimulatedClock()
    clock.sleep_until(Instant(42))
    return Log(path, "s", "dx", clock, lambda: WALL, most_bytes)


def lines(path: Path) -> list[dict[str, Any]]:
    text = path.read_text()
    assert text == "" or text.endswith("\n")
    return [json.loads(line, parse_constant=pytest.fail) for line in text.splitlines()]


@contextmanager
def files_no_longer_than(length: int) -> Iterator[None]:
    """The kernel refuses what would make a file of this process longer, as it does on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_line_has_time_place_event_and_severity(tmp_path: Path) -> None:
    one = log(tmp_path / "dx.jsonl")
    one.note(LogEvent.FROZEN, peer="cx", tick=7, ratio=math.nan, why=None, forced=True)
    assert (tmp_path / "dx.jsonl").read_text() == ""  # a tick writes nothing
    one.close()
    assert lines(tmp_path / "dx.jsonl") == [
        {
            "time": "2026-01-02T03:04:05.678901Z",
            "monotonic_ns": 42,
            "session": "s",
            "node": "dx",
            "level": "warning",
            "event": "frozen",
            "peer": "cx",
            "tick": 7,
            "ratio": None,
            "why": None,
            "forced": True,
        }
    ]
    assert stat.S_IMODE((tmp_path / "dx.jsonl").stat().st_mode) == 0o600
    assert (one.dropped, one.trouble) == (0, None)


@given(st.dictionaries(st.text(max_size=5), st.text() | st.floats() | st.integers() | st.booleans() | st.none()))
def test_whatever_is_noted_becomes_one_line(tmp_path: Path, data: dict[str, str | float | int | bool | None]) -> None:
    path = tmp_path / "any.jsonl"
    path.unlink(missing_ok=True)
    one = log(path)
    one.note(LogEvent.INCIDENT, **{f"_{name}": value for name, value in data.items()})
    one.close()
    (line,) = lines(path)
    assert line["event"] == "incident"
    for name, value in data.items():
        told = line[f"_{name}"]
        if isinstance(value, str):
            assert len(told) <= MAX_VALUE
            assert "\x1b" not in told
        elif isinstance(value, float) and not math.isfinite(value):
            assert told is None
        else:
            assert told == value


def test_an_event_cannot_pass_itself_off_as_another_nodes(tmp_path: Path) -> None:
    one = log(tmp_path / "dx.jsonl")
    one.note(LogEvent.NOTICE, **{"node": "dy", "level": "info", "text": "x"})
    one.close()
    (line,) = lines(tmp_path / "dx.jsonl")
    assert (line["node"], line["level"], line["text"]) == ("dx", "warning", "x")


def test_the_queue_is_bounded_and_what_it_cannot_take_is_counted(tmp_path: Path) -> None:
    one = log(tmp_path / "dx.jsonl", most_bytes=10**6)
    for tick in range(QUEUE_EVENTS + 5):
        one.note(LogEvent.STALE, tick=tick)
    one.flush()
    one.note(LogEvent.END, reason="done")
    one.close()
    found = lines(tmp_path / "dx.jsonl")
    assert [line["tick"] for line in found[:-1]] == list(range(QUEUE_EVENTS))
    assert found[-1]["dropped"] == 5


@given(st.lists(st.tuples(st.sampled_from(LogEvent), st.integers(0, 400)), max_size=60), st.integers(500, 3000))
def test_a_log_stays_within_its_length_and_marks_its_end(
    tmp_path: Path, noted: list[tuple[LogEvent, int]], most: int
) -> None:
    path = tmp_path / "long.jsonl"
    path.unlink(missing_ok=True)
    one = log(path, most)
    kept = [event for event, _ in noted if event not in (LogEvent.END, LogEvent.TRUNCATED)]
    for event, length in noted:
        if event not in (LogEvent.END, LogEvent.TRUNCATED):
            one.note(event, text="x" * length)
            one.flush()
    one.note(LogEvent.END, reason="done")
    one.close()
    found = lines(path)
    assert found[-1]["event"] == "end"
    truncated = [line["event"] for line in found].count("truncated")
    assert truncated == (1 if one.dropped else truncated) <= 1
    assert found[-1].get("dropped", 0) == one.dropped == len(kept) - (len(found) - 1 - truncated)
    without_last_words = sum(len(json.dumps(line)) + 1 for line in found if line["event"] not in ("end", "truncated"))
    assert without_last_words <= most


def test_a_restarted_node_continues_its_log_within_the_length(tmp_path: Path) -> None:
    path = tmp_path / "dx.jsonl"
    for _ in range(2):
        one = log(path, most_bytes=400)
        one.note(LogEvent.START, text="x" * 100)
        one.note(LogEvent.START, text="x" * 100)
        one.close()
    assert [line["event"] for line in lines(path)] == ["start", "truncated", "truncated"]


@pytest.mark.parametrize("room", [0, 1, 150, 250])
def test_a_full_disk_is_counted_and_leaves_no_half_line(tmp_path: Path, room: int) -> None:
    one = log(tmp_path / "dx.jsonl")
    one.note(LogEvent.START)
    one.flush()
    before = (tmp_path / "dx.jsonl").stat().st_size
    with files_no_longer_than(before + room):
        one.note(LogEvent.LOOP, text="x" * 200)
        one.note(LogEvent.LOOP, text="x" * 200)
        one.flush()
    assert [line["event"] for line in lines(tmp_path / "dx.jsonl")] == ["start"]
    assert one.dropped == 2
    assert one.trouble in ("File too large", "not all of a line was taken")
    one.note(LogEvent.END, reason="done")  # there is room again
    one.close()
    assert lines(tmp_path / "dx.jsonl")[-1] == {**lines(tmp_path / "dx.jsonl")[0], "event": "end", "reason": "done",
                                                "dropped": 2}  # fmt: skip


def test_an_unopenable_or_unwanted_log_disturbs_nobody(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    for path, trouble in ((tmp_path / "absent" / "dx.jsonl", "No such file"), (tmp_path / "link", "Too many levels")):
        one = log(path)
        one.note(LogEvent.START)
        one.close()
        one.close()
        assert one.dropped == 1
        assert trouble in str(one.trouble)
    unwanted = log(None)
    for _ in range(2 * QUEUE_EVENTS):
        unwanted.note(LogEvent.START)
    unwanted.close()
    assert (unwanted.dropped, unwanted.trouble) == (0, None)
    assert not (tmp_path / "elsewhere").exists()


def test_every_event_has_a_level_and_a_guest_no_log() -> None:
    assert LEVELS.keys() == set(LogEvent)
    assert set(LEVELS.values()) == set(LogLevel)
    assert log_path("", "dx") is None
    assert log_path("/run", "dx") == Path("/run/log/dx.jsonl")
