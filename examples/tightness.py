"""How tight a certificate is: the certified stiffness over the one at which instability really begins.

The table of docs/design.md, section 12. For each loop `manyhands` designs the stiffest coupling that it can certify.
Then the coupling is made stiffer, the same for all users, until some passive hand shakes the loop: a mass, with a
spring or without, that every user holds alike, on a device that has nothing but its promised damping. Hands are
searched by factors, so that the stiffness found is an upper bound of the one at which instability begins; for one
user on a rigid wall it is the limit that Colgate's condition states.

    python examples/tightness.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.synthesis import design

Matrix = NDArray[np.float64]

T, DAMPING = 1e-3, 1.37  # s, N·s/m
WALL = Network(("d0",), (), (NetworkLink(("d0", GROUND), 1e9, 0.0),))
EXAMPLE_1 = Network(
    ("d0", "d1", "d2"),
    (("hub", 3.0),),
    (
        NetworkLink(("d0", "hub"), 3800.0, 0.1),
        NetworkLink(("d1", "hub"), 3500.0, 0.2),
        NetworkLink(("d2", "hub"), 3300.0, 0.3),
        NetworkLink(("hub", GROUND), 2600.0, 0.5),
    ),
)
MASSES = T * DAMPING * 10.0 ** np.arange(-2.5, 3.1, 0.5)  # kg: from one that stops long before a tick is over
SPRINGS = (0.0, *DAMPING / T * 10.0 ** np.arange(-4.0, 2.1, 0.5))  # N/m


def certified(network: Network, tau: float) -> float:
    """The least stiffness (N/m) of the stiffest coupling that is certified for delays up to ``tau`` (s)."""
    m = len(network.ports)
    devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[DAMPING]])) for i in range(m))
    alone = Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m)))
    loop = HapticLoop("tightness", T, network.ports, devices, alone, network, tau)
    coupling = design(loop, SpringDamperWanted(Wish("stiffest"))).certificate.spring_damper
    assert coupling is not None  # noqa: S101  # it was asked for
    return float(np.linalg.eigvalsh(coupling.stiffness)[0])


def device(mass: float, spring: float, tau: float) -> tuple[Matrix, Matrix, Matrix]:
    """What a tick makes of (x, v), of the force before, which acts for ``tau`` more, and of the new one."""
    rates = np.array([[0.0, 1.0, 0.0], [-spring / mass, -DAMPING / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    early, late = expm(tau * rates), expm((T - tau) * rates)
    return late[:2, :2] @ early[:2, :2], late[:2, :2] @ early[:2, 2:], late[:2, 2:]


def shaken(network: Network, tau: float, stiffness: float, hand: tuple[Matrix, Matrix, Matrix]) -> bool:
    """Whether the loop grows: springs of ``stiffness`` (N/m) between the users, whose hands are alike, and E."""
    E, m = network.environment(T), len(network.ports)
    I = np.eye(m)
    free, old, new = (np.kron(I, part) for part in hand)
    N, n = np.linalg.inv(I + E.D / stiffness), E.order
    f = -N @ np.hstack([np.kron(E.D, [[1.0, 0.0]]), np.zeros((m, m)), E.C])  # of (x, v; f before; eta)
    tool = np.hstack([np.kron(I, [[1.0, 0.0]]), np.zeros((m, m + n))]) + f / stiffness
    loop = np.vstack(
        [
            np.hstack([free, old, np.zeros((2 * m, n))]) + new @ f,
            f,
            np.hstack([np.zeros((n, 3 * m)), E.A]) + E.B @ tool,
        ]
    )
    return bool(np.abs(np.linalg.eigvals(loop)).max() > 1.0 + 1e-9)


def onset(network: Network, tau: float, start: float) -> float:
    """The least stiffness (N/m), above ``start``, at which one of the hands shakes the loop; to a thousandth."""
    hands = [device(mass, spring, tau) for mass in MASSES for spring in SPRINGS]
    low, high = start, start * 100.0
    while high > 1.0005 * low:
        middle = np.sqrt(low * high)
        found = [hand for hand in hands if shaken(network, tau, middle, hand)]
        if found:
            high, hands = middle, found  # what shakes a softer coupling is among what shakes a stiffer one
        else:
            low = middle
    return float(high)


def rows() -> list[str]:
    """The table's rows."""
    out = []
    for name, network in (("one user, a rigid wall", WALL), ("three users, Example 1", EXAMPLE_1)):
        for tau in (0.0, 0.5e-3):
            K = certified(network, tau)
            real = onset(network, tau, K)
            out.append(f"| {name} | {1e3 * tau:g} | {K:.0f} | {real:.0f} | {K / real:.2f} |")
    return out


if __name__ == "__main__":
    print("| loop | τ, ms | certified, N/m | instability begins, N/m | ratio |\n|---|---|---|---|---|")
    print("\n".join(rows()))
