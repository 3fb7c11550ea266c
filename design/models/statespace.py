"""Linear systems in state space, the type that all models of the design share.

A system (A, B, C, D) has n states, p inputs and m outputs. The code that makes a system states whether it is read in
discrete time (psi+ = A psi + B u) or in continuous time (d psi/dt = A psi + B u). Of :class:`StateSpace` itself, only
:meth:`StateSpace.simulate` depends on it: it is discrete.

**From continuous to discrete time and back.** The Cayley transform keeps storage functions and supply rates. For a rate
a > 0 (1/s), with s = a (z - 1)/(z + 1) and R = (a I - A)^{-1},

    A_d = (a I + A) R,    B_d = sqrt(2a) R B,    C_d = sqrt(2a) C R,    D_d = D + C R B

has at z the response that (A, B, C, D) has at s. Along psi = (psi_d+ + psi_d)/sqrt(2a), with u and y the
same in both, d psi/dt = sqrt(a/2) (psi_d+ - psi_d), so that

    2 psi^T P d psi/dt = psi_d+^T P psi_d+ - psi_d^T P psi_d :

the continuous storage inequality with P is a congruence of the discrete one with the same P. In contrast to Tustin's
rule, whose rate is 2/T, nothing is approximated. The rate is free; it only decides which frequency comes to the middle
of the circle.

In the inverse direction, at the rate 1, z = (1 + s)/(1 - s) takes the circle to the imaginary axis. There the
frequencies at which a level is crossed are the imaginary eigenvalues of a Hamiltonian matrix ([Boyd1989]_,
[Bruinsma1990]_). Between two of them the level is kept or violated throughout, so that one frequency in each gap
decides. Three searches need no grid for this reason: for a norm (:mod:`manyhands.design.passivity.hinfinity`), for the
environment's level (:mod:`manyhands.design.levels.environment`) and for a supply ratio
(:mod:`manyhands.design.passivity.frequency`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manyhands.design.models.brief import brief_repr

Matrix = NDArray[np.float64]

Rational = tuple[tuple[float, ...], tuple[float, ...]]
"""Numerator and denominator, descending powers of s."""

_POINTS_AT_ONCE = 4096  # frequencies evaluated together, so that memory stays bounded


def matrix(data: ArrayLike, rows: int | None = None, columns: int | None = None) -> Matrix:
    """Return ``data`` as a read-only float64 matrix of its own.

    Raises:
        ValueError: not two-dimensional, not of the wanted shape, or not finite.
    """
    out = np.array(data, dtype=np.float64)
    if out.ndim != 2:
        raise ValueError(f"found {out.ndim} dimension(s); expected a matrix")
    if (rows is not None and out.shape[0] != rows) or (columns is not None and out.shape[1] != columns):
        raise ValueError(f"found {out.shape[0]} x {out.shape[1]}; expected a {rows} x {columns} matrix")
    if not np.all(np.isfinite(out)):
        raise ValueError("expected finite entries")
    out.setflags(write=False)
    return out


def symmetric_part(M: NDArray[np.floating[Any]]) -> Matrix:
    """The symmetric part (M + M^T)/2 of a square matrix."""
    return np.asarray((M + M.T) / 2.0, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear system (A, B, C, D).

    Attributes:
        A: n x n.
        B: n x p.
        C: m x n.
        D: m x p.
        static_gain: m x p, the output per constant input, if it is stated instead of D; otherwise None. D then follows
            from it, and a proof takes the gain, not D, as exact.

    Raises:
        ValueError: shapes that do not fit each other, or an entry that is not finite.

    Example:
        >>> from manyhands import passivity
        >>> spring = passivity.StateSpace.static([[1.0 / 500.0]])      # m/N
        >>> lag = passivity.StateSpace([[0.5]], [[1.0]], [[0.001]], [[0.0]])
        >>> lag, float(lag.response(1.0)[0, 0].real)
        (StateSpace(A=0.5, B=1, C=0.001, D=0), 0.002)
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    static_gain: Matrix | None = None

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        A = matrix(self.A)
        n = A.shape[0]
        D = matrix(self.D)
        object.__setattr__(self, "A", matrix(A, n, n))
        object.__setattr__(self, "B", matrix(self.B, n, D.shape[1]))
        object.__setattr__(self, "C", matrix(self.C, D.shape[0], n))
        object.__setattr__(self, "D", D)
        if self.static_gain is not None:
            object.__setattr__(self, "static_gain", matrix(self.static_gain, *D.shape))

    @classmethod
    def with_static_gain(
        cls, A: ArrayLike, B: ArrayLike, C: ArrayLike, gain: ArrayLike, *, continuous: bool = False
    ) -> StateSpace:
        """The system whose static gain is exactly ``gain``: D = gain - C (I - A)^-1 B, or gain + C A^-1 B.

        Raises:
            ValueError: the system has a pole at z = 1, or at s = 0, and so no static gain.
        """
        static = matrix(gain)
        m, p = static.shape
        n = len(matrix(A)) if np.size(A) else 0
        states, entering, leaving = (
            matrix(np.reshape(M, shape)) for M, shape in ((A, (n, n)), (B, (n, p)), (C, (m, n)))
        )
        try:
            steady = np.linalg.solve(-states if continuous else np.eye(n) - states, entering)
        except np.linalg.LinAlgError:
            raise ValueError(f"found a pole at {'s = 0' if continuous else 'z = 1'}; expected a static gain") from None
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused with a sentence
            direct = static - leaving @ steady
        return cls(states, entering, leaving, direct, static)

    @classmethod
    def static(cls, D: ArrayLike) -> StateSpace:
        """A gain without states, y = D u."""
        gain = matrix(D)
        m, p = gain.shape
        return cls(np.zeros((0, 0)), np.zeros((0, p)), np.zeros((m, 0)), gain)

    @classmethod
    def of(cls, system: HasMatrices | HasPolynomials) -> StateSpace:
        """A system of any library: of ``control.ss``, ``control.tf``, ``scipy.signal`` and the like.

        An object with A, B, C and D keeps its matrices. One with ``num`` and ``den``, descending powers of s or z, gets
        a companion form for each entry, which is not minimal in general. The sample time is not kept: functions that
        depend on it have the argument ``time``.

        Raises:
            ValueError: the object has neither, or an entry is improper.

        Example:
            >>> import scipy.signal
            >>> from manyhands import passivity
            >>> device = scipy.signal.TransferFunction([1.0], [0.2, 1.37])      # N to m/s
            >>> passivity.StateSpace.of(device)
            StateSpace(A=-6.85, B=1, C=5, D=0)
        """
        if isinstance(system, HasMatrices):
            return cls(system.A, system.B, system.C, system.D)
        if not isinstance(system, HasPolynomials):
            raise ValueError(
                f"found {type(system).__name__}; expected a linear system, with A, B, C and D or with num and den"
            )
        num, den = system.num, system.den
        if isinstance(num[0], int | float | np.number):  # SciPy's, with one input and one output
            num, den = [[num]], [[den]]
        return companion_forms(proper_entries(num, den))

    @property
    def order(self) -> int:
        """Number n of states."""
        return int(self.A.shape[0])

    @property
    def inputs(self) -> int:
        """Number p of inputs."""
        return int(self.D.shape[1])

    @property
    def outputs(self) -> int:
        """Number m of outputs."""
        return int(self.D.shape[0])

    def response(self, point: complex) -> NDArray[np.complex128]:
        """C (point I - A)^{-1} B + D, m x p: the transfer matrix at one point of the z or s plane."""
        resolvent = np.linalg.solve(point * np.eye(self.order) - self.A, self.B.astype(np.complex128))
        return np.asarray(self.C @ resolvent + self.D)

    def minus(self, other: StateSpace) -> StateSpace:
        """This system less another one with the same inputs and outputs; the states of this one, then of the other."""
        n, k = self.order, other.order
        return StateSpace(
            np.block([[self.A, np.zeros((n, k))], [np.zeros((k, n)), other.A]]),
            np.vstack([self.B, other.B]),
            np.hstack([self.C, -other.C]),
            self.D - other.D,
        )

    def simulate(self, inputs: Matrix) -> Matrix:
        """Outputs (ticks x m) of the discrete system from rest, for ``inputs`` (ticks x p)."""
        state = np.zeros(self.order)
        outputs = np.zeros((inputs.shape[0], self.outputs))
        for k, u in enumerate(inputs):
            outputs[k] = self.C @ state + self.D @ u
            state = self.A @ state + self.B @ u
        return outputs


@runtime_checkable
class HasMatrices(Protocol):
    """A linear system of any library, by its matrices."""

    @property
    def A(self) -> Any:
        """N x n."""

    @property
    def B(self) -> Any:
        """N x p."""

    @property
    def C(self) -> Any:
        """M x n."""

    @property
    def D(self) -> Any:
        """M x p."""


@runtime_checkable
class HasPolynomials(Protocol):
    """A transfer matrix of any library, by its polynomials; SciPy's has one input and one output, and no rows."""

    @property
    def num(self) -> Any:
        """M rows of p numerators, descending powers."""

    @property
    def den(self) -> Any:
        """M rows of p denominators."""


