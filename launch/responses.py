"""What a design does over frequency: the responses that its pictures draw, for many frequencies at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from manyhands.design.partition import Partition
from manyhands.design.statespace import Matrix, StateSpace, frequency_response

Complex = NDArray[np.complex128]
Filter = Callable[[complex], complex]
"""A weight's response at a point of the z plane."""

_DECADES, _PER_DECADE = 4.0, 100  # of a grid up to pi/T, evenly spaced in the logarithm
_MOST_RESONANCES = 40  # poles, nearest to the circle first, whose neighbourhood is looked at besides
_CHUNK = 4_000_000  # complex numbers that are solved for at once, 64 MB


def frequencies(systems: Sequence[StateSpace], T: float) -> Matrix:
    """Frequencies (rad/s, ascending, up to pi/T) that show what the discrete ``systems`` do, their resonances too."""
    grid = np.pi * np.logspace(-_DECADES, 0.0, round(_DECADES * _PER_DECADE) + 1)
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in systems])
    poles = poles[(np.abs(poles) > 0.5) & (poles.imag > 0.0)]  # a pole far from the circle has no peak on it
    poles = poles[np.argsort(-np.abs(poles))][:_MOST_RESONANCES]
    steps = np.linspace(-2.0, 2.0, max(7, 200 // max(len(poles), 1) | 1))  # of a peak's half width; odd, so with 0
    near = [np.angle(poles) + step * (1.0 - np.abs(poles)) for step in steps]
    angles = np.unique(np.concatenate([grid, *near]))
    return np.asarray(angles[(angles >= grid[0]) & (angles <= np.pi)] / T)


def response(system: StateSpace, angles: Matrix) -> Complex:
    """C (zI - A)^-1 B + D at z = e^{j angle}, angles x m x p, a part at a time so that memory stays bounded."""
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


def shaped_response(
    E: Complex, V: Complex, F: Complex, points: Complex, W1: Filter | None, W2: Filter | None, objective: str | None
) -> tuple[str, Complex]:
    """What the objective keeps small, with its name: W1 E V W2, W1 (F - E) W2, or E V where there is no objective.

    Args:
        E: response of the environment, points x m x m.
        V: of the coupling.
        F: of the closed loop.
        points: z of each.
        W1: weight on the left; None for 1.
        W2: weight on the right; None for 1.
        objective: "loop-shaping", "closed-loop", or anything else.
    """
    if objective not in ("loop-shaping", "closed-loop"):
        return "E V", E @ V
    weight = np.array([(W1(z) if W1 else 1.0) * (W2(z) if W2 else 1.0) for z in points])[:, None, None]
    if objective == "closed-loop":
        return "W₁ (F(E,V) − E) W₂", weight * (F - E)
    return "W₁ E V W₂", weight * (E @ V)
