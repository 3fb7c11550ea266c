"""The environment's promise: E_hat is (-Phi_E)-ISP, by the network's energy or by a storage matrix.

The level of a declared environment is not proved here. A controller enforces it at run time, and the proof only
compares it with the level that the certificate relies on.

**By the proxy test.** For springs to proxies the theorem of docs/decisions/0042-proxies.md needs K = K' > 0 and a level
Phi_E >= 0, which are proved here. The rest is the test itself, which the environment keeps at every tick.

**By energy.** Let a network of masses, springs and dampers have ports u and masses q. With the incidence of the links,
K and B in R^((m+n) x (m+n)) are symmetric, and M is diagonal. Backward Euler makes the mechanical energy U (divided by
T) a storage function of E_hat, for w = (u - u-)/T, v = (q - q-)/T:

    f'w = (U - U-)/T + [w; v]' (B + T K/2) [w; v] + (v - v-)' M (v - v-)/(2T),

so that E_hat is (-Phi_E)-ISP when (B + TK/2) + blockdiag(Phi_E, 0) >= 0. The left side grows with every stiffness and
damping and does not depend on the masses: a proof at the lower ends holds for every network between the ends.

**By a storage matrix.** The integrators of E_hat = Tz/(z-1) E are split off, in balls. With E1 = E(1), the static
stiffness, and E = (A, B, C, D) stable,

    E_hat = T/(z-1) E1 + Rest,        Rest = (A, -T A (I - A)^-1 B, C, T D).

T/(z-1) E1 with E1 = E1' >= 0 is lossless except for -T/2 E1. So E_hat is (-Phi_E)-ISP if, for Rest = (A, B, C, D),

    M_E = [ A'PA - P   A'PB - C'/2                                ]
          [ .          B'PB - (D + D')/2 - Phi_E + (T/2) E1       ]  < 0,     P > 0,     E1 >= 0.

Without the compliance C that is counted in series it is E (I - C E)^-1 (:mod:`manyhands.design.proof.series`).

The states of rational functions may be their differences instead (:mod:`manyhands.design.proof.system`): the storage
matrix says of which of the two it is.

A delay of d ticks makes it E_hat z^-d = T/(z-1) E1 + [z^-d Rest - T E1 (z^-1 + ... + z^-d)]. Whether E1 is symmetric
and >= 0 is decided exactly, in rationals (:mod:`manyhands.design.proof.statics`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from flint import arb_mat, fmpq

from manyhands.design.proof import exact, rational, scene, statics
from manyhands.design.proof.claim import (
    DeclaredData,
    DynamicsData,
    EnvironmentData,
    LinkData,
    NetworkData,
    PromiseData,
    ProxyData,
    SceneData,
    Span,
    StiffenedData,
    SystemData,
    TransferData,
    WaveLinkData,
)
from manyhands.design.proof.exact import MAX_DENSE, Sparse, StatedDifferences, StatedMatrix, exact_decimal
from manyhands.design.proof.finding import Finding, Verdict, weakest
from manyhands.design.proof.rational import assembled, diagonal_blocks, identity
from manyhands.design.proof.statics import Undecided
from manyhands.design.proof.system import NotDiscretised, Realisation, discrete, realised, transfer_order


@dataclass(frozen=True, eq=False)
class EnclosedSplit:
    """E_hat = T/(z-1) E1 + Rest, with balls that enclose every entry.

    Attributes:
        stiffness: E1, m x m symmetric, N/m.
        A, B, C, D: Rest, from velocity (m/s) to force (N).
    """

    stiffness: arb_mat
    A: arb_mat
    B: arb_mat
    C: arb_mat
    D: arb_mat


def split_system(A: arb_mat, B: arb_mat, C: arb_mat, D: arb_mat, E1: arb_mat, T: fmpq) -> EnclosedSplit:
    """The split of a discrete E = (A, B, C, D) with the static stiffness E1 = E1'.

    Raises:
        ZeroDivisionError: A is not proved to have no eigenvalue 1.
    """
    n = A.nrows()
    steady = (identity(arb_mat, n) - A).solve(B) if n else B
    return EnclosedSplit(E1, A, -(A * steady) * T, C, D * T)


def delayed(rest: EnclosedSplit, ticks: int, T: fmpq) -> EnclosedSplit:
    """The split of E_hat z^-d; the states are those of Rest, then w_{k-1}, ..., w_{k-d}."""
    if ticks == 0:
        return rest
    n, m, d = rest.A.nrows(), rest.D.nrows(), ticks
    chain = n + m * (d - 1)  # index of w_{k-d}
    A, B = arb_mat(n + m * d, n + m * d), arb_mat(n + m * d, m)
    rational.place(A, rest.A, 0, 0)
    rational.place(A, rest.B, 0, chain)
    rational.place(B, identity(arb_mat, m), n, 0)
    rational.place(A, identity(arb_mat, m * (d - 1)), n + m, n)
    late = -rest.stiffness * T
    C = assembled(arb_mat, [[rest.C, *([late] * (d - 1)), late + rest.D]])
    return replace(rest, A=A, B=B, C=C, D=arb_mat(m, m))


def dissipation(rest: EnclosedSplit, P: arb_mat, Phi_E: arb_mat, T: fmpq) -> arb_mat:
    """-M_E, (n+m) x (n+m), symmetric."""
    n = rest.A.nrows()
    G = assembled(arb_mat, [[rest.A, rest.B]])
    supply = assembled(arb_mat, [[arb_mat(n, n), rest.C.transpose() / 2], [rest.C / 2, rational.symmetrised(rest.D)]])
    level = Phi_E - rest.stiffness * (T / 2)
    kept = diagonal_blocks(arb_mat, [P, level])
    return rational.symmetrised(supply + kept - G.transpose() * P * G)


def environment(rest: EnclosedSplit, T: fmpq) -> tuple[arb_mat, arb_mat, arb_mat, arb_mat]:
    """E from its split, with the state (eta, u-): eta is the state of Rest, u- the displacement of the tick before.

    eta+ = A eta + B (u - u-)/T,    u-+ = u,    f = E1 u- + C eta + D (u - u-)/T.
    """
    n, m = rest.A.nrows(), rest.D.nrows()
    B, D = rest.B / T, rest.D / T
    return (
        assembled(arb_mat, [[rest.A, -B], [arb_mat(m, n), arb_mat(m, m)]]),
        assembled(arb_mat, [[B], [identity(arb_mat, m)]]),
        assembled(arb_mat, [[rest.C, rest.stiffness - D]]),
        D,
    )


STEPS = 4_000  # of conjugate gradients; each costs a few products with the matrix's entries
MOST_DENSE = 400  # rows of B + TK/2 up to which balls are tried, if no structure helps
MOST_SEARCHED = 200  # the same, where dominance is equivalent


def laplacian(links: tuple[LinkData, ...], weights: list[fmpq]) -> Sparse:
    """The matrix of the quadratic form sum over the links of weight (a_1 end_1 - a_2 end_2)^2, with their arms a."""
    out: Sparse = {}
    for link, weight in zip(links, weights, strict=True):
        ends = [(end, arm) for end, arm in zip(link.ends, link.arms, strict=True) if end is not None]
        if weight == 0:
            continue
        for end, arm in ends:
            exact.add_entry(out, end, end, weight * arm * arm)
        if len(ends) == 2:
            (i, a), (j, b) = ends
            exact.add_entry(out, i, j, -weight * a * b)
            exact.add_entry(out, j, i, -weight * a * b)
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

    The test goes through the groups of ports and masses that the links and Phi_E join. Where Phi_E >= 0, every link's
    own term is enough. Small groups are tested exactly, large groups by weighted diagonal dominance, or in balls.
    """
    size = network.ports + len(network.masses)
    weights = [exact_decimal(link.damping[0]) + exact_decimal(link.stiffness[0]) * T / 2 for link in network.links]
    own = laplacian(network.links, weights)
    total = dict(own)
    for (i, j), value in Phi_E.items():
        exact.add_entry(total, i, j, value)
    negative = _negative(Phi_E, network.ports)
    parts: dict[str, Verdict] = {}
    for group in exact.groups(size, [own, Phi_E]):
        if negative.isdisjoint(group):
            parts["links"] = Verdict(True, 0.0, "link by link, where Phi_E >= 0")
        else:
            parts[f"the part of port {group[0] + 1}"] = _group(total, group)
    return weakest(parts)


