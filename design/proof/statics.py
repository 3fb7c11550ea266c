"""Static gains, exactly: the response to a constant input, and whether it can come from an energy.

E_hat and V_hat have an integrator for each port. It integrates the static gain, E(1) or V(1), and is passive only if
the gain is symmetric and >= 0. A skew part or a negative eigenvalue, however small, makes the loop unstable for some
hand. So both conditions are decided in rationals, from the decimals of the file, without any tolerance:

- network: E(1) is a Schur complement of the stiffness matrix, symmetric and >= 0 by the links' signs alone;
- rational function of s: num(0)/den(0), entry by entry;
- continuous state space: D - C A^-1 B, which backward Euler, Tustin and a zero-order hold all keep;
- discrete state space: D + C (I - A)^-1 B;
- a world without the compliance C that is counted in series: E(1) (I - C E(1))^-1.

A state space may state its static gain instead of D, and D follows from it. So the gain can be exactly symmetric even
if D has no finite decimals.
"""

from __future__ import annotations

from functools import lru_cache

from flint import fmpq_mat

from manyhands.design.proof import exact, rational
from manyhands.design.proof.claim import StiffenedData, SystemData, TransferData
from manyhands.design.proof.exact import MAX_STATIC, Sparse, StatedMatrix, exact_decimal
from manyhands.design.proof.finding import Verdict


class Undecided(ValueError):
    """The statics are not decided: the system is too large, or has no static gain."""


def of_system(
    A: StatedMatrix,
    B: StatedMatrix,
    C: StatedMatrix,
    D: StatedMatrix | None,
    static: StatedMatrix | None,
    discrete: bool,
) -> fmpq_mat:
    """The static gain of a state space that states D or the gain itself.

    Raises:
        Undecided: the system has no static gain, because of a pole at z = 1 or s = 0; or it has too many states.
    """
    return _stated(D) + _carried(A, B, C, discrete) if static is None else static.rational()


def feedthrough(
    A: StatedMatrix,
    B: StatedMatrix,
    C: StatedMatrix,
    D: StatedMatrix | None,
    static: StatedMatrix | None,
    discrete: bool,
) -> fmpq_mat:
    """D of a state space that states D or the static gain; from the gain, the states' part is subtracted.

    Raises:
        Undecided: as for :func:`of_system`.
    """
    return _stated(static) - _carried(A, B, C, discrete) if D is None else D.rational()


def _stated(table: StatedMatrix | None) -> fmpq_mat:
    assert table is not None  # noqa: S101  # for the type checker: a reader takes D or the static gain
    return table.rational()


@lru_cache(maxsize=8)
def _carried(A: StatedMatrix, B: StatedMatrix, C: StatedMatrix, discrete: bool) -> fmpq_mat:
    """The states' part of the static gain: C (I - A)^-1 B, or -C A^-1 B of a continuous system.

    A proof asks for it several times, of the same tables; they are compared by identity, and nothing may change them.
    """
    n = A.rows
    if n == 0:
        return fmpq_mat(C.rows, B.columns)
    if n > MAX_STATIC:
        raise Undecided(f"found {n} states; expected at most {MAX_STATIC}: statics are decided exactly")
    M = -A.rational()
    if discrete:
        M += rational.identity(fmpq_mat, n)
    try:
        return C.rational() * M.solve(B.rational())
    except ZeroDivisionError:
        raise Undecided(f"there is a pole at {'z = 1' if discrete else 's = 0'}, and so no static gain") from None


def of_environment(data: SystemData | TransferData | StiffenedData) -> fmpq_mat:
    """E(1), N/m, of an environment given by matrices or by rational functions.

    Raises:
        Undecided: the environment has a pole at z = 1 or s = 0, or too many states.
    """
    if isinstance(data, StiffenedData):
        return _stiffened(of_environment(data.world), data.compliance)
    if isinstance(data, SystemData):
        return of_system(data.A, data.B, data.C, data.D, data.static, data.method is None)
    m = len(data.entries)
    out = fmpq_mat(m, m)
    for i, row in enumerate(data.entries):
        for j, (num, den) in enumerate(row):
            if den[-1] == 0:
                raise Undecided(f"entry ({i + 1}, {j + 1}) has a pole at s = 0, and so no static gain")
            out[i, j] = exact_decimal(num[-1]) / exact_decimal(den[-1])
    return out


def _stiffened(E1: fmpq_mat, C: fmpq_mat) -> fmpq_mat:
    """E1 (I - C E1)^-1, as (I - E1 C)^-1 E1."""
    m = E1.nrows()
    if m > MAX_STATIC:
        raise Undecided(f"found {m} ports; expected at most {MAX_STATIC}: statics are decided exactly")
    out = fmpq_mat(m, m)
    entries: Sparse = {(i, j): E1[i, j] for i in range(m) for j in range(m) if E1[i, j] != 0}
    for group in exact.groups(m, [entries]):
        own, taken = exact.dense(entries, group), fmpq_mat(len(group), len(group))
        for k, port in enumerate(group):
            taken[k, k] = C[port, port]
        try:
            part = (rational.identity(fmpq_mat, len(group)) - own * taken).solve(own)
        except ZeroDivisionError:
            raise Undecided("E(1) C has the eigenvalue 1, so that nothing holds the world that is left") from None
        for k, i in enumerate(group):
            for n, j in enumerate(group):
                out[i, j] = part[k, n]
    return out


def asymmetry(M: fmpq_mat) -> str:
    """The first pair of entries that differ, in words; empty if M is symmetric."""
    for i in range(M.nrows()):
        for j in range(i):
            if M[i, j] != M[j, i]:
                left, right = rational.rounded(M[i, j]), rational.rounded(M[j, i])
                return f"the entries ({i + 1}, {j + 1}) and ({j + 1}, {i + 1}) are {left!r} and {right!r}"
    return ""


def semidefinite(M: fmpq_mat) -> Verdict:
    """Whether M is symmetric and >= 0, group by group of the ports that its entries join."""
    unequal = asymmetry(M)
    if unequal:
        return Verdict(False, float("nan"), f"not symmetric: {unequal}")
    m = M.nrows()
    entries: Sparse = {(i, j): M[i, j] for i in range(m) for j in range(m) if M[i, j] != 0}
    least, argument = float("inf"), "exactly: the matrix is zero"
    for group in exact.groups(m, [entries]):
        part = exact.dense(entries, group)
        if len(group) == 1 and part[0, 0] == 0:
            continue
        verdict = exact.definite(part, strict=False)
        if not verdict.holds:
            ports = ", ".join(str(i + 1) for i in group[:6])
            return Verdict(False, verdict.least, f"ports {ports}: {verdict.argument}")
        if verdict.least < least:
            least, argument = verdict.least, verdict.argument
    return Verdict(True, least if least < float("inf") else 0.0, argument)
