"""Networks of masses, springs and dampers: their energy as a proof, and Rest from their physics.

With the incidence of the links, ports u and masses q, K and B in R^((m+n) x (m+n)) symmetric and M diagonal, backward
Euler makes the mechanical energy U (divided by T) a storage function of E_hat, for w = (u - u-)/T, v = (q - q-)/T:

    f'w = (U - U-)/T + [w; v]' (B + T K/2) [w; v] + (v - v-)' M (v - v-)/(2T),

so that E_hat is (-Phi_E)-ISP when (B + TK/2) + blockdiag(Phi_E, 0) >= 0. The left side grows with every stiffness and
damping and does not depend on the masses: proved at the lower ends it holds for every network between.
"""

from __future__ import annotations

import numpy as np
from flint import arb_mat, fmpq

from manyhands.design.proof import balls, rational, sparse
from manyhands.design.proof.finding import Verdict, weakest
from manyhands.design.proof.physical import Link, NetworkData, Span
from manyhands.design.proof.reading import exact
from manyhands.design.proof.sparse import Sparse
from manyhands.design.proof.split import Split

_STEPS = 4_000  # of conjugate gradients, each a few products with the matrix's entries
_MOST_DENSE = 700  # rows of B + TK/2 for which balls are tried where no structure helps


def laplacian(links: tuple[Link, ...], weights: list[fmpq]) -> Sparse:
    """The matrix of the quadratic form sum over the links of weight (difference of its ends)^2."""
    out: Sparse = {}
    for link, weight in zip(links, weights, strict=True):
        ends = [end for end in link.ends if end is not None]
        if weight == 0:
            continue
        for end in ends:
            sparse.add_entry(out, end, end, weight)
        if len(ends) == 2:
            sparse.add_entry(out, ends[0], ends[1], -weight)
            sparse.add_entry(out, ends[1], ends[0], -weight)
    return out


def physical(network: NetworkData) -> Verdict:
    """Whether every mass is positive and no stiffness or damping negative, at the lower ends."""
    values = [low > 0 for low, _ in network.masses]
    values += [low >= 0 for link in network.links for low, _ in (link.stiffness, link.damping)]
    spans = [*network.masses, *(span for link in network.links for span in (link.stiffness, link.damping))]
    least = min((float(low) for low, _ in spans), default=0.0)
    return Verdict(all(values), least, "exactly: the file's numbers")


def energy(network: NetworkData, Phi_E: Sparse, T: fmpq) -> Verdict:
    """Whether (B + TK/2) + blockdiag(Phi_E, 0) >= 0 at the lower ends.

    Group by group of what the links and Phi_E join: where Phi_E >= 0 every link's own term is enough; small groups are
    tested exactly; large ones by weighted diagonal dominance, or in balls.
    """
    size = network.ports + len(network.masses)
    weights = [exact(link.damping[0]) + exact(link.stiffness[0]) * T / 2 for link in network.links]
    own = laplacian(network.links, weights)
    total = dict(own)
    for (i, j), value in Phi_E.items():
        sparse.add_entry(total, i, j, value)
    negative = _negative(Phi_E, network.ports)
    parts: dict[str, Verdict] = {}
    for group in sparse.groups(size, [own, Phi_E]):
        if negative.isdisjoint(group):
            parts["links"] = Verdict(True, 0.0, "link by link, where Phi_E >= 0")
        else:
            parts[f"the part of port {group[0] + 1}"] = _group(total, group)
    return weakest(parts)


def _negative(Phi_E: Sparse, ports: int) -> set[int]:
    """The ports where Phi_E is not proved >= 0."""
    out: set[int] = set()
    for group in sparse.groups(ports, [Phi_E]):
        entry = Phi_E.get((group[0], group[0]), fmpq(0))
        if entry < 0 or (len(group) > 1 and not sparse.definite(sparse.dense(Phi_E, group), strict=False).holds):
            out.update(group)
    return out


def _group(total: Sparse, group: list[int]) -> Verdict:
    if len(group) <= sparse.MOST_EXACT:
        return sparse.definite(sparse.dense(total, group), strict=False)
    verdict = dominant(total, group)
    if not verdict.holds and len(group) <= _MOST_DENSE:
        return balls.decided(len(group), lambda: balls.definite(arb_mat(sparse.dense(total, group))))
    return verdict


def dominant(matrix: Sparse, group: list[int]) -> Verdict:
    """Whether the matrix on ``group`` is >= 0 because, with some weights x > 0, N_ii x_i >= sum over j of |N_ij| x_j.

    The weights come from conjugate gradients in floats on N with its other entries made negative, and nothing rests on
    them: the inequalities are checked exactly, one for each row.
    """
    position = {i: k for k, i in enumerate(group)}
    entries = [(position[i], position[j], value) for (i, j), value in matrix.items() if i in position]
    n = len(group)
    diagonal = np.zeros(n)
    for i, j, value in entries:
        if i == j:
            diagonal[i] = rational.rounded(value)
    if not np.all(diagonal > 0.0):
        return Verdict(False, float(np.min(diagonal)), "a diagonal entry is not positive")
    root = np.sqrt(diagonal)
    rows = np.array([i for i, _, _ in entries])
    columns = np.array([j for _, j, _ in entries])
    values = np.array([abs(rational.rounded(value)) * (1.0 if i == j else -1.0) for i, j, value in entries])
    values /= root[rows] * root[columns]
    x = np.zeros(n)
    residual = np.ones(n)  # of the right-hand side 1: what is below it in every entry is enough
    direction, square = residual.copy(), float(n)
    for _ in range(_STEPS):
        product = np.bincount(rows, values * direction[columns], minlength=n)
        curvature = float(direction @ product)
        if not curvature > 0.0:
            break
        step = square / curvature
        x, residual = x + step * direction, residual - step * product
        if float(np.max(np.abs(residual))) < 0.5:
            break
        following = float(residual @ residual)
        direction, square = residual + following / square * direction, following
    weights = x / root
    if not (np.all(np.isfinite(weights)) and np.all(weights > 0.0)):
        return Verdict(False, float("nan"), "no weights were found that make it diagonally dominant")
    exactly = [exact(float(w)) for w in weights]
    sums = [fmpq(0)] * n
    for i, j, value in entries:
        sums[i] += (value if i == j else -abs(value)) * exactly[j]
    holds = all(total >= 0 for total in sums)
    return Verdict(holds, 0.0 if holds else -1.0, "exactly, by diagonal dominance with weights")


