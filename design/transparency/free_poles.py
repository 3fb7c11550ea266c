"""Linear couplings with free poles, for the search: gains and poles move together, and passivity holds on a grid.

In the Tustin plane, lambda = 2(z-1)/(z+1) = j Omega on the unit circle (T = 1), a block of order n is

    v = D + sum_j (a_j c_0j + b_j sqrt(c_0j) lambda) / (lambda^2 + c_1j lambda + c_0j)  [+ a c/(lambda + c)],

which is stable exactly for positive c. The logarithms of c are the unknowns, so that a pair of poles may be complex or
real and change from one to the other. V_hat is Delta-OSP iff, with X = v - kappa I,

    He[(1/2 + j/Omega) X] - X^* Delta X >= 0    on the unit circle, and X(1) >= 0,

which is Re V_hat >= V_hat^* Delta V_hat divided by Omega^2/(1 + Omega^2/4). A change of D alone repairs a small
violation. The search returns a start for the convex program over its poles
(:mod:`manyhands.design.transparency.families`), in which passivity is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.statespace import Matrix
from manyhands.design.passivity.hinfinity import frequency_grid, refined_peaks
from manyhands.design.solver import LinearMatrixProgram
from manyhands.design.transparency.families import NormalisedLoop, PoleBasis, symmetric_units
from manyhands.design.transparency.minimax import Family

ComplexArray = NDArray[np.complex128]

ROOM = 1e-6  # least eigenvalue kept in the passivity condition, of order one
_REPAIRS = 12  # each repairs more than half of the violation; the level's quadratic term takes the rest
_MOST_DAMPING = 40.0  # c_1^2/c_0: above it, the pair is one slow pole and one so fast that D replaces it
_LEAST_DAMPING = 1e-4
_DENSE = 400  # angles per decade: they resolve closed-loop resonances as narrow as half a per cent
_CHECKED = 24  # angles of the passivity condition on a logarithmic grid, in addition to those where it is tightest


@dataclass(frozen=True)
class PoleShape:
    """The order of one block: its sections of two poles, and whether it has a single pole.

    Attributes:
        pairs: number of sections of second order.
        single: whether a real pole is added.
        ports: m_i.
    """

    pairs: int
    single: bool
    ports: int

    @property
    def poles(self) -> int:
        """Number of unknown pole coefficients, the order n."""
        return 2 * self.pairs + self.single

    @property
    def size(self) -> int:
        """Unknowns of the block: pole coefficients, then gains (symmetric, m_i x m_i) of the sections, then D."""
        return self.poles + (self.poles + 1) * (self.ports * (self.ports + 1) // 2)

    def basis(self, x: Matrix) -> PoleBasis:
        """The poles of the block in the z plane."""
        out: list[complex] = []
        for c_0, c_1 in np.exp(x[: 2 * self.pairs]).reshape(-1, 2):
            roots = np.roots([1.0, c_1, c_0])
            z = (1.0 + roots / 2.0) / (1.0 - roots / 2.0)
            if abs(roots[0].imag) > 0.0:
                out += [complex(z[0]), complex(z[0]).conjugate()]
            else:
                out += [complex(p.real) for p in z]
        if self.single:
            c = float(np.exp(x[2 * self.pairs]))
            out.append(complex((1.0 - c / 2.0) / (1.0 + c / 2.0)))
        return PoleBasis(tuple(out))

    def functions(self, x: Matrix, angles: Matrix) -> tuple[ComplexArray, ComplexArray]:
        """The sections' responses (angles x (n + 1), D's last) and their slopes.

        The slopes, angles x n x (n + 1), are with respect to the logarithms of the pole coefficients.
        """
        lam = 2j * np.tan(np.minimum(angles, np.pi - 1e-9) / 2.0)
        n = self.poles
        f = np.zeros((len(angles), n + 1), dtype=np.complex128)
        df = np.zeros((len(angles), n, n + 1), dtype=np.complex128)
        f[:, n] = 1.0
        for j, (c_0, c_1) in enumerate(np.exp(x[: 2 * self.pairs]).reshape(-1, 2)):
            q = 1.0 / (lam**2 + c_1 * lam + c_0)
            f[:, 2 * j] = c_0 * q
            f[:, 2 * j + 1] = np.sqrt(c_0) * lam * q
            df[:, 2 * j, 2 * j] = c_0 * q - (c_0 * q) ** 2
            df[:, 2 * j, 2 * j + 1] = np.sqrt(c_0) * lam * q * (0.5 - c_0 * q)
            df[:, 2 * j + 1, 2 * j] = -c_0 * c_1 * lam * q**2
            df[:, 2 * j + 1, 2 * j + 1] = -np.sqrt(c_0) * c_1 * lam**2 * q**2
        if self.single:
            c = np.exp(x[2 * self.pairs])
            f[:, n - 1] = c / (lam + c)
            df[:, n - 1, n - 1] = c * lam / (lam + c) ** 2
        return f, df


@dataclass(frozen=True, eq=False)
class FreePoleFamily(Family):
    """Couplings of given order per block with free poles; x holds the blocks' unknowns one after the other.

    Attributes:
        loop: the normalised loop.
        shapes: order and ports of each block.
        levels: Delta of each block in scaled ports.
    """

    loop: NormalisedLoop
    shapes: tuple[PoleShape, ...]
    levels: tuple[Matrix, ...]

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return sum(shape.size for shape in self.shapes)

    @property
    def affine(self) -> bool:
        """False: the response is not affine in the poles."""
        return False

    def grid(self, x: Matrix) -> Matrix:
        """Angles that resolve the poles of E and of the couplings; dense, as the poles of F(E,V) are not known here."""
        poles = [np.array(shape.basis(part).poles) for shape, part in zip(self.shapes, self.parts(x), strict=True)]
        density = 40 if self.loop.aim.objective == "loop-shaping" else _DENSE
        return frequency_grid(np.concatenate([self.loop.weighted.poles(), *poles]).astype(np.complex128), density)

    def parts(self, x: Matrix) -> list[Matrix]:
        """Each block's unknowns."""
        return list(np.split(x, np.cumsum([shape.size for shape in self.shapes])[:-1]))

    def block(self, i: int, x: Matrix, angles: Matrix) -> tuple[ComplexArray, ComplexArray]:
        """V of block i and its slopes: angles x m_i x m_i, angles x unknowns x m_i x m_i."""
        shape = self.shapes[i]
        units = symmetric_units(shape.ports)
        f, df = shape.functions(x, angles)
        gains = np.tensordot(x[shape.poles :].reshape(shape.poles + 1, -1), units, axes=1)
        v = np.tensordot(f, gains, axes=1)
        poles = np.tensordot(df, gains, axes=1)
        rest = (f[:, :, None, None, None] * units).reshape(len(angles), -1, shape.ports, shape.ports)
        return np.asarray(v), np.concatenate([poles, rest], axis=1)

    def _blocks(self, x: Matrix, angles: Matrix) -> tuple[list[ComplexArray], list[ComplexArray]]:
        found = [self.block(i, part, angles) for i, part in enumerate(self.parts(x))]
        return [v for v, _ in found], [slope for _, slope in found]

    def responses(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """G at ``angles``."""
        v, _ = self._blocks(x, angles)
        return self.loop.weighted.factors(self.loop.coupling(v, angles), angles)[0]

    def derivatives(self, x: Matrix, angles: Matrix) -> ComplexArray:
        """The slopes of G at ``angles``."""
        v, slopes = self._blocks(x, angles)
        return self.loop.derivatives(v, slopes, angles)

    def passivity(self, i: int, x: Matrix, angles: Matrix) -> tuple[ComplexArray, ComplexArray]:
        """The passivity condition of block i, angles x m_i x m_i Hermitian, and its slopes, angles x unknowns x ..."""
        v, slopes = self.block(i, x, angles)
        X = v - self.loop.kappa * np.eye(self.shapes[i].ports)
        factor = (0.5 + 0.5j / np.tan(np.clip(angles, 1e-9, np.pi) / 2.0))[:, None, None]
        Delta = self.levels[i]
        XD = np.conj(np.swapaxes(X, 1, 2)) @ Delta
        value = _hermitian_part(factor * X) - XD @ X
        slope = _hermitian_part(factor[:, None] * slopes - 2.0 * XD[:, None] @ slopes)
        return value, slope

    def tightest(self, i: int, x: Matrix) -> tuple[Matrix, Matrix]:
        """Angles where block i is least passive, and the least eigenvalues there; the smallest first."""
        poles = np.array(self.shapes[i].basis(x).poles, dtype=np.complex128)
        grid = frequency_grid(poles, per_decade=20)[1:]

        def depth(angles: Matrix) -> Matrix:
            return np.asarray(-np.linalg.eigvalsh(self.passivity(i, x, angles)[0])[:, 0])

        angles, depths = refined_peaks(depth, grid, passes=2)
        return angles, np.asarray(-depths)

    def constrain(self, program: LinearMatrixProgram, x: Matrix) -> None:
        """Require passivity, linearised at x, where it is tightest and on a coarse grid."""
        at = 0
        for i, (part, shape) in enumerate(zip(self.parts(x), self.shapes, strict=True)):
            angles = np.concatenate([self.tightest(i, part)[0], np.geomspace(1e-4, np.pi, _CHECKED)])
            value, slope = self.passivity(i, part, angles)
            v, static = self.block(i, part, np.zeros(1))
            value = np.concatenate([value, v - self.loop.kappa * np.eye(shape.ports)])
            slope = np.concatenate([slope, static])
            constant = value - np.tensordot(slope, part, axes=((1,), (0,))) - ROOM * np.eye(shape.ports)
            for c, s in zip(constant, slope, strict=True):
                wide = np.zeros((program.size, shape.ports, shape.ports), dtype=np.complex128)
                wide[at : at + shape.size] = s
                program.hermitian(c, wide)
            at += shape.size

    def trust(self, x: Matrix, radius: float) -> tuple[Matrix, Matrix]:
        """Bounds with which logarithms of pole coefficients move by the radius, and gains by a part of themselves."""
        low, high = [], []
        for part, shape in zip(self.parts(x), self.shapes, strict=True):
            gains = part[shape.poles :]
            span = np.full(len(part), radius)
            span[shape.poles :] = radius * np.maximum(2.0 * np.abs(gains), max(self.loop.kappa, np.max(np.abs(gains))))
            span[: shape.poles] = min(radius, 0.5)
            low.append(part - span)
            high.append(part + span)
        return np.concatenate(low), np.concatenate(high)

    def restored(self, x: Matrix) -> Matrix | None:
        """The unknowns x with D raised until the blocks are passive, and dampings within bounds; None if that fails."""
        x = x.copy()
        for i, (part, shape) in enumerate(zip(self.parts(x), self.shapes, strict=True)):  # parts are views
            pairs = part[: 2 * shape.pairs].reshape(-1, 2)
            ratio = 2.0 * pairs[:, 1] - pairs[:, 0]
            pairs[:, 1] = (np.clip(ratio, np.log(_LEAST_DAMPING), np.log(_MOST_DAMPING)) + pairs[:, 0]) / 2.0
            diagonal = np.cumsum(np.arange(1, shape.ports + 1)) - 1  # of the lower triangle by rows
            D = part[len(part) - shape.ports * (shape.ports + 1) // 2 :]
            before = np.inf
            for _ in range(_REPAIRS):
                static = self.block(i, part, np.zeros(1))[0][0].real - self.loop.kappa * np.eye(shape.ports)
                missing = ROOM - min(self.tightest(i, part)[1][0], float(np.linalg.eigvalsh(static)[0]) / 2.0)
                if missing <= 0.0:
                    break
                if not missing < before:
                    return None  # the block is too compliant for the level, and a greater D adds compliance
                before = missing
                D[diagonal] += 2.05 * missing
            else:
                return None
        return x


def fitted(shape: PoleShape, logs: Matrix, v: ComplexArray, angles: Matrix) -> Matrix:
    """The unknowns of a block with given pole coefficients and the response nearest to ``v`` (angles x m_i x m_i)."""
    f, _ = shape.functions(np.concatenate([logs, np.zeros(shape.size - shape.poles)]), angles)
    rows, columns = np.tril_indices(shape.ports)
    right = v[:, rows, columns]
    gains = np.linalg.lstsq(np.concatenate([f.real, f.imag]), np.concatenate([right.real, right.imag]), rcond=1e-12)[0]
    return np.asarray(np.concatenate([logs, gains.ravel()]), dtype=np.float64)


def section(frequency: float, damping: float) -> Matrix:
    """Logarithms of c_0, c_1 for a resonance at ``frequency`` (rad a sample) with a damping ratio."""
    Omega = 2.0 * np.tan(frequency / 2.0)
    return np.asarray(np.log(np.array([Omega**2, 2.0 * damping * Omega])))


def _hermitian_part(M: ComplexArray) -> ComplexArray:
    return np.asarray((M + np.conj(np.swapaxes(M, -1, -2))) / 2.0)
