"""The bundle of each process: the part of a session and its certificate that this process may know.

Only this module, in the launching process, holds the data of several users together. :func:`cut` makes the bundles of a
run, and :func:`invite` writes one bundle for a node on another machine: with its key, it is all that this node needs.

Bundles also carry the bounds within which a process expects its peers' values. A device keeps to its own limits, and a
coupling clips every force to the limits of its devices. The largest values that an honest coupling can send to the
environment follow from these limits (:func:`tool_bounds`). The environment receives the bounds, and never the limits.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from manyhands.design.files import replacing
from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.models.kind import WhatRuns
from manyhands.design.models.statespace import Matrix, StateSpace, matrix
from manyhands.design.peak_gain import output_bounds
from manyhands.design.problem import HapticLoop
from manyhands.launch.files import require_target
from manyhands.launch.plan.keys import Keys
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.plan.reach import IPC, Listen, Reach, ReachError, reach
from manyhands.launch.plan.topology import Topology
from manyhands.launch.session import PERSONS, SCRIPTED, Device, Session
from manyhands.launch.session.errors import one_of
from manyhands.launch.session.limits import HAND_STORE
from manyhands.launch.session.motion import plain_intent
from manyhands.launch.session.session import ENVIRONMENT
from manyhands.launch.session.wave_link import WaveLink
from manyhands.nodes.kernel import bundle as bundle_files
from manyhands.nodes.kernel.arithmetic import feedthrough_digest
from manyhands.nodes.kernel.bundle import (
    MAX_TELEMETRY_TICKS,
    OWN,
    REALTIME,
    TELEMETRY_PERIOD,
    WALL,
    Bundle,
    Common,
    CouplingBundle,
    CouplingRung,
    DeviceBundle,
    DeviceRung,
    EnvironmentBundle,
    Limits,
    ObserverBundle,
    OrientationPart,
    OrientedTool,
    Peer,
    PersonHand,
    PluginDevice,
    RecordedMotion,
    SensedPart,
    SimulatedHand,
    Source,
    WaveEnd,
)
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.nodes.kernel.site_bounds import SiteBounds, site_bounds
from manyhands.nodes.wave_link.faces import wave_feedthrough
from manyhands.protocol.channels import hands_at, links_at, topics_of
from manyhands.protocol.limits import MAX_CONTROL_BYTES
from manyhands.protocol.messages import Role
from manyhands.protocol.plain import written

PortBounds = tuple[float | None, ...]
"""One bound for each port of the session; None where a port has no bound."""


def limits_at(session: Session, ports: Sequence[str]) -> Limits:
    """The limits of force (N), displacement (m) and speed (m/s) at ``ports``, in their order."""
    of_ports = []
    for port in ports:
        name = session.device_at[port]
        limits, axis = session.devices[name].limits, session.ports_of(name).index(port)
        of_ports.append((limits.force[axis], limits.displacement[axis], limits.speed[axis]))
    force, displacement, speed = zip(*of_ports, strict=True)
    return Limits(force, displacement, speed)


def budgets(session: Session) -> tuple[EnergyBudget, ...]:
    """The energy budget of each coupling: that of each of its devices, in proportion to the axes that it couples."""
    of_port: dict[str, tuple[float, float, float]] = {}
    for name, device in session.devices.items():
        limits, ports = device.limits, session.ports_of(name)
        stroke = 2.0 * sum(force * reach for force, reach in zip(limits.force, limits.displacement, strict=True))
        whole = (limits.power, limits.energy, min(HAND_STORE, stroke))
        of_port |= {port: (whole[0] / len(ports), whole[1] / len(ports), whole[2] / len(ports)) for port in ports}
    return tuple(
        EnergyBudget(*map(sum, zip(*(of_port[port] for port in ports), strict=True))) for ports in session.blocks
    )


def tool_bounds(session: Session, blocks: Sequence[StateSpace]) -> tuple[PortBounds, PortBounds]:
    """The greatest |p| and |p(k) - p(k-1)|, m, that honest devices and couplings can send.

    p = x + C_V xi, and xi follows forces that were clipped, so that

        |p_i| <= X_i + sum_j ||h_ij||_1 F_j,     |p_i(k) - p_i(k-1)| <= T S_i + sum_j ||h_ij(k) - h_ij(k-1)||_1 F_j

    with h the impulse response of (A_V, B_V, C_V, 0) and X, S, F the limits of displacement, speed and force. The ports
    of a block that is not found to be stable have no bounds.

    Args:
        session: the session.
        blocks: the blocks of V, in the order of the session's couplings.
    """
    magnitude: dict[str, float] = {}
    step: dict[str, float] = {}
    known: dict[tuple[bytes, ...], tuple[Matrix, Matrix]] = {}  # users are often alike, and a block's bounds take 3 ms
    for ports, block in zip(session.blocks, blocks, strict=True):
        limits = limits_at(session, ports)
        alike = tuple(part.tobytes() for part in (block.A, block.B, block.C, np.array(limits.force)))
        if alike not in known:
            dynamic = StateSpace(block.A, block.B, block.C, np.zeros_like(block.D))
            known[alike] = output_bounds(dynamic, np.array(limits.force))
        offset, change = known[alike]
        magnitude |= zip(ports, (limits.displacement + offset).tolist(), strict=True)
        step |= zip(ports, (session.period * np.array(limits.speed) + change).tolist(), strict=True)
    return _in_order(session, magnitude), _in_order(session, step)


def _require_runnable(prepared: Prepared) -> None:
    """Refuse a certified run that counts on dry friction which is not there, or of which no account can be kept.

    Raises:
        NotCertified: it does.
    """
    if not prepared.certified:
        return
    for name, device in prepared.session.devices.items():
        at = f"{prepared.session.name}: devices.{name}"
        if device.friction is None:
            continue
        if device.factory is None and device.kinematics is not None:
            raise NotCertified(
                f"{at}.friction: found friction behind the kinematics of a simulated linkage, which burns that of its "
                "joints alone, and no claim of the tip is proved of it; expected no friction, or kappa alone as its "
                "linkage, for a run; or an uncertified run"
            )
        speed = prepared.session.design.speed
        if device.factory is not None and speed is not None:
            _require_measured(prepared.session, name, speed)


def _require_measured(session: Session, name: str, below: float) -> None:
    """Refuse a driver of another package whose displacements tell too little of its ways, or of speeds ``below``."""
    device = session.devices[name]
    least = session.period_of(name) - device.timing.jitter  # between two samples, s
    at, unit = f"{session.name}: devices.{name}.step", device.units("m")
    if device.step is None:
        raise NotCertified(
            f"{at}: found none beside a driver's factory, friction and design.speed; expected the step to which its "
            f"displacements are measured, in {device.units('m')}: friction counts on ways alone that are no noise"
        )
    if not max(device.step) < below * least:
        raise NotCertified(
            f"{at}: found {max(device.step):g} {unit}; expected less than the {max(0.0, below * least):.3g} {unit} "
            f"that {below:g} {unit}/s are in {max(0.0, least):g} s, the least time between two samples: a finer step, "
            "or a greater design.speed. One step would look like a faster motion"
        )


def _friction_of(prepared: Prepared, name: str) -> DryFriction | None:
    """The dry friction that the account of a device counts; None where it counts none.

    That of a driver of another package counts below a speed alone.
    """
    device, certificate = prepared.session.devices[name], prepared.certificate_of(name)
    if certificate is None or device.friction is None:
        return None
    if device.factory is not None and prepared.session.design.speed is None:
        return None
    loop = certificate.loop  # every rung keeps as much: friction that is kept for steps has no ladder
    kept = dict.fromkeys(loop.ports, 0.0) if loop.kept is None else dict(zip(loop.ports, loop.kept, strict=True))
    own = tuple(kept[port] for port in prepared.session.ports_of(name))
    return DryFriction(device.friction.least, own, prepared.session.design.speed)


def _in_order(session: Session, bounds: Mapping[str, float]) -> PortBounds:
    return tuple(bounds[port] if math.isfinite(bounds[port]) else None for port in session.ports)


MOST_TRACE_VALUES = MAX_CONTROL_BYTES // 8 - 4096  # values of all traces in a message, limited by the size of a frame
USUAL_TRACE_VALUES = 8192  # beyond, a frame takes longer to make than a tick leaves: 0.7 ms for six times as many
FEWEST_TICKS = 10  # in such a message, for its figures cost time as well


@dataclass(frozen=True)
class RunPlan:
    """How a session is to be run.

    Attributes:
        clock: "realtime" or "simulated".
        directory: the run's own directory; None where the processes are on other machines.
        control: endpoint of the supervisor's hub.
        reach: how the processes reach each other.
        private: the file of each process's private key; empty without keys, or for a node on another machine.
    """

    clock: str
    directory: Path | None
    control: str
    reach: Reach = IPC
    private: Mapping[str, Path] = field(default_factory=dict)


def cut(prepared: Prepared, run: RunPlan) -> dict[str, Bundle]:
    """The bundle of every node, by name.

    Args:
        prepared: the session with its coupling and certificate.
        run: how the session is to be run.

    Raises:
        NotCertified: the certificate counts on dry friction that a simulated device has not, or of which no account
            can be kept.
    """
    session = prepared.session
    _require_runnable(prepared)
    links_of = _links_of(prepared.graph)
    commons = {name: _common(prepared, run, name, links_of) for name in prepared.graph.nodes}
    rungs = _rungs(prepared)
    # where several couplings share a device, the certificate is one
    coupling_at = {port: name for name, ports in session.blocks_by_name.items() for port in ports}
    bundles: dict[str, Bundle] = {}
    allowance = session.faults.enforced_tank if prepared.certified else None  # without a certificate, no promise
    for name in session.devices:
        own_rungs = rungs[coupling_at[session.ports_of(name)[0]]]
        of_device = tuple(
            DeviceRung(rung.tau, rung.period_tolerance, rung.share, _turning(prepared, name, number))
            for number, rung in enumerate(own_rungs)
        )
        limits = limits_at(session, commons[name].ports)
        osp = matrix(session.osp_level(name))
        time = WALL if session.in_wall_time(name, run.clock) else OWN
        inertia = session.devices[name].inertia
        held = session.devices[name].held_torque if prepared.certified else None  # without a certificate, no promise
        buttons = session.devices[name].buttons or {}
        scripts = tuple(buttons.values()) if session.devices[name].driver in SCRIPTED else ()
        bundles[name] = DeviceBundle(
            commons[name], osp, of_device, _source(session, name), limits, time, allowance, inertia, held,
            _friction_of(prepared, name), scripts, _orientation_of(prepared, name),
        )  # fmt: skip
    longest = max(map(len, rungs.values()))
    at_rungs = ([of_one[min(rung, len(of_one) - 1)].block for of_one in rungs.values()] for rung in range(longest))
    tools = _widest([tool_bounds(session, blocks) for blocks in at_rungs])
    bounds = _site_bounds(session, tools[0], {name: own.block.D for name, (own, *_) in rungs.items()})
    for name in session.couplings:
        own, *softer = (CouplingRung(rung.block, rung.K, rung.level) for rung in rungs[name])
        limits = limits_at(session, commons[name].ports)
        link = session.wave_links.get(name)
        wave = None if link is None else _wave_end(session, name, link, bounds[name], at_user=True)
        bundles[name] = CouplingBundle(commons[name], own.block, own.K, own.level, limits, tuple(softer), wave)
    running = prepared.loop.environment.nominal.running(session.period)
    Phi_E = _level(prepared, running)
    waves = {
        name: _wave_end(session, name, link, bounds[name], at_user=False) for name, link in session.wave_links.items()
    }
    bundles[ENVIRONMENT] = EnvironmentBundle(
        commons[ENVIRONMENT],
        running.E,
        Phi_E,
        *tools,
        {
            name: feedthrough_digest(wave_feedthrough(waves[name].b, session.period) if name in waves else block.D)
            for name, block in zip(session.couplings, prepared.blocks, strict=True)
        },
        {name: tuple(rung.block.D for rung in softer) for name, (_, *softer) in rungs.items()},
        independent=prepared.ladder is None or prepared.ladder.independent,
        enforce=session.environment.enforce and Phi_E is not None,
        model=session.foreign_code.get("environment.model"),
        scene=running.scene,
        stiffness=running.stiffness,
        masses=session.environment.reported(session.ports),
        longest_tau=_longest_tau(prepared, rungs),
        budgets=budgets(session),
        storage=running.storage,
        waves=waves,
        tank=running.tank,
        oriented=session.environment.oriented,
        oriented_tools=tuple(_oriented_tool(prepared, name) for name in session.hands),
    )
    return _with_part_ids(prepared, bundles)


def _orientation_of(prepared: Prepared, name: str) -> OrientationPart | SensedPart | None:
    """The orientation of a device, with the stiffness that is proved, or in an uncertified run designed."""
    own = prepared.session.devices[name].orientation
    if own is None:
        return None
    part = prepared.certificate_of(name)
    return own.part(_spring_in(prepared.loop if part is None else part.loop, name))


def _spring_in(loop: HapticLoop, name: str) -> float:
    """K of the spring at the orientation of a device, N*m/rad, as its loop has it."""
    (level,) = (device.orientation for device in loop.devices if device.name == name)
    if level is None:
        raise AssertionError(f"the loop has the orientation of {name}")
    return level.stiffness


def _turning(prepared: Prepared, name: str, rung: int) -> float | None:
    """K of the spring at a device's orientation, at a rung, N*m/rad; None where no torque acts."""
    part = _orientation_of(prepared, name)
    if not isinstance(part, OrientationPart):
        return None
    if rung == 0 or prepared.ladder is None:
        return part.stiffness
    return _spring_in(prepared.ladder.rungs[rung].loop, name)


