"""Bounds on a stable discrete system's output, and on its change in a tick, for bounded inputs.

With the impulse response h(0) = D, h(k) = C A^(k-1) B and |u_j(k)| <= a_j from rest, the output satisfies

    |y_i(k)| <= sum_j ||h_ij||_1 a_j,      ||h_ij||_1 = sum_k |h_ij(k)|,

and no smaller bound holds for every such input: the l1 norm is the gain from peak to peak ([Dahleh1987]_).

**The tail.** The norm is summed in strides of L ticks, A^L at a time. After q strides, with rho = ||A^(qL)||_inf < 1,
everything left is split as A^(qLj) A^(Ls) A^i, j >= 1, 0 <= s < q, 0 <= i < L, and

    sum_(k > qL) |h(k)| <= rho/(1 - rho) (sum_s ||row of C A^(Ls)||_1) (sum_i ||column of A^i B||_inf),

because |c M b| <= ||c||_1 ||M||_inf ||b||_inf. The tail is added, so that the result is a bound up to rounding. The sum
ends when the tail is negligible, or at a limit on the work; then the result is a bound too, with a greater tail.
"""

from __future__ import annotations

import numpy as np

from manyhands.design.models.statespace import Matrix, StateSpace

_NEGLIGIBLE = 1e-12  # tail relative to the largest norm
_STRIDE_ENTRIES = 2**18  # of the stride's A^i B in memory, 2 MiB
_LONGEST_STRIDE = 512  # ticks
_MOST_STRIDES = 4096  # takes one to two seconds; enough for poles at a distance of 1e-5 from the unit circle
_MOST_WORK = 1e9  # multiplications, as long; blocks of hundreds of states with slow poles reach this limit


def peak_gain(system: StateSpace) -> Matrix:
    """||h_ij||_1 of a discrete system, outputs x inputs; all ``inf`` if the system is not found to be stable."""
    n, p, m = system.order, system.inputs, system.outputs
    gain = np.abs(system.D)
    if n == 0:
        return gain
    if not float(np.max(np.abs(np.linalg.eigvals(system.A)))) < 1.0:
        return np.full((m, p), np.inf)
    length = int(np.clip(_STRIDE_ENTRIES // (n * p), 1, _LONGEST_STRIDE))
    columns, stride = _stride(system.A, system.B, length)  # [B, A B, ...], A^L
    reach = np.max(np.abs(columns), axis=0).reshape(length, p).sum(axis=0)
    rows, rows_seen, power = system.C, np.zeros(m), np.eye(n)
    tail: Matrix = np.full((m, p), np.inf)
    for _ in range(max(1, min(_MOST_STRIDES, int(_MOST_WORK / (m * n * p * length + n**3))))):
        gain = gain + np.abs(rows @ columns).reshape(m, length, p).sum(axis=1)
        rows_seen = rows_seen + np.abs(rows).sum(axis=1)
        rows, power = rows @ stride, power @ stride
        rho = float(np.max(np.abs(power).sum(axis=1)))
        if rho < 1.0:
            tail = rho / (1.0 - rho) * np.outer(rows_seen, reach)
            if np.max(tail) <= _NEGLIGIBLE * np.max(gain):
                break
    return np.asarray(gain + tail)


def output_bounds(system: StateSpace, amplitude: Matrix) -> tuple[Matrix, Matrix]:
    """The greatest |y_i(k)| and |y_i(k) - y_i(k-1)| from rest, for inputs |u_j(k)| <= amplitude_j.

    Args:
        system: discrete.
        amplitude: one entry per input, in its unit.

    Returns:
        Two vectors, one entry per output, in its unit; ``inf`` if the system is not found to be stable.
    """
    return _bound(system, amplitude), _bound(_increment(system), amplitude)


def _bound(system: StateSpace, amplitude: Matrix) -> Matrix:
    gain = peak_gain(system)
    # an input that is always zero moves nothing, even if its gain is infinite
    return np.asarray(np.where(amplitude > 0.0, gain, 0.0) @ amplitude)


def _increment(system: StateSpace) -> StateSpace:
    """The system from u to y(k) - y(k-1), whose state remembers y(k-1)."""
    n, m = system.order, system.outputs
    return StateSpace(
        np.block([[system.A, np.zeros((n, m))], [system.C, np.zeros((m, m))]]),
        np.vstack([system.B, system.D]),
        np.hstack([system.C, -np.eye(m)]),
        system.D,
    )


def _stride(A: Matrix, B: Matrix, length: int) -> tuple[Matrix, Matrix]:
    """[B, A B, ..., A^(length-1) B] and A^length."""
    parts, power = [B], np.eye(A.shape[0])
    for _ in range(length - 1):
        parts.append(A @ parts[-1])
    for _ in range(length):
        power = A @ power
    return np.hstack(parts), power
