"""Responses of a loop over frequency: the environment E, the coupling V, and F(E, V), which the hands feel.

They prove nothing and need no solver: they are computed from the systems themselves, for many frequencies at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.statespace import Matrix, StateSpace, frequency_response
from manyhands.design.problem import HapticLoop

Complex = NDArray[np.complex128]

_DECADES, _PER_DECADE = 4.0, 100  # of a logarithmic grid up to pi/T
_MOST_RESONANCES = 40  # poles, nearest to the unit circle first, around which the grid is refined
_CHUNK = 4_000_000  # complex numbers that are solved for at once, 64 MB


@dataclass(frozen=True, eq=False)
class FrequencyResponses:
    """Responses at z = e^{j omega T}.

    Attributes:
        omega: n frequencies, rad/s.
        E: n x m x m, N/m, the environment's impedance.
        V: n x m x m, m/N, the coupling's compliance.
        F: n x m x m, N/m, F(E, V) = (I + E V)^-1 E, the impedance that the hands feel.
    """

    omega: Matrix
    E: Complex
    V: Complex
    F: Complex

    __repr__ = brief_repr


def responses_of(
    loop: HapticLoop, E: StateSpace, blocks: Sequence[StateSpace], omega: ArrayLike | None = None
) -> FrequencyResponses:
    """The responses of a loop; see :meth:`.Certificate.frequency_responses`.

    Args:
        loop: the loop.
        E: the environment's impedance.
        blocks: the coupling's blocks, in the partition's order.
        omega: as there.
    """
    T = loop.period
    at = frequencies([E, *blocks], T) if omega is None else np.atleast_1d(np.asarray(omega, float))
    if at.ndim != 1 or not np.all((at >= 0.0) & (at <= np.pi / T * (1.0 + 1e-12))):
        raise ValueError(f"omega: expected frequencies from 0 to pi/T = {np.pi / T:.6g} rad/s in one dimension")
    E_z = response(E, at * T)
    V_z = coupling_response(blocks, loop.partition, at * T)
    if loop.series:
        V_z = V_z - response(loop.counted, at * T)
    return FrequencyResponses(at, E_z, V_z, closed_loop(E_z, V_z))


def frequencies(systems: Sequence[StateSpace], T: float) -> Matrix:
    """Frequencies (rad/s, ascending, up to pi/T) that resolve the responses of ``systems``, resonances included."""
    grid = np.pi * np.logspace(-_DECADES, 0.0, round(_DECADES * _PER_DECADE) + 1)
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in systems])
    poles = poles[(np.abs(poles) > 0.5) & (poles.imag > 0.0)]  # a pole far from the circle has no peak on it
    poles = poles[np.argsort(-np.abs(poles))][:_MOST_RESONANCES]
    steps = np.linspace(-2.0, 2.0, max(7, 200 // max(len(poles), 1) | 1))  # of a peak's half width; odd, so with 0
    near = [np.angle(poles) + step * (1.0 - np.abs(poles)) for step in steps]
    angles = np.unique(np.concatenate([grid, *near]))
    return np.asarray(angles[(angles >= grid[0]) & (angles <= np.pi)] / T)


def response(system: StateSpace, angles: Matrix) -> Complex:
    """C (zI - A)^-1 B + D at z = e^{j angle}, angles x m x p; solved in parts, so that memory stays bounded."""
    size = max(1, _CHUNK // max(1, system.order * (system.order + system.inputs)))
    parts = [frequency_response(system, angles[at : at + size]) for at in range(0, len(angles), size)]
    return np.concatenate(parts)


def coupling_response(blocks: Sequence[StateSpace], partition: Partition, angles: Matrix) -> Complex:
    """V at z = e^{j angle}, angles x m x m, block by block."""
    out = np.zeros((len(angles), partition.size, partition.size), dtype=np.complex128)
    for ports, block in zip(partition.blocks, blocks, strict=True):
        out[np.ix_(range(len(angles)), ports, ports)] = response(block, angles)
    return out


def closed_loop(E: Complex, V: Complex) -> Complex:
    """F(E,V) = (I + E V)^-1 E, angles x m x m, from the responses of E and V."""
    return np.asarray(np.linalg.solve(np.eye(E.shape[1]) + E @ V, E))
