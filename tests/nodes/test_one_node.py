"""One node alone, with a test at the other end of its links that breaks the rules."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.joins import establish
from manyhands.nodes.kernel.bundle import Bundle, CouplingBundle, DeviceBundle, EnvironmentBundle, Peer
from manyhands.nodes.link.join import OwnEnd
from manyhands.protocol.clock import Instant, RealtimeClock
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.handshake import HandshakeRefused
from manyhands.protocol.limits import LINK_QUEUE_FRAMES, MAX_CONTROL_BYTES, MAX_STRAY_FRAMES
from manyhands.protocol.messages import Figures, Force, Reaction, Sample, SignalMessage, Start, Tool, Values
from manyhands.protocol.transport import Link, TransportError
from tests.support.memory_transport import MemoryTransport

SESSIONS = Path(__file__).parents[2] / "launch" / "sessions"
LIMITS = "devices.dx.limits={force: 2, displacement: 0.25, speed: 50}"

Node = DeviceNode | CouplingNode | EnvironmentNode
Ends = Mapping[str, Link]
Meet = Callable[..., Ends]


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml", [LIMITS]))


@pytest.fixture(scope="module")
def bundles(prepared: Prepared) -> dict[str, Bundle]:
    return cut(prepared, RunPlan("simulated", None, ""))


@pytest.fixture
def meet() -> Iterator[Meet]:
    """Shakes hands with a node in the place of all its peers; gives the other ends of its links."""
    transport = MemoryTransport()

    def ends(node: Node, bundle: Bundle, feedthrough: Mapping[str, Values] | None = None) -> Ends:
        own = bundle.common
        near: dict[str, Link] = {}
        far: dict[str, Link] = {}
        for peer in own.peers:
            near[peer.name], endpoint = transport.bind(f"{own.name}-{peer.name}", peer.name)
            far[peer.name] = transport.connect(endpoint, own.name)

        def greet(peer: Peer) -> None:
            us = Peer(own.name, own.role, peer.ports, not peer.binds)
            common = dataclasses.replace(own, name=peer.name, role=peer.role, ports=peer.ports, peers=(us,))
            end = OwnEnd(common, RealtimeClock(), feedthrough=(feedthrough or {}).get(peer.name))
            establish(end, {own.name: far[peer.name]})

        with ThreadPoolExecutor(len(own.peers)) as pool:
            greetings = [pool.submit(greet, peer) for peer in own.peers]
            node.establish(near)
            for greeting in greetings:
                greeting.result()
        return far

    yield ends
    transport.close()


def send(link: Link, *messages: SignalMessage | bytes) -> None:
    for message in messages:
        assert link.send(message if isinstance(message, bytes) else encode(message))


def values_at(link: Link, ticks: int) -> list[list[float]]:
    """What a node has sent, tick after tick."""
    out = []
    for tick in range(ticks):
        message = decode(link.recv(None) or b"", MAX_CONTROL_BYTES)
        assert isinstance(message, (Sample, Tool, Reaction, Force))
        assert message.tick == tick
        out.append(message.values.tolist())
    return out


def one(*values: float) -> Values:
    return np.array(values)


class Recorded:
    """A driver with given samples that keeps the exerted forces."""

    axes = 1

    def __init__(self, samples: list[float]) -> None:
        self._samples, self._x = samples, one(0.0)
        self.exerted: list[float] = []

    def sample(self, tick: int, at: Instant) -> Values:
        self._x = one(self._samples[tick])
        return self._x

    def apply(self, f: Values, at: Instant, until: Instant | None = None) -> Values:
        self.exerted.append(float(f[0]))
        return self._x

    def release(self, at: Instant) -> Values:
        return self.apply(one(0.0), at)

    def idle(self, due: Instant) -> None:
        """Nothing was put off."""

    def intended_work(self) -> float:
        return 0.0

    def figures(self) -> Figures:
        return Figures()

    def close(self) -> None:
        """Nothing is open."""


# --- a device


def device_of(bundles: Mapping[str, Bundle], samples: list[float]) -> tuple[DeviceNode, DeviceBundle, Recorded]:
    bundle, driver = bundles["dx"], Recorded(samples)
    assert isinstance(bundle, DeviceBundle)
    return DeviceNode(bundle, driver), bundle, driver


def test_junk_on_a_link_is_counted_and_changes_nothing(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    """Rubbish, a future force, another's signal and a wide one before the first tick's force; then replays."""
    node, bundle, driver = device_of(bundles, [0.0] * 3)
    coupling = meet(node, bundle)["cx"]
    send(coupling, b"\xc1junk", Force(1, 0, one(1.0)), Sample(0, 0, one(1.0)), Force(0, 0, np.ones(2)))
    for tick in range(3):
        send(coupling, Force(tick, 0, one(0.5)), Force(tick, 0, one(1.0)))
    node.loop(Start(0, 3), new_life(), new_line())
    counts = node.report().figures.table("dropped")
    assert {reason: n for reason, n in counts.items() if n} == {
        "malformed": 1,
        "future_tick": 1,
        "wrong_kind": 1,
        "wrong_width": 1,
        "old_tick": 2,  # the third tick's replay is never read
    }
    assert driver.exerted == [0.5, 0.5, 0.5, 0.0]  # and lets go at the end


def test_a_force_beyond_the_limit_is_clipped_last_before_the_actuator(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    """Here the coupling has not clipped it: it is counted, and the ledger and the traces hold what was applied."""
    samples, forces = [0.0, 1e-3, 1e-3], [1.0, 900.0, -3.0]
    node, bundle, driver = device_of(bundles, samples)
    coupling, line = meet(node, bundle)["cx"], new_line()
    send(coupling, *(Force(k, 0, one(f)) for k, f in enumerate(forces)))
    node.loop(Start(0, 3), new_life(), line)
    assert driver.exerted == [1.0, 2.0, -2.0, 0.0]
    np.testing.assert_array_equal(line.trace("f_v"), [[1.0], [2.0], [-2.0]])
    assert node.report().figures["clipped"] == 2
    assert line.telemetry[-1].figures["clipped"] == 2.0
    T, level, K = bundle.common.period, bundle.promises[0].level[0, 0], bundle.promises[0].K[0, 0]
    y = [K * 1.0 / T, 1e-3 / T + K * 1.0 / T, -4.0 * K / T]
    energy = sum(T * (f * v - level * v * v) for f, v in zip([1.0, 2.0, -2.0], y, strict=True))
    assert node.report().figures["ledger"] == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize(
    ("sample", "sentence", "told"),
    [
        (0.3, "found a displacement of 0.3 m at dx; expected at most 0.25 m", 0.05),  # no faster than 50 m/s
        (0.1, "found a speed of 100 m/s at dx; expected at most 50 m/s", 0.05),
        (float("nan"), "found a displacement of nan m at dx", 0.0),
    ],
)
def test_a_device_beyond_its_limits_lets_go_and_hides_its_position(
    sample: float,
    sentence: str,
    told: float,
    bundles: dict[str, Bundle],
    meet: Meet,
    new_life: Any,
    new_line: Any,
) -> None:
    """Its coupling receives a position within the limits, and then a tool at rest; the ticks go on."""
    node, bundle, driver = device_of(bundles, [0.0, sample, 0.0])
    coupling, life, line = meet(node, bundle)["cx"], new_life(), new_line()
    send(coupling, *(Force(k, 0, one(1.0)) for k in range(3)))
    node.loop(Start(0, 3), life, line)
    assert not life.failure
    assert driver.exerted == [1.0, 0.0, 0.0, 0.0]
    report = node.report()
    assert (report.ticks, report.figures["let_go"]) == (3, 1)
    assert values_at(coupling, 3) == [[0.0], [pytest.approx(told)], [pytest.approx(told)]]
    assert node.device.guard.why.startswith(sentence)


def test_a_device_whose_coupling_floods_it_fails_and_lets_go(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    node, bundle, driver = device_of(bundles, [0.0] * 2)
    coupling, life = meet(node, bundle)["cx"], new_life()
    send(coupling, Force(0, 0, one(1.0)), *[b"junk"] * (LINK_QUEUE_FRAMES - 1))
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(node.loop, Start(0, 2), life, new_line())
        while not running.done():  # as fast as the queue takes them
            coupling.send(b"junk")
        running.result()
    assert life.failure.startswith(
        f"dx: cx sent {MAX_STRAY_FRAMES + 1} stray frames while its signal of tick 1 was awaited"
    )
    assert node.report().figures.table("dropped")["malformed"] == MAX_STRAY_FRAMES + 1
    assert driver.exerted[0] == 1.0
    assert driver.exerted[-1] == 0.0


def test_a_device_whose_link_fails_lets_go(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    node, bundle, driver = device_of(bundles, [0.0] * 2)

    def fail_at_the_second_tick(tick: int, at: Instant) -> Values:
        if tick == 1:
            raise TransportError("the link is gone")
        return one(0.0)

    driver.sample = fail_at_the_second_tick  # type: ignore[method-assign]
    send(meet(node, bundle)["cx"], Force(0, 0, one(1.0)))
    with pytest.raises(TransportError):
        node.loop(Start(0, 2), new_life(), new_line())
    assert driver.exerted == [1.0, 0.0]


# --- a coupling


def test_a_coupling_admits_no_sample_that_its_device_could_not_have(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    """0.25 m and 50 m/s at 1 kHz: what is beyond is counted, and the honest sample behind it taken."""
    bundle = bundles["cx"]
    assert isinstance(bundle, CouplingBundle)
    node = CouplingNode(bundle)
    far = meet(node, bundle)
    for k, (wrong, right) in enumerate([(0.26, 0.25), (0.19, 0.2), (-9e9, 0.25)]):
        send(far["dx"], Sample(k, 0, one(wrong)), Sample(k, 0, one(right)))
        send(far["environment"], Reaction(k, 0, one(0.0)))
    node.loop(Start(0, 3), new_life(), new_line())
    assert values_at(far["environment"], 3) == [[0.25], [0.2], [0.25]]
    assert node.report().figures.table("dropped")["out_of_range"] == 3


def test_a_coupling_clips_a_force_before_passing_and_absorbing_it(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    bundle = bundles["cx"]
    assert isinstance(bundle, CouplingBundle)
    node = CouplingNode(bundle)
    far = meet(node, bundle)
    forces = [1.0, 1e6, -1e300, 0.5, 0.0]
    for k, f in enumerate(forces):
        send(far["dx"], Sample(k, 0, one(0.0)))
        send(far["environment"], Reaction(k, 0, one(f)))
    node.loop(Start(0, len(forces)), new_life(), new_line())
    clipped = [[1.0], [2.0], [-2.0], [0.5], [0.0]]
    assert values_at(far["dx"], len(forces)) == clipped
    offset = dataclasses.replace(bundle.block, D=np.zeros((1, 1))).simulate(np.array(clipped))
    np.testing.assert_allclose(values_at(far["environment"], len(forces)), offset, rtol=1e-12, atol=1e-15)
    assert node.report().figures["saturated"] == 2


def test_a_coupling_sends_its_figures_and_traces(
    bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    bundle = bundles["cx"]
    assert isinstance(bundle, CouplingBundle)
    common = dataclasses.replace(bundle.common, telemetry_ticks=2, telemetry_first=2)
    bundle = dataclasses.replace(bundle, common=common)
    node, line = CouplingNode(bundle), new_line()
    far = meet(node, bundle)
    for k in range(3):
        send(far["dx"], Sample(k, 0, one(0.0)))
        send(far["environment"], Reaction(k, 0, one(9.0)))
    node.loop(Start(0, 3), new_life(), line)
    first, rest = line.telemetry
    assert (first.tick, rest.tick) == (2, 3)
    assert first.figures["saturated"] == 2.0
    assert {name: trace.shape for name, trace in first.traces.items()} == {
        "p": (2, 1),
        "f_v": (2, 1),
        "ledger": (2, 1),
    }
    assert first.traces["ledger"][-1, 0] == first.figures["ledger"]


# --- the environment


def environment_of(bundles: Mapping[str, Bundle]) -> tuple[EnvironmentNode, EnvironmentBundle]:
    bundle = bundles["environment"]
    assert isinstance(bundle, EnvironmentBundle)
    return EnvironmentNode(bundle), bundle


def test_the_environment_admits_no_tool_beyond_what_honest_limits_allow(
    prepared: Prepared, bundles: dict[str, Bundle], meet: Meet, new_life: Any, new_line: Any
) -> None:
    node, bundle = environment_of(bundles)
    far = meet(node, bundle, dict(zip(("cx", "cy", "cz"), (block.D for block in prepared.blocks), strict=True)))
    magnitude, step = bundle.tool_magnitude[0], bundle.tool_step[0]
    assert magnitude is not None
    assert step is not None
    assert step < magnitude
    tools = [(1.001 * magnitude, 0.0), (-1.01 * step, 0.9 * step), (magnitude, 0.0)]
    for k, (wrong, right) in enumerate(tools):
        send(far["cx"], Tool(k, 0, one(wrong)), Tool(k, 0, one(right)))
        for other in ("cy", "cz"):
            send(far[other], Tool(k, 0, one(0.0)))
    node.loop(Start(0, len(tools)), new_life(), new_line())
    assert node.report().ticks == len(tools)
    assert node.report().figures.table("dropped")["out_of_range"] == 3


def test_a_coupling_with_another_feedthrough_is_refused(
    prepared: Prepared, bundles: dict[str, Bundle], meet: Meet
) -> None:
    node, bundle = environment_of(bundles)
    told = dict(zip(("cx", "cy", "cz"), (block.D for block in prepared.blocks), strict=True))
    told["cy"] = np.nextafter(told["cy"], 1.0)
    with pytest.raises(
        HandshakeRefused,
        match=r"^environment refused cy: found a feedthrough D_V with the digest [0-9a-f]{16}; expected",
    ):
        meet(node, bundle, told)
