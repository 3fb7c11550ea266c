"""The transparency level: ||W1 E V W2|| < gamma, or ||W1 (F - E) W2|| < gamma with F = (I + E V)^-1 E.

The proof uses the discrete bounded real lemma. For a realisation (A, B, C, D) with P > 0 and

    [A B]' P [A B] - blockdiag(P, gamma^2 I) + [C D]' [C D] < 0,

A is stable and the H-infinity norm of C (zI - A)^-1 B + D is below gamma. P belongs to one realisation. It consists of
these four systems, with m inputs and m outputs each:

- W_i: companion form, copies for the ports by kron with I_m. For den = z^n + a_1 z^(n-1) + ... + a_n (divided by its
  first coefficient): A = kron(A_w, I_m) with (-a_1, ..., -a_n) in the first row of A_w and ones below its diagonal, B
  = kron(e_1, I_m), C = kron((b_1 - a_1 b_0, ..., b_n - a_n b_0), I_m), D = b_0 I_m.
- V: its blocks, states stacked in the order of "structure", inputs and outputs at their ports. A spring-damper block
  has C_V = (T K + B)^-1, A_V = B C_V, B_V = T A_V, D_V = T C_V, one state per port.
- Where compliance of the world is counted in series, V above is the blocks less C, and E is the world as it is
  (:mod:`manyhands.design.proof.series`): states of the blocks, then, of a network, one for each port where something is
  counted.
- E: from E1 and Rest = (A_r, B_r, C_r, D_r), for every kind of environment, delayed ones too (Rest with its chain),
  and a network in the middle of its intervals, in the states that P is stated in; state (eta, u-), u- the displacement
  of the tick before:

      A_E = [ A_r  -B_r/T ]    B_E = [ B_r/T ]    C_E = [ C_r   E1 - D_r/T ]    D_E = D_r/T.
            [ 0     0     ]          [ I     ]

**Loop shaping**, states (x_2, x_V, x_E, x_1) of W2, V, E, W1 in series: p = W2 r, d = V p, f = E d, output W1 f. For
two systems in series, S_2 after S_1, the realisation is

    S_2 S_1 = ( [ A_1  0 ; B_2 C_1  A_2 ],  [ B_1 ; B_2 D_1 ],  [ D_2 C_1  C_2 ],  D_2 D_1 ).

**Closed loop**, states (x_2, x_a, x_V, x_b, x_1) of W2, a first copy of E, V, a second copy of E, W1, because
F - E = (I + E V)^-1 E - E = -E V (I + E V)^-1 E: p = W2 r, a = E_a p; the loop s = a - E_b V s with
N = (I + D_E D_V)^-1 is

    s    = N (a - C_E x_b - D_E C_V x_V),
    x_V+ = A_V x_V + B_V s,     x_b+ = A_E x_b + B_E (C_V x_V + D_V s),     output s - a,

which as a system L from a, with the states (x_V, x_b), has S = [-N D_E C_V, -N C_E] (s = S x + N a) and

    A_L = [ A_V  0 ; B_E C_V  A_E ] + [ B_V ; B_E D_V ] S,    B_L = [ B_V ; B_E D_V ] N,    C_L = S,    D_L = N - I;

the whole is W1 L E_a W2 in series.
"""

from __future__ import annotations

from flint import arb_mat, fmpq

from manyhands.design.proof import environment, rational
from manyhands.design.proof import series as series_of_world
from manyhands.design.proof.claim import (
    Claim,
    DeclaredData,
    DynamicsData,
    Linear,
    NetworkData,
    StatedSpringDamper,
    StatedTransparency,
)
from manyhands.design.proof.environment import environment as environment_of
from manyhands.design.proof.exact import MAX_DENSE, StatedDifferences, exact_decimal
from manyhands.design.proof.finding import Finding, Verdict, weakest
from manyhands.design.proof.rational import assembled, diagonal_blocks, identity
from manyhands.design.proof.statics import Undecided, feedthrough
from manyhands.design.proof.system import NotDiscretised, Realisation, companion


def finding(claim: Claim, stated: StatedTransparency) -> Finding:
    """Whether the norm is below gamma."""
    what = "W1 E V W2" if stated.objective == "loop-shaping" else "W1 (F(E, V) - E) W2"
    condition = f"transparency: ||{what}|| < {float(stated.gamma):.6g}"
    m = len(claim.ports)
    E = claim.environment
    if isinstance(E, DeclaredData):
        return Finding(condition, False, float("nan"), 0.0, argument="nothing is known of E but its declared level")
    size = order(claim, E, stated)
    problem = ""
    if not stated.gamma > 0:
        problem = "gamma is not positive"
    elif size + m > MAX_DENSE:
        problem = f"{size} states and {m} ports are too many for a dense proof (at most {MAX_DENSE})"
    elif stated.P.rows != size:
        problem = f"the storage matrix has {stated.P.rows} rows, the realisation {size} states"
    elif isinstance(stated.P, StatedDifferences) and not environment.has_differences(E):
        problem = "a storage matrix in differences is for rational functions alone"
    if problem:
        return Finding(condition, False, float("nan"), 0.0, argument=problem)

    def test() -> Verdict:
        try:
            system = weighted(claim, E, stated)
        except (NotDiscretised, Undecided) as error:
            return Verdict(False, float("nan"), str(error))
        P = rational.symmetrised(stated.P.witness())
        return weakest(
            {
                "P > 0": rational.definite_in_balls(P),
                "the bounded real lemma": rational.definite_in_balls(_dissipation(system, P, stated)),
            }
        )

    because = "the bounded real lemma"
    if isinstance(E, NetworkData) and E.uncertain:
        because += ", for the network in the middle of its intervals"
    return rational.decided(size + m, test).finding(condition, because)


