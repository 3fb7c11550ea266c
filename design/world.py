"""The certificate of a world: one environment with its ports, and what it owes the parties that meet it there.

A session with wave links has several certificates (docs/decisions/0034-sites-and-worlds.md):

- of each **site**, a coupling with a wave link: an ordinary certificate, whose environment is the face of the wave link
  (:class:`manyhands.design.wave_link.WaveLinkFace`);
- of the **users in the tick** together: an ordinary certificate, whose environment is what the world promises them
  (:class:`manyhands.design.wave_link.WorldPromise`);
- of the **world**: this one. It holds the environment, its level Phi_E with what proves it, and the terms of each
  contract. It knows no device and no coupling's numbers.

With Phi the level promised to the users in the tick, the world keeps its contracts if

    blockdiag(Phi, 0 at wave links) - Phi_E >= 0.                                                                (A)

At the port of a wave link nobody pays for a lack of passivity, so that the environment has to be passive there. For a
passive environment Phi = 0 here: who joins later can then change nothing that has been promised.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manyhands.design.certificate import describe_environment, identity, pretty
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.files import replacing
from manyhands.design.levels.contract import ENERGY, ENFORCED
from manyhands.design.levels.environment import RESERVES, lack_of_passivity, storage
from manyhands.design.levels.network import diagonal_level
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import (
    DeclaredEnvironment,
    Environment,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.models.statespace import Matrix
from manyhands.design.proof import prove_world
from manyhands.design.statics import check_environment
from manyhands.design.wave_link import in_tick_id, wave_link_id

FORMAT = "manyhands-world"
VERSION = 1
CONDITION_A = "(A)"
_ROUNDING = 1e-12  # of the level: (A) need not be strict, and the proof decides it exactly

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class FaceTerms:
    """What a world states of the wave link of a coupling.

    Attributes:
        id: its name, :func:`manyhands.design.wave_link.wave_link_id`.
        b: wave impedance, m_i x m_i, N*s/m. The world's face has D_V = T b^-1.
        tank: E_0, J.
    """

    id: str
    b: Matrix
    tank: float


@dataclass(frozen=True, eq=False)
class InTickTerms:
    """What a world owes the users in the tick.

    Attributes:
        id: its name, :func:`manyhands.design.wave_link.in_tick_id`.
        ports: their ports, in their certificate's order.
        level: Phi, N*s/m, in that order.
    """

    id: str
    ports: tuple[str, ...]
    level: Matrix


@dataclass(frozen=True, eq=False)
class World:
    """The claim that a world keeps its contracts, with its proof.

    Attributes:
        session: its name.
        period: T, s.
        partition: the ports of every coupling.
        environment: E, or its declared level.
        wave_links: by coupling, the terms of its wave link.
        in_tick: the terms with all other couplings; None if there are none.
        Phi_E: m x m, N*s/m: E_hat is (-Phi_E)-ISP.
        P_E: its storage matrix; or "energy"; or "enforced", where nothing is proved.
        margins: "(A)", the least eigenvalue of (A), N*s/m. If it is 0, (A) holds and is not strict.
        method: how the level was found.
        id: SHA-256 (hex) over the content.
    """

    session: str
    period: float
    partition: Partition
    environment: Environment
    wave_links: Mapping[str, FaceTerms]
    in_tick: InTickTerms | None
    Phi_E: Matrix
    P_E: Matrix | Literal["energy", "enforced"]
    margins: Mapping[str, float]
    method: Mapping[str, str | int]
    id: str = ""

    @property
    def ports(self) -> tuple[str, ...]:
        """Names of the m ports, in order."""
        return self.environment.ports

    def promised(self) -> Matrix:
        """blockdiag(Phi, 0), m x m, N*s/m: the level that the world owes at each port."""
        out = np.zeros((len(self.ports), len(self.ports)))
        if self.in_tick is not None:
            at = [self.ports.index(port) for port in self.in_tick.ports]
            out[np.ix_(at, at)] = self.in_tick.level
        return out


def world_content(world: World) -> dict[str, Any]:
    """The whole content of a world as JSON values, without its id."""
    partition, ports = world.partition, world.ports
    Phi_E: Any = world.Phi_E.tolist()
    if partition.admits(world.Phi_E):
        parts = zip(partition.names, partition.restrict(world.Phi_E), strict=True)
        Phi_E = {name: part.tolist() for name, part in parts}
    terms = world.in_tick
    return {
        "format": FORMAT,
        "version": VERSION,
        "session": world.session,
        "period": world.period,
        "ports": list(ports),
        "structure": {
            name: [ports[p] for p in block] for name, block in zip(partition.names, partition.blocks, strict=True)
        },
        "environment": describe_environment(world.environment),
        "wave_links": {
            name: {"id": link.id, "b": link.b.tolist(), "tank": link.tank} for name, link in world.wave_links.items()
        },
        "in_tick": None
        if terms is None
        else {"id": terms.id, "ports": list(terms.ports), "level": terms.level.tolist()},
        "levels": {"Phi_E": Phi_E},
        "storage": {"E_hat": world.P_E if isinstance(world.P_E, str) else world.P_E.tolist()},
        "margins": dict(world.margins),
        "method": dict(world.method),
    }


_TERMS = ("session", "period", "ports", "structure", "environment", "wave_links", "in_tick")


def world_differences(data: Mapping[str, Any], world: World) -> list[str]:
    """A sentence for each difference between plain data of a world and a session's own world; empty if they fit.

    The level Phi_E and its proof are not compared: any that is proved serves.
    """
    own = world_content(world)
    return [
        f"the {key} differs from the session's"
        for key in _TERMS
        if json.dumps(data.get(key)) != json.dumps(own[key])  # the order of ports and couplings counts
    ]


def save_world(world: World, path: Path) -> None:
    """Write the file whole or not at all."""
    with replacing(path) as file:
        file.write((pretty({"id": world.id, **world_content(world)}) + "\n").encode())


def is_world(data: Mapping[str, Any]) -> bool:
    """Whether plain data say that they are of a world, and not a certificate."""
    return data.get("format") == FORMAT


def promised_level(environment: Environment, partition: Partition, linked: frozenset[str]) -> Matrix:
    """Phi, the level that the users in the tick may assume of a world, N*s/m, over their ports in the world's order.

    It is 0 for an environment that has to be passive. A declared environment promises its declared level.

    Args:
        environment: with all ports.
        partition: the couplings' ports.
        linked: names of the couplings with wave links.

    Raises:
        Infeasible: a declared level joins a port of a wave link with a different coupling, or is not enforced.
    """
    own = sorted(
        p for name, ports in zip(partition.names, partition.blocks, strict=True) if name not in linked for p in ports
    )
    if not isinstance(environment, DeclaredEnvironment):
        return np.zeros((len(own), len(own)))
    level = environment.promised()
    others = sorted(set(range(partition.size)) - set(own))
    if np.any(level[np.ix_(own, others)]):
        raise Infeasible(
            "the environment's declared level joins ports of wave links with ports of users in the tick",
            ("declare a level without entries between them",),
        )
    return level[np.ix_(own, own)]


def design_world(
    session: str,
    period: float,
    environment: Environment,
    partition: Partition,
    links: Mapping[str, tuple[Matrix, float]],
    progress: Progress | None = None,
) -> World:
    """Find a level with which the world keeps its contracts, and prove it.

    Args:
        session: its name.
        period: T, s.
        environment: with the ports of all couplings.
        partition: the couplings' ports.
        links: b (N*s/m) and E_0 (J) of each coupling with a wave link.
        progress: called with a line of text for each step.

    Raises:
        Infeasible: the environment lacks passivity where a wave link meets it.
        SolverFailure: the level does not survive the proof.
    """
    check_environment(environment)
    ports = environment.ports
    level = promised_level(environment, partition, frozenset(links))
    in_tick = tuple(
        ports[p]
        for p in range(partition.size)
        if not any(p in block for name, block in zip(partition.names, partition.blocks, strict=True) if name in links)
    )
    terms = {}
    for name, block in zip(partition.names, partition.blocks, strict=True):
        if name in links:
            b, tank = links[name]
            own = [ports[p] for p in block]
            terms[name] = FaceTerms(wave_link_id(session, name, own, b, tank), b, tank)
    Phi_E, P_E, method = _level(environment, period, progress)
    draft = World(
        session,
        period,
        partition,
        environment,
        terms,
        InTickTerms(in_tick_id(session, period, in_tick, level), in_tick, level) if in_tick else None,
        Phi_E,
        P_E,
        {},
        {"algorithm": method, "numpy": np.__version__},
    )
    margin = float(np.linalg.eigvalsh(draft.promised() - Phi_E)[0])
    if margin < -_ROUNDING * float(np.max(np.abs(Phi_E))):
        raise _lacking(-margin, "so its declared level says", "a declared level of 0 or less at every such port")
    draft = replace(draft, margins={CONDITION_A: max(margin, 0.0)})
    data = world_content(draft)
    data["id"] = identity(data)
    if progress is not None:
        progress("proving the world")
    failing = [finding for finding in prove_world(data) if not finding.holds]
    if failing:
        raise SolverFailure(
            f"the world's level does not survive the proof: {failing[0].condition} ({failing[0].argument})"
        )
    return replace(draft, id=data["id"])


def _level(
    environment: Environment, T: float, progress: Progress | None
) -> tuple[Matrix, Matrix | Literal["energy", "enforced"], str]:
    """Phi_E <= 0 with what proves it, and the method; or the declared level."""
    if isinstance(environment, DeclaredEnvironment):
        return environment.promised(), ENFORCED, "declared"
    if environment.passive_network is not None:
        return diagonal_level(environment.passive_network, T), ENERGY, "mechanical energy"
    split = environment.split(T)
    I = np.eye(split.rest.inputs)
    found = lack_of_passivity(split, T, I, progress)
    if found.multiple >= 0.0:
        late = not isinstance(environment, StateSpaceEnvironment | TransferEnvironment) or environment.delay > 0
        remedy = f"a damping of more than {found.multiple:.4g} N*s/m at each such port, by backward Euler"
        if late:
            remedy = "an environment without delay: a wave link carries delay in its place"
        raise _lacking(found.multiple, f"it lacks passivity at {found.frequency:.4g} rad/s", remedy)
    for reserve in RESERVES:
        Phi_E = (1.0 - reserve) * found.multiple * I
        with contextlib.suppress(SolverFailure):  # the next level leaves its storage function more room
            return Phi_E, storage(split, T, Phi_E, progress, found.frequency), "greatest multiple of the identity"
    raise SolverFailure("the environment is passive, but no storage function with room for a proof was found")


def _lacking(lack: float, where: str, remedy: str) -> Infeasible:
    return Infeasible(
        f"condition (A) fails: the environment needs {lack:.4g} N*s/m at the ports of wave links, where nobody pays "
        f"for it: {where}",
        (remedy, "couplings without wave links, whose devices pay for it"),
    )
