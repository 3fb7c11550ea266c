"""The contract between the parties: levels, the storage that proves them, and condition (10).

Each party promises a level from data that it sees itself; together they make the loop stable when (10) of
[Bianchini2010]_ holds. This module is what synthesis and verification have in common: the words, not the methods.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from manyhands.design.statespace import Matrix


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels and storage matrices that are claimed to satisfy Theorem 3, in physical units.

    Attributes:
        Delta_V: m x m, N*s/m, with the structure of V: V_hat,i is Delta_V,i-OSP.
        Phi_E: m x m, N*s/m: E_hat is (-Phi_E)-ISP.
        P_E: storage matrix of E_hat, in the coordinates of :attr:`manyhands.design.problem.HapticLoop.E_hat`.
        P_V: storage matrix of each V_hat,i, in the realisation (12) of its block.
    """

    Delta_V: Matrix
    Phi_E: Matrix
    P_E: Matrix
    P_V: tuple[Matrix, ...]


def loop_inequality(Delta_D: Matrix, Delta_V: Matrix, Phi_E: Matrix) -> Matrix:
    """The left-hand side of (10), 2m x 2m, N*s/m; its least eigenvalue is the certificate's margin."""
    return np.block([[Delta_D - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]])