def _oriented_tool(prepared: Prepared, name: str) -> OrientedTool:
    """The same as the environment knows it."""
    part = _orientation_of(prepared, name)
    if part is None:
        raise AssertionError(f"the orientation of {name} is a port")
    if isinstance(part, SensedPart):
        return OrientedTool(name, part.stiffness, None, None)
    session = prepared.session
    own, T = session.period_of(name), session.period
    return OrientedTool(name, part.stiffness, part.torque, part.power(own) * T / own)


def _riding(session: Session, node: str) -> tuple[str, ...]:
    """The devices whose orientations pass through a node: of a coupling, those of which it has the first port."""
    if node == ENVIRONMENT:
        return session.hands
    if node in session.couplings:
        own = session.blocks_by_name[node]
        return tuple(name for name in session.hands if session.ports_of(name)[0] in own)
    return tuple(name for name in session.hands if name == node)


def _with_part_ids(prepared: Prepared, bundles: Mapping[str, Bundle]) -> dict[str, Bundle]:
    """The same bundles, of which those of a wave link's site have the id of their part, at either end of the link."""
    out = dict(bundles)
    ids = dict[str, str]()
    for name in [name for name in prepared.session.wave_links if name in prepared.parts]:
        nodes = [*prepared.session.devices_of(name), name]
        ids[name] = part_id(prepared.parts[name].id, [bundles[node] for node in nodes])
        for node in nodes:
            out[node] = replace(bundles[node], common=replace(bundles[node].common, certificate=ids[name]))
    world = bundles[ENVIRONMENT]
    peers = tuple(replace(peer, certificate=ids.get(peer.name, "")) for peer in world.common.peers)
    out[ENVIRONMENT] = replace(world, common=replace(world.common, peers=peers))
    return out