def _negative(Phi_E: Sparse, ports: int) -> set[int]:
    """Indices of the ports where Phi_E is not proved >= 0."""
    out: set[int] = set()
    for group in exact.groups(ports, [Phi_E]):
        entry = Phi_E.get((group[0], group[0]), fmpq(0))
        if entry < 0 or (len(group) > 1 and not exact.definite(exact.dense(Phi_E, group), strict=False).holds):
            out.update(group)
    return out


def _group(total: Sparse, group: list[int]) -> Verdict:
    if len(group) <= exact.MOST_EXACT:
        return exact.definite(exact.dense(total, group), strict=False)
    verdict = dominant(total, group)
    if not verdict.holds and len(group) <= most_dense(total, group):
        return rational.decided(len(group), lambda: rational.definite_in_balls(arb_mat(exact.dense(total, group))))
    return verdict


def most_dense(total: Sparse, group: list[int]) -> int:
    """Rows up to which balls are tried after diagonal dominance.

    Where no entry beside the diagonal is positive, the matrix is >= 0 exactly if such weights exist. Then balls only
    help where the weights are not found, and they are tried for small groups alone.
    """
    inside = set(group)
    joined = any(value > 0 for (i, j), value in total.items() if i != j and i in inside)
    return MOST_DENSE if joined else MOST_SEARCHED


