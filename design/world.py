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

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from manyhands.design.certificate import describe_environment, pretty
from manyhands.design.files import replacing
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import Environment
from manyhands.design.models.statespace import Matrix

FORMAT = "manyhands-world"
VERSION = 1
CONDITION_A = "(A)"


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
        file.write(world_json(world).encode())


def world_json(world: World) -> str:
    """The text of the file."""
    return pretty({"id": world.id, **world_content(world)}) + "\n"


def is_world(data: Mapping[str, Any]) -> bool:
    """Whether plain data say that they are of a world, and not a certificate."""
    return data.get("format") == FORMAT