def part_id(certificate: str, bundles: Sequence[Bundle]) -> str:
    """The id of a site's part of a session: SHA-256 (hex) of its certificate's id and of all that its nodes are given.

    Keys, addresses, and when the nodes send telemetry are no part of it. So a change elsewhere in the session leaves
    the id as it is, and an invitation good.

    Args:
        certificate: the id of the site's certificate.
        bundles: of the site's nodes.
    """
    content: list[Any] = [certificate]
    for bundle in bundles:
        members = written(bundle)
        common = members.pop("common")
        links = [[peer["name"], peer["ports"], peer["binds"]] for peer in common["peers"]]
        content.append([members, links, {key: common[key] for key in _OF_A_PART}])
    return hashlib.sha256(json.dumps(content, sort_keys=True, allow_nan=False).encode()).hexdigest()


_OF_A_PART = ("session", "name", "role", "period", "clock", "ports", "rate", "buttons", "riding")


def _site_bounds(session: Session, tools: PortBounds, feedthrough: Mapping[str, Matrix]) -> dict[str, SiteBounds]:
    """By coupling with a wave link: the greatest wave of its site, and the furthest place of its tool.

    Args:
        session: the session.
        tools: the greatest |p| of each port, m; None where there is no bound.
        feedthrough: by coupling, D_V, m/N: the tool is at p + D_V f.
    """
    furthest = {port: math.inf if most is None else most for port, most in zip(session.ports, tools, strict=True)}
    of_budget = dict(zip(session.couplings, budgets(session), strict=True))
    out = {}
    for name, link in session.wave_links.items():
        ports = session.blocks_by_name[name]
        limits, b = limits_at(session, ports), link.impedance(len(ports))
        tool = np.array([furthest[port] for port in ports]) + np.abs(feedthrough[name]) @ np.array(limits.force)
        out[name] = site_bounds(b, limits.force, limits.speed, tool.tolist(), of_budget[name].energy, session.period)
    return out


