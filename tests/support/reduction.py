"""What is left of a certificate when coupling blocks are frozen, and when their ratios are anything between.

A frozen block's tools rest in the environment and no force goes to its users. For other users, the environment is
the compression of E_hat to their ports: a network with the frozen ports held to the ground, or matrices without
their rows and columns. Levels and storage are parts of those of the whole certificate:

- (10) becomes a principal submatrix, and Phi_E too;
- a storage of E_hat, restricted to what can be reached with w = 0 at the frozen ports and minimised over what their
  forces alone would show, satisfies the same inequality without their rows;
- blocks of V stay as they are. A device of which some ports are frozen keeps, at the others, the level that the
  certificate counts on there: it has V's structure, and below the device's level with no force at the frozen ports.

:func:`reduced` makes of them the certificate of a session of the remaining users, which is proved like any other.

**Any ratios.** With an ideal transformer of ratio s_i in [0, 1] between each block i and the environment,
S = diag(s_i I) commutes with Delta_G = share Delta_D and Delta_V, and what those behind it see of the environment is
(-S Phi_E S)-ISP. Then

    diag(Delta_G, Delta_V) - [I; I] S Phi_E S [I  I]
        = diag((I - S^2) Delta_G, (I - S^2) Delta_V) + diag(S, S) M diag(S, S),

with M the matrix of (10): no smaller than the least eigenvalue of M, Delta_G and Delta_V, since for every vector u
the two terms take |u|^2 - |S u|^2 and |S u|^2 of it. :func:`at_any_ratio` proves what this needs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from flint import fmpq

from manyhands.design.certificate import Certificate, seal
from manyhands.design.levels.contract import Levels, Storage, margin
from manyhands.design.models.coupling import Partition
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, Rational, StateSpace, matrix, symmetric_part
from manyhands.design.models.transfer import InDifferences
from manyhands.design.problem import DeviceLevel, HapticLoop
from manyhands.design.proof import contract, exact
from manyhands.design.proof.claim import Claim
from manyhands.design.proof.exact import Sparse
from manyhands.design.proof.finding import Finding


def reduced(certificate: Certificate, frozen: Collection[str]) -> Certificate:
    """The certificate of the remaining users, sealed; it is a claim, not yet a proof.

    Of transparency it claims nothing: that storage is in another realisation. What was asked stays what was asked of
    the whole loop.

    Args:
        certificate: of the whole loop.
        frozen: names of the frozen blocks.

    Raises:
        ValueError: a name is no block's, or no block remains.
    """
    loop, levels = certificate.loop.cut, certificate.levels
    partition = loop.partition
    unknown = sorted(set(frozen) - set(partition.names))
    if unknown:
        raise ValueError(f"found the frozen blocks {unknown}; expected some of {list(partition.names)}")
    kept = [i for i, name in enumerate(partition.names) if name not in frozen]
    if not kept:
        raise ValueError("found every block frozen; expected one at least to remain")
    ports = sorted(port for i in kept for port in partition.blocks[i])
    place = {port: new for new, port in enumerate(ports)}
    remaining = Partition(
        tuple(partition.names[i] for i in kept),
        tuple(tuple(place[port] for port in partition.blocks[i]) for i in kept),
    )
    environment, P_E = _held(loop.environment, levels.P_E, ports)
    parts = Levels(
        device=levels.device,
        Delta_D=tuple(levels.Delta_D[i] for i in kept),
        Delta_V=tuple(levels.Delta_V[i] for i in kept),
        Phi_E=matrix(levels.Phi_E[np.ix_(ports, ports)]),
        P_E=P_E,
        P_V=tuple(levels.P_V[i] for i in kept),
    )
    names = ", ".join(sorted(frozen)) or "nobody"
    return seal(
        Certificate(
            loop=HapticLoop(
                session=loop.session,
                period=loop.period,
                ports=tuple(loop.ports[port] for port in ports),
                devices=_devices(loop, partition.embed(levels.Delta_D), place),
                partition=remaining,
                environment=environment,
                tau=loop.tau,
                period_tolerance=loop.period_tolerance,
            ),
            coupling=tuple(certificate.coupling[i] for i in kept),
            levels=parts,
            transparency=None,
            margins={"(10)": margin(remaining, parts)},
            method={"algorithm": "reduction", "of": certificate.id, "frozen": names},
            asked=certificate.asked,
        )
    )


def _devices(loop: HapticLoop, Delta_D: Matrix, place: Mapping[int, int]) -> tuple[DeviceLevel, ...]:
    """The devices with a port that remains."""
    out = []
    for device in loop.devices:
        left = [port for port in device.ports if port in place]
        if left:
            whole = len(left) == len(device.ports)
            level = device.level if whole else matrix(Delta_D[np.ix_(left, left)])
            out.append(DeviceLevel(device.name, tuple(place[port] for port in left), level))
    return tuple(out)


def _held(environment: Environment, P: Storage, ports: Sequence[int]) -> tuple[Environment, Storage]:
    """The environment with all but ``ports`` held at rest, and its storage."""
    names = tuple(environment.ports[port] for port in ports)
    match environment:
        case Network():
            return _grounded(environment, names), P
        case NetworkBox(low, high):
            return NetworkBox(_grounded(low, names), _grounded(high, names)), P
        case DelayedNetwork(network, delay):
            late = _without_late(P, len(environment.ports), ports, delay)
            return DelayedNetwork(_grounded(network, names), delay), late
        case StateSpaceEnvironment(_, E, method, delay):
            gain = None if E.static_gain is None else E.static_gain[np.ix_(ports, ports)]
            system = StateSpace(E.A, E.B[:, ports], E.C[ports], E.D[np.ix_(ports, ports)], gain)
            late = _without_late(P, len(environment.ports), ports, delay)
            return StateSpaceEnvironment(names, system, method, delay), late
        case TransferEnvironment(_, entries, method, delay):
            rows = tuple(tuple(entries[i][j] for j in ports) for i in ports)
            late = _without_late(P.P if isinstance(P, InDifferences) else P, len(environment.ports), ports, delay)
            kept = _of_entries(late, environment, ports)
            if isinstance(P, InDifferences) and not isinstance(kept, str | InDifferences):
                kept = InDifferences(kept)
            return TransferEnvironment(names, rows, method, delay), kept
        case DeclaredEnvironment():
            return replace(environment, ports=names, level=environment.level[np.ix_(ports, ports)]), P
    raise TypeError(f"expected an environment of a known kind, found {type(environment).__name__}")


def _grounded(network: Network, ports: tuple[str, ...]) -> Network:
    """The network with the ports that are not among ``ports`` held to the ground; its masses all stay."""
    gone = {*network.ports} - {*ports} | {GROUND}
    links = []
    for link in network.links:
        a, b = (GROUND if end in gone else end for end in link.ends)
        if a != b:
            links.append(NetworkLink((a, b), link.stiffness, link.damping))
    return Network(ports, network.masses, tuple(links))


def _without_late(P: Storage, m: int, ports: Sequence[int], delay: int) -> Storage:
    """P without the delayed velocities of held ports, which are zero: the last m ``delay`` states, the latest first."""
    if isinstance(P, str) or delay == 0:
        return P
    n = P.shape[0] - m * delay
    left = [*range(n), *(n + m * tick + port for tick in range(delay) for port in ports)]
    return matrix(P[np.ix_(left, left)])


def _of_entries(P: Storage, environment: TransferEnvironment, ports: Sequence[int]) -> Storage:
    """P in the states of the entries that remain, row by row, then those of a delay.

    Those of an entry from a held port are zero; those of an entry to a held port from one that remains move, and
    only its force shows them: the storage is minimised over them, a Schur complement.
    """
    if isinstance(P, str):
        return P
    kept: list[int] = []
    hidden: list[int] = []
    at = 0
    for i, row in enumerate(environment.entries):
        for j, entry in enumerate(row):
            states = range(at, at + _degree(entry))
            at += len(states)
            if j in ports:
                (kept if i in ports else hidden).extend(states)
    kept += range(at, P.shape[0])
    if not hidden:
        return matrix(P[np.ix_(kept, kept)])
    across = P[np.ix_(hidden, kept)]
    return matrix(symmetric_part(P[np.ix_(kept, kept)] - across.T @ np.linalg.solve(P[np.ix_(hidden, hidden)], across)))


def _degree(entry: Rational) -> int:
    """States of an entry's companion form: the larger degree of numerator and denominator, leading zeros apart."""
    return max(1, *(len(np.trim_zeros(part, "f")) for part in entry)) - 1


