"""The messages of the live connection: those of a recording, thinned, and never more than a client has room for."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader

from manyhands.design.models.scene import Body, ContactScene, ToolSphere
from manyhands.extras import MissingExtra
from manyhands.launch.bridges.foxglove import (
    LEAST_QUEUE,
    MOST_QUEUE,
    FoxgloveServer,
    LiveMessage,
    LiveMessages,
    application_address,
)
from manyhands.launch.run.running import Running
from manyhands.nodes.monitor.session_state import About
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import recorded_of
from manyhands.protocol.clock import Instant

from ...support.observed_session import ABOUT, UNCERTIFIED, conditioned, judged, moving, observed
from ...support.slot import described

ROOT = Path(__file__).parents[3]
WALL = 1_700_000_000_000_000_000  # ns since 1970
BEGIN = observed("environment", 100, {"q": np.zeros((100, 1)), "x_e": np.full((100, 3), np.inf)})
"""The time begins with the environment: its tick 100 comes at :data:`WALL`."""

FRAMES = (BEGIN, moving(100), moving(200), judged(conditioned(), moving(200)))


def made(
    *frames: bytes, about: About = ABOUT, every: int = 10, wanted: Callable[[str], bool] = lambda topic: True
) -> list[LiveMessage]:
    live = LiveMessages(about, every)
    return [message for frame in frames for message in live.take(frame, Instant(0), WALL, wanted)]


def recorded(*frames: bytes, about: About = ABOUT) -> dict[tuple[str, int], bytes]:
    """The data of a recording's messages, by topic and time."""
    core = RecorderCore(recorded_of(about))
    for frame in frames:
        core.take(frame, WALL)
    file = BytesIO(core.cut() + core.end())
    return {
        (channel.topic, message.log_time): message.data for _, channel, message in make_reader(file).iter_messages()
    }


def test_messages_are_those_of_a_recording() -> None:
    kept = recorded(*FRAMES)
    sent = [message for message in made(*FRAMES) if message.topic != "/pair/supervisor/health"]
    assert len(sent) > 50
    assert {message.topic for message in sent} == {topic for topic, _ in kept}
    for message in sent:
        assert kept[message.topic, message.time] == message.data


IN_SPACE = replace(
    ABOUT,
    masses=dict.fromkeys(("ball.x", "ball.y", "ball.z"), 0.5),
    scene=ContactScene(
        ("left", "right.x", "right.y"),
        (
            ToolSphere("left", (0,), (0,), (-0.1, 0.0, 0.0), 0.01),
            ToolSphere("right", (1, 2), (0, 1), (0.1, 0.0, 0.0), 0.01),
        ),
        (Body("ball", 0.5, (0.0, 0.0, 0.0), 0.03),),
    ),
)


def in_space(begin: int, end: int, **others: Any) -> bytes:
    rows = np.arange(begin, end, dtype=np.float64)[:, None] / 1e4 * np.ones(3)
    return observed("environment", end, {"x_e": rows, "q": -rows, **others})


def test_what_shows_a_scene_is_that_of_a_recording() -> None:
    frames = in_space(0, 130), in_space(130, 1050)
    kept = recorded(*frames, about=IN_SPACE)
    shown = [m for m in made(*frames, about=IN_SPACE) if m.topic.endswith(("/scene", "/transforms"))]
    assert [m.topic for m in shown].count("/pair/environment/transforms") == 21  # twenty a second, not every tenth tick
    assert [m.topic for m in shown].count("/pair/environment/scene") == 2
    for message in shown:
        assert kept[message.topic, message.time] == message.data
    assert {topic for topic, _ in kept} == {m.topic for m in made(*frames, about=IN_SPACE)}


TURNED = described("0.01 0 0")


def turning(end: int, node: str) -> bytes:
    """A hundred ticks of a hand that turns its tool, or of its world."""
    angles = np.arange(end - 100, end) / 1e3
    R = np.stack([np.cos(angles / 2), 0.0 * angles, np.sin(angles / 2), 0.0 * angles], axis=1)
    one, x = np.ones((100, 1)), 1e-4 * np.arange(end - 100, end)[:, None] * np.ones(3)
    if node == "environment":
        return observed(node, end, {"x_e": x, "heard": np.hstack([R, 0 * one, one]), "told": np.hstack([R, 0 * one])})
    return observed(node, end, {"x": x, "f_v": x, "R": R, "Q": R, "t_v": x})