def dominant(matrix: Sparse, group: list[int]) -> Verdict:
    """Whether the matrix on ``group`` is >= 0 because, with some weights x > 0, N_ii x_i >= sum over j of |N_ij| x_j.

    The weights come from conjugate gradients in floats, on N with its off-diagonal entries made negative. The proof
    does not rely on how they were found: the inequalities are checked exactly, one for each row.
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
    residual = np.ones(n)  # of the right-hand side 1: weights with every entry of the residual below 1 are enough
    direction, square = residual.copy(), float(n)
    for _ in range(STEPS):
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
    exactly = [exact_decimal(float(w)) for w in weights]
    sums = [fmpq(0)] * n
    for i, j, value in entries:
        sums[i] += (value if i == j else -abs(value)) * exactly[j]
    holds = all(total >= 0 for total in sums)
    return Verdict(holds, 0.0 if holds else -1.0, "exactly, by diagonal dominance with weights")


def moved(network: NetworkData) -> list[int]:
    """Indices of the masses that a chain of links joins to a port; the others influence no port and are not in Rest.

    A link whose stiffness and damping are zero at both ends of their intervals joins nothing. The ground joins nothing
    either, because it stands still. K and B then have no entry between an omitted mass and any other node, and E is
    exactly the same without the omitted masses.
    """
    m = network.ports
    joined: Sparse = {}
    for link in network.links:
        a, b = link.ends
        if a is not None and b is not None and any((*link.stiffness, *link.damping)):
            joined[a, b] = fmpq(1)
    groups = exact.groups(m + len(network.masses), [joined])
    return sorted(i - m for group in groups if group[0] < m for i in group if i >= m)


def carriers(network: NetworkData) -> list[int]:
    """Indices of the masses whose deflections are states of Rest.

    These are the masses of :func:`moved`, without one mass of each group that no spring holds. Their K_II is regular
    and has the rank of K_qq. A group moves freely if springs join its masses and none leads to a port or to the ground;
    it has one deflection less than masses.
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
    for group in exact.groups(n, [inner]):
        out.update(group if any(m + i in held for i in group) else group[:-1])
    return sorted(out.intersection(moved(network)))


def network_order(network: NetworkData) -> int:
    """Number of states of Rest without the delay's."""
    return len(carriers(network)) + len(moved(network))


