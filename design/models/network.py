"""Environments made of masses, springs and dampers, in any topology, discretised by backward Euler.

Links of stiffness k_l (N/m) and damping b_l (N*s/m) join the tool positions u = x_e (m ports) and the masses'
positions q (n masses). A link is as long as its ends are apart, e = a_1 u_1 - a_2 u_2, where a is the lever arm of an
end that turns (m/rad), and 1 otherwise. With the incidence of the links they give

    K, B in R^{(m+n) x (m+n)},    energy = 1/2 [u; q]^T K [u; q] + 1/2 q'^T M q',

and E maps u to the force that the tools must exert, so f_v = -E u. Backward Euler, s = (z-1)/(Tz) [Bianchini2010]_,
makes the mechanical energy a storage function of the *transformed* environment E_hat = E * Tz/(z-1), from tool velocity
to force: it is passive by construction. E_hat is given in coordinates in which that energy is T times the squared
norm of the state, because solvers are most accurate in this scaling.

**Discretisation.** Other environments E come in continuous time too. The loop needs passivity of E_hat = Tz/(z-1) E,
the map from the backward-difference velocity to force. Each method treats it in its own way.

- *Backward Euler*, s = (z-1)/(Tz), maps E(s)/s, the impedance from velocity, to E_hat itself, and the right half
  plane to the outside of a disc inside the unit disc: a passive E(s)/s gives a passive E_hat, with damping to spare.
  It also takes improper entries, k + b s + M s^2.
- *Tustin*, s = 2(z-1)/(T(z+1)), keeps the passivity of E(s)/s only with the trapezoidal velocity. With the backward
  difference, E_hat gains the factor 2z/(z+1). A spring stays passive. A damper keeps a pole at z = -1 and a mass a
  double one, so that improper entries are refused. Proper entries can lose passivity near the Nyquist frequency.
- *Zero-order hold* is exact at the ticks for a displacement that is held. E_hat is then T times the sampled impulse
  response of the impedance E(s)/s. Its Hermitian part is the sum of that of E(s)/s over all frequencies that sampling
  makes equal, and half the first sample. A passive and proper impedance stays passive.

The design does not assume any of this: it computes Phi_E for the E that results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.contacts import GROUND as GROUND
from manyhands.design.models.device import zero_order_hold
from manyhands.design.models.integrators import Split
from manyhands.design.models.kind import Counts, Environment, WhatRuns
from manyhands.design.models.statespace import Matrix, StateSpace, matrix, symmetric_part

_RANK_TOLERANCE = 1e-12  # relative pivot below which a direction of K stores no energy (double precision: 2e-16 * size)


@dataclass(frozen=True)
class NetworkLink:
    """A spring and a damper, in parallel, between two ends.

    Attributes:
        ends: two of the network's ports, masses, or :data:`GROUND`.
        stiffness: k >= 0, N/m.
        damping: b >= 0, N*s/m.
        arms: by how much the link's length changes with each end, > 0: 1, or of an end that turns its lever arm, m/rad.

    Example:
        >>> from manyhands import passivity
        >>> passivity.NetworkLink(("hand", "ground"), stiffness=500.0, damping=0.2)
        NetworkLink(ends=('hand', 'ground'), stiffness=500.0, damping=0.2, arms=(1.0, 1.0))
    """

    ends: tuple[str, str]
    stiffness: float
    damping: float
    arms: tuple[float, float] = (1.0, 1.0)

    @property
    def levers(self) -> bool:
        """Whether an end has a lever arm."""
        return self.arms != (1.0, 1.0)

    def with_values(self, stiffness: float, damping: float) -> NetworkLink:
        """The same link with another spring and damper."""
        return NetworkLink(self.ends, stiffness, damping, self.arms)


@dataclass(frozen=True)
class Network(Environment):
    """A spring-mass-damper network with ports.

    Attributes:
        ports: names of the m ports, in order.
        masses: name and mass (kg, > 0) of each of the n masses, in order.
        links: the links.

    Raises:
        ValueError: a name used twice, a link to an unknown end or to itself, a parameter that is negative or not
            finite, a mass or a lever arm that is not positive, or lever arms that contradict each other
            (:func:`scales`).

    Example:
        >>> from manyhands import passivity
        >>> Link = passivity.NetworkLink
        >>> ball = passivity.Network(("hand",), (("ball", 0.5),), (Link(("hand", "ball"), 2000.0, 0.3),))
        >>> ball.environment(T=0.001)
        StateSpace(A=[3 x 3], B=[3 x 1], C=[1 x 3], D=2289.47)
    """

    ports: tuple[str, ...]
    masses: tuple[tuple[str, float], ...]
    links: tuple[NetworkLink, ...]

    __repr__ = brief_repr
    counts: ClassVar[Counts] = "part"

    def __post_init__(self) -> None:
        names = [*self.ports, *(name for name, _ in self.masses), GROUND]
        known = set(names)
        if len(known) != len(names):
            raise ValueError(
                f"found the names {names[:-1]} of ports and masses; expected distinct ones, none of them {GROUND!r}"
            )
        for link in self.links:
            if not set(link.ends) <= known or link.ends[0] == link.ends[1]:
                raise ValueError(f"link between {link.ends}: expected two different ones of {sorted(known)}")
            if not (0.0 <= link.stiffness < np.inf and 0.0 <= link.damping < np.inf):
                raise ValueError(
                    f"link between {link.ends}: found stiffness {link.stiffness}, damping {link.damping}, "
                    "expected finite ones >= 0"
                )
            if not all(0.0 < arm < np.inf for arm in link.arms):
                raise ValueError(f"link between {link.ends}: found the arms {link.arms}; expected finite ones > 0")
        if any(link.levers for link in self.links):
            scales(self.links)
        for name, mass in self.masses:
            if not 0.0 < mass < np.inf:
                raise ValueError(f"mass {name}: found {mass} kg; expected a finite one > 0")

    def contacts(self) -> dict[str, NetworkLink]:
        """The link by which a port meets the rest of the world, by port; links in parallel are added.

        A port is left out if its links lead to several ends, or to another port, or if it has no stiffness: then no
        spring of its own is in series with whatever moves the port. It is left out as well where a link has a lever.
        """
        ports = set(self.ports)
        found: dict[str, NetworkLink] = {}
        several: set[str] = set()
        for link in self.links:
            for port, end in (link.ends, link.ends[::-1]):
                if port not in ports:
                    continue
                before = found.get(port)
                if end in ports or link.levers or (before is not None and before.ends[1] != end):
                    several.add(port)
                k, b = (0.0, 0.0) if before is None else (before.stiffness, before.damping)
                found[port] = NetworkLink((port, end), k + link.stiffness, b + link.damping)
        return {port: link for port, link in found.items() if port not in several and link.stiffness > 0.0}

    def stiffened(self, parts: Mapping[str, float]) -> Network:
        """The network whose links at a port are stiffer by 1/(1 - part), in stiffness and damping.

        For a port of :meth:`contacts` with the link k + b s, this is the world that is left when the compliance
        part/(k + b s) is taken out of it (docs/decisions/0045-series-compliance.md).

        Args:
            parts: 0 <= part < 1, by port.
        """
        links = []
        for link in self.links:
            factor = 1.0 / (1.0 - max(parts.get(end, 0.0) for end in link.ends))
            links.append(link.with_values(factor * link.stiffness, factor * link.damping))
        return Network(self.ports, self.masses, tuple(links))

    def counted(self, parts: Mapping[str, float], T: float) -> StateSpace:
        """C = diag(part/(k + b s)) by backward Euler, with one state for each port where something is counted."""
        contacts, m = self.contacts(), len(self.ports)
        ports = [i for i, port in enumerate(self.ports) if port in parts]
        n = len(ports)
        A, B, C, D = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n)), np.zeros((m, m))
        for at, i in enumerate(ports):
            link = contacts[self.ports[i]]
            impedance = T * link.stiffness + link.damping
            A[at, at] = link.damping / impedance
            B[at, i] = T * A[at, at]
            C[i, at] = parts[self.ports[i]] / impedance
            D[i, i] = T * C[i, at]
        return StateSpace(A, B, C, D)

    def terms(self) -> dict[str, Any]:
        """Masses and links, without a delay."""
        return network_terms(self, self, 0)

    def together(self) -> Matrix:
        """M + n motions with which no link changes its length, except those to ground: all 1 without lever arms."""
        if not any(link.levers for link in self.links):
            return np.ones(len(self.ports) + len(self.masses))
        found = scales(self.links)
        return np.array([1.0 / found.get(end, 1.0) for end in (*self.ports, *(name for name, _ in self.masses))])

    def stiffness_matrix(self) -> Matrix:
        """K, (m+n) x (m+n), N/m; ports first, then masses."""
        return self._assemble([link.stiffness for link in self.links])

    def damping_matrix(self) -> Matrix:
        """B, (m+n) x (m+n), N*s/m; ports first, then masses."""
        return self._assemble([link.damping for link in self.links])

    def mass_matrix(self) -> Matrix:
        """M, n x n diagonal, kg."""
        return np.diag([mass for _, mass in self.masses]) if self.masses else np.zeros((0, 0))

    def environment(self, T: float) -> StateSpace:
        """E, from tool displacement x_e (m) to force E x_e (N), sampled with period T (s).

        The state is (u, q, q') of the tick before, m + 2n entries, with

            M (v_k - v_{k-1})/T = -K_qq q_k - K_qp u_k - B_qq v_k - B_qp (u_k - u_{k-1})/T,   v_k = (q_k - q_{k-1})/T.
        """
        m, n = len(self.ports), len(self.masses)
        K, B, M = self.stiffness_matrix(), self.damping_matrix(), self.mass_matrix()
        u_now = np.hstack([np.zeros((m, m + 2 * n)), np.eye(m)])  # rows over (u-, q-, v-, u)
        u_old = np.hstack([np.eye(m), np.zeros((m, 2 * n + m))])
        q_old = np.hstack([np.zeros((n, m)), np.eye(n), np.zeros((n, n + m))])
        v_old = np.hstack([np.zeros((n, m + n)), np.eye(n), np.zeros((n, m))])
        inertia = M / T**2 + K[m:, m:] + B[m:, m:] / T
        load = (M / T**2 + B[m:, m:] / T) @ q_old + M / T @ v_old - K[m:, :m] @ u_now - B[m:, :m] / T @ (u_now - u_old)
        q_now = np.linalg.solve(inertia, load) if n else load
        v_now = (q_now - q_old) / T
        force = K[:m, :m] @ u_now + K[:m, m:] @ q_now + B[:m, :m] / T @ (u_now - u_old) + B[:m, m:] @ v_now
        state = np.vstack([u_now, q_now, v_now])
        order = m + 2 * n
        return StateSpace(state[:, :order], state[:, order:], force[:, :order], force[:, order:])

    def energy_matrix(self) -> Matrix:
        """P, (m + 2n) x (m + 2n): the mechanical energy is 1/2 eta^T P eta, J, in the state of :meth:`environment`."""
        joined = len(self.ports) + len(self.masses)
        P = np.zeros((joined + len(self.masses),) * 2)
        P[:joined, :joined], P[joined:, joined:] = self.stiffness_matrix(), self.mass_matrix()
        return P

    def running(self, T: float) -> WhatRuns:
        """E, and its mechanical energy."""
        return WhatRuns(E=self.environment(T), storage=self.energy_matrix())

    @property
    def passive_network(self) -> Network:
        """The network itself: its mechanical energy is a storage function."""
        return self

    @property
    def order(self) -> int:
        """The order of Rest: two for each mass that a port moves; less if masses float freely."""
        return 2 * len(self.reachable().masses)

    def reachable(self) -> Network:
        """The network without the masses that no chain of links joins to a port, because no port ever moves them.

        A link without stiffness and damping joins nothing, and the ground transmits no motion.
        """
        links = [link for link in self.links if link.stiffness or link.damping]
        beside: dict[str, list[str]] = {}
        for link in links:
            for end, other in (link.ends, link.ends[::-1]):
                beside.setdefault(end, []).append(other)
        joined = {*self.ports, GROUND}
        waiting = list(self.ports)
        while waiting:
            found = [end for end in beside.get(waiting.pop(), ()) if end not in joined]
            joined.update(found)
            waiting += found
        return Network(
            self.ports,
            tuple((name, mass) for name, mass in self.masses if name in joined),
            tuple(link for link in self.links if joined >= set(link.ends)),
        )

    def split(self, T: float) -> Split:
        """E_hat = T/(z-1) E1 + Rest, with Rest stable and without a state that the ports cannot reach.

        Masses that no port moves are left out. Let I be a set of r = rank K_qq of the other masses with K_II
        nonsingular, and R = K_II^{-1} K_I:. The state is (e, v): e in R^r is the deflection of the masses in I from the
        static equilibrium of the tick before (m), v in R^n are the velocities (m/s). I contains all masses except the
        last mass of each group that springs join and that no spring holds to a port or to the ground:

            (M/T + B_qq + T K_qq) v+ = M v / T - K_qI e - (B_qu + T K_qu) w
            e+ = e + T (R v+ + K_II^{-1} K_Iu w)
            f  = [E1 x-] + K_uI e + (B_uq + T K_uq) v+ + (B_uu + T K_uu) w,     E1 = K_uu - K_uI K_II^{-1} K_Iu.

        The order is 2n if a port moves every mass and springs hold it, directly or through others; otherwise less.
        """
        reachable = self.reachable()
        if len(reachable.masses) < len(self.masses):
            return reachable.split(T)
        m, n = len(self.ports), len(self.masses)
        K, B, M = self.stiffness_matrix(), self.damping_matrix(), self.mass_matrix()
        chosen = self._deflected()
        r = len(chosen)
        seen = m + np.array(chosen, dtype=np.intp)
        K_uI = K[:m][:, seen]
        solved = np.linalg.solve(K[np.ix_(seen, seen)], K[seen]) if r else np.zeros((0, m + n))  # (K_II^{-1} K_Iu, R)
        # rows over (e, v, w)
        e = np.hstack([np.eye(r), np.zeros((r, n + m))])
        v = np.hstack([np.zeros((n, r)), np.eye(n), np.zeros((n, m))])
        w = np.hstack([np.zeros((m, r + n)), np.eye(m)])
        load = M @ v / T - K[m:][:, seen] @ e - (B[m:, :m] + T * K[m:, :m]) @ w
        v_now = np.linalg.solve(M / T + B[m:, m:] + T * K[m:, m:], load) if n else load
        e_now = e + T * (solved[:, m:] @ v_now + solved[:, :m] @ w)
        force = K_uI @ e + (B[:m, m:] + T * K[:m, m:]) @ v_now + (B[:m, :m] + T * K[:m, :m]) @ w
        state, order = np.vstack([e_now, v_now]), r + n
        rest = StateSpace(state[:, :order], state[:, order:], force[:, :order], force[:, order:])
        return Split(matrix(symmetric_part(K[:m, :m] - K_uI @ solved[:, :m])), rest)

    def _deflected(self) -> list[int]:
        """Indices of the masses I of :meth:`split`."""
        index = {name: i for i, (name, _) in enumerate(self.masses)}
        group = list(range(len(index)))
        springs = [link for link in self.links if link.stiffness > 0.0]
        for link in springs:
            ends = [index[end] for end in link.ends if end in index]
            if len(ends) == 2:
                kept, gone = sorted(group[end] for end in ends)
                group = [kept if g == gone else g for g in group]
        held = {
            group[index[end]]
            for link in springs
            for end in link.ends
            if end in index and not set(link.ends) <= set(index)
        }
        last = {g: i for i, g in enumerate(group)}
        return [i for i, g in enumerate(group) if g in held or i != last[g]]

    def transformed_environment(self, T: float) -> StateSpace:
        """E_hat = E * Tz/(z-1), from tool velocity (m/s) to force (N), in energy coordinates.

        With K = L L^T of full column rank r, the state is psi = (L^T [u; q], M^{1/2} q') / sqrt(2 T), of
        order r + n, so that the mechanical energy divided by T is psi^T psi. Directions that store no energy (of a
        network that floats freely) are unobservable in E_hat and are left out.
        """
        m, n = len(self.ports), len(self.masses)
        L = full_rank_factor(self.stiffness_matrix())
        B = self.damping_matrix()
        root_M = np.sqrt(self.mass_matrix())
        r = L.shape[1]
        scale = np.sqrt(2.0 * T)
        deflection = scale * np.hstack([np.eye(r), np.zeros((r, n + m))])  # rows over (psi, w)
        velocity = scale * np.hstack([np.zeros((n, r)), _inverse_diagonal(root_M), np.zeros((n, m))])
        w = np.hstack([np.zeros((m, r + n)), np.eye(m)])
        # M (v - v-)/T = -L_q (e- + T L^T [w; v]) - B_q [w; v], solved for v
        L_u, L_q = L[:m], L[m:]
        inertia = self.mass_matrix() / T + T * L_q @ L_q.T + B[m:, m:]
        load = self.mass_matrix() / T @ velocity - L_q @ (deflection + T * L_u.T @ w) - B[m:, :m] @ w
        v_now = np.linalg.solve(inertia, load) if n else load
        e_now = deflection + T * (L_u.T @ w + L_q.T @ v_now)
        force = L_u @ e_now + B[:m, :m] @ w + B[:m, m:] @ v_now
        state = np.vstack([e_now, root_M @ v_now]) / scale
        order = r + n
        return StateSpace(state[:, :order], state[:, order:], force[:, :order], force[:, order:])

    def _assemble(self, weights: list[float]) -> Matrix:
        index = {name: i for i, name in enumerate([*self.ports, *(name for name, _ in self.masses)])}
        out = np.zeros((len(index), len(index)))
        for link, weight in zip(self.links, weights, strict=True):
            ends = [(index[end], arm) for end, arm in zip(link.ends, link.arms, strict=True) if end != GROUND]
            for i, arm in ends:
                out[i, i] += weight * (arm * arm)
            if len(ends) == 2:
                (i, a), (j, b) = ends
                out[i, j] -= weight * (a * b)
                out[j, i] -= weight * (a * b)
        return out


def scales(links: Sequence[NetworkLink]) -> dict[str, float]:
    """By end, s > 0 with which every link's length is a multiple of the difference of the ends' s u.

    In the coordinates s u a network with lever arms is one without, so that whatever holds of springs between equal
    coordinates holds of it. Ends that no links join have scales of their own, and the first of each group has 1.

    Raises:
        ValueError: there are none: two ways between two ends multiply their motions by different numbers, and such
            gears could not turn.
    """
    beside: dict[str, list[tuple[str, Fraction]]] = {}
    for link in links:
        (a, b), (of_a, of_b) = link.ends, (Fraction(repr(float(arm))) for arm in link.arms)  # the decimals as written
        if GROUND not in link.ends:
            beside.setdefault(a, []).append((b, of_b / of_a))
            beside.setdefault(b, []).append((a, of_a / of_b))
    found: dict[str, Fraction] = {}
    for start in beside:
        if start in found:
            continue
        found[start] = Fraction(1)
        waiting = [start]
        while waiting:
            end = waiting.pop()
            for other, ratio in beside[end]:
                wanted = ratio * found[end]
                if other not in found:
                    found[other] = wanted
                    waiting.append(other)
                elif found[other] != wanted:
                    raise ValueError(
                        f"lever arms: found two ways from {start} to {other} that multiply its motion by "
                        f"{1 / float(found[other]):.6g} and by {1 / float(wanted):.6g}; expected the same by every way"
                    )
    return {end: float(scale) for end, scale in found.items()}


def network_terms(low: Network, high: Network, delay: int) -> dict[str, Any]:
    """All networks between two, whose forces are ``delay`` ticks late, as JSON values; an interval is [low, high]."""
    return {
        "type": "network",
        "masses": {name: _interval(a, b) for (name, a), (_, b) in zip(low.masses, high.masses, strict=True)},
        "links": [
            {
                "between": list(a.ends),
                "stiffness": _interval(a.stiffness, b.stiffness),
                "damping": _interval(a.damping, b.damping),
                **({"arms": list(a.arms)} if a.levers else {}),
            }
            for a, b in zip(low.links, high.links, strict=True)
        ],
        "delay": delay,
    }


def _interval(low: float, high: float) -> float | list[float]:
    return low if low == high else [low, high]


def full_rank_factor(K: Matrix) -> Matrix:
    """L of full column rank with K = L L^T, for symmetric K >= 0 (pivoted Cholesky).

    The factor is unique for its order of pivots, so the same K gives the same L on every machine up to rounding. An
    eigenvalue factor is not unique if eigenvalues coincide.

    Raises:
        ValueError: K is not positive semidefinite.
    """
    remainder = np.array(K, dtype=np.float64)
    scale = float(np.max(np.abs(remainder), initial=0.0))
    columns: list[Matrix] = []
    for _ in range(remainder.shape[0]):
        pivot = int(np.argmax(np.diag(remainder)))
        value = float(remainder[pivot, pivot])
        if value <= _RANK_TOLERANCE * scale:
            break
        column = remainder[:, pivot] / np.sqrt(value)
        columns.append(column)
        remainder = remainder - np.outer(column, column)
    if float(np.max(np.abs(remainder), initial=0.0)) > 1e3 * _RANK_TOLERANCE * max(scale, 1e-300):
        raise ValueError("expected a positive semidefinite matrix")
    return np.stack(columns, axis=1) if columns else np.zeros((remainder.shape[0], 0))


def _inverse_diagonal(D: Matrix) -> Matrix:
    return np.diag(1.0 / np.diag(D)) if D.size else D


Method = Literal["backward-euler", "tustin", "zoh"]
METHODS: tuple[Method, ...] = ("backward-euler", "tustin", "zoh")
_SINGULAR = 1e12  # condition above which a discretisation does not exist


def discretise(system: StateSpace, method: Method, T: float) -> StateSpace:
    """The discrete system of the continuous ``system`` (A, B, C, D) for the period T (s).

    Backward Euler: with R = (I - T A)^{-1}, (R, T R B, C R, D + T C R B) in the state of the tick before.
    Tustin: with R = (I - T A/2)^{-1}, (R (I + T A/2), T R B, C R, D + T/2 C R B).

    Raises:
        Infeasible: the method's matrix is singular for this period.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    n = system.order
    if method == "zoh":
        return zero_order_hold(system, T)
    step = T if method == "backward-euler" else T / 2.0
    if n and not np.linalg.cond(np.eye(n) - step * A) < _SINGULAR:
        raise Infeasible(f"{method}: I - {step:g} A is singular; expected another period or method")
    R: Matrix = np.asarray(np.linalg.inv(np.eye(n) - step * A), dtype=np.float64)
    if method == "backward-euler":
        return StateSpace(R, T * R @ B, C @ R, D + T * C @ R @ B)
    return StateSpace(R @ (np.eye(n) + step * A), T * R @ B, C @ R, D + step * C @ R @ B)