def condition_at(claim: Claim, ratios: Mapping[str, fmpq]) -> Sparse:
    """diag(Delta_G, Delta_V) - [I; I] S Phi_E S [I  I], exactly, 2m x 2m, N*s/m.

    Args:
        claim: the certificate as :func:`manyhands.design.proof.claim.read` reads it.
        ratios: s of each block by its name; 1 where it is absent.
    """
    s = {port: ratios.get(block.name, fmpq(1)) for block in claim.blocks for port in block.ports}
    m = len(claim.ports)
    out: Sparse = {(i, j): claim.share * value for (i, j), value in contract.Delta_D(claim).items() if claim.share != 0}
    for (i, j), value in contract.Delta_V(claim).items():
        exact.add_entry(out, m + i, m + j, value)
    for (i, j), value in claim.Phi_E.items():
        for row in (i, m + i):
            for column in (j, m + j):
                exact.add_entry(out, row, column, -value * s[i] * s[j])
    return out


def at_any_ratio(claim: Claim) -> Finding:
    """Whether (10) is proved for every S with one ratio from 0 to 1 a block, and so for every sequence of them.

    It is when (10), share Delta_D and Delta_V are proved positive, by the identity above; Delta_D and Delta_V are
    read by block, so that S commutes with them. The value is the least of the three least eigenvalues, N*s/m.
    """
    m = len(claim.ports)
    Delta_G = {place: claim.share * value for place, value in contract.Delta_D(claim).items()}
    parts = {"(10)": (contract.condition_10(claim), 2 * m), "share Delta_D": (Delta_G, m)}
    parts["Delta_V"] = (contract.Delta_V(claim), m)
    one_each = contract.one_party_each(claim)
    verdicts = {name: exact.definite_by_groups(M, size, name="rows") for name, (M, size) in parts.items()}
    failing = [name for name, verdict in verdicts.items() if not verdict.holds]
    failing += [] if one_each.holds else [one_each.condition]
    return Finding(
        "condition (10) for any ratios of the blocks",
        not failing,
        min(exact.least_eigenvalue(M, size) for M, size in parts.values()),
        0.0,
        argument=f"not proved: {', '.join(failing)}" if failing else "exactly, from (10), Delta_D > 0 and Delta_V > 0",
    )
