"""What encoder steps add to the forces: w_i >= sum_j ||y_ij||_1 q_j/2, in balls, and whether dry friction covers it.

Samples x + delta with |delta_j| <= q_j/2 make the linear loop's forces Y x + Y delta. Y = E (I + V E)^-1 is realised
from V and E of :mod:`manyhands.design.proof.transparency`, V with what is counted in series and E without it: f = E p,
p = x - V f. With N = (I + D_E D_V)^-1 and states (x_V, x_E),

    f    = N (C_E x_E - D_E C_V x_V + D_E x),
    x_V+ = A_V x_V + B_V f,      x_E+ = A_E x_E + B_E (x - C_V x_V - D_V f).

The columns of B and D are scaled by q_j/2, so that w_i is to be no less than the sum of all |h_ij(k)|. The first terms
are summed in balls. They come as R W: W has the columns of A^i B, 0 <= i < L, and R the rows of C A^(Ls), 0 <= s < S.
Both grow by doubling, because balls that are multiplied one after the other would grow with every product.

**The tail.** With M = A^(LS) and rho = ||M||_inf < 1 in scaled states, everything later is C A^(Ls) M^j A^i B, j >= 1,
and at most

    rho/(1 - rho) (sum_s ||row of C A^(Ls)||_1) (sum_i ||column of A^i B||_inf).

So rho < 1 also proves that Y is stable. The scales of the states are powers of two, found in floats.

Such a force does at most w_i |dx_i| of work (docs/decisions/0051-encoder-steps-and-friction.md). Where the devices'
dry friction c_i is at least w_i at every port, quantised samples are covered. Elsewhere they are not, and the
certificate says so: it is then about devices that measure exactly, which is *assumed*.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from flint import arb, arb_mat, ctx, fmpq

from manyhands.design.proof import cost, environment, series, transparency
from manyhands.design.proof.claim import Claim, DeclaredData, NetworkData, StatedSpringDamper
from manyhands.design.proof.finding import Finding
from manyhands.design.proof.rational import assembled, rounded
from manyhands.design.proof.statics import Undecided
from manyhands.design.proof.system import NotDiscretised, Realisation

MOST_STATES: Final = 120
"""States and ports up to which the impulse responses are summed."""

BOUNDED: Final = "encoder steps of q add forces of at most w: w >= sum of ||y||_1 q/2"
"""The condition on a stated w."""

MEASURED: Final = "devices measure exactly: encoder steps are not covered"
"""What is assumed where they are not."""

_MOST_TERMS = 1_000_000
"""Entries of the impulse responses that are summed; fewer where a loop has many states."""

_MOST_OPERATIONS = 4e9  # of the sum
_TERM = 3_000.0  # operations to take one entry out of a matrix and add it
_STRIDE_ENTRIES = 2**16  # of W
_PRECISION = 192  # bits
_CHUNK_ENTRIES = 2**18  # of the product that are in memory
_NEGLIGIBLE = 1e-7  # the tail, relative to the least w that is to be proved


def findings(claim: Claim) -> list[Finding]:
    """Of a certificate whose devices state steps: what they add is bounded, and covered; or it says that it is not."""
    q = steps(claim)
    if claim.encoder is None:
        stated = not any(q)
        return (
            [] if stated else [_failed("what encoder steps add is claimed", "devices state steps, and encoder lacks")]
        )
    if not any(q):
        return [_failed("what encoder steps add is claimed", "no device states a step")]
    force = claim.encoder.force
    condition = "dry friction covers what encoder steps add: c >= w at every port"
    if force is None:
        if claim.encoder.covered:
            return [_failed(condition, "no w is stated")]
        return [_assumed(_unknown(claim) or "no bound on the force that they add is claimed")]
    found = [_bound(claim, force)]
    least = min(c - w for c, w in zip(friction(claim), force, strict=True))
    if claim.encoder.covered:
        argument = "exactly, in rationals: the force does at most w |dx| of work; every clutch engaged"
        found.append(Finding(condition, bool(least >= 0), rounded(least), 0.0, argument=argument))
    else:
        found.append(_assumed("no dry friction is claimed to cover the force that they add"))
    return found


def expense(claim: Claim) -> float:
    """The operations that :func:`findings` may take."""
    if claim.encoder is None or claim.encoder.force is None:
        return 0.0
    n = _order(claim)
    if n is None or n + len(claim.ports) > MOST_STATES:
        return 0.0
    return _MOST_OPERATIONS + 45.0 * cost.product(n + len(claim.ports), _PRECISION)


def steps(claim: Claim) -> list[fmpq]:
    """The steps q by port, m; 0 where none is stated."""
    return _by_port(claim, claim.step)


def friction(claim: Claim) -> list[fmpq]:
    """The dry friction c by port, N; 0 where none is stated."""
    return _by_port(claim, claim.friction)


def _by_port(claim: Claim, stated: tuple[tuple[fmpq, ...] | None, ...]) -> list[fmpq]:
    out = [fmpq(0)] * len(claim.ports)
    for device, values in zip(claim.devices, stated, strict=True):
        for port, value in zip(device.ports, values or (), strict=values is not None):
            out[port] = value
    return out


def _failed(condition: str, argument: str) -> Finding:
    return Finding(condition, False, float("nan"), 0.0, argument=argument)


def _assumed(argument: str) -> Finding:
    return Finding(MEASURED, True, 0.0, 0.0, "", argument, assumed=True)


def _bound(claim: Claim, force: tuple[fmpq, ...]) -> Finding:
    """Whether every w is at least the sum of its row of impulse responses."""
    if unknown := _unknown(claim):
        return _failed(BOUNDED, unknown)
    before, ctx.prec = ctx.prec, _PRECISION
    try:
        Y = _scaled_inputs(closed(claim), [q / 2 for q in steps(claim)])
        sums, ticks = _row_sums(Y, min(force))
    except (NotDiscretised, Undecided, ZeroDivisionError, OverflowError) as error:
        return _failed(BOUNDED, str(error) or "a matrix is not proved regular")
    finally:
        ctx.prec = before
    if sums is None:
        return _failed(BOUNDED, f"the responses are not proved to decay within {ticks} ticks")
    room = [arb(w) - total for w, total in zip(force, sums, strict=True)]
    holds = all(bool(left >= 0) for left in room)
    least = min(float(left.mid()) for left in room)
    argument = f"in balls: {ticks} ticks of the impulse responses, and a bound on the rest"
    return Finding(BOUNDED, holds, max(least, 0.0) if holds else least, 0.0, argument=argument)


def _unknown(claim: Claim) -> str:
    """Why no sum of impulse responses is formed, in words; empty where it is."""
    n = _order(claim)
    if n is None:
        return "the world is no one linear system: it is known by a level, or up to intervals"
    m = len(claim.ports)
    return f"{n} states and {m} ports are too many (at most {MOST_STATES})" if n + m > MOST_STATES else ""


def _order(claim: Claim) -> int | None:
    """States of Y; None where the world is no one linear system."""
    world = series.cut(claim).environment
    if isinstance(world, DeclaredData) or (isinstance(world, NetworkData) and world.uncertain):
        return None
    n_V = sum(V.stiffness.rows if isinstance(V, StatedSpringDamper) else V.A.rows for V in claim.coupling)
    return n_V + environment.order(world, len(claim.ports)) + len(claim.ports)


def closed(claim: Claim) -> Realisation:
    """Y, m x m, from displacement (m) to force (N); states of V, then of E.

    Raises:
        ZeroDivisionError: a matrix is not proved regular.
        NotDiscretised, Undecided: the discrete environment does not exist, or has no static stiffness.
    """
    world, T = series.cut(claim).environment, claim.period
    if isinstance(world, DeclaredData):
        raise Undecided("only a level is known of the world")
    A_V, B_V, C_V, D_V = transparency.coupling(claim)
    A_E, B_E, C_E, D_E = environment.environment(environment.split(world, T), T)
    n_V, n_E, m = A_V.nrows(), A_E.nrows(), D_E.nrows()
    unit = arb_mat(m, m, [int(i == j) for i in range(m) for j in range(m)])
    N = (unit + D_E * D_V).inv()
    C, D = assembled(arb_mat, [[-(N * D_E * C_V), N * C_E]]), N * D_E
    of_p = assembled(arb_mat, [[-C_V, arb_mat(m, n_E)]]) - D_V * C
    free = assembled(arb_mat, [[A_V, arb_mat(n_V, n_E)], [arb_mat(n_E, n_V), A_E]])
    A = free + assembled(arb_mat, [[B_V * C], [B_E * of_p]])
    return A, assembled(arb_mat, [[B_V * D], [B_E * (unit - D_V * D)]]), C, D


def _scaled_inputs(Y: Realisation, factors: list[fmpq]) -> Realisation:
    """Y with each input times its factor, without those whose factor is 0."""
    A, B, C, D = Y
    used = [j for j, factor in enumerate(factors) if factor != 0]

    def columns(M: arb_mat) -> arb_mat:
        return arb_mat(M.nrows(), len(used), [M[i, j] * factors[j] for i in range(M.nrows()) for j in used])

    return A, columns(B), C, columns(D)


def _row_sums(Y: Realisation, least: fmpq) -> tuple[list[arb] | None, int]:
    """An upper bound of the sum of |h_ij(k)| over j and k, by row, and the ticks that were summed.

    None in place of the sums where the responses are not proved to decay. The sum ends when the tail is negligible
    beside ``least``, or at the limit on its work.
    """
    A, B, C, D = Y
    n, m, p = A.nrows(), C.nrows(), B.ncols()
    sums = _absolute_sums(D, m)
    if n == 0:
        return sums, 1
    most = min(_MOST_TERMS, int(_MOST_OPERATIONS / (_TERM + 60.0 * n))) // (m * p)
    length = 1
    columns, power = B, A
    while 2 * length <= most and 2 * length * n * p <= _STRIDE_ENTRIES:
        columns, power, length = assembled(arb_mat, [[columns, power * columns]]), power * power, 2 * length
    scales = _scales(columns)
    reach = _reach(columns, scales)
    rows = new = C
    count = 1
    while True:
        for chunk in _chunks(new, max(1, _CHUNK_ENTRIES // (columns.ncols() * m)) * m):
            sums = [a + b for a, b in zip(sums, _absolute_sums(chunk * columns, m), strict=True)]
        rho = _norm(power, scales)
        if rho < 1:
            tail = rho / (1 - rho) * reach
            seen = _rows_seen(rows, scales, m)
            if all(bool(tail * row <= arb(least) * _NEGLIGIBLE) for row in seen) or 2 * count * length > most:
                return [(total + tail * row).upper() for total, row in zip(sums, seen, strict=True)], count * length
        if 2 * count * length > most:
            return None, count * length
        new = rows * power
        rows, power, count = assembled(arb_mat, [[rows], [new]]), power * power, 2 * count


def _absolute_sums(M: arb_mat, m: int) -> list[arb]:
    """The sum of |entries| of the rows of each of the m outputs, which take turns."""
    out = [arb(0)] * m
    for number, row in enumerate(M.tolist()):
        out[number % m] += sum(map(abs, row), arb(0))
    return out


def _chunks(M: arb_mat, most: int) -> Iterator[arb_mat]:
    """M, at most so many rows at a time."""
    rows = M.tolist()
    for at in range(0, len(rows), most):
        yield arb_mat(rows[at : at + most])


def _scales(columns: arb_mat) -> list[int]:
    """A power of two for each state, about the greatest that it gets to."""
    out = []
    for row in columns.tolist():
        greatest = max(abs(float(entry.mid())) for entry in row)
        out.append(math.frexp(greatest)[1] if 0.0 < greatest < math.inf else 0)
    floor = max(out) - 200  # a state that hardly moves needs no finer scale
    return [max(power, floor) for power in out]


def _reach(columns: arb_mat, scales: list[int]) -> arb:
    """The sum over the columns of the greatest |entry|, in scaled states."""
    total = arb(0)
    for column in columns.transpose().tolist():
        most = arb(0)
        for entry, power in zip(column, scales, strict=True):
            most = most.max(abs(entry).upper() * arb(2) ** (-power))
        total += most
    return total


def _rows_seen(rows: arb_mat, scales: list[int], m: int) -> list[arb]:
    """The sum over s of ||row of C A^(Ls)||_1 in scaled states, for each of the m outputs."""
    out = [arb(0)] * m
    for number, row in enumerate(rows.tolist()):
        for entry, power in zip(row, scales, strict=True):
            out[number % m] += abs(entry) * arb(2) ** power
    return out


def _norm(M: arb_mat, scales: list[int]) -> arb:
    """||M||_inf in scaled states, from above; infinite where a ball is."""
    most = arb(0)
    for row, own in zip(M.tolist(), scales, strict=True):
        weights = (arb(2) ** (power - own) for power in scales)
        total = sum((abs(entry) * weight for entry, weight in zip(row, weights, strict=True)), arb(0)).upper()
        if not total.is_finite():
            return arb.pos_inf()
        most = most.max(total)
    return most
