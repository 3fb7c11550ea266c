"""The best passivity levels of a system: the greatest Delta with which it is OSP, the greatest Phi for ISP.

Both are searched with Lemma 1 of [Bianchini2010]_, in which the level enters linearly,

    maximise  d (level d I)   or   trace of the level    subject to   P > 0,  M(P) <= 0,

and may come out negative: what a system lacks. The optimum of the program is an edge, so the level is lowered by as
little as lets :func:`~manyhands.design.lemma1.analyse` find and check a storage matrix. What is returned is proved,
and for the shape "scalar" held against a figure that no storage matrix can beat,

    d <= least (w^* y - w^* Phi w) / y^* y    (output),      d <= least (w^* y - y^* Delta y) / w^* w    (input)

over all pairs of the unit circle, exactly (:mod:`manyhands.design.level_sets`).

Some directions can have no positive level whatever the rest does: the output of an undamped mode (an integrator of
E_hat), the input at a zero on the circle (the differentiator of V_hat). Where the level 0 is possible there, it is set
exactly, and the search goes on in the other directions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from manyhands.design.cayley import Time, in_discrete_time
from manyhands.design.errors import Infeasible
from manyhands.design.lemma1 import checked_levels
from manyhands.design.level_search import Level, Role, Search, best_level, frequency_bound, idle_directions
from manyhands.design.partition import Partition
from manyhands.design.passivity import kernel
from manyhands.design.statespace import Matrix, StateSpace

Shape = Literal["scalar", "diagonal", "matrix"] | Partition
"""d I; a diagonal; any symmetric matrix; one with the block structure of a partition."""

_SILENT = 1e-9  # of the largest: an output smaller than that is none


def greatest_output_level(
    system: StateSpace, shape: Shape = "scalar", Phi: Matrix | None = None, time: Time = "discrete"
) -> Level:
    """The greatest Delta with which ``system`` is Delta-OSP (and Phi-ISP): greatest d, or greatest trace.

    Args:
        system: (A, B, C, D), m x m.
        shape: which Delta are allowed; d is maximised for "scalar", the trace for the others.
        Phi: m x m input level that is to hold besides; zero by default.
        time: how ``system`` is read.

    Raises:
        Infeasible: no level of this shape.
        ValueError: an argument of the wrong shape, or an output that is zero in some direction, where any level holds.
        SolverFailure: the solver gave no usable answer.
    """
    return _greatest(system, shape, "output", Phi, time)


def greatest_input_level(
    system: StateSpace, shape: Shape = "scalar", Delta: Matrix | None = None, time: Time = "discrete"
) -> Level:
    """The greatest Phi with which ``system`` is Phi-ISP (and Delta-OSP): greatest d, or greatest trace.

    Args:
        system: (A, B, C, D), m x m.
        shape: which Phi are allowed; d is maximised for "scalar", the trace for the others.
        Delta: m x m output level that is to hold besides; zero by default.
        time: how ``system`` is read.

    Raises:
        Infeasible: no level of this shape, as for an unstable system.
        ValueError: an argument of the wrong shape.
        SolverFailure: the solver gave no usable answer.
    """
    return _greatest(system, shape, "input", Delta, time)


def _greatest(system: StateSpace, shape: Shape, role: Role, other: Matrix | None, time: Time) -> Level:
    m = system.inputs
    Delta, Phi = checked_levels(system, *((None, other) if role == "output" else (other, None)))
    if isinstance(shape, Partition) and shape.size != m:
        raise ValueError(f"expected a partition of {m} ports, found one of {shape.size}")
    discrete, _ = in_discrete_time(system, time)
    seen = np.linalg.svd(np.hstack([discrete.C, discrete.D]), compute_uv=False)
    if role == "output" and (seen[0] == 0.0 or (shape != "scalar" and seen[-1] <= _SILENT * seen[0])):
        raise ValueError("the output is zero in some direction: every level holds there")
    basis, fixed = _span(shape, m), Phi if role == "output" else Delta
    search = Search(system, time, discrete, role, fixed, basis, shape == "scalar")
    bound = frequency_bound(search) if search.scalar else None
    idle = idle_directions(search)
    found = best_level(replace(search, basis=_silent_on(basis, idle)), bound) if idle.shape[1] else None
    found = best_level(search, bound) if found is None else found
    if found is None:
        raise Infeasible(f"the system has no {role} level of this shape: no positive storage function at any", ())
    return found


def _span(shape: Shape, m: int) -> Matrix:
    """Symmetric matrices that span the levels of ``shape``, k x m x m."""
    if shape == "scalar":
        return np.eye(m)[None]
    if shape == "diagonal":
        blocks: tuple[tuple[int, ...], ...] = tuple((i,) for i in range(m))
    else:
        blocks = shape.blocks if isinstance(shape, Partition) else (tuple(range(m)),)
    out = []
    for block in blocks:
        for a, i in enumerate(block):
            for j in block[a:]:
                unit = np.zeros((m, m))
                unit[i, j] = unit[j, i] = 1.0
                out.append(unit)
    return np.stack(out)


def _silent_on(basis: Matrix, directions: Matrix) -> Matrix:
    """The levels of a span that are zero on ``directions`` (m x k)."""
    equations = np.stack([(L @ directions).ravel() for L in basis], axis=1)
    return np.asarray(np.tensordot(kernel(equations).T, basis, axes=1))
