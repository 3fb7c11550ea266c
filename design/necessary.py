"""Conditions on one block of a coupling, cheap enough to test before any solver runs.

V_hat,i = (z-1)/(Tz) [V_i - K_i] is OSP at some level only if its Hermitian part is non-negative on the
unit circle. At its two ends, z -> 1 and z = -1, that is

    V(1) = V(1)^T > K,            for springs and dampers   K_s T/2 < Delta_D,
    V(-1) + V(-1)^T > 2 K,                                  K_s T/2 + B_s < Delta_D

(K_s, B_s stiffness and damping), which names the limit and what would relax it.
"""

from __future__ import annotations

import numpy as np

from manyhands.design.contract import NO_DELAY_GAIN
from manyhands.design.coupling import SpringDamper
from manyhands.design.errors import Infeasible
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.transformation import transformed_coupling

_FREQUENCIES = 400
_ROUNDING = 1e-9  # relative to the largest gain on the circle
_EDGE = 1e-12  # relative: so near to the limit, exact arithmetic may find a coupling beyond it


def check_spring_damper(name: str, coupling: SpringDamper, Lambda: Matrix, T: float, kappa: float) -> None:
    """Test K_s > 0, J = Lambda - T/2 K_s > 0 and J - B >= 0: exactly when V_hat of springs and dampers is OSP.

    Args:
        name: of the block, for the message.
        coupling: stiffness and damping of the block.
        Lambda: Delta_D / (2 kappa), m_i x m_i, N*s/m.
        T: period, s.
        kappa: gain of the loop transformation, 1/2 without delay.

    Raises:
        Infeasible: V_hat is OSP at no level.
    """
    if float(np.linalg.eigvalsh(coupling.stiffness)[0]) <= 0.0:
        raise Infeasible(
            f"coupling {name}: V(1) is not positive, so that V_hat is output strictly passive at no level",
            ("put a spring of positive stiffness between hand and tool in every direction",),
        )
    inverse = np.linalg.inv(np.linalg.cholesky(Lambda))
    limit = 2.0 / T * float(np.linalg.eigvalsh(Lambda)[0])
    for part, meaning in (
        (T / 2.0 * coupling.stiffness, "stiffness"),
        (T / 2.0 * coupling.stiffness + coupling.damping, "stiffness plus 2/T times its damping"),
    ):
        used = float(np.linalg.eigvalsh(symmetric_part(inverse @ part @ inverse.T))[-1])
        if not used < 1.0 - _EDGE:
            raise _too_stiff(name, meaning, used * limit, limit, T, kappa, period=meaning == "stiffness")


def _too_stiff(name: str, meaning: str, found: float, limit: float, T: float, kappa: float, period: bool) -> Infeasible:
    formula = "2 Delta_D / T" if kappa == NO_DELAY_GAIN else f"Delta_D / ({kappa:.4g} T)"
    return Infeasible(
        f"coupling {name}: its {meaning}, {found:.4g} N/m, is not below {formula} = {limit:.4g} N/m, so that "
        "V_hat is output strictly passive at no level",
        (
            f"a {meaning} below {limit:.4g} N/m",
            f"devices with an osp above {found * kappa * T:.4g} N*s/m",
            *((f"a period below {T * limit / found * 1e3:.3g} ms",) if period else ()),
            *(("a shorter delay inside the tick",) if kappa != NO_DELAY_GAIN else ()),
        ),
    )


def check_block(name: str, block: StateSpace, K: Matrix, T: float, kappa: float = NO_DELAY_GAIN) -> None:
    """Test the necessary conditions on the linear block ``name`` of V.

    Args:
        name: of the coupling, for the message.
        block: V_i, discrete, force (N) to displacement (m).
        K: the block K_i of the transformation, m/N.
        T: period, s.
        kappa: gain of the loop transformation, for the message.

    Raises:
        Infeasible: V_hat,i is OSP at no level.
    """
    if np.max(np.abs(np.linalg.eigvals(block.A)), initial=0.0) >= 1.0:
        raise Infeasible(
            f"coupling {name}: V is not stable",
            ("give every mode of the coupling some damping, and every direction a spring of positive stiffness",),
        )
    limit = 1.0 / float(np.linalg.eigvalsh(K)[-1])
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
        raise _too_stiff(name, meaning, 1.0 / softest, limit, T, kappa, period=point == 1.0)
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