def require_state_space(system: object) -> None:
    """Refuse a system of another library, whose matrices and sample time the lemmas would misread.

    Raises:
        ValueError: ``system`` is no :class:`StateSpace`.
    """
    if not isinstance(system, StateSpace):
        raise ValueError(
            f"found {type(system).__name__}; expected a StateSpace: mh.passivity.StateSpace.of(system) converts what "
            'has A, B, C and D or num and den, and time="continuous" says that it is one in s'
        )


class LinearSystem(NamedTuple):
    """A linear system with its sample time, in the form that other libraries take: ``control.ss(*system)``.

    SciPy takes it as it is, as in ``scipy.signal.dstep(system)``.

    Attributes:
        A: n x n.
        B: n x p.
        C: m x n.
        D: m x p.
        dt: the sample time, s; 0 for continuous time.

    Example:
        >>> import manyhands as mh
        >>> import scipy.signal
        >>> V = mh.certify(mh.load("example1")).V
        >>> V
        LinearSystem(3 states, 3 inputs, 3 outputs, dt=0.001)
        >>> scipy.signal.dstep(V, n=3)[1][0][:, 0].round(6)     # m, after a step of 1 N at the first port
        array([0.00073 , 0.000868, 0.000895])
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    dt: float

    def __repr__(self) -> str:
        n, (m, p) = len(self.A), self.D.shape
        return f"LinearSystem({n} states, {p} inputs, {m} outputs, dt={self.dt:g})"


def frequency_response(system: StateSpace, angles: Matrix) -> NDArray[np.complex128]:
    """S(e^{j theta}) for ``angles`` theta in rad, stacked: angles x outputs x inputs."""
    out = np.empty((len(angles), system.outputs, system.inputs), dtype=np.complex128)
    identity, B = np.eye(system.order), system.B.astype(np.complex128)
    for start in range(0, len(angles), _POINTS_AT_ONCE):
        part = slice(start, start + _POINTS_AT_ONCE)
        z = np.exp(1j * angles[part])[:, None, None]
        out[part] = system.C @ np.linalg.solve(z * identity - system.A, np.broadcast_to(B, (len(z), *B.shape)))
    return out + system.D


def storage_inequality(system: StateSpace, P: Matrix, Delta: Matrix | None = None, Phi: Matrix | None = None) -> Matrix:
    """The matrix M(P) of Lemma 1, (2) of [Bianchini2010]_, (n+m) x (n+m); Delta and Phi default to zero (passivity).

    Args:
        system: (A, B, C, D) with as many inputs as outputs, m.
        P: n x n symmetric.
        Delta: m x m, output level.
        Phi: m x m, input level.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> lag = passivity.StateSpace([[0.5]], [[0.5]], [[1.0]], [[1.0]])
        >>> P = passivity.analyse(lag).P
        >>> bool(np.linalg.eigvalsh(passivity.storage_inequality(lag, P))[-1] < 0.0)
        True
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    m = system.inputs
    Delta = np.zeros((m, m)) if Delta is None else Delta
    Phi = np.zeros((m, m)) if Phi is None else Phi
    off = A.T @ P @ B - C.T / 2.0 + C.T @ Delta @ D
    return np.block(
        [
            [A.T @ P @ A - P + C.T @ Delta @ C, off],
            [off.T, B.T @ P @ B - (D + D.T) / 2.0 + D.T @ Delta @ D + Phi],
        ]
    )


