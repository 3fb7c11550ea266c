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

import manyhands as mh

Matrix = NDArray[np.float64]

T, DAMPING = 1e-3, 1.37  # s, N·s/m
WALL = {
    "session": "wall",
    "period": T,
    "devices": {"d": {"dof": 1, "osp": DAMPING, "driver": "simulated", "mass": 0.2}},
    "couplings": {"c": {"devices": ["d"]}},
    "environment": {"type": "network", "links": [{"between": ["d", "ground"], "stiffness": 1e9}]},
    "design": {"coupling": "spring-damper"},
}
MASSES = T * DAMPING * 10.0 ** np.arange(-2.5, 3.1, 0.5)  # kg: from one that stops long before a tick is over
SPRINGS = (0.0, *DAMPING / T * 10.0 ** np.arange(-4.0, 2.1, 0.5))  # N/m


def certified(session: mh.Session, tau: float) -> mh.Certificate:
    """The stiffest coupling that is certified for delays up to ``tau`` (s)."""
    return mh.certify(session.replace({"design.objective": "stiffest", "design.tau": tau}))


def device(mass: float, spring: float, tau: float) -> tuple[Matrix, Matrix, Matrix]:
    """What a tick makes of (x, v), of the force before, which acts for ``tau`` more, and of the new one."""
    rates = np.array([[0.0, 1.0, 0.0], [-spring / mass, -DAMPING / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    early, late = expm(tau * rates), expm((T - tau) * rates)
    return late[:2, :2] @ early[:2, :2], late[:2, :2] @ early[:2, 2:], late[:2, 2:]


def shaken(E: mh.LinearSystem, stiffness: float, hand: tuple[Matrix, Matrix, Matrix]) -> bool:
    """Whether the loop grows: springs of ``stiffness`` (N/m) between the users, whose hands are alike, and E."""
    m, n = len(E.D), len(E.A)
    I = np.eye(m)
    free, old, new = (np.kron(I, part) for part in hand)
    N = np.linalg.inv(I + E.D / stiffness)
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


def onset(E: mh.LinearSystem, tau: float, start: float) -> float:
    """The least stiffness (N/m), above ``start``, at which one of the hands shakes the loop; to a thousandth."""
    hands = [device(mass, spring, tau) for mass in MASSES for spring in SPRINGS]
    low, high = start, start * 100.0
    while high > 1.0005 * low:
        middle = np.sqrt(low * high)
        found = [hand for hand in hands if shaken(E, middle, hand)]
        if found:
            high, hands = middle, found  # what shakes a softer coupling is among what shakes a stiffer one
        else:
            low = middle
    return float(high)


def rows() -> list[str]:
    """The table's rows."""
    out = []
    for name, session in (("one user, a rigid wall", mh.load(WALL)), ("three users, Example 1", mh.load("example1"))):
        for tau in (0.0, 0.5e-3):
            certificate = certified(session, tau)
            K = float(np.linalg.eigvalsh(certificate.stiffness)[0])
            real = onset(certificate.E, tau, K)
            out.append(f"| {name} | {1e3 * tau:g} | {K:.0f} | {real:.0f} | {K / real:.2f} |")
    return out


if __name__ == "__main__":
    print("| loop | τ, ms | certified, N/m | instability begins, N/m | ratio |\n|---|---|---|---|---|")
    print("\n".join(rows()))
