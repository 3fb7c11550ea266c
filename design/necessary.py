"""Necessary conditions on one block of a coupling, cheap enough to test before any solver runs.

V_hat,i = (z-1)/(Tz) [V_i - K_i] is OSP at some level only if its Hermitian part is non-negative on the
unit circle. At its two ends, z -> 1 and z = -1, that is

    V(1) = V(1)^T > K,            for springs and dampers   K_s T/2 < Delta_D,
    V(-1) + V(-1)^T > 2 K,                                  K_s T/2 + B_s < Delta_D

(K_s, B_s stiffness and damping), which names the limit and what would relax it.
"""

from __future__ import annotations

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.transformation import transformed_coupling

_FREQUENCIES = 400
_ROUNDING = 1e-9  # relative to the largest gain on the circle


def check_block(name: str, block: StateSpace, K: Matrix, T: float) -> None:
    """Test the necessary conditions on the block ``name`` of V.

    Args:
        name: of the coupling, for the message.
        block: V_i, discrete, force (N) to displacement (m).
        K: the block K_i of the transformation, m/N.
        T: period, s.

    Raises:
        Infeasible: V_hat,i is OSP at no level.
    """
    if np.max(np.abs(np.linalg.eigvals(block.A)), initial=0.0) >= 1.0:
        raise Infeasible(
            f"coupling {name}: V is not stable",
            ("give every mode of the coupling some damping, and every direction a spring of positive stiffness",),
        )
    level = 2.0 / T * K  # Delta_D^{-1}
    limit = 2.0 / (T * float(np.linalg.eigvalsh(level)[-1]))
    for point, meaning in ((1.0, "stiffness"), (-1.0, "stiffness plus 2/T times its damping")):
        compliance = block.response(point).real
        # only where (z-1)/(Tz) vanishes does a skew part outweigh the symmetric one
        if point == 1.0 and np.max(np.abs(compliance - compliance.T)) > _ROUNDING * np.max(
            np.abs(compliance), initial=1e-300
        ):
            raise Infeasible(
                f"coupling {name}: V({point:g}) is not symmetric, so that V_hat is output strictly passive at no level",
                ("make the static compliance of the block symmetric",),
            )
        compliance = symmetric_part(compliance)
        softest = float(np.linalg.eigvalsh(compliance)[0])
        if float(np.linalg.eigvalsh(compliance - K)[0]) > 0.0:
            continue
        if softest <= 0.0:
            raise Infeasible(
                f"coupling {name}: V({point:g}) is not positive, so that V_hat is output strictly passive at no level",
                ("put a spring of positive stiffness between hand and tool in every direction",),
            )
        found = 1.0 / softest
        raise Infeasible(
            f"coupling {name}: its {meaning}, {found:.4g} N/m, is not below 2 Delta_D / T = {limit:.4g} N/m, so that "
            "V_hat is output strictly passive at no level",
            (
                f"a {meaning} below {limit:.4g} N/m",
                f"devices with an osp above {found * T / 2.0:.4g} N*s/m",
                *((f"a period below {T * limit / found * 1e3:.3g} ms",) if point == 1.0 else ()),
            ),
        )
    V_hat = transformed_coupling(block, K, T)
    for angle in np.linspace(np.pi / _FREQUENCIES, np.pi, _FREQUENCIES):
        response = V_hat.response(np.exp(1j * angle))
        least = float(np.linalg.eigvalsh((response + response.conj().T) / 2.0)[0])
        if not least >= -_ROUNDING * float(np.max(np.abs(response))):
            raise Infeasible(
                f"coupling {name}: V_hat is not passive at {angle / T:.4g} rad/s: the least eigenvalue of its "
                f"Hermitian part is {least:.3g} m/(N s)",
                ("lower the coupling's impedance around that frequency", "shorten the period"),
            )