def block_diagonal(parts: Sequence[Matrix]) -> Matrix:
    """The matrix with ``parts`` on its diagonal, in order; parts may be non-square or empty."""
    rows = sum(part.shape[0] for part in parts)
    columns = sum(part.shape[1] for part in parts)
    out = np.zeros((rows, columns))
    i = j = 0
    for part in parts:
        out[i : i + part.shape[0], j : j + part.shape[1]] = part
        i, j = i + part.shape[0], j + part.shape[1]
    return out


def parallel_blocks(systems: Sequence[StateSpace]) -> StateSpace:
    """The decoupled system blockdiag(S_1, ..., S_N), its states, inputs and outputs stacked in order."""
    return StateSpace(
        block_diagonal([s.A for s in systems]),
        block_diagonal([s.B for s in systems]),
        block_diagonal([s.C for s in systems]),
        block_diagonal([s.D for s in systems]),
    )


Time = Literal["discrete", "continuous"]
"""How a :class:`StateSpace` is read: psi+ = A psi + B u, or d psi/dt = A psi + B u."""

_FASTEST_RATIO = 1e-8  # eigenvalues below this part of the largest are integrators and do not count for the rate


def natural_rate(system: StateSpace) -> float:
    """A rate a (1/s) in the middle of a continuous system's poles: the geometric mean of their distances from 0."""
    sizes = np.abs(np.linalg.eigvals(system.A))
    largest = float(np.max(sizes, initial=0.0))
    if largest == 0.0:
        return 1.0
    return float(np.exp(np.mean(np.log(sizes[sizes > _FASTEST_RATIO * largest]))))


