"""The benchmarks of the loop run for a moment and report in the documented form. No timings."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
PERCENTILES = ["p50", "p99", "p999", "max"]
DEVICES = {"dx", "dy", "dz"}


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Benchmarks are scripts beside each other, and no package."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    monkeypatch.syspath_prepend(BENCHMARKS / "loop_peers")


def run(script: str, *arguments: str | Path) -> str:
    command = [sys.executable, str(BENCHMARKS / script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("| ")]


PROCESSES = {"manyhands": 8, "manyhands-colocated": 5, "pyzmq": 7}


@pytest.mark.long
@pytest.mark.alone
def test_the_loop_beside_bare_pyzmq(tmp_path: Path) -> None:
    file, picture, page = tmp_path / "loop.json", tmp_path / "loop.png", tmp_path / "page.md"
    page.write_text("before\n<!-- loop: begin -->\nold\n<!-- loop: end -->\nafter\n")
    said = run(
        "loop.py", "--rounds", "2", "--seconds", "0.3", "--only", "--json", file, "--plot", picture, "--markdown", page
    )
    content = json.loads(file.read_text())
    compiled = {"manyhands-compiled", "manyhands-compiled-colocated"}  # only where they have been built
    assert [set(of) - compiled for of in content["runs"]] == [set(PROCESSES)] * 2
    assert content["failed"].keys() <= compiled
    for of in content["runs"]:
        for name, one in of.items():
            assert one["tau_us"].keys() == DEVICES
            for tau in one["tau_us"].values():
                values = [tau[percentile] for percentile in PERCENTILES]
                assert values[0] > 0.0
                assert values == sorted(values)
            assert one["processes"] == PROCESSES[name.replace("-compiled", "")]
            assert 0.0 <= one["late"] <= 1.0
            assert 0 < one["ticks"] <= 300
            assert one["resident"] > 7 * 5.0  # MiB: no interpreter is smaller
    assert len(rows(said)) == 1 + len(content["runs"][0])
    assert page.read_text() == f"before\n<!-- loop: begin -->\n{said.strip()}\n<!-- loop: end -->\nafter\n"
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.alone
def test_the_memory_of_a_run(tmp_path: Path) -> None:
    file = tmp_path / "soak.json"
    said = run("loop.py", "--soak", "0.5", "--json", file)
    content = json.loads(file.read_text())
    assert content["resident"].keys() == {*DEVICES, "cx", "cy", "cz", "environment", "supervisor"}
    assert all(len(of) == len(content["seconds"]) for of in content["resident"].values())
    assert len(rows(said)) == 1 + 8


def test_the_users_of_one_environment(tmp_path: Path) -> None:
    file = tmp_path / "users.json"
    said = run("users.py", "--users", "3", "--seconds", "0.3", "--repeats", "1", "--json", file)
    (point,) = json.loads(file.read_text())["points"]
    assert point["users"] == 3
    assert 0 < point["ticks"] <= 300
    assert 0.0 <= point["late"] <= 1.0
    values = [point["round_trip_us"][percentile] for percentile in PERCENTILES]
    assert values[0] > 0.0
    assert values == sorted(values)
    assert len(rows(said)) == 2


def test_what_a_datagram_costs() -> None:
    said = rows(run("datagrams.py", "--rounds", "1", "--count", "20", "--seconds", "0.3"))
    assert len(said) == (1 + 9) + (1 + 3)
    assert [row.split(" | ")[0] for row in said[-3:]] == ["| none", "| stranger", "| forger"]
    for row in said[1:10]:
        assert all(float(cell) >= 0.0 for cell in row.strip("| ").split(" | ")[1:])


def test_a_page_without_marks_is_left_alone(tmp_path: Path) -> None:
    from page import fill  # type: ignore[import-not-found]

    page = tmp_path / "page.md"
    page.write_text("<!-- loop: begin -->\nno end\n")
    with pytest.raises(SystemExit, match="found no place"):
        fill(page, "loop", "figures")
    assert page.read_text() == "<!-- loop: begin -->\nno end\n"


def test_ratios_are_taken_within_a_round() -> None:
    from loop_figures import table  # type: ignore[import-not-found]

    def of(tau: float) -> dict[str, Any]:
        percentiles = dict.fromkeys(PERCENTILES, tau)
        return {
            "tau_us": dict.fromkeys(DEVICES, percentiles),
            "ticks": 10,
            "late": 0.0,
            "processes": 7,
            "cpu": 0.5,
            "resident": 100.0,
            "told": "",
        }

    rounds = [(150.0, 100.0), (2500.0, 1000.0), (400.0, 200.0)]  # ours, bare; the machine is not always the same
    content = {
        "rounds": 3,
        "seconds": 1.0,
        "machine": {},
        "treatment": {},
        "failed": {"dora": "there is none"},
        "runs": [{"manyhands": of(ours), "pyzmq": of(bare)} for ours, bare in rounds],
    }
    said = table(content)
    assert "| **manyhands** | 400 | 400 | 400 | 0.00% | 2.00 (1.50-2.50) |" in said
    assert "dora did not run: there is none" in said
    assert "missed (2.00)" in said


def test_memory_that_grows_is_seen() -> None:
    from loop_figures import slope

    seconds = [float(s) for s in range(120)]
    assert slope(seconds, [10.0] * 120) == 0.0
    assert slope(seconds, [10.0 + s / 60.0 for s in seconds]) == pytest.approx(1024.0)  # a MiB a minute
    assert slope(seconds, [0.0] * 12 + [10.0] * 108) == 0.0  # what is needed to warm up is no leak


class Over(Exception):
    """A scripted wire has no frame left."""


class ScriptedWire:
    """The frames of each peer, in order; None for no frame within the time."""

    version = "scripted"

    def __init__(self, **heard: Iterable[bytes | None]) -> None:
        self._heard = {peer: iter(frames) for peer, frames in heard.items()}
        self.sent: list[tuple[str, bytes]] = []

    def send(self, peer: str, frame: bytes) -> None:
        self.sent.append((peer, frame))

    def receive(self, peer: str, wait: float) -> bytes | None:
        try:
            return next(self._heard[peer])
        except StopIteration:
            raise Over from None


def test_the_chain_of_others_goes_on_after_a_lost_frame() -> None:
    """The frame of tick 1 from b is lost; all give the tick up and meet again in tick 2."""
    from chain import FRAME, environment  # type: ignore[import-not-found]

    a, b = ([FRAME.pack(tick, number) for tick in range(3)] for number in (100, 200))
    wire = ScriptedWire(a=[a[0], a[1], a[2]], b=[None, b[0], None, b[2]])
    with pytest.raises(Over):
        environment(wire, ["a", "b"])
    assert wire.sent == [("a", a[0]), ("b", b[0]), ("a", a[2]), ("b", b[2])]


def test_a_late_answer_is_not_taken_for_the_awaited() -> None:
    from chain import FRAME, awaited

    late, right = FRAME.pack(6, 0), FRAME.pack(7, 0)
    assert awaited(ScriptedWire(c=[late, right]), "c", 7) == right
    assert awaited(ScriptedWire(c=[late, None]), "c", 7) is None


def test_a_tick_that_was_not_done_is_late() -> None:
    from loop_runs import share_late  # type: ignore[import-not-found]

    assert share_late(100, [(100, 0), (100, 0)]) == 0.0
    assert share_late(100, [(100, 10), (80, 0)]) == pytest.approx(0.15)


def test_what_a_recording_costs_without_a_loop(tmp_path: Path) -> None:
    file = tmp_path / "recorder.json"
    said = run("recorder.py", "--seconds", "1", "--no-loop", "--json", file)
    found = json.loads(file.read_text())["without_loop"]
    # a message a tick and topic that a node may have, ten times a second one of each node
    topics, figures = 3 * 8 + 3 * 3 + 3, 7 * 10
    assert found["messages_per_s"] == topics * 1000 + figures
    assert found["processor_share"] > 0
    assert f"{found['messages_per_s']:.0f} messages/s" in said


def test_an_onlookers_window_takes_each_tick_once() -> None:
    from watched_figures import Window  # type: ignore[import-not-found]

    window = Window(["a", "b"], first=100, ticks=50)
    window.take("a", 110, np.full(20, 300.0))  # half of it is before
    window.take("a", 130, np.full(25, 300.0))  # some of it is known
    window.take("c", 150, np.full(50, 9999.0))  # no device of the session's
    assert not window.over
    window.take("a", 160, np.concatenate([np.full(10, 1200.0), np.full(20, 300.0)]))  # the last ten are beyond
    window.take("b", 140, np.full(40, 500.0))
    assert not window.over
    window.take("b", 155, np.full(5, 9999.0))  # 140 ... 149 were never done, and these are beyond
    assert window.over
    run = window.run(1000.0, 8, 0.5, 100.0)
    assert run.ticks == 40
    assert run.tau_us["b"] == dict.fromkeys(PERCENTILES, 500.0)
    assert (run.tau_us["a"]["p50"], run.tau_us["a"]["max"]) == (300.0, 1200.0)
    assert run.late == pytest.approx((10 + 10) / 100)


def test_a_silent_device_is_named() -> None:
    from watched_figures import Window

    window = Window(["a", "b"], 0, 10)
    window.take("a", 10, np.full(10, 300.0))
    window.take("b", 10, np.full(10, np.nan))
    with pytest.raises(ValueError, match="b told of no tick"):
        window.run(1000.0, 8, 0.5, 100.0)


def test_who_looks_on_is_held_against_nobody_in_the_same_round() -> None:
    from watched_figures import VARIANTS, table

    def of(tau: float) -> dict[str, Any]:
        run = {"tau_us": dict.fromkeys(DEVICES, dict.fromkeys(PERCENTILES, tau)), "ticks": 10, "late": 0.01}
        return {"run": {**run, "processes": 8, "cpu": 1.25, "resident": 100.0}, "onlookers": 0.5}

    rounds = [(100.0, 150.0), (1000.0, 2500.0), (200.0, 400.0)]
    runs = [{"alone": of(alone), "page": of(page)} for alone, page in rounds]
    runs[0]["top"] = of(1.0)  # not in every round
    said = table({"rounds": 3, "seconds": 1.0, "machine": {"cores": "2"}, "runs": runs})
    alone, page = rows(said)[1:]
    assert alone.startswith("| nobody | 200 | 200 | 200 | 1.00% | 1.00 (1.00-1.00) | 1.00 (1.00-1.00) | 1.25 | 0.50 |")
    assert page.startswith(f"| {VARIANTS['page'].label} | 400 |")
    assert page.count("2.00 (1.50-2.50)") == 2
