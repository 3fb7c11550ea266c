"""The human operator H: rational transfer matrices in continuous time, and whether they are passive.

Assumption 1(b) of [Bianchini2010]_ asks that each H_i, from velocity (m/s) to force (N), be a passive
operator. For a stable proper H(s) that is

    H(jw) + H(jw)^* >= 0    for all real w,

which is checked exactly (:mod:`manyhands.design.passivity.frequency`), and also on a frequency grid that is dense
around every pole. The grid serves operators that are too large or too badly scaled for the exact test. It is alone
where there is no SciPy: a session can be shown there, and whatever designs, proves or runs one needs SciPy and reads it
anew. At whatever frequency either test finds the least eigenvalue, the reported figure is that of the rational
functions there.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from manyhands.design.models.statespace import Matrix, Rational, StateSpace, companion_forms, proper

_POINTS_PER_DECADE = 400
_DECADES_BEYOND = 3
_EXACT_ORDER = 64  # states of the largest realisation that is tested exactly; the eigenvalue problem is twice as large
_ROUNDING = 1e-12  # of the largest gain: a smaller negative eigenvalue is rounding


@dataclass(frozen=True)
class PassivityFinding:
    """The result of the passivity check of an operator.

    Attributes:
        passive: whether H is passive.
        smallest: the least eigenvalue of the Hermitian part of H(jw) over w, in N*s/m.
        frequency: where it is reached, in rad/s; inf when it is the limit at high frequencies.
        reason: one sentence, also for a passive operator.
    """

    passive: bool
    smallest: float
    frequency: float
    reason: str


@dataclass(frozen=True)
class RationalMatrix:
    """A square matrix of proper rational functions of s.

    Attributes:
        entries: rows of (numerator, denominator), each in descending powers of s.

    Raises:
        ValueError: not square, a zero denominator, or an improper entry.
    """

    entries: tuple[tuple[Rational, ...], ...]

    def __post_init__(self) -> None:
        size = len(self.entries)
        if size == 0 or any(len(row) != size for row in self.entries):
            raise ValueError("expected a square matrix of entries")
        trimmed = tuple(
            tuple(
                proper(entry, f"entry ({i}, {j})", "put inertia into the mass instead")
                for j, entry in enumerate(row, 1)
            )
            for i, row in enumerate(self.entries, 1)
        )
        object.__setattr__(self, "entries", trimmed)

    @property
    def size(self) -> int:
        """Number m of ports."""
        return len(self.entries)

    def response(self, frequencies: Matrix) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
        """H(jw), frequencies x m x m, for ``frequencies`` w in rad/s; inf gives the limit."""
        w = np.asarray(frequencies, dtype=np.float64)
        beyond = np.isinf(w)
        s = 1j * np.where(beyond, 0.0, w)
        out = np.zeros((s.size, self.size, self.size), dtype=np.complex128)
        for i, row in enumerate(self.entries):
            for j, (num, den) in enumerate(row):
                limit = num[0] / den[0] if len(num) == len(den) else 0.0
                out[:, i, j] = np.where(beyond, limit, np.polyval(num or (0.0,), s) / np.polyval(den, s))
        return out

    def poles(self) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
        """Roots of all denominators, rad/s."""
        roots = [np.roots(den) for row in self.entries for _, den in row if len(den) > 1]
        return np.concatenate(roots).astype(np.complex128) if roots else np.zeros(0, dtype=np.complex128)

    def realisation(self) -> StateSpace:
        """A continuous state space of H(s): one companion form for each entry, not minimal in general."""
        return companion_forms(self.entries)

    def passivity(self) -> PassivityFinding:
        """Check passivity by the module's equation."""
        poles = self.poles()
        unstable = poles[poles.real >= 0.0]
        if unstable.size:
            worst = unstable[np.argmax(unstable.real)]
            return PassivityFinding(
                False,
                -np.inf,
                float(abs(worst.imag)),
                f"operator not passive: it has a pole at {worst:.3g} rad/s, not in the open left half plane"
                + ("; give a spring as the hand's stiffness instead" if worst == 0.0 else ""),
            )
        frequency, smallest = self._least_eigenvalue(poles)
        scale = float(np.max(np.abs(self.response(np.array([frequency])))))
        if smallest < -_ROUNDING * max(scale, 1e-300):
            return PassivityFinding(
                False,
                smallest,
                frequency,
                f"operator not passive {_at(frequency)}: the least eigenvalue of its Hermitian part "
                f"there is {smallest:.3g} N·s/m",
            )
        return PassivityFinding(
            True,
            smallest,
            frequency,
            f"passive: least eigenvalue {smallest:.3g} N·s/m {_at(frequency)}",
        )

    def _least_eigenvalue(self, poles: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> tuple[float, float]:
        """The frequency (rad/s) and value of the least eigenvalue of the Hermitian part."""
        found = [self._on_grid(poles)]
        for part in self.components():
            frequency = part.exactly_least()
            if frequency is not None:
                found.append((frequency, float(self._smallest_at(np.array([frequency]))[0])))
        return min(found, key=lambda each: each[1])

    def components(self) -> tuple[RationalMatrix, ...]:
        """The diagonal blocks that no entry joins: axes, or groups of axes, that the operator does not couple."""
        joined = np.array([[bool(num) for num, _ in row] for row in self.entries]) | np.eye(self.size, dtype=np.bool_)
        reached = joined | joined.T
        while np.any((further := reached @ reached) != reached):
            reached = further
        groups = [np.flatnonzero(reached[first]) for first in np.unique(np.argmax(reached, axis=1))]
        return tuple(RationalMatrix(tuple(tuple(self.entries[i][j] for j in group) for i in group)) for group in groups)

    def exactly_least(self) -> float | None:
        """The frequency of the least eigenvalue of the Hermitian part, rad/s; None if it cannot be decided here."""
        if find_spec("scipy") is None:
            return None
        from manyhands.design.passivity.frequency import least_hermitian_eigenvalue

        try:
            with np.errstate(all="ignore"):  # an overflow is refused below as not finite
                system = self.realisation()
            if system.order > _EXACT_ORDER:
                return None
            return least_hermitian_eigenvalue(system, "continuous")[1]
        except (ValueError, np.linalg.LinAlgError):  # coefficients so far apart that the realisation overflows
            return None

    def _on_grid(self, poles: np.ndarray[tuple[int], np.dtype[np.complex128]]) -> tuple[float, float]:
        """The least eigenvalue on the grid: its frequency (rad/s) and its value."""
        corners: list[float] = [float(abs(p)) for p in poles]
        for row in self.entries:
            for num, _ in row:
                corners += [float(abs(z)) for z in np.roots(num)] if len(num) > 1 else []
        corners = [float(c) for c in corners if c > 0.0] or [1.0]
        low = np.log10(min(corners)) - _DECADES_BEYOND
        high = np.log10(max(corners)) + _DECADES_BEYOND
        grid = np.logspace(low, high, int((high - low) * _POINTS_PER_DECADE))
        grid = np.unique(np.concatenate([np.zeros(1), grid, *(_around(pole) for pole in poles)]))
        values = self._smallest_at(grid)
        for _ in range(4):  # each pass divides the spacing around every local minimum by 20
            inner = np.flatnonzero((values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:])) + 1
            deepest = inner[np.argsort(values[inner])[:8]]
            fine = np.linspace(grid[deepest - 1], grid[deepest + 1], 41)
            grid = np.unique(np.concatenate([grid, fine.ravel()]))
            values = self._smallest_at(grid)
        best = int(np.argmin(values))
        return float(grid[best]), float(values[best])

    def _smallest_at(self, frequencies: Matrix) -> Matrix:
        H = self.response(frequencies)
        hermitian = (H + np.conj(np.swapaxes(H, 1, 2))) / 2.0
        return np.asarray(np.linalg.eigvalsh(hermitian)[:, 0])


def _at(frequency: float) -> str:
    """The frequency (rad/s) in the words of a message."""
    return "at high frequencies" if np.isinf(frequency) else f"at {frequency:.3g} rad/s"


def _around(pole: complex) -> Matrix:
    """Frequencies around a pole's own (rad/s), spaced by its decay rate, which is the width of its resonance."""
    rate, centre = abs(pole.real), abs(pole.imag)
    widest = max(centre / rate, 1.0) if rate > 0.0 else 1.0
    steps = np.logspace(-2.0, np.log10(widest), int(20 * (np.log10(widest) + 2.0)) + 2)
    around = centre + rate * np.concatenate([-steps, np.zeros(1), steps])
    return np.asarray(around[around >= 0.0])