def cayley(system: StateSpace, rate: float) -> StateSpace:
    """The discrete system with the same storage matrices as the continuous ``system``; see the module's head.

    Args:
        system: (A, B, C, D) in continuous time, m x m.
        rate: a, 1/s, positive and not an eigenvalue of A.

    Raises:
        ValueError: ``rate`` is not positive, or an eigenvalue of A.
    """
    if not 0.0 < rate < np.inf:
        raise ValueError(f"found {rate}; expected a positive rate in 1/s")
    n = system.order
    shifted: Matrix = rate * np.eye(n) - system.A
    try:
        R = np.linalg.inv(shifted)
    except np.linalg.LinAlgError:
        raise ValueError(f"found {rate}; expected a rate that is no eigenvalue of A") from None
    root = float(np.sqrt(2.0 * rate))
    return StateSpace(
        (rate * np.eye(n) + system.A) @ R,
        root * R @ system.B,
        root * system.C @ R,
        system.D + system.C @ R @ system.B,
    )


def axis_image(system: StateSpace) -> StateSpace:
    """The continuous system whose response at s is that of the discrete ``system`` at z = (1 + s)/(1 - s).

    It is the inverse of :func:`cayley` at the rate 1. With R = (A + I)^{-1} it reads

        (R (A - I),    sqrt(2) R B,    sqrt(2) C R,    D - C R B).

    Args:
        system: discrete, without a pole at -1; inputs and outputs may differ in number.

    Raises:
        numpy.linalg.LinAlgError: A has the eigenvalue -1.
    """
    I = np.eye(system.order)
    R = np.linalg.inv(system.A + I)
    root = np.sqrt(2.0)
    return StateSpace(R @ (system.A - I), root * R @ system.B, root * system.C @ R, system.D - system.C @ R @ system.B)