def moved(network: NetworkData) -> list[int]:
    """The masses that a chain of links joins to a port: the others influence no port, and Rest does not have them.

    A link whose stiffness and damping are zero at both ends of their intervals joins nothing. Neither does the ground:
    it stands still. K and B then have no entry between the masses that are left out and anything else, and E is the
    same without them, exactly.
    """
    m = network.ports
    joined: Sparse = {}
    for link in network.links:
        a, b = link.ends
        if a is not None and b is not None and any((*link.stiffness, *link.damping)):
            joined[a, b] = fmpq(1)
    groups = sparse.groups(m + len(network.masses), [joined])
    return sorted(i - m for group in groups if group[0] < m for i in group if i >= m)


def carriers(network: NetworkData) -> list[int]:
    """The masses whose deflections Rest has as states: of :func:`moved`, all but one of each group no spring holds.

    K_II of these is regular and of the rank of K_qq: a group of masses joined by springs, none of which
    leads to a port or the ground, moves freely, and has one deflection less than masses.
    """
    m, n = network.ports, len(network.masses)
    springs = {
        (link.ends[0], link.ends[1]): fmpq(1)
        for link in network.links
        if link.stiffness[0] > 0 or link.stiffness[1] > 0
    }
    inner = {
        (a - m, b - m): one for (a, b), one in springs.items() if a is not None and b is not None and min(a, b) >= m
    }
    held = {end for ends in springs for end in ends if any(other is None or other < m for other in ends)}
    out: set[int] = set()
    for group in sparse.groups(n, [inner]):
        out.update(group if any(m + i in held for i in group) else group[:-1])
    return sorted(out.intersection(moved(network)))


def order(network: NetworkData) -> int:
    """Number of states of Rest without the delay's."""
    return len(carriers(network)) + len(moved(network))


def split(network: NetworkData, T: fmpq) -> Split:
    """E_hat = T/(z-1) E1 + Rest, in balls, for the network in the middle of its intervals.

    Of the n masses q that :func:`moved` names, with I = :func:`carriers` and R = K_II^-1 K_I:, the states are e in R^r,
    deflections of the masses in I from static equilibrium (m), and v in R^n, the velocities (m/s):

        (M/T + B_qq + T K_qq) v+ = M v/T - K_qI e - (B_qu + T K_qu) w
        e+ = e + T (R v+ + K_II^-1 K_Iu w)
        f  = [E1 x-] + K_uI e + (B_uq + T K_uq) v+ + (B_uu + T K_uu) w,     E1 = K_uu - K_uI K_II^-1 K_Iu.

    Raises:
        ZeroDivisionError: a matrix is singular, which a physical network's are not.
    """
    m, of_masses = network.ports, moved(network)
    ports, masses, I = list(range(m)), [m + i for i in of_masses], [m + i for i in carriers(network)]
    n, r = len(masses), len(I)
    K = laplacian(network.links, [_middle(link.stiffness) for link in network.links])
    B = laplacian(network.links, [_middle(link.damping) for link in network.links])

    def part(matrix: Sparse, rows: list[int], columns: list[int]) -> arb_mat:
        out = arb_mat(len(rows), len(columns))
        at, beside = {i: k for k, i in enumerate(rows)}, {j: k for k, j in enumerate(columns)}
        for (i, j), value in matrix.items():
            if i in at and j in beside:
                out[at[i], beside[j]] = value
        return out

    M = arb_mat(n, n)
    for k, i in enumerate(of_masses):
        M[k, k] = _middle(network.masses[i])
    K_uI, K_qI = part(K, ports, I), part(K, masses, I)
    coupled = part(B, masses, ports) + part(K, masses, ports) * T
    # columns over (e, v, w)
    load = balls.assembled(arb_mat, [[-K_qI, M / T, -coupled]])
    following = (M / T + part(B, masses, masses) + part(K, masses, masses) * T).solve(load) if n else load
    e = balls.assembled(arb_mat, [[balls.identity(arb_mat, r), arb_mat(r, n + m)]])
    w = balls.assembled(arb_mat, [[arb_mat(m, r + n), balls.identity(arb_mat, m)]])
    static = arb_mat(m, m)
    deflection = e
    if r:
        K_II = part(K, I, I)
        to_ports = K_II.solve(part(K, I, ports))
        deflection = e + (K_II.solve(part(K, I, masses)) * following + to_ports * w) * T
        static = K_uI * to_ports
    K_uu = part(K, ports, ports)
    force = K_uI * e + coupled.transpose() * following + (part(B, ports, ports) + K_uu * T) * w
    state = balls.assembled(arb_mat, [[deflection], [following]])
    return Split(balls.symmetrised(K_uu - static), *balls.columns_cut(state, r + n), *balls.columns_cut(force, r + n))


def _middle(span: Span) -> fmpq:
    return (exact(span[0]) + exact(span[1])) / 2
