"""How much a proof may cost, from the sizes and the numbers of a file alone, before the proof begins.

A certificate may come from a stranger. Its reader has to know how long the proof can take, whatever the numbers are: a
few states with numbers of a thousand digits cost more than a hundred with seventeen. The bound is a sum over the parts
of the proof, each by the worst path that it may take (:mod:`manyhands.design.proof.cost`). It is no time: the same file
has the same bound on every machine.

A file of up to 1 MB may cost :data:`MOST` operations, which a slow core does within ten seconds, and a longer one in
proportion.
An honest large loop has a storage matrix of seventeen digits an entry, so that its file grows with its proof. Texts
that nothing is proved of, and what was asked for, do not count. Kinematics have a bound of their own beside this one
(:data:`manyhands.design.proof.linkage.MOST_PARTS`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from flint import fmpq

from manyhands.design.proof import contract, cost, environment, exact, quantisation
from manyhands.design.proof.claim import (
    Claim,
    DeclaredData,
    DynamicsData,
    EnvironmentData,
    NetworkData,
    ProxyData,
    Realisation,
    StatedSpringDamper,
    StiffenedData,
    SystemData,
    TransferData,
    WaveLinkData,
)
from manyhands.design.proof.exact import MAX_DENSE, MAX_STATIC, Number, Sparse, StatedMatrix
from manyhands.design.proof.finding import ProofInputError

if TYPE_CHECKING:
    from manyhands.design.proof.world import WorldClaim

MOST: Final = 20e9
"""Operations that the proof of a file of up to :data:`FREE` bytes may take: at most ten seconds of a slow core.

