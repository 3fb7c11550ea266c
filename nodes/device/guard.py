"""What a device may exert and reach, checked by the device itself: nobody else need be trusted for it.

The device's own displacement and speed beyond a limit end the session; a force beyond its limit is clipped, last before
the actuator. The couplings clip to the same limits already, so that a force to be clipped here means that a coupling
misbehaves.
"""

from __future__ import annotations

from collections.abc import Sequence

from manyhands.nodes.bundle import Limits
from manyhands.nodes.linear_map import Floats
from manyhands.nodes.saturation import Saturation


class LimitExceeded(Exception):
    """A device went beyond its displacement or its speed; says which, where, and by how much."""


class Guard:
    """Watches over one device."""

    def __init__(self, limits: Limits, T: float, axes: Sequence[str]) -> None:
        """Watch from the first sample on.

        Args:
            limits: one entry an axis.
            T: period, s.
            axes: the device's ports, for the sentences.
        """
        self._axes, self._T = tuple(axes), T
        self._displacement, self._speed = limits.displacement, limits.speed
        self._saturation = Saturation(limits.force)
        self._before: Floats | None = None

    @property
    def clipped(self) -> int:
        """Ticks whose force was clipped here."""
        return self._saturation.ticks

    def breach(self, x: Floats, periods: int = 1) -> str | None:
        """What is wrong with the displacement x(k), m, in one sentence; None if it is within its limits.

        ``periods`` have passed since the sample before: more than one where a tick was late.

        The first sample has no speed: a device may be switched on anywhere within its reach. ``x`` is kept for then.
        """
        before, self._before = self._before or x, x
        T = self._T * periods
        for axis, (at, last) in enumerate(zip(x, before, strict=True)):
            if not abs(at) <= self._displacement[axis]:
                return self._sentence(axis, "displacement", at, self._displacement[axis], "m")
            if not abs(at - last) <= T * self._speed[axis]:
                return self._sentence(axis, "speed", (at - last) / T, self._speed[axis], "m/s")
        return None

    def clip(self, f: Floats) -> Floats:
        """The force to apply for f_v(k), N: within the limits of every axis, and counted if it was not."""
        return self._saturation.clip(f)

    def _sentence(self, axis: int, quantity: str, found: float, limit: float, unit: str) -> str:
        return (
            f"found a {quantity} of {found:.6g} {unit} at {self._axes[axis]}; expected at most {limit:g} {unit}, its "
            "limit; see what moved it, or raise the limit in the session file"
        )
