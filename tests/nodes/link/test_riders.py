"""What rides with a signal: it passes couplings as it is, and the linear loop knows nothing of it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.block import Block
from manyhands.nodes.kernel.bundle import Common, CouplingBundle, Peer
from manyhands.nodes.kernel.orientation import RIDER
from manyhands.nodes.link.join import OwnEnd, Received
from manyhands.nodes.link.peer_link import Frames, PeerLink, bounds_by_peer, hello_to
from manyhands.protocol.clock import Duration, RealtimeClock
from manyhands.protocol.codec import decode, encode
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Force, Reaction, Role, Sample, Tool
from tests.support.memory_transport import MemoryTransport

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"

finite = st.floats(allow_nan=False, allow_infinity=False)
riders = st.lists(finite, min_size=RIDER, max_size=RIDER)


@pytest.fixture(scope="module")
def coupling() -> CouplingBundle:
    """The coupling of x of example 1, with whose device an orientation rides to the environment."""
    bundle = cut(prepare(load_session(SESSIONS / "example1.yaml"), None), RunPlan("simulated", None, ""))["cx"]
    assert isinstance(bundle, CouplingBundle)
    peers = tuple(replace(peer, riding=("dx",)) for peer in bundle.common.peers)
    return replace(bundle, common=replace(bundle.common, peers=peers, riding=("dx",)))


class Nobody:
    def on_other_tick(self, *_: Any) -> bool:
        return False

    def on_notice(self, *_: Any) -> bool:
        return False

    def flooded(self, text: str) -> None:
        raise AssertionError(text)


def block_of(coupling: CouplingBundle) -> tuple[Block, Any, MemoryTransport]:
    transport = MemoryTransport()
    world, endpoint = transport.bind("environment-cx", "cx")
    (peer,) = (peer for peer in coupling.common.peers if peer.role is Role.ENVIRONMENT)
    join = Frames(OwnEnd(coupling.common, RealtimeClock())).join(peer, transport.connect(endpoint, "environment"))
    return Block(coupling, join), world, transport


@given(riders, riders)
def test_a_coupling_passes_it_on_as_it_is(coupling: CouplingBundle, up: list[float], down: list[float]) -> None:
    block, world, transport = block_of(coupling)
    plain, unladen, other = block_of(replace(coupling, common=replace(coupling.common, riding=(), peers=tuple(
        replace(peer, riding=()) for peer in coupling.common.peers
    ))))  # fmt: skip
    for of in (block, plain):
        of.send([0.25, *up] if of is block else [0.25], 0, 7)
        of.send_again(0)
    for _ in range(2):
        sent = decode(world.recv(Duration(0)), MAX_CONTROL_BYTES)
        alone = decode(unladen.recv(Duration(0)), MAX_CONTROL_BYTES)
        assert isinstance(sent, Tool)
        assert isinstance(alone, Tool)
        assert sent.values.tolist() == [*alone.values.tolist(), *up]
    world.send(encode(Reaction(0, 7, np.array([0.5, *down]))))
    unladen.send(encode(Reaction(0, 7, np.array([0.5]))))
    assert block.hear(0, Duration(0)) is plain.hear(0, Duration(0)) is Received.SIGNAL
    assert block.applied == [*plain.applied, *down]
    for of in (block, plain):
        of.settle(0)
    assert block.port.row() == plain.port.row()
    for of in (transport, other):
        of.close()


def link_of(common: Common, peer: Peer) -> tuple[PeerLink, Any, MemoryTransport]:
    transport = MemoryTransport()
    far, endpoint = transport.bind("a-b", "b")
    bounds = bounds_by_peer(common, Role.DEVICE, [1.0] * len(common.ports), [0.1] * len(common.ports))
    join = Frames(OwnEnd(common, RealtimeClock(), bounds)).join(peer, transport.connect(endpoint, "a"))
    return join, far, transport


@given(st.lists(st.floats(), min_size=RIDER, max_size=RIDER))
def test_only_what_is_finite_is_admitted_and_the_bounds_of_motion_stay(
    coupling: CouplingBundle, up: list[float]
) -> None:
    (device,) = (peer for peer in coupling.common.peers if peer.role is Role.DEVICE)
    join, far, transport = link_of(coupling.common, device)
    values = [math.nan] * coupling.common.width
    good = np.array([0.5, *up])
    frame = encode(Sample(0, 0, np.array([0.5] + [0.0] * RIDER)))
    far.send(frame[: -8 * (1 + RIDER)] + good.astype("<f8").tobytes())
    found = join.hear(values, 0, Duration(0), Nobody())
    assert (found is Received.SIGNAL) == all(map(math.isfinite, up))
    assert found is not Received.SIGNAL or values == [0.5, *up]
    far.send(encode(Sample(0, 0, np.array([2.0] + [0.0] * RIDER))))
    assert join.hear(values, 0, Duration(0), Nobody()) is Received.NOTHING
    far.send(encode(Sample(0, 0, np.array([0.5]))))
    assert join.hear(values, 0, Duration(0), Nobody()) is Received.NOTHING
    assert join.dropped["wrong_width"] == 1
    transport.close()


def test_among_several_each_link_has_its_own_part(coupling: CouplingBundle) -> None:
    common = replace(coupling.common, ports=("a", "b", "c"), riding=("left", "right"), turning=())
    right = Peer("right", Role.DEVICE, ("b", "c"), True, riding=("right",))
    join, far, transport = link_of(replace(common, peers=()), right)
    values = list(map(float, range(common.width)))
    assert join.share(values) == [1.0, 2.0, *range(9, 15)]
    assert join.share_of_ports(values) == [1.0, 2.0]
    join.put_ports(values, [-1.0, -2.0])
    assert values == [0.0, -1.0, -2.0, *range(3, 9), *[0.0] * RIDER]
    join.send(Force, 5, 0, values)
    sent = decode(far.recv(Duration(0)), MAX_CONTROL_BYTES)
    assert isinstance(sent, Force)
    assert sent.values.tolist() == [-1.0, -2.0, *[0.0] * RIDER]
    join.send_zero(Force, 6)
    sent = decode(far.recv(Duration(0)), MAX_CONTROL_BYTES)
    assert isinstance(sent, Force)
    assert sent.values.tolist() == [0.0] * (2 + RIDER)
    assert hello_to(common, right, None).ports == ("b", "c")
    transport.close()
