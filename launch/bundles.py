"""Cutting a session and its certificate into what each process may know.

This is the only place where the data of one user and of another are in the same hands.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from manyhands.design.contract import DeviceShare
from manyhands.design.statespace import Matrix, symmetric_part
from manyhands.launch.port_bounds import limits_at, tool_bounds
from manyhands.launch.preparation import Prepared
from manyhands.launch.reach import IPC, Reach
from manyhands.launch.session import Device, TraceData
from manyhands.launch.topology import ENVIRONMENT, Topology, topology
from manyhands.nodes.bundle import (
    MAX_TELEMETRY_TICKS,
    Bundle,
    Common,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    Limits,
    ObserverBundle,
    Peer,
    SimulatedHand,
)
from manyhands.nodes.feedthrough import feedthrough_digest
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Role

TELEMETRY_PERIOD = 0.1  # s, ten a second (the channel table's rate)
MOST_TRACE_VALUES = MAX_CONTROL_BYTES // 8 - 4096  # of all traces in a message: what its frame has room for


@dataclass(frozen=True)
class Run:
    """How a session is to be run.

    Attributes:
        clock: "realtime" or "simulated".
        directory: the run's own directory; None where the processes are on other machines.
        control: endpoint of the supervisor's hub.
        traces: whether every x and f_v is wanted.
        reach: how the processes reach each other.
        private: where each process's private key is; empty without keys, or where that is the guest's own business.
    """

    clock: str
    directory: Path | None
    control: str
    traces: bool
    reach: Reach = IPC
    private: Mapping[str, Path] = field(default_factory=dict)


def cut(prepared: Prepared, run: Run) -> dict[str, Bundle]:
    """The bundle of every node, by name.

    Args:
        prepared: the session with its coupling and certificate.
        run: how it is to be run.
    """
    session, loop, certificate = prepared.session, prepared.loop, prepared.certificate
    graph = topology(session)
    commons = {name: _common(prepared, run, graph, name) for name in graph.nodes}
    share = DeviceShare() if certificate is None else certificate.levels.device
    bundles: dict[str, Bundle] = {
        name: _device(commons[name], device, session.osp_level(name), share, limits_at(session, commons[name].ports))
        for name, device in session.devices.items()
    }
    levels: tuple[Matrix | None, ...] = (None,) * len(prepared.blocks)
    if certificate is not None:
        levels = certificate.levels.Delta_V
    for name, block, K, level in zip(
        loop.partition.names, prepared.blocks, loop.loop_gain(share.kappa), levels, strict=True
    ):
        bundles[name] = CouplingBundle(commons[name], block, K, level, limits_at(session, commons[name].ports))
    bundles[ENVIRONMENT] = EnvironmentBundle(
        commons[ENVIRONMENT],
        loop.environment.environment(loop.period),
        None if certificate is None else certificate.levels.Phi_E,
        *tool_bounds(session, prepared.blocks),
        {name: feedthrough_digest(block.D) for name, block in zip(session.couplings, prepared.blocks, strict=True)},
    )
    return bundles


def bundle_of(prepared: Prepared, run: Run, name: str) -> Bundle:
    """The bundle of one node, or of an observer."""
    if name in prepared.session.observers:
        return ObserverBundle(_common(prepared, run, topology(prepared.session), name))
    return cut(prepared, run)[name]


def _common(prepared: Prepared, run: Run, graph: Topology, name: str) -> Common:
    peers, ports = [], graph.ports.get(name, ())
    for index, link in enumerate(graph.links):
        if name in (link.binder, link.connector):
            binds = link.binder == name
            other = link.connector if binds else link.binder
            address = run.reach.address(graph, index) if binds else ""
            peers.append(Peer(other, graph.nodes[other], link.ports, binds, address))
    return Common(
        session=prepared.session.name,
        name=name,
        role=graph.nodes.get(name, Role.OBSERVER),
        certificate=prepared.id,
        period=prepared.session.period,
        tau=0.0 if prepared.certificate is None else prepared.certificate.tau,
        clock=run.clock,
        transport=run.reach.transport,
        public=run.reach.public(name),
        private=str(run.private.get(name, "")),
        directory="" if run.directory is None else str(run.directory),
        control=run.control,
        ports=ports,
        peers=tuple(peers),
        telemetry_ticks=_telemetry_ticks(prepared.session.period, len(ports)),
        traces=run.traces,
    )


def _telemetry_ticks(period: float, ports: int) -> int:
    """Ticks between two telemetry messages: as the channel table says, but no more than two traces have room for."""
    room = MOST_TRACE_VALUES // (2 * max(1, ports))  # an observer has none
    return max(1, min(MAX_TELEMETRY_TICKS, room, round(TELEMETRY_PERIOD / period)))


def _device(common: Common, device: Device, level: Matrix, share: DeviceShare, limits: Limits) -> DeviceBundle:
    """What a device promises behind its sampler: share Delta_D, with K = kappa T Delta_D^{-1}."""
    K = symmetric_part(share.kappa * common.period * np.linalg.inv(level))
    return DeviceBundle(common, share.share * level, K, _hand(device), limits)


def _hand(device: Device) -> SimulatedHand:
    """The physics of a simulated device with its hand: masses add up, intentions become plain data."""
    hand = device.hand
    return SimulatedHand(
        mass=tuple(float(a + b) for a, b in zip(device.mass, hand.mass, strict=True)),
        damping=device.damping,
        operator=hand.rational.realisation(),
        hand_damping=hand.damping,
        hand_stiffness=hand.stiffness,
        force=tuple(_plain(intent) for intent in hand.force),
        motion=tuple(_plain(intent) for intent in hand.motion),
    )


def _plain(intent: float | str | TraceData) -> object:
    if isinstance(intent, TraceData):
        return {"times": list(intent.times), "values": list(intent.values)}
    return intent
