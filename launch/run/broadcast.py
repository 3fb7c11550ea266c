"""What a running session shows to observers: a description first, and then all that its nodes report.

:class:`Showing` serves everyone with access to the run's directory, and shows all of it. :class:`ObserverBroadcast`
serves the observers with keys, and each receives only the part of a node's telemetry that it may read. The supervisor
waits for no observer, and nothing that an observer does reaches a node. The receiving end is
:mod:`manyhands.launch.look`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from manyhands.design.files import open_new
from manyhands.launch.plan.access import observed
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import Reach
from manyhands.launch.plan.topology import Topology
from manyhands.launch.run.outcome import Progress
from manyhands.launch.session import SUPERVISOR, Session
from manyhands.nodes.kernel.bundle import SIMULATED
from manyhands.nodes.monitor.session_state import About, CertificateAbout, LinkAbout, NodeAbout, SpringAbout
from manyhands.nodes.rows import figures as names
from manyhands.protocol.codec import encode
from manyhands.protocol.limits import MAX_SENTENCES
from manyhands.protocol.messages import Condition, Figures, Observation, Telemetry, presentable
from manyhands.protocol.transport import Link, Transport
from manyhands.protocol.transport.broadcast import Broadcast


def observation_frame(node: str, telemetry: Telemetry) -> bytes | None:
    """The frame with all of a node's telemetry; None where it is longer than a frame may be."""
    try:
        return encode(Observation(node, telemetry.tick, telemetry.figures, telemetry.traces))
    except ValueError:  # a node may have filled the longest frame; that must not end the supervisor
        return None


def condition_of(progress: Progress) -> Condition:
    """The session's condition, as a message, from its progress."""
    sentences = (progress.notices, progress.incidents, progress.faults, progress.visits)
    notices, incidents, faults, visits = (tuple(map(presentable, texts[-MAX_SENTENCES:])) for texts in sentences)
    silent = tuple(sorted(progress.silent))
    promises = tuple(replace(row, remark=presentable(row.remark)) for row in progress.promises)
    return Condition(
        progress.phase.value, progress.elapsed, progress.states, silent, notices, incidents, faults, promises,
        progress.by_itself, visits,
    )  # fmt: skip


def condition_frame(progress: Progress) -> bytes | None:
    """The frame with the session's condition; None where its sentences are longer than a frame may be."""
    try:
        return encode(condition_of(progress))
    except ValueError:  # as above; the next condition may be shorter
        return None


def describe(
    prepared: Prepared,
    clock: str,
    transport: str,
    ticks: int,
    remote: Collection[str] = frozenset(),
    seats: Collection[str] = frozenset(),
) -> About:
    """The description of a session that is about to start.

    Args:
        prepared: the session with its certificate.
        clock: "realtime" or "simulated".
        transport: "ipc" or "tcp".
        ticks: number of ticks; 0 for no end.
        remote: nodes that run on other machines.
        seats: those of them that users take and leave while the session runs.
    """
    session, graph = prepared.session, prepared.graph
    masses, springs = session.environment.masses_and_springs(session.ports)
    return About(
        session=session.name,
        id=prepared.id,
        pid=os.getpid(),
        clock=clock,
        transport=transport,
        period=session.period,
        ticks=ticks,
        started=time.time(),
        nodes={
            name: NodeAbout(
                role,
                graph.ports[name],
                graph.carriers.get(name),
                session.in_wall_time(name, clock),
                session.own_periods.get(name),
                session.impedance_of(name),
                session.devices[name].word if name in session.devices else None,
                session.tells_work(name),
            )
            for name, role in graph.nodes.items()
        },
        links=tuple(LinkAbout((link.connector, link.binder), link.ports) for link in graph.links),
        masses=masses,
        springs=tuple(SpringAbout(link.ends, link.stiffness, link.damping) for link in springs),
        grips=_grips(session, clock, remote),
        reach=_by_port(session, "displacement"),
        force=_by_port(session, "force"),
        certificate=_certificate(prepared) if prepared.certified else None,
        environment=session.environment.type,
        observers={name: tuple(observer.reads) for name, observer in session.observers.items()},
        seats={name: session.carriers[name] for name in session.wave_links if name in seats},
        scene=session.environment.geometry(session.ports),
        turning=session.turning,
        oriented=session.environment.oriented,
        hands=session.hands,
        sensed=session.sensed_hands,
    )


def _by_port(session: Session, limit: str) -> dict[str, float]:
    """A limit of every port's device."""
    return {
        port: most
        for name, device in session.devices.items()
        for port, most in zip(session.ports_of(name), getattr(device.limits, limit), strict=True)
    }