def crossing_angles(hamiltonian: Matrix, relative: float, absolute: float = 0.0) -> Matrix:
    """The angles 2 atan |s| of the imaginary eigenvalues s of a Hamiltonian matrix, ascending, in [0, pi].

    Args:
        hamiltonian: 2n x 2n, in the coordinates of :func:`axis_image`.
        relative: an eigenvalue counts as imaginary up to |Re s| = relative |s| + absolute. Large tolerances are right:
            a false crossing costs one evaluation, and a missed crossing makes the result wrong.
        absolute: the same for eigenvalues near 0, for rounding.
    """
    values = np.linalg.eigvals(hamiltonian)
    near = np.abs(values.real) <= relative * np.abs(values) + absolute
    return np.unique(2.0 * np.arctan(np.abs(values[near].imag)))


def gaps(crossings: Sequence[float] | Matrix) -> tuple[Matrix, Matrix]:
    """The gaps between crossings on the upper half circle: their ends, including 0 and pi, and their middles.

    Args:
        crossings: angles in [0, pi], in any order.
    """
    ends = np.unique(np.concatenate([[0.0], crossings, [np.pi]]))
    return ends, np.asarray((ends[1:] + ends[:-1]) / 2.0)


def in_discrete_time(system: StateSpace, time: Time) -> tuple[StateSpace, float]:
    """``system`` in discrete time, and the rate a (1/s) of its Cayley transform; 1 if it was discrete already."""
    if time == "discrete":
        return system, 1.0
    rate = natural_rate(system)
    if np.any(np.abs(np.linalg.eigvals(system.A) - rate) < 1e-3 * rate):  # an unstable pole may sit on the rate
        rate *= np.sqrt(2.0)
    return cayley(system, float(rate)), float(rate)


def frequency_of(angle: float, time: Time, rate: float) -> float:
    """The frequency at z = e^{j angle}, 0 <= angle <= pi: rad a tick, or w = a tan(angle/2) in rad/s."""
    if time == "discrete":
        return angle
    return float("inf") if angle >= np.pi else rate * float(np.tan(angle / 2.0))