def _wave_end(session: Session, name: str, link: WaveLink, bounds: SiteBounds, at_user: bool) -> WaveEnd:
    """One end of a wave link; the user's end alone harvests, from what its site's certificate leaves."""
    ports = len(session.blocks_by_name[name])
    harvest = link.harvest_of(ports)
    theta = matrix(np.diag(harvest)) if at_user and any(harvest) else None
    own, peer = link.period_in(session.period), session.period
    if not at_user:
        own, peer = peer, own
    every, peer_every = link.every(own), link.every(peer)
    number = list(session.wave_links).index(name)
    turn = number % max(every, peer_every)
    return WaveEnd(
        matrix(link.impedance(ports)), theta, link.tank, peer, link.depth,
        every=every, peer_every=peer_every, turn=turn, bounds=bounds, way=link.way(2 * number + at_user),
    )  # fmt: skip


def _level(prepared: Prepared, running: WhatRuns) -> Matrix | None:
    """The level that the environment promises; None where it promises none.

    That of a model and of a scene is *declared*, certified or not.
    """
    return running.level if running.E is None else prepared.Phi_E


@dataclass(frozen=True, eq=False)
class _Rung:
    """What is in force for one coupling and its devices at one rung.

    Attributes:
        tau: the delay inside the tick that the rung covers, s.
        period_tolerance: rho; the rung covers periods up to (1 + rho) T.
        share: the share of the devices' levels that remains behind their samplers.
        K: of the block, m/N.
        block: the block of V.
        level: of the block; None where nothing is certified.
    """

    tau: float
    period_tolerance: float
    share: DeviceShare
    K: Matrix
    block: StateSpace
    level: Matrix | None


