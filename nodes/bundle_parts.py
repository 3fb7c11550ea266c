"""What a node's bundle is made of: who it is, its peers, limits, and rungs of the ladder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from manyhands.design.statespace import Matrix, StateSpace
from manyhands.protocol.messages import Role

MOST_RUNGS = 8
"""Of a ladder, besides rung 0: as many as a session file may state."""


@dataclass(frozen=True)
class Peer:
    """A node at the other end of one of this node's links.

    Attributes:
        name: the peer's name.
        role: what it is.
        ports: the ports that the link carries, in order.
        binds: whether *this* node binds the link's endpoint.
        address: where it binds it (tcp), host:port; empty for any port of the loopback.
    """

    name: str
    role: Role
    ports: tuple[str, ...]
    binds: bool
    address: str = ""


@dataclass(frozen=True)
class Common:
    """What every node needs to find and recognise the others.

    Attributes:
        session: the session's name.
        name: the node's name.
        role: the node's role.
        certificate: id of the certificate (or of the uncertified session) that all nodes must share.
        period: T, s.
        tau: delay that the certificate assumes, s.
        clock: :data:`REALTIME` or :data:`SIMULATED`.
        transport: "ipc" or "tcp".
        public: the public keys of this node, its peers and the supervisor; empty for a session without keys.
        private: the file of this node's private key; empty for a session without keys, or where the user names it.
        directory: the session's directory, mode 0700; empty for a node on another machine.
        control: endpoint of the supervisor's hub.
        ports: the node's ports, in order.
        peers: its links.
        telemetry_ticks: ticks between two telemetry messages.
        telemetry_first: ticks to the first, at most as many: nodes do not all tell in the same tick.

    Raises:
        ValueError: the first telemetry has more ticks than the others, for which alone there is room.
    """

    session: str
    name: str
    role: Role
    certificate: str
    period: float
    tau: float
    clock: str
    transport: str
    public: Mapping[str, str]
    private: str
    directory: str
    control: str
    ports: tuple[str, ...]
    peers: tuple[Peer, ...]
    telemetry_ticks: int
    telemetry_first: int

    def __post_init__(self) -> None:
        if self.telemetry_first > self.telemetry_ticks:
            raise ValueError(
                f"found {self.telemetry_first} ticks to the first telemetry; expected at most {self.telemetry_ticks}, "
                "as to every other"
            )


@dataclass(frozen=True)
class Limits:
    """What the devices at a node's ports may exert and reach, either way; one entry for each port of the node.

    Attributes:
        force: N.
        displacement: m.
        speed: m/s.

    Raises:
        ValueError: a limit is not a finite number greater than 0.
    """

    force: tuple[float, ...]
    displacement: tuple[float, ...]
    speed: tuple[float, ...]

    def __post_init__(self) -> None:
        for limit in (*self.force, *self.displacement, *self.speed):
            if not 0.0 < limit < math.inf:
                raise ValueError(f"found the limit {limit}; expected a finite number greater than 0")


@dataclass(frozen=True, eq=False)
class DeviceRung:
    """What a device promises at one rung of the ladder.

    Attributes:
        tau: delay that the rung covers, s.
        level: of its G_hat, m_i x m_i, N*s/m.
        K: m_i x m_i, m/N.
    """

    tau: float
    level: Matrix
    K: Matrix


@dataclass(frozen=True, eq=False)
class CouplingRung:
    """One block of V at one rung of the ladder.

    Attributes:
        block: V_i.
        K: K_i, m_i x m_i, m/N.
        level: Delta_V,i, m_i x m_i, N*s/m; None where nothing is certified.
    """

    block: StateSpace
    K: Matrix
    level: Matrix | None


def require_rungs(rungs: Sequence[DeviceRung | CouplingRung]) -> None:
    """Check that the rungs of one node fit each other.

    Args:
        rungs: all of them, rung 0 first.

    Raises:
        ValueError: too many, a matrix of another shape than rung 0's, or a coupling's rung without a level.
    """
    if len(rungs) > 1 + MOST_RUNGS:
        raise ValueError(f"found {len(rungs)} rungs; expected at most {1 + MOST_RUNGS}")
    wanted = rungs[0].K.shape
    for number, rung in enumerate(rungs[1:], 1):
        if rung.level is None:
            raise ValueError(f"rung {number}: found no level; expected that of the block")
        shapes = [rung.K.shape, rung.level.shape]
        if isinstance(rung, CouplingRung):
            shapes.append(rung.block.D.shape)
        if wrong := [shape for shape in shapes if shape != wanted]:
            raise ValueError(f"rung {number}: found a matrix of shape {wrong[0]}; expected {wanted}, that of rung 0")