def trimmed_polynomial(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """The coefficients without leading zeros."""
    for i, c in enumerate(coefficients):
        if c != 0.0:
            return tuple(float(x) for x in coefficients[i:])
    return ()


def proper_entries(num: Sequence[Any], den: Sequence[Any]) -> tuple[tuple[Rational, ...], ...]:
    """The entries of a transfer matrix, without leading zeros.

    Args:
        num: m rows of p numerators, descending powers.
        den: m rows of p denominators.

    Raises:
        ValueError: no rows, rows of different lengths, a zero denominator, or an improper entry.
    """
    rows = [[(_plain(a), _plain(b)) for a, b in zip(*row, strict=True)] for row in zip(num, den, strict=True)]
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        raise ValueError(
            f"found rows of {[len(row) for row in rows]} entries; expected as many in each row, one at least"
        )
    return tuple(
        tuple(proper(entry, f"entry ({i}, {j})", "give it a faster pole") for j, entry in enumerate(row, 1))
        for i, row in enumerate(rows, 1)
    )


def _plain(polynomial: Any) -> tuple[float, ...]:
    return tuple(float(one) for one in polynomial)


def proper(entry: Rational, place: str, instead: str) -> Rational:
    """An entry without leading zeros.

    Raises:
        ValueError: a zero denominator, or an improper entry, with what to do instead.
    """
    num, den = trimmed_polynomial(entry[0]), trimmed_polynomial(entry[1])
    if not den:
        raise ValueError(f"{place}: the denominator is zero")
    if len(num) > len(den):
        raise ValueError(
            f"{place}: improper, the numerator's degree {len(num) - 1} exceeds the denominator's {len(den) - 1}; "
            f"{instead}"
        )
    return num, den


def companion_forms(entries: tuple[tuple[Rational, ...], ...]) -> StateSpace:
    """A state space of a matrix of proper rational functions of s or of z: one companion form per entry, row by row.

    Entry (i, j) with den of degree n has n states, xi' = A xi + b u_j, in the controllable form: ones above the
    diagonal of A, -den (made monic) reversed, constant term first, in its last row, b the last unit vector. The state
    space is not minimal in general.

    Args:
        entries: m rows of p (numerator, denominator), descending powers, proper, no leading zero in the denominator.
    """
    m, p = len(entries), len(entries[0])
    A_parts: list[Matrix] = []
    B, C, D = np.zeros((0, p)), np.zeros((m, 0)), np.zeros((m, p))
    for i, row in enumerate(entries):
        for j, (num, den) in enumerate(row):
            A_entry, C_entry, D[i, j] = _companion(num, den)
            order = A_entry.shape[0]
            if order == 0 or not np.any(C_entry):
                continue
            A_parts.append(A_entry)
            B_entry, C_wide = np.zeros((order, p)), np.zeros((m, order))
            B_entry[-1, j] = 1.0
            C_wide[i] = C_entry
            B, C = np.vstack([B, B_entry]), np.hstack([C, C_wide])
    return StateSpace(block_diagonal(A_parts), B, C, D)


def _companion(num: tuple[float, ...], den: tuple[float, ...]) -> tuple[Matrix, Matrix, float]:
    """Controllable companion form of num/den: A (n x n), C (n,), D; B is the last unit vector."""
    order = len(den) - 1
    monic = np.array(den) / den[0]
    padded = np.zeros(order + 1)
    if num:
        padded[order + 1 - len(num) :] = np.array(num) / den[0]
    D = float(padded[0])
    C = (padded[1:] - D * monic[1:])[::-1]
    A = np.zeros((order, order))
    if order:
        A[:-1, 1:] = np.eye(order - 1)
        A[-1] = -monic[1:][::-1]
    return A, C, D


def system_values(system: StateSpace) -> dict[str, Any]:
    """A, B, C and D as rows; or the static gain instead of D, if the system states it."""
    last = {"D": system.D.tolist()} if system.static_gain is None else {"static": system.static_gain.tolist()}
    return {"A": system.A.tolist(), "B": system.B.tolist(), "C": system.C.tolist(), **last}


def read_system(data: Mapping[str, Any], *, continuous: bool = False) -> StateSpace:
    """The system that :func:`system_values` wrote; JSON has no shape for a matrix without rows or columns.

    Raises:
        KeyError, TypeError, ValueError: a matrix is missing, or its shape does not fit the others.
    """
    if not data["A"] and (data["B"] or any(data["C"])):
        raise ValueError("expected B and C without entries where A has none")
    if "static" in data:
        if "D" in data:
            raise ValueError("found both D and static; expected one of them")
        A, B, C = (data[key] if data["A"] else [] for key in "ABC")
        return StateSpace.with_static_gain(A, B, C, data["static"], continuous=continuous)
    D = matrix(data["D"])
    if not data["A"]:
        return StateSpace.static(D)
    return StateSpace(matrix(data["A"]), matrix(data["B"]), matrix(data["C"]), D)


def rational_values(rational: Rational) -> dict[str, list[float]]:
    """Numerator and denominator, descending powers."""
    num, den = rational
    return {"num": list(num), "den": list(den)}


def read_rational(data: Mapping[str, Any]) -> Rational:
    """The rational function that :func:`rational_values` wrote.

    Raises:
        KeyError, TypeError, ValueError: a polynomial is missing, or is no list of numbers.
    """
    num, den = (tuple(matrix([data[key]])[0].tolist()) for key in ("num", "den"))
    return num, den
