"""Which part of the world's own contact springs is counted in series with the coupling, port by port.

Where one spring and damper k + b s joins port i to a mass or to ground, it is in series with the coupling. So the loop
may be cut inside that link: its compliance 1/(k + b s) is the sum of a part p/(k + b s), which joins the coupling, and
of (1 - p)/(k + b s), a link stiffer by 1/(1 - p) that stays in the world. Theorem 3 then applies to the pair

    V + C,   C = diag(p_i/(k_i + b_i s)),        and        E', the world with the stiffer links,

and the same pair is run. docs/decisions/0045-series-compliance.md has the proof.

**The choice of p.** For every aim of a design more is better: E' is a network, hence passive whatever p is, and the
couplings V + C that (10) admits do not depend on p, except through a Phi_E' < 0, which only adds to the margin. So p is
the greatest that two limits allow:

- ``most`` < 1: p = 1 would leave a link of infinite stiffness;
- p/k <= 0.9 times the least compliance kappa T/Delta_D that V + C can have, so that V itself keeps a tenth of it. A
  world that is softer than the coupling's limit would otherwise leave V a negative compliance.
"""

from __future__ import annotations

import math

import numpy as np

from manyhands.design.levels.contract import NO_DELAY_GAIN
from manyhands.design.levels.device import least_gain
from manyhands.design.models.environment import NetworkBox
from manyhands.design.models.network import Network
from manyhands.design.problem import HapticLoop

MOST = 0.999
"""The greatest part that is counted by default: what is left of the link is a thousand times as stiff."""
_DIGITS = 1000  # parts are whole thousandths: the same decimals on every machine
_KEPT = 0.9  # of the coupling's least compliance


def counted_parts(loop: HapticLoop, most: float = MOST) -> tuple[float, ...]:
    """The part of each port's own link that is counted; empty if no port has a link of its own.

    Args:
        loop: the loop; its ``series`` does not matter.
        most: the greatest part, more than 0 and less than 1.
    """
    environment = loop.environment
    if not isinstance(environment, Network | NetworkBox):
        return ()
    contacts = environment.contacts()
    kappa = NO_DELAY_GAIN if loop.punctual else least_gain(loop.tau / loop.period, loop.period_tolerance)
    out = [0.0] * len(loop.ports)
    for ports, gain in zip(loop.partition.blocks, loop.loop_gain(kappa), strict=True):
        least = _KEPT * float(np.linalg.eigvalsh(gain)[0])
        for port in ports:
            link = contacts.get(loop.ports[port])
            if link is not None:
                out[port] = math.floor(_DIGITS * min(most, link.stiffness * least)) / _DIGITS
    return tuple(out) if any(out) else ()