def _grips(session: Session, clock: str, remote: Collection[str]) -> tuple[str, ...]:
    """The devices that a person can hold in the browser: on this machine, and under the realtime clock."""
    if clock == SIMULATED:
        return ()
    return tuple(n for n, device in session.devices.items() if device.driver == "browser" and n not in remote)


def _certificate(prepared: Prepared) -> CertificateAbout:
    session, certificate = prepared.session, prepared.certificate
    proofs = {device: proof for device in session.devices if (proof := prepared.certificate_of(device)) is not None}
    transparency = None if certificate is None else certificate.transparency
    return CertificateAbout(
        tau=min(proof.tau for proof in proofs.values()),
        margins=_margins(prepared),
        gamma=None if transparency is None else transparency.gamma,
        delta_D={name: float(np.linalg.eigvalsh(session.osp_level(name))[0]) for name in session.devices},
        ladder=() if prepared.ladder is None else tuple(prepared.ladder.taus[1:]),
        enforced=tuple(prepared.loop.enforced),
        tank=session.faults.tank.energy,
        power=session.faults.tank.power,
        bounded=session.faults.enforced_tank is not None,
        taus={} if prepared.world is None else {device: proof.tau for device, proof in proofs.items()},
    )


def _margins(prepared: Prepared) -> dict[str, float]:
    """The margins of the only part; or of a world, and of its parts with the name of the part before each."""
    if prepared.world is None:
        return {what: value for part in prepared.certificates for what, value in part.margins.items()}
    of_parts = {
        f"{name}: {what}": value for name, part in prepared.parts.items() for what, value in part.margins.items()
    }
    return {**prepared.world.margins, **of_parts}


class Showing:
    """One session's broadcast, from before its nodes are started to after their end."""

    def __init__(self, directory: Path, about: About, files: Mapping[str, bytes] = MappingProxyType({})) -> None:
        """Open the broadcast in the session's directory.

        Args:
            directory: the session's.
            about: its description.
            files: further files, contents by name, readable for their user alone; written before the description.

        Raises:
            OSError, TransportError: the broadcast cannot be opened there.
        """
        self._broadcast = Broadcast(directory)
        try:
            for name, data in files.items():
                with open_new(directory / name, mode=0o600) as file:
                    file.write(data)
            about.save(directory)
        except OSError:
            self._broadcast.close()
            raise

    def show(self, frame: bytes | None) -> None:
        """Show an observation or a condition; None, a frame that was too long, shows nothing."""
        if frame is not None:
            self._broadcast.show(frame)

    def close(self) -> None:
        """Close the broadcast. A second call does nothing."""
        self._broadcast.close()


TRACE_OF: Mapping[str, str] = {
    "sample": names.DISPLACEMENT,
    "force": names.FORCE,
    "tool": names.FREE_POSITION,
    "reaction": names.FORCE,
}
"""By channel, the trace of a node's telemetry that holds the channel's signal."""


def visible(node: str, telemetry: Telemetry, channels: Collection[str]) -> Observation | None:
    """The part of a node's telemetry that belongs to ``channels``; None if that is nothing.

    Figures belong to the channel ``telemetry``; each trace belongs to the channel of its signal.
    """
    wanted = {TRACE_OF[channel] for channel in channels if channel in TRACE_OF}
    traces = {name: trace for name, trace in telemetry.traces.items() if name in wanted}
    figures = telemetry.figures if "telemetry" in channels else Figures()
    return Observation(node, telemetry.tick, figures, traces) if traces or figures else None


class ObserverBroadcast:
    """The observers, each with a link of its own, on which the supervisor sends and never receives.

    Attributes:
        missed: number of observations that were not sent: the observer was absent or too slow, or the frame too long.
    """

    def __init__(self, session: Session) -> None:
        self._channels = {observer: observed(session, observer) for observer in session.observers}
        self._links: dict[str, Link] = {}
        self.missed = 0

    def serve(self, transport: Transport, reach: Reach, graph: Topology) -> Mapping[str, str]:
        """Bind a link for each observer; returns their endpoints."""
        endpoints = {}
        for index, observer in enumerate(self._channels):
            address = reach.observer_address(graph, index)
            self._links[observer], endpoints[observer] = transport.bind_outlet(
                f"{SUPERVISOR}-{observer}", observer, address
            )
        return endpoints

    def send(self, node: str, telemetry: Telemetry) -> None:
        """Send each observer the part that it may read; an observer that is too slow misses it, and the supervisor
        never waits.
        """
        for observer, link in self._links.items():
            observation = visible(node, telemetry, self._channels[observer].get(node, ()))
            if observation is not None and not _send(link, observation):
                self.missed += 1


def _send(link: Link, observation: Observation) -> bool:
    try:
        return link.send(encode(observation))
    except ValueError:  # a node may have filled the longest frame; that must not end the supervisor
        return False