The sum of worst paths is never reached: in searches for the slowest file, a second stood for at least 2e9 of them."""

FREE: Final = 1_000_000
"""Bytes of content up to which a file may cost :data:`MOST`; a longer one in proportion."""

_UNPROVED = ("id", "asked", "method", "session")


class Expense(NamedTuple):
    """What a part of a proof may cost.

    Attributes:
        place: the key of the file, with what is found there.
        operations: at most, on words.
    """

    place: str
    operations: float


def require_bounded(data: Mapping[str, Any], parts: Callable[[], Iterable[Expense]]) -> None:
    """Refuse a proof that may cost more than a file of this size may.

    Args:
        data: the plain data of the file.
        parts: gives what the parts of its proof may cost; called after the size of the file is known.

    Raises:
        ProofInputError: the sum is too great; the message names the costliest part.
    """
    content = {key: value for key, value in data.items() if key not in _UNPROVED}
    try:
        text = json.dumps(content, separators=(",", ":"))
    except RecursionError:
        raise ProofInputError(
            "certificate: found lists or objects that are nested too deep to be written again"
        ) from None
    most = MOST * max(1.0, len(text) / FREE)
    total, largest = 0.0, Expense("its numbers", cost.numbers(text.count(",") + text.count(":")))
    for part in chain((largest,), parts()):
        total += part.operations
        largest = max(largest, part, key=lambda one: one.operations)
        if total > most:
            raise ProofInputError(
                f"{largest.place}: the proof may take more than {total:.3g} operations; expected at most {most:.3g} "
                f"for a file of {len(text) / 1e6:.2g} MB, which ends within {10.0 * most / MOST:.0f} s"
            )


def parts_of(claim: Claim) -> Iterator[Expense]:
    """What the parts of the proof of a certificate may cost (:func:`manyhands.design.proof.prove`).

    What is quickly computed comes first.
    """
    m = len(claim.ports)
    scalars = (claim.period, claim.tau, claim.period_tolerance, claim.kappa, claim.share, claim.c)
    long = sum(height(x) for x in scalars)
    yield Expense("levels.kappa, share and c", 0.1e9 * (1.0 + long / 600.0))
    bits = _bits([*claim.osp, *claim.Delta_D, *claim.Delta_V]) + _sparse_bits(claim.Phi_E) + long
    bits += max((height(x) for x in claim.margins.values()), default=0)
    for block, V in zip(claim.blocks, claim.coupling, strict=True):
        yield _block(f"coupling.blocks.{block.name[:60]}", V, len(block.ports), bits)
    if isinstance(claim.environment, WaveLinkData):
        yield _wave_link(claim.environment, claim.coupling, m)
    if claim.transparency is not None:
        yield from _transparency(claim, claim.transparency.P.rows)
    if claim.encoder is not None:
        yield Expense("encoder", quantisation.expense(claim))
    yield from of_environment(environment_of(claim), claim.P_E, claim.Phi_E, m, claim.period)
    yield from _groups("levels", [contract.condition_10(claim)], 2 * m, bits, 1 + len(claim.margins))
    yield from _groups("levels", [contract.Delta_V(claim)], m, bits, 1)
    yield from _groups("devices", [contract.Delta_D(claim), contract.device_levels(claim)], m, bits, 2)


def _transparency(claim: Claim, n: int) -> Iterator[Expense]:
    """The proof of a level of transparency, with a storage matrix of n rows."""
    m, place = len(claim.ports), f"transparency.P: found {n} rows"
    built = 12.0 * sum(cost.product(n + m, p) for p in cost.precisions(n + m))
    yield Expense(place, cost.in_balls(n) + cost.in_balls(n + m, 2) + built)
    if isinstance(claim.environment, NetworkData | SystemData | TransferData):
        yield Expense(place, _split(claim.environment, m, claim.period))


def parts_of_world(claim: WorldClaim, condition: Sparse) -> list[Expense]:
    """What the parts of the proof of a world may cost, with the left-hand side of its condition (A)."""
    m, T = len(claim.ports), exact.exact_decimal(claim.period)
    bits = _sparse_bits(condition) + max((height(x) for x in claim.margins.values()), default=0)
    out = _groups("levels", [condition], m, bits, 1 + len(claim.margins))
    for name, link in claim.wave_links.items():
        out.append(Expense(f"wave_links.{name[:60]}", cost.definiteness(link.b.rows, 2.0 * _bits([link.b]))))
    return out + of_environment(claim.environment, claim.P_E, claim.Phi_E, m, T)


def environment_of(claim: Claim) -> EnvironmentData:
    """The environment without what is counted in series, as far as its cost is concerned."""
    world = claim.environment
    if claim.series and isinstance(world, SystemData | TransferData):
        m = len(claim.ports)
        return StiffenedData(world, exact.dense({(port, port): c for port, c in claim.series.items()}, range(m)))
    return world


def of_environment(data: EnvironmentData, P: StatedMatrix | None, Phi_E: Sparse, m: int, T: fmpq) -> list[Expense]:
    """What the proof of the environment's level may cost."""
    bits = _sparse_bits(Phi_E)
    if isinstance(data, DeclaredData):
        tables = [data.level, data.stiffness] if isinstance(data, ProxyData) else [data.level]
        bits += _bits(tables)
        found: list[Sparse] = [dict(Phi_E), {}]
        exact.add(found[0], range(m), tables[0])
        exact.add(found[1], range(m), tables[-1])
        return _groups("environment", found, m, bits, 2)
    if isinstance(data, NetworkData) and P is None:
        return _energy(data, Phi_E, m, bits, T)
    if P is None or P.rows != environment.order(data, m) or P.rows + m > MAX_DENSE:
        return []  # refused before anything is computed
    n = P.rows
    out = [Expense(f"storage.E_hat: found {n} rows", cost.in_balls(n) + cost.in_balls(n + m, 2))]
    if not isinstance(data, NetworkData):
        out.append(_statics(data, m))
    return [*out, Expense(f"environment: found {n} states with those of its delay", _split(data, m, T))]


def height(x: fmpq) -> int:
    """Bits of the longer one of numerator and denominator."""
    return int(x.height_bits())