def _rungs(prepared: Prepared) -> dict[str, list[_Rung]]:
    """By coupling: the rung in force at the start, then the softer rungs to which the coupling may change."""
    couplings = tuple(prepared.session.couplings)
    if not prepared.certified:
        share = DeviceShare()
        gains = prepared.loop.loop_gain(share.kappa)
        of_each = zip(couplings, gains, prepared.blocks, strict=True)
        return {name: [_Rung(0.0, 0.0, share, K, block, None)] for name, K, block in of_each}
    found: dict[str, list[_Rung]] = {name: [] for name in couplings}
    for proof in prepared.rungs:
        share = proof.levels.device
        gains = proof.loop.loop_gain(share.kappa)
        proved = zip(proof.loop.partition.names, gains, proof.blocks, proof.levels.Delta_V, strict=True)
        for name, K, block, level in proved:
            found[name].append(_Rung(proof.tau, proof.period_tolerance, share, K, block, level))
    for of_one, block in zip(found.values(), prepared.blocks, strict=True):
        of_one[0] = replace(of_one[0], block=block)
    return found


def _longest_tau(prepared: Prepared, rungs: Mapping[str, Sequence[_Rung]]) -> float:
    """The longest delay that the users in the tick may have, s; 0 where there are none."""
    session = prepared.session
    last = -1 if session.faults.breach == "soften" else 0
    return max((of_one[last].tau for name, of_one in rungs.items() if name not in session.wave_links), default=0.0)


