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
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from manyhands.design.certificate import (
    describe_level,
    describe_storage,
    describe_structure,
    identity,
    level_of,
    pretty,
    storage_of,
)
from manyhands.design.files import replacing
from manyhands.design.levels.contract import Storage
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix
from manyhands.design.wave_link import in_tick_id, promised_level, wave_link_id

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

    __repr__ = brief_repr


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

    __repr__ = brief_repr


@dataclass(frozen=True, eq=False)
class WorldTerms:
    """What is asked of a world, by a session or in a certificate.

    Attributes:
        session: its name.
        period: T, s.
        partition: the ports of every coupling.
        environment: E, or its declared level.
        wave_links: by coupling, the terms of its wave link.
        in_tick: the terms with all other couplings; None if there are none.
    """

    session: str
    period: float
    partition: Partition
    environment: Environment
    wave_links: Mapping[str, FaceTerms]
    in_tick: InTickTerms | None

    __repr__ = brief_repr

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

    def kept(
        self,
        Phi_E: Matrix,
        P_E: Storage,
        margins: Mapping[str, float],
        method: Mapping[str, str | int],
    ) -> World:
        """The claim that a world with this level keeps these terms, under its id."""
        terms = {field.name: getattr(self, field.name) for field in fields(WorldTerms)}
        claim = World(**terms, Phi_E=Phi_E, P_E=P_E, margins=margins, method=method)
        return replace(claim, id=identity(world_content(claim)))


@dataclass(frozen=True, eq=False)
class World(WorldTerms):
    """The claim that a world keeps its contracts, with its proof.

    Attributes:
        Phi_E: m x m, N*s/m: E_hat is (-Phi_E)-ISP.
        P_E: its storage matrix; or "energy"; or "enforced", where nothing is proved.
        margins: "(A)", the least eigenvalue of (A), N*s/m. If it is 0, (A) holds and is not strict.
        method: how the level was found.
        id: SHA-256 (hex) over the content.
    """

    Phi_E: Matrix
    P_E: Storage
    margins: Mapping[str, float]
    method: Mapping[str, str | int]
    id: str = ""

    __repr__ = brief_repr


def world_terms(
    session: str,
    period: float,
    environment: Environment,
    partition: Partition,
    links: Mapping[str, tuple[Matrix, float]],
) -> WorldTerms:
    """What a session asks of its world.

    Args:
        session: its name.
        period: T, s.
        environment: with the ports of all couplings.
        partition: the couplings' ports.
        links: b (N*s/m) and E_0 (J) of each coupling with a wave link.

    Raises:
        Infeasible: a declared level joins a port of a wave link with a different coupling.
    """
    ports = environment.ports
    level = promised_level(environment, partition, frozenset(links))
    faces = {}
    others = set(ports)
    for name, block in zip(partition.names, partition.blocks, strict=True):
        if name in links:
            b, tank = links[name]
            own = [ports[p] for p in block]
            others.difference_update(own)
            faces[name] = FaceTerms(wave_link_id(session, name, own, b, tank), b, tank)
    in_tick = tuple(port for port in ports if port in others)
    owed = InTickTerms(in_tick_id(session, period, in_tick, level), in_tick, level) if in_tick else None
    return WorldTerms(session, period, partition, environment, faces, owed)


def world_from_content(data: Mapping[str, Any], terms: WorldTerms) -> World:
    """The world that :func:`world_content` (with "id") describes, of a session that asks ``terms`` of it.

    The level and its proof are those of the file, whoever found them.

    Raises:
        KeyError, TypeError, AttributeError, OverflowError: a key is missing, or its value has the wrong type or size.
        ValueError: the same of a shape or a number; or a term differs; or the file is not written as
            :func:`world_json` writes it.
    """
    level = level_of(data["levels"]["Phi_E"], terms.partition)
    margins = {name: float(value) for name, value in data["margins"].items()}
    world = terms.kept(level, storage_of(data["storage"]["E_hat"], terms.environment), margins, dict(data["method"]))
    if world.id != data["id"]:
        raise ValueError(
            f"it was re-serialised, or has other terms: its content has the id {world.id[:16]}, the file says "
            f"{str(data['id'])[:16]}"
        )
    return world


def _terms_content(terms: WorldTerms) -> dict[str, Any]:
    ports, partition, owed = terms.ports, terms.partition, terms.in_tick
    return {
        "session": terms.session,
        "period": terms.period,
        "ports": list(ports),
        "structure": describe_structure(ports, partition),
        "environment": terms.environment.terms(),
        "wave_links": {
            name: {"id": link.id, "b": link.b.tolist(), "tank": link.tank} for name, link in terms.wave_links.items()
        },
        "in_tick": None if owed is None else {"id": owed.id, "ports": list(owed.ports), "level": owed.level.tolist()},
    }


def world_content(world: World) -> dict[str, Any]:
    """The whole content of a world as JSON values, without its id."""
    return {
        "format": FORMAT,
        "version": VERSION,
        **_terms_content(world),
        "levels": {"Phi_E": describe_level(world.Phi_E, world.partition)},
        "storage": {"E_hat": describe_storage(world.P_E)},
        "margins": dict(world.margins),
        "method": dict(world.method),
    }


def world_differences(data: Mapping[str, Any], terms: WorldTerms) -> list[str]:
    """A sentence for each difference between plain data of a world and what a session asks; empty if they fit.

    The level Phi_E and its proof are not compared: any that is proved serves.
    """
    return [
        f"the {key} differs from the session's"
        for key, asked in _terms_content(terms).items()
        if json.dumps(data.get(key)) != json.dumps(asked)  # the order of ports and couplings counts
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