def network_split(network: NetworkData, T: fmpq) -> EnclosedSplit:
    """E_hat = T/(z-1) E1 + Rest, in balls, for the network in the middle of its intervals.

    Let q be the n masses of :func:`moved`, I those of :func:`carriers`, and R = K_II^-1 K_I:. The states are e in R^r,
    the deflections of the masses in I from static equilibrium (m), and v in R^n, the velocities (m/s):

        (M/T + B_qq + T K_qq) v+ = M v/T - K_qI e - (B_qu + T K_qu) w
        e+ = e + T (R v+ + K_II^-1 K_Iu w)
        f  = [E1 x-] + K_uI e + (B_uq + T K_uq) v+ + (B_uu + T K_uu) w,     E1 = K_uu - K_uI K_II^-1 K_Iu.

    Raises:
        ZeroDivisionError: a matrix is singular, which does not happen for a physical network.
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
    load = rational.assembled(arb_mat, [[-K_qI, M / T, -coupled]])
    following = (M / T + part(B, masses, masses) + part(K, masses, masses) * T).solve(load) if n else load
    e = rational.assembled(arb_mat, [[rational.identity(arb_mat, r), arb_mat(r, n + m)]])
    w = rational.assembled(arb_mat, [[arb_mat(m, r + n), rational.identity(arb_mat, m)]])
    static = arb_mat(m, m)
    deflection = e
    if r:
        K_II = part(K, I, I)
        to_ports = K_II.solve(part(K, I, ports))
        deflection = e + (K_II.solve(part(K, I, masses)) * following + to_ports * w) * T
        static = K_uI * to_ports
    K_uu = part(K, ports, ports)
    force = K_uI * e + coupled.transpose() * following + (part(B, ports, ports) + K_uu * T) * w
    state = rational.assembled(arb_mat, [[deflection], [following]])
    return EnclosedSplit(
        rational.symmetrised(K_uu - static), *rational.columns_cut(state, r + n), *rational.columns_cut(force, r + n)
    )


def _middle(span: Span) -> fmpq:
    return (exact_decimal(span[0]) + exact_decimal(span[1])) / 2


_ISP = "E_hat is (-Phi_E)-ISP, (14)"


def order(data: DynamicsData, m: int) -> int:
    """Number of states of Rest, with those of the delay."""
    match data:
        case NetworkData():
            own = network_order(data)
        case SystemData():
            own = data.A.rows
        case StiffenedData():
            own = order(data.world, m)
        case _:
            own = transfer_order(data)
    return own + m * data.delay


def split(data: DynamicsData, T: fmpq, differences: bool = False) -> EnclosedSplit:
    """E_hat without its integrators and with its delay; of a network, in the middle of its intervals.

    The states of rational functions are their ``differences``, or those of the form in z.

    Raises:
        ZeroDivisionError: a matrix is not proved regular.
        NotDiscretised: the discrete environment does not exist.
        Undecided: the environment has no static stiffness.
    """
    match data:
        case NetworkData():
            own = network_split(data, T)
        case StiffenedData():
            E = stiffened(_discrete(data.world, T, differences), arb_mat(data.compliance))
            own = split_system(*E, arb_mat(statics.of_environment(data)), T)
        case _:
            own = split_system(*_discrete(data, T, differences), arb_mat(statics.of_environment(data)), T)
    return delayed(own, data.delay, T)


def _discrete(data: SystemData | TransferData, T: fmpq, differences: bool) -> Realisation:
    return discrete(data, T) if isinstance(data, SystemData) else realised(data, T, differences)


def has_differences(data: DynamicsData) -> bool:
    """Whether the states have differences to speak of: those of rational functions do."""
    return isinstance(data.world if isinstance(data, StiffenedData) else data, TransferData)


def stiffened(E: Realisation, C: arb_mat) -> Realisation:
    """E (I - C E)^-1 for a static C, m x m (:mod:`manyhands.design.proof.series`).

    Raises:
        ZeroDivisionError: I - D C is not proved regular.
    """
    A, B, leaving, D = E
    unit = identity(arb_mat, D.nrows())
    N = (unit - D * C).inv()
    return A + B * C * N * leaving, B * (unit + C * N * D), N * leaving, N * D


def findings(data: EnvironmentData, P: StatedMatrix | None, Phi_E: Sparse, m: int, T: fmpq) -> list[Finding]:
    """Whether E_hat is (-Phi_E)-ISP with the storage matrix P, or with its energy if P is None."""
    if isinstance(data, ProxyData):
        return _proxy_findings(data, Phi_E, m)
    if isinstance(data, DeclaredData):
        own = scene.findings(data, m) if isinstance(data, SceneData) else []
        return [*own, _declared(data, Phi_E, m)]
    out = []
    if isinstance(data, NetworkData):
        physics = physical(data)
        condition = "masses are positive, no stiffness and no damping is negative"
        out.append(Finding(condition, physics.holds, physics.least, 0.0, argument=physics.argument))
        if not physics.holds:
            return [*out, _refused("the network is not a physical one")]
        if P is None and data.delay == 0:
            verdict = energy(data, Phi_E, T)
            because = "mechanical energy: monotone in every stiffness and damping, whatever the masses are"
            return [*out, verdict.finding(_ISP, because)]
        if P is not None and data.uncertain:
            return [*out, _refused("intervals need the energy: a storage matrix covers one network alone")]
    if P is None:
        return [*out, _refused("only a network without delay has its energy as a storage")]
    size = order(data, m)
    if size + m > MAX_DENSE:
        return [*out, _refused(f"{size} states and {m} ports are too many for a dense proof (at most {MAX_DENSE})")]
    if P.rows != size:
        return [*out, _refused(f"the storage matrix has {P.rows} rows, Rest has {size} states")]
    if isinstance(P, StatedDifferences) and not has_differences(data):
        return [*out, _refused("a storage matrix in differences is for rational functions alone")]
    return [*out, *_matrix_findings(data, P, Phi_E, m, T)]


def _declared(data: DeclaredData, Phi_E: Sparse, m: int) -> Finding:
    """The level that is enforced or assumed is at least as strict as the level with which (10) is proved."""
    declared: Sparse = {}
    exact.add(declared, range(m), data.level)
    verdict = exact.definite_by_groups(exact.difference(Phi_E, declared), m, strict=False)
    if not verdict.holds:
        return _refused(f"the declared level is not proved to be at most Phi_E: {verdict.argument}")
    match data:
        case ProxyData():
            argument = "kept by the proxy test at every tick, whatever positions are proposed"
            if data.tank > 0:
                argument += f"; gives out at most the {float(data.tank):g} J of its tank, which counts as stored"
            return Finding(_ISP, True, 0.0, 0.0, argument=argument, enforced=True)
        case WaveLinkData():
            argument = "by the rules of the wave link's face, whatever arrives; not proved here"
            return Finding(_ISP, True, 0.0, 0.0, argument=argument, assumed=True)
        case SceneData():
            return Finding(_ISP, True, 0.0, 0.0, argument=scene.argument(data), enforced=True)
        case PromiseData():
            argument = "assumed of the world, whose own certificate proves it"
            return Finding(_ISP, True, 0.0, 0.0, argument=argument, assumed=True)
    return Finding(_ISP, True, 0.0, 0.0, argument="not proved: enforced at run time by a controller", enforced=True)


def _proxy_findings(data: ProxyData, Phi_E: Sparse, m: int) -> list[Finding]:
    """K > 0 and a level >= 0, under which the proxy test can be kept whatever is proposed, and the level itself."""
    stiffness: Sparse = {}
    level: Sparse = {}
    exact.add(stiffness, range(m), data.stiffness)
    exact.add(level, range(m), data.level)
    found = [
        exact.definite_by_groups(stiffness, m).finding("the stiffness K of the proxies' springs is symmetric and > 0"),
        exact.definite_by_groups(level, m, strict=False).finding("the declared level of the proxies is >= 0"),
        *(
            [Finding("the tank of the world is not negative", data.tank >= 0, float(data.tank), 0.0)]
            if data.tank
            else []
        ),
    ]
    return [*found, _declared(data, Phi_E, m)] if all(one.holds for one in found) else found


def _refused(argument: str) -> Finding:
    return Finding(_ISP, False, float("nan"), 0.0, argument=argument)


def _matrix_findings(data: DynamicsData, stated: StatedMatrix, Phi_E: Sparse, m: int, T: fmpq) -> list[Finding]:
    condition = "the static stiffness E1 = E(1) is symmetric and >= 0"
    if isinstance(data, NetworkData):
        static = Verdict(True, 0.0, "as a Schur complement of the network's K >= 0")
    else:
        try:
            static = statics.semidefinite(statics.of_environment(data))
        except Undecided as error:
            static = Verdict(False, float("nan"), str(error))
    if not static.holds:
        return [static.finding(condition)]
    conditions = {"P": "E_hat's storage matrix is positive", "M_E": _ISP}

    def test() -> dict[str, Verdict]:
        try:
            rest = split(data, T, isinstance(stated, StatedDifferences))
        except (NotDiscretised, Undecided) as error:
            return {"": Verdict(False, float("nan"), str(error))}
        P = rational.symmetrised(stated.witness())
        level = arb_mat(exact.dense(Phi_E, range(m)))
        return {
            "P": rational.definite_in_balls(P),
            "M_E": rational.definite_in_balls(dissipation(rest, P, level, T)),
        }

    found = rational.all_decided(stated.rows + m, test)
    if "" in found:
        return [_refused(found[""].argument)]
    because = {"M_E": "M_E < 0: a storage matrix for E_hat less its integrators; E is stable with it"}
    proved = [verdict.finding(conditions[name], because.get(name, "")) for name, verdict in found.items()]
    return [static.finding(condition), *proved]