def test_what_shows_a_hand_that_turns_is_that_of_a_recording() -> None:
    frames = [turning(end, node) for end in (100, 200) for node in ("environment", "pen")]
    kept = recorded(*frames, about=TURNED)
    sent = [message for message in made(*frames, about=TURNED) if message.topic.endswith(("/pose", "/transforms"))]
    assert [message.topic for message in sent].count("/slot/pen/pose") == 4
    for message in sent:
        assert kept[message.topic, message.time] == message.data
    assert {topic for topic, _ in kept} == {message.topic for message in made(*frames, about=TURNED)}
    last = {message.topic.rpartition("/")[2]: json.loads(message.data) for message in sent}
    (tool,) = last["transforms"]["transforms"]  # here turned as the device is, and in its place
    assert last["pose"]["pose"] == {"position": tool["translation"], "orientation": tool["rotation"]}
    assert last["pose"]["frame_id"] == tool["parent_frame_id"] == "slot"
    c, s = np.cos(0.15), np.sin(0.15)  # about the model's y, and about a point beside the stick's middle, turned by it
    assert tool["translation"] == pytest.approx({"x": 0.025 - 0.01 * c, "y": 0.015, "z": 0.015 + 0.01 * s})
    assert tool["rotation"] == pytest.approx({"w": np.cos(0.075), "x": 0.0, "y": np.sin(0.075), "z": 0.0})


@pytest.mark.parametrize("topic", ["scene", "transforms", "tools"])
def test_a_scene_is_made_for_those_who_receive_it_alone(topic: str) -> None:
    sent = made(in_space(0, 100), about=IN_SPACE, wanted=lambda name: name.endswith(topic))
    assert {message.topic for message in sent} == {f"/pair/environment/{topic}"}


@pytest.mark.parametrize("others", [{"q": np.zeros((100, 1))}, {"q": np.zeros((90, 3))}, {"x_e": np.zeros((100, 4))}])
def test_traces_of_another_shape_show_no_scene(others: Any) -> None:
    live = LiveMessages(IN_SPACE)
    sent = live.take(in_space(0, 100, **others), Instant(0), WALL, lambda topic: topic.endswith("transforms"))
    assert ([*sent], live.unfit) == ([], 1)


def test_channels_are_those_of_a_recording() -> None:
    core = RecorderCore(recorded_of(ABOUT))
    for frame in FRAMES:
        core.take(frame, WALL)
    reader = make_reader(BytesIO(core.cut() + core.end()))
    live = LiveMessages(ABOUT).channels
    for schema, channel, _ in reader.iter_messages():
        about = live[channel.topic]
        assert schema is not None
        assert (about.schema, about.schema_text.encode(), about.metadata) == (
            schema.name,
            schema.data,
            channel.metadata,
        )


def test_every_nth_tick_is_sent_whatever_the_frames() -> None:
    ticks = [
        json.loads(m.data)["tick"]
        for m in made(BEGIN, moving(95, 95), moving(130, 35))
        if m.topic == "/pair/left/sample"
    ]
    assert ticks == [*range(0, 130, 10)]
    assert len([m for m in made(BEGIN, moving(95, 95), every=1) if m.topic == "/pair/left/sample"]) == 95


def test_times_are_the_sessions() -> None:
    for message in made(*FRAMES):
        if message.topic == "/pair/left/sample":
            tick = json.loads(message.data)["tick"]
            assert message.time == WALL - 100_000_000 + tick * 1_000_000


def test_the_time_never_goes_back() -> None:
    live = LiveMessages(ABOUT)
    times = []
    for frame in (moving(100), BEGIN, observed("environment", 50, {"q": np.zeros((1, 1))}), moving(2**40)):
        [*live.take(frame, Instant(0), WALL, lambda topic: True)]
        times.append(live.time.latest)
    assert times == [None, WALL, WALL, WALL]  # a user's ticks, which may come from elsewhere, do not shift it


def test_ticks_beyond_all_times_are_counted() -> None:
    live = LiveMessages(ABOUT)
    frames = (BEGIN, moving(2**60))
    sent = [message for frame in frames for message in live.take(frame, Instant(0), WALL, lambda topic: True)]
    assert live.unfit == 1
    assert not any(message.topic.startswith("/pair/left/") for message in sent)


def test_nothing_is_made_that_nobody_receives() -> None:
    assert {m.topic for m in made(*FRAMES, wanted=lambda topic: topic.endswith("/tau"))} == {"/pair/left/tau"}