def _widest(bounds: Sequence[tuple[PortBounds, PortBounds]]) -> tuple[PortBounds, PortBounds]:
    """The bounds on |p| and on its steps that hold at every rung; None for a port without a bound at some rung."""
    magnitudes, steps = (zip(*of_one_kind, strict=True) for of_one_kind in zip(*bounds, strict=True))
    return tuple(map(_greatest, magnitudes)), tuple(map(_greatest, steps))


def _greatest(bounds: tuple[float | None, ...]) -> float | None:
    stated = [bound for bound in bounds if bound is not None]
    return max(stated) if len(stated) == len(bounds) else None


def bundle_of(prepared: Prepared, run: RunPlan, name: str) -> Bundle:
    """The bundle of one node, or of an observer."""
    if name in prepared.session.observers:
        return ObserverBundle(_common(prepared, run, name, {}))
    return cut(prepared, run)[name]


def _links_of(graph: Topology) -> dict[str, list[int]]:
    """By node, the indices of its links."""
    found: dict[str, list[int]] = {name: [] for name in graph.nodes}
    for index, link in enumerate(graph.links):
        found[link.binder].append(index)
        found[link.connector].append(index)
    return found


def _common(prepared: Prepared, run: RunPlan, name: str, links_of: Mapping[str, Sequence[int]]) -> Common:
    graph = prepared.graph
    peers, ports = [], graph.ports.get(name, ())
    buttons = prepared.session.buttons_at
    own = buttons.get(name, ())
    for index in links_of.get(name, ()):
        link = graph.links[index]
        binds = link.binder == name
        other = link.connector if binds else link.binder
        address = run.reach.address(graph, index) if binds else ""
        carried = [button for button in own if button in buttons[other]]  # they follow each other at either end
        first = own.index(carried[0]) if carried else 0
        there = _riding(prepared.session, other)
        riding = tuple(device for device in _riding(prepared.session, name) if device in there)
        peers.append(
            Peer(other, graph.nodes[other], link.ports, binds, address, buttons=(first, len(carried)), riding=riding)
        )
    period = prepared.session.period_of(name)
    every = _telemetry_ticks(period, _columns(prepared.session, graph, name, run.clock))
    return Common(
        session=prepared.session.name,
        name=name,
        role=graph.nodes.get(name, Role.OBSERVER),
        certificate=prepared.id,
        period=period,
        clock=run.clock,
        transport=run.reach.transport,
        public=run.reach.public(name),
        private=str(run.private.get(name, "")),
        directory="" if run.directory is None else str(run.directory),
        control=run.control,
        ports=ports,
        peers=tuple(peers),
        telemetry_ticks=every,
        telemetry_first=_telemetry_first(every, list(graph.nodes).index(name) if name in graph.nodes else 0, graph),
        rate=prepared.session.period / period,
        phase=_phase(prepared.session, name) if run.clock == REALTIME else 0.0,
        turning=tuple(port for port in ports if port in prepared.session.turning),
        buttons=own,
        riding=_riding(prepared.session, name),
    )


def _phase(session: Session, node: str) -> float:
    """When the first tick of a node is, s: sites take turns, and then comes their world; all others begin at 0."""
    linked = list(session.wave_links)
    turn = session.period_of(node) / (len(linked) + 1)
    if node == ENVIRONMENT:
        return turn * len(linked) if len(linked) == len(session.couplings) else 0.0
    return turn * linked.index(session.sites[node]) if node in session.sites else 0.0


def _columns(session: Session, graph: Topology, name: str, clock: str) -> int:
    """The number of columns in all traces of a node; 0 for an observer."""
    if name not in graph.nodes:
        return 0
    ports, masses = graph.ports[name], session.environment.reported(session.ports)
    links = links_at(name, graph.nodes[name], graph.ports, session.wave_links)
    wall, torques = session.in_wall_time(name, clock), session.tells_work(name)
    oriented = session.environment.oriented
    hands = hands_at(name, graph.nodes[name], session.hands)
    sensed = session.sensed_hands
    topics = topics_of(
        graph.nodes[name], masses, wall, bool(links), torques, oriented=oriented, hands=hands, sensed=sensed
    )
    return sum(len(topic.columns_of(ports, masses, links, oriented, hands)) for topic in topics)


