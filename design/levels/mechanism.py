"""What a device may promise of its level, with all that is stated of its mechanism.

Dry friction adds to Delta_D below a speed (:mod:`manyhands.design.levels.dry_friction`), and held torques take from the
sum (:mod:`manyhands.design.levels.held_torque`).
"""

from __future__ import annotations

import numpy as np

from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.statespace import Matrix


class NothingLeft(ValueError):
    """Held torques may give out more than a device burns.

    Attributes:
        least: the least eigenvalue of its level, with what friction adds, N*s/m.
        taken: the damping that would pay for the torques, N*s/m; infinite where no damping does.
    """

    def __init__(self, least: float, taken: float, tau: float) -> None:
        self.least, self.taken = least, taken
        super().__init__(
            f"held: found an osp of {least:.6g} N·s/m; expected more than the {taken:.6g} N·s/m that held torques may "
            f"give out at a delay of {tau:g} s"
        )


def promised_level(
    level: Matrix,
    held: HeldTorque | None,
    friction: DryFriction | None,
    T: float,
    tau: float,
    period_tolerance: float,
) -> Matrix:
    """The level that a certificate, a bundle and an account count on, m x m, N*s/m.

    Args:
        level: Delta_D, m x m, N*s/m.
        held: how its motors hold torques; None where they hold the force itself.
        friction: its dry friction; None where none counts.
        T: period, s.
        tau: the longest delay inside the tick, s.
        period_tolerance: rho; periods are at most (1 + rho) T.

    Raises:
        NothingLeft: held torques leave nothing of it.
    """
    raised = level if friction is None else friction.raised(level)
    if held is None:
        return raised
    left = held.left(raised, T, tau, period_tolerance)
    if left is None:
        raise NothingLeft(float(np.linalg.eigvalsh(raised)[0]), held.damping(T, tau, period_tolerance), tau)
    return left
