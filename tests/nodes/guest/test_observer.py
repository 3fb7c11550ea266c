"""An observer prints one line of JSON for each observation, and nothing for other frames."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from manyhands.launch.plan.bundles import RunPlan, bundle_of
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.guest.observer import ObserverCore
from manyhands.nodes.kernel.bundle import ObserverBundle, save
from manyhands.protocol.clock import Duration
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import (
    Connect,
    Figures,
    NodeHello,
    Observation,
    Refusal,
    Role,
    Stop,
    Telemetry,
    Welcome,
)
from manyhands.protocol.transport.zeromq import ZmqTransport

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
LONG = Duration(10_000_000_000)
numbers = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf])
traces = hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=3), elements=numbers)
names = st.text("abc_.é\u2028 ", min_size=1, max_size=6).filter(str.isprintable)
named = st.dictionaries(names, numbers, max_size=4)
observations = st.builds(
    Observation,
    names,
    st.integers(0, 2**62),
    st.builds(Figures, named, st.dictionaries(names.map("t{}".format), named, max_size=2)),
    st.dictionaries(names, traces, max_size=3),
)


def plain(value: float) -> float | None:
    return value if math.isfinite(value) else None


@given(observations)
def test_a_line_holds_the_whole_observation(observation: Observation) -> None:
    core = ObserverCore()
    line = core.line(encode(observation))
    assert line is not None
    assert len(line.splitlines()) == 1
    assert line.isascii()
    assert json.loads(line, parse_constant=pytest.fail) == {
        "node": observation.node,
        "tick": observation.tick,
        "figures": {
            **{name: plain(value) for name, value in observation.figures.items()},
            **{
                name: {key: plain(value) for key, value in table.items()}
                for name, table in observation.figures.tables.items()
            },
        },
        "traces": {n: [[plain(value) for value in row] for row in t.tolist()] for n, t in observation.traces.items()},
    }
    assert core.malformed == 0


@given(
    st.binary(max_size=80)
    | st.builds(lambda plain: msgpack.packb([35, *plain]), st.lists(st.integers(0, 2**63), max_size=5))
)
def test_anything_else_is_counted_and_not_printed(frame: bytes) -> None:
    core = ObserverCore()
    if not isinstance(decode(frame, MAX_CONTROL_BYTES), Observation):
        assert core.line(frame) is None
        assert core.malformed == 1


@pytest.mark.parametrize("message", [Telemetry(1, Figures({"speed": 0.5}), {}), Stop("now"), Welcome()])
def test_not_even_other_messages_are(message: Telemetry | Stop | Welcome) -> None:
    core = ObserverCore()
    assert core.line(encode(message)) is None
    assert core.malformed == 1


class Test_its_process:
    """Over Unix-domain sockets, with the supervisor's part in the test's hand."""

    @pytest.fixture
    def transport(self, tmp_path: Path) -> ZmqTransport:
        (tmp_path / "s").mkdir(mode=0o700)
        return ZmqTransport.ipc(tmp_path / "s")

    def bundle(self, folder: Path) -> None:
        session = load_session(SESSIONS / "example1-uncoupled.yaml", ["observers={watch: {reads: [telemetry]}}"])
        bundle = bundle_of(prepare(session, uncertified=True), RunPlan("realtime", None, ""), "watch")
        assert isinstance(bundle, ObserverBundle)
        save(bundle, folder / "watch.bundle")

    def started(self, folder: Path, endpoint: str, **more: object) -> subprocess.Popen[bytes]:
        self.bundle(folder)
        command = ["-P", "-m", "manyhands", "node", "watch", "--bundle", "watch.bundle", "--connect", endpoint]
        return subprocess.Popen([sys.executable, *command], cwd=folder, stderr=subprocess.PIPE, **more)  # type: ignore[call-overload,no-any-return]

    def test_it_joins_prints_and_ends_with_the_session(self, transport: ZmqTransport, tmp_path: Path) -> None:
        hub, endpoint = transport.bind_hub("control", ["watch"])
        outlet, place = transport.bind_outlet("supervisor-watch", "watch")
        process = self.started(tmp_path, endpoint, stdout=subprocess.PIPE)
        descriptor = os.pidfd_open(process.pid)
        try:
            while (received := hub.recv()) is None:
                assert not hub.wait(LONG, [descriptor]), process.communicate()
            sender, frame = received
            hello = decode(frame, MAX_CONTROL_BYTES)
            assert sender == "watch"
            assert isinstance(hello, NodeHello)
            assert (hello.name, hello.role, hello.endpoints) == ("watch", Role.OBSERVER, {})
            hub.send("watch", encode(Welcome()))
            hub.send("watch", encode(Connect({"supervisor": place})))
            assert process.stdout is not None
            while not outlet.send(b"no observation"):
                hub.wait(Duration(1_000_000), [descriptor])
            assert outlet.send(encode(Observation("dx", 7, Figures({"speed": math.nan}), {})))
            assert json.loads(process.stdout.readline()) == {"node": "dx", "tick": 7, "figures": {"speed": None},
                                                             "traces": {}}  # fmt: skip
            process.send_signal(15)
            out, err = process.communicate(timeout=60)
            assert (process.returncode, out, err) == (128 + 15, b"", b"")
        finally:
            os.close(descriptor)
            transport.close()

    def test_it_ends_quietly_when_nobody_reads_its_lines_any_more(
        self, transport: ZmqTransport, tmp_path: Path
    ) -> None:
        hub, endpoint = transport.bind_hub("control", ["watch"])
        outlet, place = transport.bind_outlet("supervisor-watch", "watch")
        reader, writer = os.pipe()
        process = self.started(tmp_path, endpoint, stdout=writer)
        os.close(writer)
        os.close(reader)
        descriptor = os.pidfd_open(process.pid)
        try:
            while hub.recv() is None:
                assert not hub.wait(LONG, [descriptor]), process.communicate()
            hub.send("watch", encode(Welcome()))
            hub.send("watch", encode(Connect({"supervisor": place})))
            while not hub.wait(Duration(1_000_000), [descriptor]):
                outlet.send(encode(Observation("dx", 7, Figures(), {})))
            _, err = process.communicate(timeout=60)
            assert (process.returncode, err) == (0, b"")
        finally:
            os.close(descriptor)
            transport.close()

    def test_a_refusal_is_reported(self, transport: ZmqTransport, tmp_path: Path) -> None:
        hub, endpoint = transport.bind_hub("control", ["watch"])
        process = self.started(tmp_path, endpoint, stdout=subprocess.PIPE)
        descriptor = os.pidfd_open(process.pid)
        try:
            while hub.recv() is None:
                assert not hub.wait(LONG, [descriptor]), process.communicate()
            hub.send("watch", encode(Refusal("name", "supervisor refused watch: because")))
            out, err = process.communicate(timeout=60)
            assert (process.returncode, out, err) == (4, b"", b"supervisor refused watch: because\n")
        finally:
            os.close(descriptor)
            transport.close()