def _groups(place: str, matrices: Sequence[Sparse], size: int, bits: float, times: float) -> list[Expense]:
    """So many proofs that matrices like these, and their sums, are definite: group by group."""
    out = []
    for group in exact.groups(size, matrices):
        n = len(group)
        if n <= MAX_DENSE:
            dense = cost.definiteness(n, 2.0 * bits) if n <= exact.MOST_EXACT else cost.in_balls(n)
            figures = f"{place}: found {n} joined ports with numbers of up to {bits:.0f} bits"
            out.append(Expense(figures, times * (dense + (15.0 * n + 600.0) * n * n)))
    return out


def _block(place: str, V: StatedSpringDamper | Realisation, m: int, levels: float) -> Expense:
    """The proof of one block of the coupling; ``levels`` are the bits of its levels and of all scalars."""
    if isinstance(V, StatedSpringDamper):
        b = _bits([V.stiffness, V.damping]) + levels
        operations = 4.0 * cost.in_balls(m, 3) if m > 4 or b > 300 else 0.0
        if m <= 32:
            exactly = cost.solution(m, m, min(b, 1_500.0)) + 3.0 * cost.definiteness(m, b)
            operations += exactly + cost.definiteness(m, 2.0 * m * min(b, 1_500.0))
        return Expense(f"{place}: found {m} ports with numbers of up to {b:.0f} bits", operations)
    n, b = V.A.rows, _bits([V.A, V.B, V.C])
    place = f"{place}: found {n} states and {m} ports with numbers of up to {b:.0f} bits"
    operations = cost.solution(n, m, b) + _reduction(n, m, b) if n <= MAX_STATIC else 0.0
    if n + m > MAX_DENSE:
        return Expense(place, operations)
    operations += 2.0 * cost.in_balls(n + m, 5)
    if n + m <= 12:
        long = min(b + levels, 1_500.0)
        operations += cost.solution(n + m, n + m, long) + 2.0 * cost.definiteness(n + m, 2.0 * (n + m) * long)
    return Expense(place, operations)


def _statics(data: SystemData | TransferData | StiffenedData, m: int) -> Expense:
    """The static gain of an environment, and that it is symmetric and >= 0: exactly."""
    world = data.world if isinstance(data, StiffenedData) else data
    if isinstance(world, SystemData):
        n, b = world.A.rows, _bits([world.A, world.B, world.C])
        place = f"environment.A: found {n} states with numbers of up to {b:.0f} bits"
        operations = cost.solution(n, m, b) + _reduction(n, m, b) if n <= MAX_STATIC else 0.0
        long = n * b + b
    else:
        ends = [part[-1] for row in world.entries for entry in row for part in entry]
        long = 2.0 * _bits_of(ends)
        place = f"environment.entries: found {m} ports with numbers of up to {long / 2.0:.0f} bits"
        operations = m * m * 10_000.0
    if isinstance(data, StiffenedData):
        operations += cost.solution(m, m, 2.0 * long)
        long *= m
    distinct = m * m if isinstance(world, TransferData) else 1
    return Expense(place, operations + cost.definiteness(m, 2.0 * long * distinct))


def _reduction(n: int, m: int, bits: float) -> float:
    """C times a solution, and its sums: m x m numbers of n bits bits, brought to lowest terms."""
    return float(m * m * n * (1_000.0 + 2.0 * (n * bits / 64.0) ** 1.6))


def _split(data: DynamicsData, m: int, T: fmpq) -> float:
    """E_hat without its integrators, in balls, at every precision."""
    n = environment.order(data, m)
    world = data.world if isinstance(data, StiffenedData) else data
    products = 10.0
    if isinstance(world, SystemData) and world.method == "zoh":
        products += 70.0  # an exponential: squarings, and the terms of a series
    of_entries = 0.0
    if isinstance(world, TransferData):
        degrees = [max(len(num), len(den)) - 1 for row in world.entries for num, den in row]
        words = 1.0 + height(T) / 64.0
        of_entries = sum(20_000.0 + 60.0 * degree**3 * (1.0 + degree * words) for degree in degrees)
    used = cost.precisions(n + m)
    return sum(products * cost.product(n + m, p) for p in used) + len(used) * (of_entries + 5_000.0 * (n + m) ** 2)


