"""Condition (10), the contract between the parties: their levels, and the storage that proves each.

Each party promises a level that follows from its own data alone. Together the levels make the loop stable if (10) of
[Bianchini2010]_ holds; :mod:`manyhands.design.proof.contract` proves it for a certificate. Synthesis and certificates
share these definitions, and no method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import Partition
from manyhands.design.models.statespace import Matrix, symmetric_part
from manyhands.design.models.transfer import InDifferences

NO_DELAY_GAIN: Final = 0.5
"""kappa of (8), K = kappa T Delta_D^{-1}, if the force acts at the instant of its sample."""

ENERGY: Final = "energy"
"""The storage of a network that needs no matrix: its mechanical energy."""

ENFORCED: Final = "enforced"
"""In place of a storage: the level is not proved; a passivity controller enforces it at run time."""


@dataclass(frozen=True)
class DeviceShare:
    """The part of the device's level that remains behind the sampler, with a delay inside the tick.

    G_hat is (share Delta_D)-OSP with K = kappa T Delta_D^{-1}.

    Attributes:
        kappa: dimensionless gain of the loop transformation; 1/2 without delay (8).
        share: dimensionless, 1 without delay (9).
        c: dimensionless weight of the storage (f_k - f_{k-1})^2 that proves it.
    """

    kappa: float = NO_DELAY_GAIN
    share: float = 1.0
    c: float = 0.0

    @property
    def part(self) -> float:
        """The a = 2 kappa share <= 1 that is share Delta_D in units of Lambda = Delta_D / (2 kappa)."""
        return 2.0 * self.kappa * self.share

    @property
    def weight(self) -> float:
        """What a motion costs at the worst answer: m = share + a^2/(b - c), a = 1/2 - share kappa, b = kappa a.

        F_t of :mod:`manyhands.design.levels.device` is, for g- = 0 and the worst g, sigma^2/lambda - m sigma^2.
        """
        a = 0.5 - self.share * self.kappa
        room = self.kappa * a - self.c
        return self.share + (a * a / room if room > 0.0 else 0.0)

    def longest_period(self, t: float) -> float:
        """The longest period, in units of T, of a tick whose force acts t T after its sample: F_t >= 0 up to

            lambda = 1/m - t^2/(4 c - t).

        Within the delay and the period that a certificate states it is at least that period. An earlier force leaves
        room for a later sample.
        """
        if t <= 0.0:
            return 1.0 / self.weight
        room = 4.0 * self.c - t
        return 1.0 / self.weight - t * t / room if room > 0.0 else 0.0


Storage = Matrix | InDifferences | Literal["energy", "enforced"]
"""What stands for E_hat's storage: a matrix, in Rest's states or in differences; or a word."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels and storage matrices that are claimed to satisfy Theorem 3, in physical units.

    Attributes:
        device: kappa, share and c.
        Delta_D: by block of V, m_i x m_i, N*s/m: the devices' level brought to the structure of V.
        Delta_V: by block of V, m_i x m_i, N*s/m: V_hat,i is Delta_V,i-OSP.
        Phi_E: m x m, N*s/m: E_hat is (-Phi_E)-ISP.
        P_E: storage matrix of Rest (:mod:`manyhands.design.models.integrators`), n x n, N*s/m in the units of its
            states; of rational functions in their differences; or "energy"; or "enforced", where nothing is proved.
        P_V: storage matrix of each linear block, n_i x n_i, in the state zeta = (xi - xi_)/T; None for springs and
            dampers, whose level is in closed form.
    """

    device: DeviceShare
    Delta_D: tuple[Matrix, ...]
    Delta_V: tuple[Matrix, ...]
    Phi_E: Matrix
    P_E: Storage
    P_V: tuple[Matrix | None, ...]

    __repr__ = brief_repr


def loop_inequality(Delta_G: Matrix, Delta_V: Matrix, Phi_E: Matrix) -> Matrix:
    """The left-hand side of (10), 2m x 2m, N*s/m; its least eigenvalue is the certificate's margin.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> D, V, Phi = (np.array([[level]]) for level in (1.37, 1.668, -0.463))
        >>> np.linalg.eigvalsh(passivity.loop_inequality(D, V, Phi)).round(3).tolist()
        [1.496, 2.468]
    """
    return np.block([[Delta_G - Phi_E, -Phi_E], [-Phi_E, Delta_V - Phi_E]])


def margin_of(Delta_G: Matrix, Delta_V: Matrix, Phi_E: Matrix) -> float:
    """The least eigenvalue of (10)."""
    return float(np.linalg.eigvalsh(symmetric_part(loop_inequality(Delta_G, Delta_V, Phi_E)))[0])


def margin(partition: Partition, levels: Levels) -> float:
    """The least eigenvalue of (10) at these levels, block by block where Phi_E has the structure of V."""
    share = levels.device.share
    if not partition.admits(levels.Phi_E):
        return margin_of(share * partition.embed(levels.Delta_D), partition.embed(levels.Delta_V), levels.Phi_E)
    parts = zip(levels.Delta_D, levels.Delta_V, partition.restrict(levels.Phi_E), strict=True)
    return min(margin_of(share * D, V, Phi) for D, V, Phi in parts)


def least_coupling_level(Delta_G: Matrix, Phi_E: Matrix) -> Matrix:
    """Phi_E + Phi_E (Delta_G - Phi_E)^{-1} Phi_E: (10) holds for every Delta_V above it (Schur complement).

    Raises:
        ValueError: Delta_G - Phi_E is not positive definite, so that (10) holds for no Delta_V.

    Example:
        >>> import numpy as np
        >>> from manyhands import passivity
        >>> passivity.least_coupling_level(np.array([[1.37]]), np.array([[0.5]])).round(3).tolist()
        [[0.787]]
    """
    rest = symmetric_part(Delta_G - Phi_E)
    if float(np.linalg.eigvalsh(rest)[0]) <= 0.0:
        raise ValueError("expected Phi_E < Delta_G")
    return symmetric_part(Phi_E + Phi_E @ np.linalg.solve(rest, Phi_E))