def order(claim: Claim, data: DynamicsData, stated: StatedTransparency) -> int:
    """Number of states of the realisation."""
    m = len(claim.ports)
    n_E = environment.order(data, m) + m
    n_V = sum(V.stiffness.rows if isinstance(V, StatedSpringDamper) else V.A.rows for V in claim.coupling)
    n_W = m * (len(stated.W1.den) + len(stated.W2.den) - 2)
    n_V += len(claim.series) if isinstance(data, NetworkData) else 0
    return n_W + n_V + n_E * (2 if stated.objective == "closed-loop" else 1)


def weighted(claim: Claim, data: DynamicsData, stated: StatedTransparency) -> Realisation:
    """The realisation of the module's head, in balls.

    Raises:
        ZeroDivisionError: a matrix is not proved regular.
        NotDiscretised: the discrete environment does not exist.
    """
    m = len(claim.ports)
    W1, W2 = (companion(w.num, w.den, m) for w in (stated.W1, stated.W2))
    V = coupling(claim)
    if claim.series:
        V = less(V, series_of_world.counted(claim))
    E = environment_of(environment.split(data, claim.period, isinstance(stated.P, StatedDifferences)), claim.period)
    if stated.objective == "loop-shaping":
        return series(W2, V, E, W1)
    return series(W2, E, loop(V, E), W1)


def less(first: Realisation, second: Realisation) -> Realisation:
    """The difference of two systems with the same inputs; states of the first, then of the second."""
    (A_1, B_1, C_1, D_1), (A_2, B_2, C_2, D_2) = first, second
    return (
        diagonal_blocks(arb_mat, [A_1, A_2]),
        assembled(arb_mat, [[B_1], [B_2]]),
        assembled(arb_mat, [[C_1, -C_2]]),
        D_1 - D_2,
    )


def series(*systems: Realisation) -> Realisation:
    """The series connection, the first system at the input; states in this order."""
    out = systems[0]
    for following in systems[1:]:
        (A_1, B_1, C_1, D_1), (A_2, B_2, C_2, D_2) = out, following
        out = (
            assembled(arb_mat, [[A_1, arb_mat(A_1.nrows(), A_2.ncols())], [B_2 * C_1, A_2]]),
            assembled(arb_mat, [[B_1], [B_2 * D_1]]),
            assembled(arb_mat, [[D_2 * C_1, C_2]]),
            D_2 * D_1,
        )
    return out


def loop(V: Realisation, E: Realisation) -> Realisation:
    """The system L, from a to s - a with s = a - E V s; states (x_V, x_b)."""
    (A_V, B_V, C_V, D_V), (A_E, B_E, C_E, D_E) = V, E
    m = D_E.nrows()
    N = (identity(arb_mat, m) + D_E * D_V).inv()
    S = assembled(arb_mat, [[-(N * D_E * C_V), -(N * C_E)]])
    entering = assembled(arb_mat, [[B_V], [B_E * D_V]])
    free = assembled(arb_mat, [[A_V, arb_mat(A_V.nrows(), A_E.ncols())], [B_E * C_V, A_E]])
    return free + entering * S, entering * N, S, N - identity(arb_mat, m)


def coupling(claim: Claim) -> Realisation:
    """The whole V, with its blocks at their ports."""
    m = len(claim.ports)
    parts = [_block(V, claim.period) for V in claim.coupling]
    order = sum(A.nrows() for A, _, _, _ in parts)
    B, C, D = arb_mat(order, m), arb_mat(m, order), arb_mat(m, m)
    at = 0
    for block, (A_i, B_i, C_i, D_i) in zip(claim.blocks, parts, strict=True):
        n = A_i.nrows()
        for j, port in enumerate(block.ports):
            for k in range(n):
                B[at + k, port] = B_i[k, j]
                C[port, at + k] = C_i[j, k]
            for i, other in enumerate(block.ports):
                D[other, port] = D_i[i, j]
        at += n
    return diagonal_blocks(arb_mat, [part[0] for part in parts]), B, C, D


def _block(V: StatedSpringDamper | Linear, T: fmpq) -> Realisation:
    if isinstance(V, Linear):
        return V.A.balls(), V.B.balls(), V.C.balls(), arb_mat(feedthrough(V.A, V.B, V.C, V.D, V.static, discrete=True))
    B = V.damping.balls()
    C = (V.stiffness.balls() * T + B).inv()
    return B * C, B * C * T, C, C * T


def _dissipation(system: Realisation, P: arb_mat, stated: StatedTransparency) -> arb_mat:
    """Minus the left-hand side of the lemma, (n+m) x (n+m)."""
    A, B, C, D = system
    G, y = assembled(arb_mat, [[A, B]]), assembled(arb_mat, [[C, D]])
    level = identity(arb_mat, D.ncols()) * (exact_decimal(stated.gamma) ** 2)
    kept = diagonal_blocks(arb_mat, [P, level])
    return rational.symmetrised(kept - G.transpose() * P * G - y.transpose() * y)
