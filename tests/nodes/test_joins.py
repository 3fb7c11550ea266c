"""What joins a node to each peer follows from its bundle, by one table; and a tick has what came before it began."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.node import CouplingNode
from manyhands.nodes.coupling.within import Within
from manyhands.nodes.device.drivers import driver_of
from manyhands.nodes.device.node import DeviceNode
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.kernel.bundle import REALTIME, SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle
from manyhands.nodes.link.join import Join, JoinKind
from manyhands.nodes.link.peer_link import PeerLink
from manyhands.nodes.wave_link.ends import UserEnd, WorldEnd
from manyhands.protocol.clock import Instant
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Force, Reaction, Role, Sample, SignalMessage, Start, Tool

SESSION = Path(__file__).parents[2] / "launch" / "sessions" / "example1.yaml"
CX_BY_WAVES = "couplings.cx.wave_link={b: 20}"
ALL_BY_WAVES = [f"couplings.{name}.wave_link={{b: 20}}" for name in ("cx", "cy", "cz")]

SIGNALS: dict[tuple[Role, Role], type[SignalMessage]] = {
    (Role.DEVICE, Role.COUPLING): Force,
    (Role.COUPLING, Role.DEVICE): Sample,
    (Role.COUPLING, Role.ENVIRONMENT): Reaction,
    (Role.ENVIRONMENT, Role.COUPLING): Tool,
}


def joins_of(prepared: Prepared, clock: str) -> dict[tuple[str, str], Join]:
    """The joins of all nodes of a session, none of which has a link yet, by node and peer."""
    bundles, carriers = cut(prepared, RunPlan(clock, None, "")), prepared.graph.carriers
    couplings = {name: CouplingNode(of) for name, of in bundles.items() if isinstance(of, CouplingBundle)}
    nodes: dict[str, DeviceNode | CouplingNode | EnvironmentNode] = {**couplings}
    for name, bundle in bundles.items():
        if isinstance(bundle, DeviceBundle):
            inside = [couplings[coupling] for coupling, carrier in carriers.items() if carrier == name]
            nodes[name] = DeviceNode(bundle, driver_of(bundle), inside=inside)
        elif isinstance(bundle, EnvironmentBundle):
            nodes[name] = EnvironmentNode(bundle)
    for node in nodes.values():
        node.establish({})
    return {(name, join.peer.name): join for name, node in nodes.items() for join in node.joins}


@pytest.mark.parametrize("clock", [REALTIME, SIMULATED])
@pytest.mark.parametrize("colocate", [False, True])
def test_a_peer_is_joined_as_the_bundle_has_it(colocate: bool, clock: str) -> None:
    prepared = prepare(load_session(SESSION, [CX_BY_WAVES, f"colocate={str(colocate).lower()}"]))
    joins = joins_of(prepared, clock)
    by_device = Within if colocate else PeerLink
    expected: dict[tuple[str, str], type[Join]] = {
        ("cx", "environment"): UserEnd,
        ("environment", "cx"): WorldEnd,
        **{(coupling, "environment"): PeerLink for coupling in ("cy", "cz")},
        **{("environment", coupling): PeerLink for coupling in ("cy", "cz")},
        **{(f"d{axis}", f"c{axis}"): by_device for axis in "xyz"},
        **({} if colocate else {(f"c{axis}", f"d{axis}"): PeerLink for axis in "xyz"}),
    }
    assert {ends: type(join) for ends, join in joins.items()} == expected
    assert [ends for ends, join in joins.items() if not join.waited_for] == (
        [("cx", "environment"), ("environment", "cx")] if clock == REALTIME else []
    )
    for (_, peer), join in joins.items():
        assert (join.peer.name, join.link, join.hello, join.reachable) == (peer, None, None, False)
        if isinstance(join, PeerLink):
            assert join._admits is SIGNALS[join.own.role, join.peer.role]


class SleptClock:
    """A clock that is moved by sleeping alone, which it notes."""

    def __init__(self, noted: list[str]) -> None:
        self.ns, self._noted = 0, noted

    def now(self) -> Instant:
        return Instant(self.ns)

    def sleep_until(self, instant: Instant) -> None:
        self._noted.append("sleeps")
        self.ns = max(self.ns, instant)


class NotedKind(JoinKind):
    """Joins of which only the reading is noted."""

    def __init__(self, noted: list[str]) -> None:
        self._noted = noted

    def serves(self, peer: object) -> bool:
        raise AssertionError("all is joined")

    def join(self, peer: object, link: object) -> Join:
        raise AssertionError("all is joined")

    def read(self) -> None:
        self._noted.append("reads")

    def close(self) -> None:
        self._noted.append("closes")


def test_what_came_while_the_world_slept_counts_in_the_tick(
    new_life: Callable[[], Any], new_line: Callable[[], Any]
) -> None:
    """A datagram that was read before the sleep alone would be a tick late."""
    bundle = cut(prepare(load_session(SESSION, ALL_BY_WAVES)), RunPlan(REALTIME, None, ""))["environment"]
    assert isinstance(bundle, EnvironmentBundle)
    noted: list[str] = []
    node = EnvironmentNode(bundle, SleptClock(noted))  # type: ignore[arg-type]
    node.establish({})
    node._kinds = [NotedKind(noted)]
    line = new_line()
    line.frame, line.post = encode, lambda _frame: None
    node.loop(Start(0, 3), new_life(), line)
    assert noted == ["sleeps", "reads"] * 3 + ["closes"]
