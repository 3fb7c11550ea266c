"""Cutting a session and its certificate into what each process may know.

This is the only place where the data of one user and of another are in the same hands.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manyhands.design.contract import DeviceShare
from manyhands.design.statespace import Matrix, symmetric_part
from manyhands.launch.preparation import Prepared
from manyhands.launch.session import Device, TraceData
from manyhands.launch.topology import ENVIRONMENT, Topology, topology
from manyhands.nodes.bundle import (
    Bundle,
    Common,
    CouplingBundle,
    DeviceBundle,
    EnvironmentBundle,
    Peer,
    SimulatedHand,
)

TELEMETRY_PERIOD = 0.1  # s, ten a second (the channel table's rate)
MOST_TELEMETRY_TICKS = 1000


@dataclass(frozen=True)
class Run:
    """How a session is to be run.

    Attributes:
        clock: "realtime" or "simulated".
        transport: "ipc" or "tcp".
        directory: the run's own directory.
        control: endpoint of the supervisor's hub.
        traces: whether every x and f_v is wanted.
    """

    clock: str
    transport: str
    directory: Path
    control: str
    traces: bool


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
        name: _device(commons[name], device, session.osp_level(name), share) for name, device in session.devices.items()
    }
    levels: tuple[Matrix | None, ...] = (None,) * len(prepared.blocks)
    if certificate is not None:
        levels = certificate.levels.Delta_V
    for name, block, K, level in zip(
        loop.partition.names, prepared.blocks, loop.loop_gain(share.kappa), levels, strict=True
    ):
        bundles[name] = CouplingBundle(commons[name], block, K, level)
    bundles[ENVIRONMENT] = EnvironmentBundle(
        commons[ENVIRONMENT],
        loop.environment.environment(loop.period),
        None if certificate is None else certificate.levels.Phi_E,
    )
    return bundles


def _common(prepared: Prepared, run: Run, graph: Topology, name: str) -> Common:
    peers = []
    for link in graph.links_of(name):
        other = link.connector if link.binder == name else link.binder
        peers.append(Peer(other, graph.nodes[other], link.ports, link.binder == name))
    return Common(
        session=prepared.session.name,
        name=name,
        role=graph.nodes[name],
        certificate=prepared.id,
        period=prepared.session.period,
        tau=0.0 if prepared.certificate is None else prepared.certificate.tau,
        clock=run.clock,
        transport=run.transport,
        directory=str(run.directory),
        control=run.control,
        ports=graph.ports[name],
        peers=tuple(peers),
        telemetry_ticks=max(1, min(MOST_TELEMETRY_TICKS, round(TELEMETRY_PERIOD / prepared.session.period))),
        traces=run.traces,
    )


def _device(common: Common, device: Device, level: Matrix, share: DeviceShare) -> DeviceBundle:
    """What a device promises behind its sampler: share Delta_D, with K = kappa T Delta_D^{-1}."""
    K = symmetric_part(share.kappa * common.period * np.linalg.inv(level))
    return DeviceBundle(common, share.share * level, K, _hand(device))


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
