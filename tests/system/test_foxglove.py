"""Foxglove's live connection of a real session, its recording, and its layouts, from one run of all processes."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from mcap.reader import make_reader

from manyhands.launch.bridges.foxglove import HEALTH
from manyhands.nodes.recorder.scene_messages import POSE, SCENE_SCHEMAS
from manyhands.protocol.channels import CONDITION, TELEMETRY, TOPICS

from ..support.commands import manyhands_command, read_until, run, started
from ..support.foxglove_client import Client, Message, ServerTime, connected

TICK_NS = 10_000_000
EVERY = 2
END = 60.0  # s, of patience with a process that is about to end

pytestmark = pytest.mark.usefixtures("own_interrupt")


@dataclass
class Seen:
    """What a client received of a session, and the files of its run."""

    folder: Path
    info: dict[str, Any]
    subprotocol: str | None
    channels: dict[str, dict[str, Any]]
    received: list[Message] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [json.loads(message.data) for message in self.received if message.topic == topic]


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Seen:
    """A session with wave links is shown live and recorded meanwhile, until every topic has come several times.

    Its ticks are slow, so that a busy machine keeps up with it. It runs in a temporary directory of its own.
    """
    folder, temporary = tmp_path_factory.mktemp("run"), tempfile.mkdtemp(prefix="mh", dir="/tmp")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", temporary)
        out = _session_seen(folder)
    left = os.listdir(temporary)
    shutil.rmtree(temporary)
    assert left == []
    return out


def _session_seen(folder: Path) -> Seen:
    launched = ("launch", "ball.yaml", "--set", "design.tau=0.0003", "--set", f"period={TICK_NS / 1e9}")
    shown = ("view", "--foxglove", "--port", "0", "--every", str(EVERY), "--layout", "live.json")
    with started(*launched, cwd=folder) as session:
        read_until(session, ": running")
        with started(*shown, cwd=folder) as view:
            address = read_until(view, "foxglove: ").split()[1]
            with started("record", "-o", "run.mcap", cwd=folder) as recorder:
                read_until(recorder, "recording ball")
                with connected(address) as client:
                    out = Seen(folder, client.info, client.subprotocol, client.channels)
                    _receive(client, out)
                ended(recorder)
            ended(view)
            assert view.returncode == 130
        assert session.poll() is None  # the session did not notice
        ended(session)
    return out


def _receive(client: Client, out: Seen) -> None:
    client.subscribe(*client.channels)
    missing = dict.fromkeys(client.channels, 3)  # a condition comes ten times a second
    for message in client.messages():
        if isinstance(message, ServerTime):
            out.times.append(message.time)
            continue
        out.received.append(message)
        missing[message.topic] -= 1
        if max(missing.values()) <= 0:
            return


def ended(process: subprocess.Popen[str]) -> None:
    """Ctrl-C, as a person would."""
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=END)


def recorded(seen: Seen) -> Iterator[tuple[Any, Any, Any]]:
    with (seen.folder / "run.mcap").open("rb") as file:
        yield from make_reader(file).iter_messages()


def test_a_client_written_from_the_specification_is_served(seen: Seen) -> None:
    assert seen.subprotocol == "foxglove.sdk.v1"
    assert seen.info["name"] == "manyhands ball"
    assert seen.info["capabilities"] == ["time"]  # it takes nothing from clients
    sample = seen.channels["/ball/left/sample"]
    assert (sample["encoding"], sample["schemaEncoding"], sample["schemaName"]) == (
        "json",
        "jsonschema",
        "manyhands.sample",
    )
    assert sample["metadata"] == {
        "node": "left",
        "role": "device",
        "symbol": "x",
        "unit": "m",
        "columns": '["left"]',
    }


def test_live_messages_agree_with_their_schemas(seen: Seen) -> None:
    assert {message.topic for message in seen.received} == set(seen.channels)
    checks = {
        topic: jsonschema.Draft202012Validator(json.loads(about["schema"])) for topic, about in seen.channels.items()
    }
    for message in seen.received:
        checks[message.topic].validate(json.loads(message.data))


def test_live_times_are_those_of_the_session(seen: Seen) -> None:
    for topic in ("/ball/left/sample", "/ball/environment/tank"):
        own = [message for message in seen.received if message.topic == topic]
        ticks = [json.loads(message.data)["tick"] for message in own]
        assert all(tick % EVERY == 0 for tick in ticks)
        assert ticks == sorted(set(ticks))
        begins = {message.time - tick * TICK_NS for message, tick in zip(own, ticks, strict=True)}
        assert len(begins) == 1
    assert seen.times == sorted(seen.times)
    assert seen.times


def test_the_wave_links_and_the_health_are_live(seen: Seen) -> None:
    health = seen.of("/ball/supervisor/health")[-1]
    assert health["nodes"].keys() == {"left", "right", "left_seat", "right_seat", "environment"}
    assert health["wave_links"].keys() == {"left_seat", "right_seat"}
    assert all(link["stiffness"] > 0 and link["round_trip"] > 0 for link in health["wave_links"].values())
    assert {"rung", "wave_lag_us"} <= seen.of("/ball/left_seat/telemetry")[-1]["figures"].keys()


def test_live_messages_are_those_of_the_recording(seen: Seen) -> None:
    kept: dict[tuple[str, int], bytes] = {}
    schemas = {}
    for schema, channel, message in recorded(seen):
        tick = json.loads(message.data)["tick"]
        kept[channel.topic, tick] = message.data
        schemas[channel.topic] = (schema.name, schema.data.decode(), channel.metadata)
    compared = 0
    for message in seen.received:
        if message.topic in ("/ball/supervisor/condition", "/ball/supervisor/health"):
            continue  # a condition is recorded where it changes
        about = seen.channels[message.topic]
        assert schemas[message.topic] == (about["schemaName"], about["schema"], about["metadata"])
        data = kept.get((message.topic, json.loads(message.data)["tick"]))
        assert data in (None, message.data)  # an onlooker may see what a recorder lost, and the other way round
        compared += data is not None
    assert compared > len(seen.channels)


def test_a_recording_agrees_with_its_schemas(seen: Seen) -> None:
    checks: dict[int, Any] = {}
    count = 0
    for schema, channel, message in recorded(seen):
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        if schema.id not in checks:
            stated = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(stated)
            checks[schema.id] = jsonschema.Draft202012Validator(stated)
        checks[schema.id].validate(json.loads(message.data))
        count += 1
    assert count > 100


def foxglove_values(layout: Path) -> list[tuple[str, list[str | int]]]:
    """Topic and fields of every path in a layout of Foxglove."""
    panels = json.loads(layout.read_text())["configById"].values()
    out = []
    for value in (path["value"] for panel in panels for path in panel.get("paths", ())):
        match = re.fullmatch(r'((?:/[\w-]+)+|"[^"]+")((?:\.(?:[\w-]+|"[^"]+")|\[\d+\])+)', value)
        assert match, value
        fields = [
            int(place) if place else key.strip('"')
            for key, place in re.findall(r'\.([\w-]+|"[^"]+")|\[(\d+)\]', match[2])
        ]
        out.append((match[1].strip('"'), fields))
    return out


def flattened(name: str, value: Any) -> Iterator[str]:
    """The names that PlotJuggler gives the numbers of a JSON message."""
    if isinstance(value, dict):
        for key, own in value.items():
            yield from flattened(f"{name}/{key}", own)
    elif isinstance(value, list):
        for place, own in enumerate(value):
            yield from flattened(f"{name}[{place}]", own)
    elif isinstance(value, int | float):
        yield name


def test_every_path_of_the_layouts_exists_live_and_recorded(seen: Seen) -> None:
    for suffix in ("json", "xml"):
        run("export", "run.mcap", "--layout", f"recorded.{suffix}", cwd=seen.folder)
    live = {message.topic: json.loads(message.data) for message in seen.received}
    kept: dict[str, Any] = {}
    for _, channel, message in recorded(seen):
        kept.setdefault(channel.topic, json.loads(message.data))
    paths = {name: foxglove_values(seen.folder / f"{name}.json") for name in ("live", "recorded")}
    assert paths["live"] == paths["recorded"]  # one layout serves both
    assert len(paths["live"]) > 30
    for messages in (live, kept):
        for topic, fields in paths["live"]:
            found = messages[topic]
            for one in fields:
                found = found[one]
            assert isinstance(found, (int, float, str)), (topic, fields)
    names = {name for topic, message in kept.items() for name in flattened(topic, message)}
    curves = [curve.get("name") for curve in ET.parse(seen.folder / "recorded.xml").getroot().iter("curve")]
    assert len(curves) > 30
    assert set(curves) <= names


def test_options_that_do_not_fit_are_refused() -> None:
    for option in ("--every", "--layout"):
        done = manyhands_command("view", option, "5")
        assert done.exit_code == 2
        assert f"{option} needs --foxglove" in done.stderr
    done = manyhands_command("view", "--foxglove", "--open", "--host", "192.0.2.7")
    assert done.exit_code == 2
    assert "would send the token to foxglove.dev" in done.stderr


PAGE, ROS_PAGE = (
    (Path(__file__).parents[2] / "docs" / name).read_text(encoding="utf-8") for name in ("foxglove.md", "ros.md")
)


def test_the_commands_and_the_python_of_both_pages_run_as_they_stand(tmp_path: Path) -> None:
    lines = re.findall(r"^\$ manyhands (.*?)(?:  +#.*)?$", PAGE, flags=re.MULTILINE)
    lines += re.findall(r"^\$ manyhands (.*)$", ROS_PAGE, flags=re.MULTILINE)  # of any recording
    assert len(lines) == 4
    for line in lines:
        run(*shlex.split(line), cwd=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "run.json", "run.xml", "run.rosbag"}
    (block,) = re.findall(r"```python\n(.*?)```", ROS_PAGE, flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-P", "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"# {done.stdout}" == block.splitlines(keepends=True)[-1]


def test_the_pages_terminals_show_what_they_say(tmp_path: Path) -> None:
    (launch, view) = [
        shlex.split(line) for line in re.findall(r"^\d \$ manyhands (.*?)(?:  +#.*)?$", PAGE, flags=re.MULTILINE)
    ]
    (quoted,) = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
    slow = ("--set", "period=0.01", "--set", "design.tau=0.001")  # as above
    with started(*launch, *slow, cwd=tmp_path) as session:
        read_until(session, ": running")
        with started(*view, "--port", "0", cwd=tmp_path) as shown:  # the page's port may be taken
            assert shown.stderr is not None
            lines = "".join(shown.stderr.readline() for _ in quoted.splitlines())
            assert re.sub(r":\d+/", ":8765/", lines) == quoted
            ended(shown)
        ended(session)
    layout = json.loads((tmp_path / "layout.json").read_text())
    assert "/browser/" in json.dumps(layout)


def test_the_pages_channels_are_those_of_the_table_of_topics() -> None:
    names = {topic.name for topics in TOPICS.values() for topic in topics} | {TELEMETRY, CONDITION, HEALTH}
    names |= {*SCENE_SCHEMAS, POSE}
    rows = re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", PAGE.partition("## Who may")[0], flags=re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} == names