def test_messages_agree_with_their_schemas() -> None:
    channels = LiveMessages(ABOUT).channels
    for message in made(BEGIN, *FRAMES[1:]):
        if message.topic == "/pair/environment/tools":
            continue  # its values are infinite, and null in its messages, which JSON Schema has no word for
        jsonschema.validate(json.loads(message.data), json.loads(channels[message.topic].schema_text))


def test_health_of_session_and_nodes() -> None:
    (health,) = [
        json.loads(m.data) for m in made(BEGIN, moving(100), conditioned(lost=("vr",))) if m.topic.endswith("health")
    ]
    assert health["health"] == "away"
    assert health["nodes"]["vr"]["health"] == "away"
    assert health["nodes"]["left"] == {"health": "ok", "state": "running", "tick": 100}  # its rate is not known yet


def test_a_ledger_is_advertised_under_a_certificate_alone() -> None:
    assert "/pair/left/ledger" in LiveMessages(ABOUT).channels
    assert "/pair/left/ledger" not in LiveMessages(UNCERTIFIED).channels


@pytest.mark.parametrize(
    "traces", [{"x": np.zeros((10, 2))}, {"x": np.zeros((10, 1)), "f_v": np.zeros((9, 1))}, {"x": np.zeros((20, 1))}]
)
def test_traces_of_another_shape_are_counted(traces: Any) -> None:
    live = LiveMessages(ABOUT)
    [*live.take(BEGIN, Instant(0), WALL, lambda topic: True)]
    sent = [*live.take(observed("left", 15, traces), Instant(0), WALL, lambda topic: True)]
    assert live.unfit == 1
    assert len(sent) == (1 if "f_v" in traces else 0)  # tick 10 of x, beside an f_v with too few rows


def test_the_queue_has_room_for_what_comes_at_once_within_bounds() -> None:
    assert LiveMessages(ABOUT, 10).queue == LEAST_QUEUE
    topics = len(LiveMessages(ABOUT).channels) - 7  # without telemetry, condition and health
    assert LiveMessages(ABOUT, 1).queue == topics * 400 + len(LiveMessages(ABOUT).channels)
    assert LiveMessages(replace(ABOUT, period=1e-6), 1).queue == MOST_QUEUE
    with pytest.raises(ValueError, match="expected at least 1"):
        LiveMessages(ABOUT, 0)


def test_a_missing_extra_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(MissingExtra, match=r"pip install 'manyhands\[foxglove\]'"):
        FoxgloveServer(Running(tmp_path, ABOUT))


def test_the_address_for_foxgloves_own_application() -> None:
    address = application_address("ws://127.0.0.1:8765/")
    assert address == "https://app.foxglove.dev/~/view?ds=foxglove-websocket&ds.url=ws%3A%2F%2F127.0.0.1%3A8765%2F"


def test_a_client_that_does_not_read_misses_the_oldest_messages() -> None:
    """In a process of its own: the threads of foxglove-sdk stay until its end."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", FLOOD], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    sent, received, last = map(int, done.stdout.split())
    assert sent == 400_000
    assert received < sent // 2
    assert last == 99_999  # the newest is never the one that is missed


FLOOD = """
import json, sys
from pathlib import Path
sys.path.insert(0, ".")
from manyhands.launch.run.running import Running
from manyhands.launch.bridges.foxglove import FoxgloveServer
from manyhands.protocol.clock import Instant
from tests.support.foxglove_client import Message, connected
from tests.launch.bridges.test_foxglove import BEGIN
from tests.support.observed_session import ABOUT, conditioned, moving

server = FoxgloveServer(Running(Path("."), ABOUT), 1)
host, port = server.address
with connected(f"ws://{host}:{port}/") as client:
    topics = [f"/pair/left/{name}" for name in ("sample", "force", "ledger", "tau")]
    client.subscribe(*topics, "/pair/supervisor/condition")
    while not all(map(server._wanted, [*topics, "/pair/supervisor/condition"])):
        pass
    server.take(BEGIN, Instant(0))
    for tick in range(100, 100_100, 100):
        server.take(moving(tick), Instant(tick))
    server.take(conditioned(), Instant(0))  # the last message of all
    received, last = 0, 0
    for message in client.messages():
        if isinstance(message, Message):
            if message.topic.endswith("condition"):
                break
            received += 1
            last = json.loads(message.data)["tick"]
print(4 * 100_000, received, last)
server.close()
"""
