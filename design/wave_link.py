"""A wave link in figures: what it is felt as, the names of contracts, and the environments beyond a contract.

A wave link of impedance b (m x m, N*s/m) and round trip R (s) is felt as the mass b R/2 while the tool moves freely.
While the tool is held, it is felt as the spring 2 b/R in series with the coupling. No linear passive link can be
lighter for its stiffness: M >= K R^2/4 (docs/remote/proof.md).

Certificates compose by contracts (docs/decisions/0034-sites-and-worlds.md). A contract says what the world and one
other party owe each other at the ports where they meet. Its name is the SHA-256 of its terms, and both certificates
state it.

- The **wave link** of a coupling: session, coupling, ports, b and E_0. The site's certificate proves the loop against
  every world that the wave link's face lets through.
- The **users in the tick**: session, period, ports and the level that they assume of the world. The certificate of the
  world proves that level.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.axis import Units
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix, matrix, symmetric_part

FELT_STIFFNESS: Final = "felt stiffness"
"""The margin of a site: the least stiffness that the hand feels while the tool is held, N/m."""


def wave_link_id(session: str, coupling: str, ports: Sequence[str], b: Matrix, tank: float) -> str:
    """The name of a wave link: SHA-256 (hex) of its terms.

    Args:
        session: name of the session.
        coupling: name of the coupling.
        ports: of the coupling, in the order of b.
        b: wave impedance, m x m, N*s/m.
        tank: E_0, J.
    """
    terms = {"session": session, "coupling": coupling, "ports": list(ports), "b": b.tolist(), "tank": tank}
    return _name({"contract": "wave-link", **terms})


def in_tick_id(session: str, period: float, ports: Sequence[str], level: Matrix) -> str:
    """The name of the contract between the world and the users in the tick: SHA-256 (hex) of its terms.

    Args:
        session: name of the session.
        period: T, s, common to both.
        ports: of these users, in the order of the level.
        level: Phi, m x m, N*s/m: at these ports the world's E_hat is (-Phi)-ISP.
    """
    terms = {"session": session, "period": period, "ports": list(ports), "level": level.tolist()}
    return _name({"contract": "in-tick", **terms})


def _name(terms: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(terms, separators=(",", ":"), allow_nan=False).encode()).hexdigest()


def felt_mass(b: Matrix, round_trip: float) -> Matrix:
    """M = b R/2, m x m, kg: the mass of a wave link whose tool moves freely."""
    return round_trip / 2.0 * b


def felt_stiffness(compliance: Matrix, b: Matrix, round_trip: float) -> Matrix:
    """(V(1) + (R/2) b^-1)^-1, m x m, N/m: the coupling and the wave link in series, the tool held.

    Args:
        compliance: V(1), m x m symmetric positive definite, m/N.
        b: wave impedance, N*s/m.
        round_trip: R, s.
    """
    return symmetric_part(np.linalg.inv(compliance + round_trip / 2.0 * np.linalg.inv(b)))


@dataclass(frozen=True, eq=False)
class WaveLinkFace(DeclaredEnvironment):
    """The environment of a site: the user's face of a wave link, with every world behind it.

    The face is (-theta)-ISP, up to the energy that the wave link holds, by the rules of its tank: Phi_E = theta.

    Attributes:
        id: the name of the wave link, :func:`wave_link_id`.
        b: wave impedance, m x m symmetric positive definite, N*s/m.
        tank: E_0, J.
        harvest: theta, diagonal, one number >= 0 for each port, N*s/m: the tank is refilled by T w^T theta w a tick.
        round_trip: R that the link is designed for, s; None if it is not known.
        mass: the felt mass allowed, m x m, kg; None if b was given.
    """

    level: Matrix = field(init=False)
    enforced: bool = field(init=False, default=True)
    id: str = ""
    b: Matrix = field(default_factory=lambda: np.zeros((0, 0)))
    tank: float = 0.0
    harvest: tuple[float, ...] = ()
    round_trip: float | None = None
    mass: Matrix | None = None

    controlled = False  # the tank keeps the level
    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        if len(self.harvest) != m:
            raise ValueError(f"environment.harvest: found {len(self.harvest)} numbers; expected {m}")
        object.__setattr__(self, "level", np.diag(self.harvest))
        object.__setattr__(self, "b", matrix(self.b, m, m))
        if self.mass is not None:
            object.__setattr__(self, "mass", matrix(self.mass, m, m))
        if np.any(self.b != self.b.T) or np.linalg.eigvalsh(self.b)[0] <= 0.0:
            raise ValueError("environment.b: expected a symmetric positive definite wave impedance")
        super().__post_init__()

    def terms(self) -> dict[str, Any]:
        """The face as JSON values, by the keys of a certificate's ``environment``."""
        return {
            "type": "wave-link",
            "id": self.id,
            "b": self.b.tolist(),
            "tank": self.tank,
            "harvest": list(self.harvest),
            "round_trip": self.round_trip,
            "mass": None if self.mass is None else self.mass.tolist(),
        }

    def margins(self, compliance: Callable[[], Matrix]) -> dict[str, float]:
        """The least stiffness that is felt, N/m, where the round trip is known."""
        if self.round_trip is None:
            return {}
        felt = felt_stiffness(compliance(), self.b, self.round_trip)
        return {FELT_STIFFNESS: float(np.linalg.eigvalsh(felt)[0])}

    def rows(self, margins: Mapping[str, float], units: Units) -> dict[str, str | Matrix]:
        """The wave link, and what it is felt as."""
        harvest = ", ".join(f"{theta:g}" for theta in dict.fromkeys(self.harvest))
        tank = f"{self.tank:g} J; harvest {harvest} {units('N·s/m')}"
        rows: dict[str, str | Matrix] = {"wave link": self.id, f"b [{units('N·s/m')}]": self.b, "E₀": tank}
        if self.round_trip is None:
            return rows
        mass = float(np.linalg.eigvalsh(felt_mass(self.b, self.round_trip))[-1])
        over = f"over a round trip of {1e3 * self.round_trip:.4g} ms"
        felt = f"at least {margins[FELT_STIFFNESS]:.1f} {units('N/m')} and at most {1e3 * mass:.4g} {units('g')} {over}"
        return {**rows, "felt": felt}

    def verdict(self, block: str) -> str:
        """Proved, for a site by the name of its coupling."""
        return f"{block}: proved, whatever is behind its wave link"