def _telemetry_ticks(period: float, columns: int) -> int:
    """Ticks between two telemetry messages: the channel table's rate, or fewer if a message would be too large."""
    columns = max(1, columns)
    room = min(MOST_TRACE_VALUES // columns, max(FEWEST_TICKS, USUAL_TRACE_VALUES // columns))
    return max(1, min(MAX_TELEMETRY_TICKS, room, round(TELEMETRY_PERIOD / period)))


def _telemetry_first(every: int, number: int, graph: Topology) -> int:
    """Ticks until a node's first telemetry: nodes send in different ticks where possible, which spreads the cost."""
    return 1 + (every - 1 - every * number // len(graph.nodes)) % every


def _source(session: Session, name: str) -> Source:
    """What moves a device: a driver's factory, its recorded motion, or its mechanism and hand, their masses added."""
    device = session.devices[name]
    if device.factory is not None:
        driver = session.foreign_code[f"devices.{name}.driver"]
        axis_map, scale = device.axis_map or (), device.scale or 1.0
        return PluginDevice(driver, device.dof, axis_map, scale, device.timing, device.step)
    if device.trace is not None:
        return RecordedMotion(session.osp_level(name), device.trace.times, device.trace.values)
    hand, mass, damping = device.hand, device.mass, device.damping
    if hand is None or mass is None or damping is None:
        raise AssertionError("every device that no trace moves has a mass, a damping and a hand")
    physics = SimulatedHand(
        mass=tuple(float(a + b) for a, b in zip(mass, hand.mass, strict=True)),
        damping=damping,
        operator=hand.rational.realisation(),
        hand_damping=hand.damping,
        hand_stiffness=hand.stiffness,
        force=tuple(plain_intent(intent) for intent in hand.force),
        motion=tuple(plain_intent(intent) for intent in hand.motion),
        linkage=_simulated_linkage(device),
        friction=None if device.kinematics is not None or device.friction is None else device.friction.simulated,
    )
    return PersonHand(physics, device.rate) if device.driver in PERSONS else physics


def _simulated_linkage(device: Device) -> dict[str, Any] | None:
    """What a simulated device has of its linkage: kinematics, and the friction of its joints where it is stated."""
    kinematics, friction = device.kinematics, device.joint_friction
    return kinematics if kinematics is None or friction is None else {**kinematics, "friction": list(friction)}


def require_member(session: Session, name: str) -> None:
    """Require a node or an observer of this name.

    Raises:
        ReachError: the session has none.
    """
    valid = (*session.roles, *session.observers)
    if name not in valid:
        raise ReachError(f"{session.name}: found no node or observer {name!r:.100}; expected {one_of(valid, name)}")


def invite(prepared: Prepared, name: str, keys: Keys | None, clock: str, path: Path) -> Bundle:
    """Make the bundle of one node or observer and write it to a file of mode 0600; returns the bundle.

    Args:
        prepared: the session, under the certificate with which it will be launched.
        name: the node or observer.
        keys: the session's keys; None for a session without encryption.
        clock: "realtime" or "simulated"; the launch must use the same.
        path: the file of the bundle; an existing file is replaced.

    Raises:
        ReachError: the session has no such node or observer.
        KeyFileError: its key, or that of one of its peers, is missing.
        TargetError, OSError: the file cannot be written.
    """
    require_member(prepared.session, name)
    require_target(path)
    ways = reach(prepared, "tcp", insecure=keys is None, keys=keys, listen=Listen(), remote=frozenset())
    # the remote machine fills in what only it knows when the node joins
    bundle = bundle_of(prepared, RunPlan(clock, None, "", reach=ways), name)
    with replacing(path, mode=0o600) as file:
        file.write(bundle_files.encoded(bundle_files.elsewhere(bundle)))
    return bundle
