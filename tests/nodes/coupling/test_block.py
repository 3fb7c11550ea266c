"""One block of V towards the environment: the signals it sends, its use of the answer, and its changes of rung."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.coupling.block import Block
from manyhands.nodes.kernel.bundle import REALTIME, CouplingBundle
from manyhands.nodes.link.join import Received
from manyhands.nodes.link.peer_link import PeerLink, handshake_of, hello_to
from manyhands.protocol.clock import Duration, RealtimeClock
from manyhands.protocol.limits import MAX_STRAY_FRAMES
from manyhands.protocol.messages import Absent, LinkHello, Reaction, Rung, Tool

from ...support.message_link import MessageLink

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
NOW = Duration(0)
LIMIT = 2.5  # N


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


@pytest.fixture
def bundle(prepared: Prepared) -> CouplingBundle:
    bundle = cut(prepared, RunPlan("simulated", None, ""))["cx"]
    assert isinstance(bundle, CouplingBundle)
    assert len(bundle.rungs) > 2
    return dataclasses.replace(bundle, limits=dataclasses.replace(bundle.limits, force=(LIMIT,)))


@pytest.fixture
def world() -> MessageLink:
    return MessageLink()


@pytest.fixture
def block(bundle: CouplingBundle, world: MessageLink) -> Block:
    return block_of(bundle, world)


def block_of(bundle: CouplingBundle, world: MessageLink) -> Block:
    common = bundle.common
    (peer,) = (peer for peer in common.peers if not peer.binds)
    own = hello_to(common, peer, bundle.block.D)
    return Block(bundle, PeerLink(own, peer, world, Reaction, slice(0, 1), RealtimeClock()))  # type: ignore[arg-type]


def force(tick: int, value: float) -> Reaction:
    return Reaction(tick, 0, np.array([value]))


def step(block: Block, world: MessageLink, tick: int, x: float, f: float) -> None:
    """A tick in which all goes well."""
    block.send(np.array([x]), tick, tick)
    world.say(force(tick, f))
    assert block.hear(tick, NOW) is Received.SIGNAL
    block.climb(tick)
    block.settle(tick)


def test_a_force_within_the_limits_is_applied_as_it_came(
    block: Block, world: MessageLink, bundle: CouplingBundle
) -> None:
    step(block, world, 0, 0.001, 1.5)
    assert block.applied == [1.5]
    block.send(np.array([0.001]), 1, 9)
    p = 0.001 + (bundle.block.C @ bundle.block.B @ [1.5])[0]
    (first, second) = world.said
    assert first == Tool(0, 0, [0.001])
    assert isinstance(second, Tool)
    assert (second.tick, second.stamp) == (1, 9)
    np.testing.assert_allclose(second.values, [p], rtol=1e-12)


def test_one_beyond_is_clipped_and_absorbed_so(block: Block, world: MessageLink, bundle: CouplingBundle) -> None:
    step(block, world, 0, 0.0, 5 * LIMIT)
    assert block.applied == [LIMIT]
    block.send(np.zeros(1), 1, 0)
    np.testing.assert_allclose(world.said[-1].values, bundle.block.C @ bundle.block.B @ [LIMIT])  # type: ignore[union-attr]
    assert block.report().figures["saturated"] == 1


def test_zero_force_of_a_later_tick_orders_the_block_there(block: Block, world: MessageLink) -> None:
    step(block, world, 0, 0.001, 1.5)
    block.send(np.array([0.001]), 1, 0)
    world.say(force(7, 0.0))
    assert block.hear(1, NOW) is Received.DECLINED
    assert block.environment.other_tick == 7
    assert block.applied == [0.0]
    assert (block.jumps, block.report().figures["jumps"]) == (1, 1)
    block.settle(7)
    assert block.ticks == block.report().ticks == 8


def test_in_real_time_a_force_of_a_later_tick_orders_the_block_there_too_for_its_end_was_held(
    bundle: CouplingBundle, world: MessageLink
) -> None:
    block = block_of(dataclasses.replace(bundle, common=dataclasses.replace(bundle.common, clock=REALTIME)), world)
    step(block, world, 0, 0.001, 1.5)
    block.send(np.array([0.001]), 1, 0)
    world.say(force(7, 0.25))
    assert block.hear(1, NOW) is Received.DECLINED
    assert (block.environment.other_tick, block.applied) == (7, [0.25])


@pytest.mark.parametrize("stray", [force(7, 0.5), force(0, 0.0), force(0, 0.5)])
def test_any_other_force_of_another_tick_is_none(block: Block, world: MessageLink, stray: Reaction) -> None:
    step(block, world, 0, 0.001, 1.5)
    block.send(np.zeros(1), 1, 0)
    world.say(stray)
    assert block.hear(1, NOW) is Received.NOTHING
    assert block.jumps == 0
    world.say(force(1, 0.25))
    assert block.hear(1, NOW) is Received.SIGNAL
    assert block.applied == [0.25]


def test_a_signal_is_sent_again_with_its_stamp(block: Block, world: MessageLink) -> None:
    block.send(np.array([0.5]), 3, 77)
    block.send_again(3)
    block.send_again(5)  # the session has gone on
    assert world.said == [Tool(3, 77, [0.5]), Tool(3, 77, [0.5]), Tool(5, 77, [0.5])]


def shift(block: Block, world: MessageLink, tick: int, rung: int) -> int | None:
    """The environment changes the block at a ratio of 0."""
    block.send(np.zeros(1), tick, 0)
    world.say(Rung(rung), force(tick, 0.0))
    assert block.hear(tick, NOW) is Received.SIGNAL
    climbed = block.climb(tick)
    block.settle(tick)
    return climbed


def test_it_changes_its_rung_at_rest_and_keeps_its_ledger(
    block: Block, world: MessageLink, bundle: CouplingBundle
) -> None:
    step(block, world, 0, 0.001, 5 * LIMIT)
    ledger = block.port.ledger
    assert shift(block, world, 1, 2) == 2
    assert (block.port.rung, block.report().figures["rung"]) == (2, 2)
    assert block.port.ledger is ledger
    assert block.report().figures["saturated"] == 1
    block.send(np.array([0.001]), 2, 0)
    np.testing.assert_array_equal(world.said[-1].values, [0.001])  # type: ignore[union-attr] -- at rest
    world.say(force(2, 1.0))
    block.hear(2, NOW)
    assert block.climb(2) is None
    block.settle(2)
    block.send(np.zeros(1), 3, 0)
    of = bundle.rungs[2].block
    np.testing.assert_allclose(world.said[-1].values, of.C @ of.B @ [1.0])  # type: ignore[union-attr]


def test_the_same_rung_and_one_beyond_the_ladder_change_nothing(
    block: Block, world: MessageLink, bundle: CouplingBundle
) -> None:
    core = block.port.core
    assert shift(block, world, 0, 0) is None
    assert shift(block, world, 1, len(bundle.rungs)) is None
    assert (block.port.rung, block.port.core) == (0, core)
    assert block.environment.gate.dropped["wrong_kind"] == 0


def test_a_block_ignores_a_misdirected_absence(block: Block, world: MessageLink) -> None:
    world.say(Absent("dx"), force(0, 0.5))
    block.send(np.zeros(1), 0, 0)
    assert block.hear(0, NOW) is Received.SIGNAL
    assert block.climb(0) is None


def meet_environment(block: Block, tick: int) -> MessageLink:
    join, fresh = block.environment, MessageLink()
    join.greet(fresh, handshake_of(join))  # type: ignore[arg-type]
    own = join.own
    hello = LinkHello(own.version, own.certificate, own.session, join.peer.name, join.peer.role, join.peer.ports)
    fresh.say(hello)
    assert block.hear(tick, NOW) is Received.RECONNECTED
    return fresh


def test_a_returned_environment_receives_the_blocks_tick(block: Block, world: MessageLink) -> None:
    block.send(np.array([0.5]), 3, 77)
    fresh = meet_environment(block, 3)
    assert fresh.said[-1] == Tool(3, 77, [0.5])
    assert len(world.said) == 1


def test_a_returned_environment_finds_the_block_at_the_first_rung(block: Block, world: MessageLink) -> None:
    """The handshake gave it D_V of that rung; it knows no other before a shift."""
    assert shift(block, world, 0, 2) == 2
    block.send(np.zeros(1), 1, 0)
    fresh = meet_environment(block, 1)
    fresh.say(force(1, 0.0))
    assert block.hear(1, NOW) is Received.SIGNAL
    assert block.climb(1) == 0
    block.settle(1)
    block.send(np.zeros(1), 2, 0)
    fresh.say(Rung(2), force(2, 0.0))  # it receives the shift, and shifts
    block.hear(2, NOW)
    assert block.climb(2) == 2


def test_a_flood_ends_the_node(block: Block, world: MessageLink, new_life: Callable[[], Any]) -> None:
    life = new_life()
    block.begin(life)
    world.coming.extend([b"\xc1"] * (MAX_STRAY_FRAMES + 1))
    assert block.hear(0, NOW) is Received.NOTHING
    assert life.failure.startswith("cx: environment sent 513 stray frames")


def test_rows_follow_each_other(
    bundle: CouplingBundle, block: Block, world: MessageLink, new_line: Callable[[], Any]
) -> None:
    """The first telemetry has fewer rows, so that not all nodes send theirs in the same tick."""
    line, first, rows = new_line(), bundle.common.telemetry_first, bundle.common.telemetry_ticks
    assert 0 < first < rows
    for tick in range(first + rows + 3):
        step(block, world, tick, tick / 1e3, 0.1)
        block.publish(line)
    block.publish_rest(line)
    block.publish_rest(line)
    assert [(told.tick, len(told.traces["p"])) for told in line.telemetry] == [
        (first, first),
        (first + rows, rows),
        (first + rows + 3, 3),
    ]
    assert line.telemetry[-1].figures["rung"] == 0.0


def test_a_block_without_a_promise_reports_no_ledger(
    bundle: CouplingBundle, block: Block, world: MessageLink, new_line: Callable[[], Any]
) -> None:
    block, line = Block(dataclasses.replace(bundle, level=None), block.environment), new_line()
    for tick in range(bundle.common.telemetry_first):
        step(block, world, tick, 0.0, 0.1)
        block.publish(line)
    (told,) = line.telemetry
    assert told.traces.keys() == {"p", "f_v"}
    assert told.tick == bundle.common.telemetry_first