@dataclass(frozen=True, eq=False)
class WorldPromise(DeclaredEnvironment):
    """The environment of the users in the tick: a level that the certificate of the world proves.

    Attributes:
        id: the name of the contract, :func:`in_tick_id`.
    """

    enforced: bool = field(init=False, default=True)
    id: str = ""

    controlled = False  # the certificate of the world proves the level
    kept = "a level that the certificate of the world proves, and that is assumed here"
    __repr__ = brief_repr

    def terms(self) -> dict[str, Any]:
        """The promise as JSON values, by the keys of a certificate's ``environment``."""
        return {"type": "world", "id": self.id, "level": self.level.tolist()}

    def verdict(self, block: str) -> str:
        """Proved, under what the world promises."""
        return "users in the tick: proved, where the certificate of the world proves the level assumed of it"


def face_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> WaveLinkFace:
    """The face that :meth:`WaveLinkFace.terms` wrote (:func:`.environment_of`)."""
    m = len(ports)
    return WaveLinkFace(
        ports,
        id=str(data["id"]),
        b=matrix(data["b"], m, m),
        tank=float(data["tank"]),
        harvest=tuple(float(theta) for theta in data["harvest"]),
        round_trip=None if data["round_trip"] is None else float(data["round_trip"]),
        mass=None if data["mass"] is None else matrix(data["mass"], m, m),
    )


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
    level = environment.promised()
    if level is None:
        return np.zeros((len(own), len(own)))
    others = sorted(set(range(partition.size)) - set(own))
    if np.any(level[np.ix_(own, others)]):
        raise Infeasible(
            "the environment's declared level joins ports of wave links with ports of users in the tick; expected a "
            "level without entries between them"
        )
    return level[np.ix_(own, own)]
