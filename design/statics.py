"""Exact checks of the static gains that a session gives, from its decimals, before any design starts.

E_hat and V_hat integrate the static gains E(1) and V(1). An integrator is passive only if its gain is symmetric and
positive semidefinite. No margin elsewhere makes up for a violation, however small, so floats do not decide these two
conditions. The proof checks them again with code of its own (:mod:`manyhands.design.proof.statics`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from decimal import Decimal
from typing import Final

from flint import fmpq, fmpq_mat

from manyhands.design.errors import Infeasible
from manyhands.design.models.axis import TRANSLATING, TURNING
from manyhands.design.models.environment import StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.statespace import Matrix, StateSpace

_MOST_STATES = 512  # for an exact solution, which takes about a minute at this size


def check_environment(environment: Environment, turning: Collection[str] = ()) -> None:
    """Refuse an environment whose E(1) is not symmetric and >= 0. A network passes by the signs of its links.

    Args:
        environment: the environment.
        turning: those of its ports that turn, for the message.

    Raises:
        Infeasible: a condition fails; the message names the entry, its value and the value that would be right.
    """
    match environment:  # in rationals, of which the kinds know nothing: two forms of numbers
        case StateSpaceEnvironment():
            gain = _of_system(environment.system, environment.method is not None, "the environment")
        case TransferEnvironment():
            gain = _of_entries(environment)
        case _:
            return
    _require_symmetric(gain, environment.ports, "the environment's static stiffness E(1)", "N/m", "E_hat", turning)
    _require_semidefinite(gain, environment.ports, turning)


_DISPLACEMENT: Final = (
    "a response from displacement: one from velocity to force is to be multiplied by s, or by (z - 1)/(T z)"
)
"""What a spring shows that was given as force over velocity: it has a pole at s = 0."""


def check_block(name: str, block: StateSpace, ports: Sequence[str], turning: Collection[str] = ()) -> None:
    """Refuse a block of V whose V(1) is not symmetric. That V(1) > K is a strict condition, which is checked later.

    Raises:
        Infeasible: V(1) is not symmetric; the message names the entry, its value and the value that would be right.
    """
    if len(ports) > 1:
        gain = _of_system(block, False, f"coupling {name}")
        _require_symmetric(gain, ports, f"coupling {name}: its static compliance V(1)", "m/N", "V_hat", turning)


def _of_system(system: StateSpace, continuous: bool, what: str) -> fmpq_mat:
    if system.static_gain is not None:
        return _exact(system.static_gain)
    n = system.order
    if n == 0:
        return _exact(system.D)
    if n > _MOST_STATES:
        raise Infeasible(f"{what} has {n} states; expected at most {_MOST_STATES} for an exact static gain")
    M = -_exact(system.A)
    for i in range(0 if continuous else n):
        M[i, i] += 1
    try:
        return _exact(system.D) + _exact(system.C) * M.solve(_exact(system.B))
    except ZeroDivisionError:
        raise Infeasible(
            f"{what} has a pole at {'s = 0' if continuous else 'z = 1'}, and so no static gain; expected a spring that "
            "holds every mode" + (f", and {_DISPLACEMENT}" if what == "the environment" else "")
        ) from None


def _of_entries(environment: TransferEnvironment) -> fmpq_mat:
    m = len(environment.ports)
    out = fmpq_mat(m, m)
    for i, row in enumerate(environment.entries):
        for j, (num, den) in enumerate(row):
            if den[-1] == 0:
                a, b = environment.ports[i], environment.ports[j]
                raise Infeasible(
                    f"the environment's entry ({a}, {b}) has a pole at s = 0, and so no static stiffness; expected a "
                    f"den with a constant term and no common factor s, and {_DISPLACEMENT}"
                )
            out[i, j] = _decimal(num[-1]) / _decimal(den[-1])
    return out


def _unit(unit: str, a: str, b: str, turning: Collection[str]) -> str:
    """The unit of an entry between two ports, of which both, one or none turns."""
    turn = [port in turning for port in (a, b)]
    if all(turn) or not any(turn):
        return (TURNING if turn[0] else TRANSLATING)(unit)
    return unit.replace("m", "rad")


def _require_symmetric(
    gain: fmpq_mat, ports: Sequence[str], what: str, translating: str, party: str, turning: Collection[str]
) -> None:
    for i in range(len(ports)):
        for j in range(i):
            if gain[i, j] == gain[j, i]:
                continue
            a, b = ports[j], ports[i]
            unit = _unit(translating, a, b, turning)
            raise Infeasible(
                f"{what} is not symmetric by its own decimals, so that {party} is passive at no level: its entry "
                f"({a}, {b}) is {_text(gain[j, i])} {unit}, its entry ({b}, {a}) is {_text(gain[i, j])} {unit}, and "
                f"they differ by {_text(abs(gain[i, j] - gain[j, i]))} {unit}; expected the same twice, as of "
                f"forces from an energy, such as {_text((gain[i, j] + gain[j, i]) / 2)} {unit}; where D cannot be "
                "written down so exactly, the key static states the static gain in its place"
            )


def _require_semidefinite(gain: fmpq_mat, ports: Sequence[str], turning: Collection[str]) -> None:
    """Refuse E(1) that is not >= 0, by an exact LDL^T.

    The first pivot that is negative, or zero with a nonzero entry in its row, shows which entry is wrong and by how
    much.
    """
    m = len(ports)
    rest = [[gain[i, j] for j in range(m)] for i in range(m)]
    consequence = "so that E_hat is passive at no level"
    for k in range(m):
        pivot = rest[k][k]
        own = _unit("N/m", ports[k], ports[k], turning)
        if pivot < 0:
            raise Infeasible(
                f"the environment's static stiffness E(1) is not positive semidefinite, {consequence}: its entry "
                f"({ports[k]}, {ports[k]}) is {_text(gain[k, k])} {own}, which is {_text(-pivot)} {own} less than the "
                f"other entries need: expected at least {_text(gain[k, k] - pivot)} {own}"
            )
        beside = next((j for j in range(k + 1, m) if rest[k][j] != 0), None)
        if pivot == 0:
            if beside is not None:
                unit = _unit("N/m", ports[k], ports[beside], turning)
                raise Infeasible(
                    f"the environment's static stiffness E(1) is not positive semidefinite, {consequence}: beside "
                    f"({ports[k]}, {ports[k]}) = {_text(gain[k, k])} {own} its entry ({ports[k]}, {ports[beside]}) is "
                    f"{_text(gain[k, beside])} {unit}; expected {_text(gain[k, beside] - rest[k][beside])} {unit}, or "
                    f"a greater entry ({ports[k]}, {ports[k]})"
                )
            continue
        column = [rest[i][k] / pivot for i in range(m)]
        for i in range(k + 1, m):
            if column[i] != 0:
                for j in range(k + 1, m):
                    rest[i][j] -= column[i] * rest[k][j]


def _exact(M: Matrix) -> fmpq_mat:
    rows, columns = M.shape
    return fmpq_mat(rows, columns, [_decimal(value) for value in M.ravel().tolist()])


def _decimal(value: float) -> fmpq:
    """The exact value of the number's shortest decimal."""
    return fmpq(*Decimal(repr(float(value))).as_integer_ratio())


def _text(value: fmpq) -> str:
    """The number with enough digits to distinguish it from the neighbouring floats."""
    return repr(int(value.p) / int(value.q)) if value else "0"