def _energy(data: NetworkData, Phi_E: Sparse, m: int, bits: float, T: fmpq) -> list[Expense]:
    """The proof of a network's level by its energy."""
    size = m + len(data.masses)
    joined: Sparse = {}
    entries = [0] * size
    for link in data.links:
        ends = [end for end in link.ends if end is not None]
        for end in ends:
            entries[end] += len(ends)
        if len(ends) == 2:
            joined[ends[0], ends[1]] = fmpq(1)
    for i, _ in Phi_E:
        entries[i] += 1
    b = bits + height(T) + _bits_of([x for link in data.links for x in (*link.stiffness, *link.damping, *link.arms)])
    positive = any(i != j and value > 0 for (i, j), value in Phi_E.items())
    most = environment.MOST_DENSE if positive else environment.MOST_SEARCHED
    negative = {i for i, _ in Phi_E}
    out = _groups("levels.Phi_E", [Phi_E], m, bits, 1)
    for group in exact.groups(size, [joined, Phi_E]):
        n = len(group)
        if negative.isdisjoint(group):
            continue
        inside = sum(entries[i] for i in group)
        if n <= exact.MOST_EXACT:
            operations = cost.definiteness(n, 2.0 * b)
        else:
            operations = environment.STEPS * (60.0 * inside + 80_000.0) + 5_000.0 * inside
            operations += cost.in_balls(n) if n <= most else 0.0
        out.append(Expense(f"environment: found a group of {n} ports and masses", operations))
    return out


def _wave_link(data: WaveLinkData, coupling: Sequence[StatedSpringDamper | Realisation], m: int) -> Expense:
    """The conditions on a wave link's own figures, and its felt stiffness: three inverses, exactly."""
    tables = [data.b] if data.mass is None else [data.b, data.mass]
    b = _bits(tables) + _bits_of([x for x in (data.round_trip, data.tank) if x is not None])
    operations = 2.0 * cost.definiteness(m, 2.0 * b)
    if data.round_trip is not None and len(coupling) == 1:
        V = coupling[0]
        own = _bits([V.stiffness]) if isinstance(V, StatedSpringDamper) else _bits([V.A, V.B, V.C]) * (V.A.rows + 1)
        operations += cost.solution(m, m, own) + cost.solution(m, m, b) + cost.solution(m, m, m * (own + b))
        operations += cost.definiteness(m, m * m * (own + b))
    return Expense(f"environment.b: found {m} ports with numbers of up to {b:.0f} bits", operations)


_DIGITS = 17  # of a float's shortest decimal, at most


def _bits(tables: Iterable[StatedMatrix]) -> float:
    """Bits of these tables' numbers, brought to one denominator."""
    return _bits_of([value for table in tables for row in table.values for value in row])


def _bits_of(values: Sequence[Number | fmpq]) -> float:
    """Bits of numbers, brought to one denominator; rationals count with their own."""
    rationals = [height(x) for x in values if isinstance(x, fmpq)]
    stated = [float(x) for x in values if not isinstance(x, fmpq)]
    sizes = np.abs(np.array(stated, dtype=np.float64))
    sizes = sizes[sizes > 0.0]
    if not sizes.size:
        return float(max(rationals, default=1))
    below = 0.0
    if any(isinstance(x, float) and x for x in values):
        below = max(0.0, (_DIGITS - math.floor(math.log10(float(sizes.min())))) * math.log2(10.0))
    return below + max(0.0, math.log2(float(sizes.max()))) + 1.0 + max(rationals, default=0)


def _sparse_bits(matrix: Sparse) -> float:
    return float(max((height(x) for x in matrix.values()), default=1))
