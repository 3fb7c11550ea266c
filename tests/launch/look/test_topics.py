"""Topics by name, the lines of `echo`, and the measured pace of a topic."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from manyhands.launch.look.topics import EchoLines, NoTopic, Pacing, find_topic, named_topics, sentence, session_of
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session.shipped import load_named
from manyhands.nodes.monitor.session_state import LiveSession
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import Recorded
from manyhands.protocol.channels import TOPICS, Columns
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Condition, Figures, Observation, Role

from ...support.observed_frames import ABOUT, MS, condition, telemetry


def read(frame: bytes) -> Observation | Condition | None:
    return LiveSession(ABOUT).take(frame, Instant(0))


class TestNames:
    def test_every_topic_of_every_node_and_no_other(self) -> None:
        expected = [
            f"{name}/{topic.name}"
            for name, node in ABOUT.nodes.items()
            for topic in TOPICS[node.role]
            if not (topic.linked or topic.torques or topic.hands or topic.columns is Columns.QUATERNIONS)
        ]
        expected += [f"{name}/telemetry" for name in ABOUT.nodes]
        assert sorted(named_topics(ABOUT)) == sorted([*expected, "supervisor/condition"])
        assert named_topics(ABOUT)["environment/masses"].columns == ("hub",)

    def test_a_wave_link_adds_those_of_its_two_ends(self) -> None:
        coupling = next(name for name, node in ABOUT.nodes.items() if node.role is Role.COUPLING)
        linked = replace(ABOUT, nodes=ABOUT.nodes | {coupling: replace(ABOUT.nodes[coupling], impedance=(20.0, 20.0))})
        found = named_topics(linked)
        added = {name: found[name].columns for name in found.keys() - named_topics(ABOUT).keys()}
        ports, tank = ABOUT.nodes[coupling].ports, tuple(f"{coupling}.{figure}" for figure in "LGH")
        assert added == {
            f"{coupling}/wave": ports,
            f"{coupling}/tank": tank,
            "environment/tool": ports,
            "environment/reaction": ports,
            "environment/wave": ports,
            "environment/tank": tank,
        }

    def test_motors_that_hold_torques_add_their_work_in_wall_time(self) -> None:
        """What a device records can be asked for; without a certificate there is no account that would need it."""
        device = next(name for name, node in ABOUT.nodes.items() if node.role is Role.DEVICE)
        holding = replace(ABOUT, nodes=ABOUT.nodes | {device: replace(ABOUT.nodes[device], torques=True)})
        found = named_topics(holding)
        assert found.keys() - named_topics(ABOUT).keys() == {f"{device}/work"}
        assert find_topic(holding, f"{device}/work").columns == ("sampled", "applied")
        assert f"{device}/work" not in named_topics(replace(holding, certificate=None))

    @pytest.mark.parametrize(("clock", "there"), [("realtime", True), ("simulated", False)])
    def test_a_sessions_description_has_it(self, clock: str, there: bool) -> None:
        torques = [
            "devices.dx.held=torque",
            "devices.dx.linkage={kappa: 8.2}",
            "devices.dx.limits={force: 5, speed: 1}",
        ]
        about = describe(prepare(load_named("example1", torques)), clock, "ipc", 0)
        works = [name for name in named_topics(about) if name.endswith("/work")]
        assert works == (["dx/work"] if there else [])

    def test_uncertified_sessions_list_no_ledgers_and_massless_ones_no_masses(self) -> None:
        names = named_topics(replace(ABOUT, certificate=None, masses={}))
        assert not [name for name in names if name.endswith(("/ledger", "/masses"))]
        assert "environment/tools" in names

    def test_a_device_in_its_own_time_offers_no_topic_that_stays_empty(self) -> None:
        own = replace(ABOUT, nodes={**ABOUT.nodes, "d": replace(ABOUT.nodes["d"], wall=False)})
        gone = named_topics(ABOUT).keys() - named_topics(own).keys()
        assert gone == {"d/applied", "d/instants", "d/interface"}

    @pytest.mark.parametrize("name", ["d/sample", "/s/d/sample"])
    def test_short_and_in_full(self, name: str) -> None:
        found = find_topic(ABOUT, name)
        assert (found.full, found.columns) == ("/s/d/sample", ("d.x", "d.y"))

    @pytest.mark.parametrize(
        ("name", "hint"),
        [
            ("d/smaple", "did you mean d/sample?"),
            ("d/x", "did you mean d/sample?"),
            ("cx/p", "did you mean cx/tool?"),
            ("/s/supervisor/conditions", "did you mean supervisor/condition?"),
            ("/other/d/sample", "did you mean d/sample?"),
            ("zzz", "'s'; expected one of: d/sample, d/force"),
            ("", "'s'; expected one of: d/sample, d/force"),
            ("///", "'s'; expected one of: d/sample, d/force"),
        ],
    )
    def test_unknown(self, name: str, hint: str) -> None:
        with pytest.raises(NoTopic) as error:
            find_topic(ABOUT, name)
        assert f"found no topic {name!r} in session" in str(error.value)
        assert hint in str(error.value)
        assert str(error.value).endswith("supervisor/condition")

    def test_the_session_of_a_name(self) -> None:
        assert [session_of(name) for name in ("/s/d/x", "d/x", "/d/x", "", "a/b/c/d")] == ["s", None, None, None, None]


def echoed(name: str, *frames: bytes, **options: Any) -> list[Any]:
    echo = EchoLines(find_topic(ABOUT, name), ABOUT.period, **options)
    return [json.loads(line, parse_constant=pytest.fail) for frame in frames for line in echo.lines(read(frame), 1234)]


class TestEcho:
    def test_ports_and_masses_are_lists_and_one_quantity_a_number(self) -> None:
        assert echoed("d/sample", telemetry("d", 1002, 2)) == [
            {"tick": 1000, "time": 1.0, "x": [1000.0, 1000.1]},
            {"tick": 1001, "time": 1.001, "x": [1001.0, 1001.1]},
        ]
        assert echoed("d/tau", telemetry("d", 1, 1)) == [{"tick": 0, "time": 0.0, "tau_us": 0.0}]
        assert echoed("cy/ledger", telemetry("cy", 8, 1)) == [{"tick": 7, "time": 0.007, "ledger": 7.0}]
        assert echoed("environment/masses", telemetry("environment", 8, 1)) == [{"tick": 7, "time": 0.007, "q": [7.0]}]

    def test_others_say_nothing_of_it(self) -> None:
        assert echoed("cx/tool", telemetry("d", 10, 2), telemetry("cy", 10, 2), condition(), b"junk") == []

    def test_the_interval_and_count_do_not_depend_on_batches(self) -> None:
        batches = [telemetry("d", 105, 98), telemetry("d", 205)]
        assert [line["tick"] for line in echoed("d/sample", *batches, every=50)] == [50, 100, 150, 200]
        assert [line["tick"] for line in echoed("d/sample", *batches, every=50, count=3)] == [50, 100, 150]
        assert [line["tick"] for line in echoed("d/sample", *batches, count=1)] == [7]

    def test_figures_and_conditions(self) -> None:
        frames = [telemetry("d", 100 * number, 1, speed=number, late=math.inf) for number in (1, 2, 3)]
        assert echoed("d/telemetry", *frames, every=2) == [
            {"tick": 100, "figures": {"speed": 1.0, "late": None}},
            {"tick": 300, "figures": {"speed": 3.0, "late": None}},
        ]
        (line,) = echoed("supervisor/condition", telemetry("d", 10, 2), condition())
        assert line | {"states": {}} == {
            "tick": 1234, "time": 1.234, "phase": "running", "elapsed": 2.5, "states": {}, "silent": [],
            "notices": ["a notice"], "incidents": [], "faults": [], "promises": [], "by_itself": {}, "visits": [],
        }  # fmt: skip
        assert line["states"]["cx"] == "running"

    def test_non_numbers_are_null_and_misfitting_fields_are_omitted(self) -> None:
        echo = EchoLines(find_topic(ABOUT, "d/sample"), ABOUT.period)

        def lines(tick: int, trace: list[list[float]]) -> list[str]:
            return list(echo.lines(Observation("d", tick, Figures(), {"x": np.array(trace)}), 0))

        assert lines(2, [[math.nan, -math.inf]]) == ['{"tick": 1, "time": 0.001, "x": [null, null]}']
        assert lines(2, [[1.0]]) == lines(0, [[1.0, 2.0]]) == []
        assert echo.misfits == 2
        assert list(echo.lines(Observation("d", 5, Figures(), {}), 0)) == []


def paced(name: str, frames: dict[int, bytes], window: int = 10_000) -> dict[str, Any]:
    pacing = Pacing(find_topic(ABOUT, name), window)
    for at, frame in frames.items():
        pacing.take(read(frame), Instant(at * MS))
    return pacing.found()


class TestPace:
    def test_ticks_a_second_and_how_batches_arrive(self) -> None:
        found = paced("cx/tool", {0: telemetry("cx", 100), 90: telemetry("cx", 200), 200: telemetry("cx", 300)})
        assert found["rate"] == pytest.approx(1000.0)
        assert (found["of"], found["window"], found["missing"], found["restarts"]) == ("ticks", 300, 0, 0)
        assert found["arrival_ms"] == pytest.approx({"p50": 100.0, "p99": 109.8, "min": 90.0, "max": 110.0})
        assert "period_us" not in found  # a coupling paces nothing
        assert "tau_us" not in found
        assert "batches arrive here" in sentence(found)

    def test_a_device_reports_the_evenness_of_its_ticks(self) -> None:
        own = {"period_us": {"p50": 1000.0, "p99": 1200.0}}
        found = paced("d/force", {0: telemetry("d", 100, tables=own), 100: telemetry("d", 200, tables=own)})
        assert found["period_us"] == {"p50": 1000.0, "p99": 1200.0}
        assert found["tau_us"] == pytest.approx({"p50": 99.5, "p99": 197.01, "min": 0.0, "max": 199.0})
        assert "1000/1200 us (the device's, since its start)" in sentence(found)
        assert "period_us" not in paced(
            "d/force", {0: telemetry("d", 100, tables={"period_us": {"p50": math.nan, "p99": 1.0}})}
        )

    def test_ticks_without_telemetry_are_counted(self) -> None:
        found = paced("d/sample", {0: telemetry("d", 100), 100: telemetry("d", 250), 200: telemetry("d", 400)})
        assert found["missing"] == 100
        assert found["rate"] == pytest.approx(1500.0)

    def test_a_node_that_begins_anew_is_paced_anew(self) -> None:
        told = {0: telemetry("d", 900), 100: telemetry("d", 100), 200: telemetry("d", 200)}
        found = paced("d/sample", told)
        assert (found["restarts"], found["missing"], found["window"]) == (1, 0, 200)
        assert found["rate"] == pytest.approx(1000.0)

    def test_the_window_is_of_the_latest(self) -> None:
        slow = {100 * n: telemetry("cx", 50 * n, 50) for n in range(1, 11)}
        fast = {1000 + 100 * n: telemetry("cx", 500 + 100 * n) for n in range(1, 11)}
        assert paced("cx/tool", slow | fast, window=500)["rate"] == pytest.approx(1000.0)
        assert paced("cx/tool", slow | fast)["rate"] < 800.0
        assert paced("cx/tool", slow | fast, window=2)["rate"] == pytest.approx(1000.0)  # two arrivals at the least

    def test_messages_that_are_no_ticks(self) -> None:
        found = paced("d/telemetry", {0: telemetry("d", 100), 50: telemetry("d", 200), 200: telemetry("d", 300)})
        assert (found["of"], found["rate"]) == ("messages", 10.0)
        found = paced("supervisor/condition", {0: condition(), 100: telemetry("d", 100), 200: condition()})
        assert (found["window"], found["rate"]) == (2, 5.0)
        assert "missing" not in found

    def test_before_a_second_message_nothing_is_claimed(self) -> None:
        for frames in ({}, {5: telemetry("cx", 100)}, {5: telemetry("d", 100)}):
            found = paced("cx/tool", frames)
            assert (found["rate"], found["arrival_ms"]) == (None, None)
            assert sentence(found) == "/s/cx/tool: waiting for a second message"
            json.dumps(found, allow_nan=False)


@pytest.mark.parametrize("name", ["d/sample", "d/tau", "environment/masses", "cx/telemetry", "environment/ledger"])
def test_a_line_is_what_a_recording_has(name: str, tmp_path: Path) -> None:
    nodes = ABOUT.nodes
    roles, ports = {n: node.role for n, node in nodes.items()}, {n: node.ports for n, node in nodes.items()}
    core = RecorderCore(Recorded(ABOUT.session, ABOUT.id, ABOUT.period, "simulated", roles, ports, tuple(ABOUT.masses)))
    data, echo = core.cut(), EchoLines(find_topic(ABOUT, name), ABOUT.period)
    lines: list[str] = []
    for tick in (100, 200):
        frame = telemetry(name.split("/")[0], tick, late=1.0)
        core.take(frame, 10**18)
        lines += echo.lines(read(frame), tick)
    (tmp_path / "r.mcap").write_bytes(data + core.cut() + core.end())
    with (tmp_path / "r.mcap").open("rb") as file:
        messages = [json.loads(m.data) for _, _, m in make_reader(file).iter_messages(topics=[f"/s/{name}"])]
    assert [json.loads(line) for line in lines] == messages
    assert len(messages) == (2 if name.endswith("telemetry") else 200)
