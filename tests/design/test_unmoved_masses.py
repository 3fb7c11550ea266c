"""Masses that no port moves: whatever an LMI of other code finds feasible is designed and proved with them.

The other code starts from the links: energy coordinates of the whole network, unmoved masses included, the residue of
E_hat at z = 1 for its integrators, and one program in cvxpy for all parties' storage functions and condition (10).
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np
import pytest

from manyhands.design.certificate import content, identity
from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import DelayedNetwork
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearWanted,
    Objective,
    PolePair,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof import prove
from manyhands.design.synthesis import design

from ..support.cases import cases

SESSIONS = int(os.environ.get("MANYHANDS_UNMOVED_SESSIONS", cases(10, 20)))  # of each class
NEAR_K = 1e-3  # V of the other code's static spring is this part above the loop gain K
ENOUGH = 3e-4  # of Delta_D: the margin of (10) from which the other code calls a session feasible


# --- the other code


def system_without_integrators(loop: HapticLoop, network: Network, delay: int) -> tuple[StateSpace, Matrix]:
    """Rest of E_hat z^-d, and T E1, from the links alone; nothing is left out but what has the pole 1."""
    m, n, T = len(network.ports), len(network.masses), loop.period
    names = [*network.ports, *(name for name, _ in network.masses)]
    K, B = np.zeros((m + n, m + n)), np.zeros((m + n, m + n))
    for link in network.links:
        across = np.array([float(name == link.ends[0]) - float(name == link.ends[1]) for name in names])
        K += link.stiffness * np.outer(across, across)
        B += link.damping * np.outer(across, across)
    values, vectors = np.linalg.eigh(K)
    stored = values > 1e-11 * max(float(values[-1]), 1e-300)
    L = vectors[:, stored] * np.sqrt(values[stored])
    M = np.diag([mass for _, mass in network.masses]).reshape(n, n)
    root, r = np.sqrt(M), L.shape[1]
    # rows over (deflection, momentum, w), whose squares are twice the energy
    e, v = np.eye(r, r + n + m), np.hstack([np.zeros((n, r)), np.linalg.inv(root) if n else root, np.zeros((n, m))])
    w = np.eye(r + n + m)[r + n :]
    load = M / T @ v - L[m:] @ (e + T * L[:m].T @ w) - B[m:, :m] @ w
    v_now = np.linalg.solve(M / T + T * L[m:] @ L[m:].T + B[m:, m:], load) if n else load
    e_now = e + T * (L[:m].T @ w + L[m:].T @ v_now)
    force = L[:m] @ e_now + B[:m, :m] @ w + B[:m, m:] @ v_now
    state, order = np.vstack([e_now, root @ v_now]), r + n
    A, B_0, C, D = state[:, :order], state[:, order:], force[:, :order], force[:, order:]
    left, sizes, right = np.linalg.svd(A - np.eye(order))
    one = sizes < 1e-9
    residue = np.zeros((m, m))
    if one.any():
        X, Y = right[one].T, left[:, one]
        projection = X @ np.linalg.solve(Y.T @ X, Y.T)
        residue = C @ projection @ B_0
        residue = (residue + residue.T) / 2.0
        beside = np.linalg.svd(Y.T)[2][X.shape[1] :].T
        A, B_0, C = beside.T @ A @ beside, beside.T @ (B_0 - projection @ B_0), C @ beside
    for _ in range(delay):
        k = len(A)
        A = np.block([[A, np.zeros((k, m))], [C, np.zeros((m, m))]])
        B_0, C, D = np.vstack([B_0, D - residue]), np.hstack([np.zeros((m, k)), np.eye(m)]), np.zeros((m, m))
    return StateSpace(A, B_0, C, D), residue


def feasible(loop: HapticLoop, network: Network, delay: int) -> bool:
    """Whether one program finds storage functions and levels for a static spring just softer than the loop allows.

    In ports where Delta_D = I: V = (1 + eps) K gives V_hat = eps/2 (1 - 1/z), whose storage must be eps/4 of the last
    force's square, as a constant force is neutral; what is left of Lemma 1 is 1/eps >= Delta_V.
    """
    m = len(network.ports)
    rest, residue = system_without_integrators(loop, network, delay)
    values, vectors = np.linalg.eigh(loop.Delta_D)
    S = vectors @ np.diag(values**-0.5) @ vectors.T
    A, B, C = rest.A, rest.B @ S, S @ rest.C
    n, I = len(A), np.eye(m)
    H = S @ ((rest.D + rest.D.T) / 2.0 - residue / 2.0) @ S
    if n:  # states as far as they are reached
        gramian, power = B @ B.T, A
        for _ in range(50):
            gramian, power = gramian + power @ gramian @ power.T, power @ power
        reach = np.sqrt(np.maximum(np.diag(gramian), 0.0))
        reach = np.where(reach > 1e-6 * reach.max(), reach, max(float(reach.max()), 1e-300))
        A, B, C = A * reach / reach[:, None], B / reach[:, None], C * reach
    P = cp.Variable((n, n), symmetric=True) if n else np.zeros((0, 0))
    inside = np.zeros((m, m))
    for block in loop.partition.blocks:
        inside[np.ix_(block, block)] = 1.0
    Phi, Delta_V, t = cp.Variable((m, m), symmetric=True), cp.Variable((m, m), symmetric=True), cp.Variable()
    G, E, W = np.hstack([A, B]), np.eye(n, n + m), np.eye(n + m)[n:]
    supply = np.block([[np.zeros((n, n)), C.T / 2.0], [C / 2.0, H]])
    kyp = supply + W.T @ Phi @ W + (E.T @ P @ E - G.T @ P @ G if n else 0.0)
    ten = cp.bmat([[I - Phi, -Phi], [-Phi, Delta_V - Phi]])
    constraints = [(kyp + kyp.T) / 2 >> 0, (ten + ten.T) / 2 >> t * np.eye(2 * m), Delta_V << I / NEAR_K]
    constraints += [cp.multiply(1.0 - inside, level) == 0 for level in (Phi, Delta_V)]
    program = cp.Problem(cp.Maximize(t), constraints)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Solution may be inaccurate", category=UserWarning)
            program.solve(solver="CLARABEL")
    except cp.error.SolverError:
        return False
    if program.status != cp.OPTIMAL or not float(t.value) > ENOUGH:
        return False
    return holds_over_frequency(loop, network, delay, np.linalg.inv(S) @ Phi.value @ np.linalg.inv(S))


def holds_over_frequency(loop: HapticLoop, network: Network, delay: int, Phi: Matrix) -> bool:
    """He E_hat + Phi >= 0 at many frequencies, with E_hat from the links: the program's own answer is not believed."""
    m, T = len(network.ports), loop.period
    names = [*network.ports, *(name for name, _ in network.masses)]
    for angle in np.concatenate([np.geomspace(1e-3, np.pi, 60), [np.pi]]):
        z = np.exp(1j * angle)
        s = (z - 1.0) / (T * z)
        Z = np.diag([0.0] * m + [mass * s**2 for _, mass in network.masses]).astype(complex)
        for link in network.links:
            across = np.array([float(name == link.ends[0]) - float(name == link.ends[1]) for name in names])
            Z += (link.stiffness + link.damping * s) * np.outer(across, across)
        E = Z[:m, :m] - Z[:m, m:] @ np.linalg.solve(Z[m:, m:], Z[m:, :m])
        E_hat = E / s / z**delay
        size = max(float(np.abs(E_hat).max()), float(np.abs(loop.Delta_D).max()))
        if np.linalg.eigvalsh((E_hat + E_hat.conj().T) / 2.0 + Phi)[0] < -1e-6 * size:
            return False
    return True


# --- random sessions


@dataclass(frozen=True)
class LoopCase:
    """A loop, what it is made of, and what is asked for."""

    loop: HapticLoop
    network: Network
    delay: int
    wanted: CouplingRequest


def random_network(rng: np.random.Generator, m: int, n: int, idle: int) -> Network:
    """m ports, n masses that they may move, and ``idle`` ones that they do not: held, adrift, or linked by nothing."""
    moved = [*(f"p{i}" for i in range(m)), *(f"m{i}" for i in range(n))]
    unmoved = [f"u{i}" for i in range(idle)]

    def link(a: str, b: str) -> NetworkLink:
        stiffness, damping = 10.0 ** rng.uniform(0.0, 4.0), 10.0 ** rng.uniform(-2.5, 1.0)
        kind = rng.choice(["both", "both", "spring", "damper"])
        return NetworkLink(
            (a, b), 0.0 if kind == "damper" else float(stiffness), 0.0 if kind == "spring" else float(damping)
        )

    links = []
    for group, each in ((moved, 1), (unmoved, int(rng.integers(0, 3)))):
        for end in group * each:
            links.append(link(end, str(rng.choice([other for other in [*group, GROUND] if other != end]))))
    if idle and rng.random() < 0.3:
        links.append(NetworkLink((unmoved[0], str(rng.choice(moved))), 0.0, 0.0))
    masses = [(name, float(10.0 ** rng.uniform(-2.0, 1.0))) for name in [*moved[m:], *unmoved]]
    shuffled = [masses[i] for i in rng.permutation(len(masses))]
    return Network(tuple(moved[:m]), tuple(shuffled), tuple(links[i] for i in rng.permutation(len(links))))


def random_loop(rng: np.random.Generator, network: Network, T: float) -> HapticLoop:
    """Devices of one or two axes, whose levels join them, and any partition."""
    m = len(network.ports)
    devices, first = [], 0
    while first < m:
        size = min(int(rng.integers(1, 3)), m - first)
        turn, _ = np.linalg.qr(rng.normal(size=(size, size)))
        level = turn @ np.diag(10.0 ** rng.uniform(-1.0, 1.3, size)) @ turn.T
        devices.append(DeviceLevel(f"d{first}", tuple(range(first, first + size)), (level + level.T) / 2.0))
        first += size
    labels, order = rng.integers(0, m, m), rng.permutation(m)
    blocks = [tuple(int(p) for p in order if labels[p] == label) for label in dict.fromkeys(labels.tolist())]
    partition = Partition(tuple(f"c{i}" for i in range(len(blocks))), tuple(blocks))
    return HapticLoop("test", T, network.ports, tuple(devices), partition, network)


def random_request(rng: np.random.Generator, loop: HapticLoop, linear: bool) -> CouplingRequest:
    objective: Objective = rng.choice(["feasible", "stiffest", "loop-shaping"])  # type: ignore[assignment]
    aim = None
    if objective == "loop-shaping":
        aim = Transparency(
            "loop-shaping", Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), loop.period), Filter.one()
        )
    wish = Wish(objective, aim)
    if not linear:
        return SpringDamperWanted(wish)
    if aim is not None:  # the search of the poles takes long, and is no other question
        return LinearWanted((2,) * len(loop.partition.blocks), wish, (PolePair(30.0, 0.7),))
    return LinearWanted(tuple(int(rng.integers(0, 3)) for _ in loop.partition.blocks), wish)


def sessions(linear: bool) -> Iterator[LoopCase]:
    """Random sessions without end, every one with masses that no port moves; late ones as soft as hands can hold."""
    seed = 0
    while True:
        rng = np.random.default_rng([seed, linear])
        seed += 1
        m, T, delay = int(rng.integers(1, 5)), float(rng.choice([2.5e-4, 1e-3, 4e-3])), int(rng.integers(0, 3))
        network = random_network(rng, m, int(rng.integers(0, 4)), int(rng.integers(1, 4)))
        loop = random_loop(rng, network, T)
        if delay:
            Delta = float(np.linalg.eigvalsh(loop.Delta_D)[0])
            greatest = max(link.damping / T + link.stiffness for link in network.links)
            factor = float(10.0 ** rng.uniform(-1.5, 0.3)) * Delta / (T * greatest)
            masses = tuple((name, factor * mass) for name, mass in network.masses)
            links = tuple(NetworkLink(a.ends, factor * a.stiffness, factor * a.damping) for a in network.links)
            network = Network(network.ports, masses, links)
        environment = DelayedNetwork(network, delay) if delay else network
        loop = replace(loop, environment=environment)
        yield LoopCase(loop, network, delay, random_request(rng, loop, linear))


@pytest.mark.wide
@pytest.mark.parametrize("linear", [False, True], ids=["spring-damper", "linear"])
def test_what_an_lmi_of_other_code_finds_feasible_is_certified(linear: bool) -> None:
    certified, drawn, refused, late = 0, 0, [], 0
    for session in sessions(linear):
        drawn += 1
        if not feasible(session.loop, session.network, session.delay):
            continue
        late += session.delay > 0
        try:
            certificate = design(session.loop, session.wanted).certificate
            assert all(finding.holds for finding in prove(content(certificate) | {"id": certificate.id}))
            certified += 1
        except DesignError as error:
            refused.append(f"session {drawn - 1}: {error}")
        if certified + len(refused) == SESSIONS:
            break
    assert not refused, "\n".join([f"{len(refused)} of {SESSIONS} feasible sessions were refused:", *refused])
    assert late >= SESSIONS // 3
    assert drawn < 2 * SESSIONS  # the other code does not find everything infeasible


# --- each cause by itself


def one_port(
    links: tuple[NetworkLink, ...], masses: tuple[tuple[str, float], ...], delay: int, osp: float = 1.0
) -> HapticLoop:
    network = Network(("p",), masses, links)
    environment = DelayedNetwork(network, delay) if delay else network
    partition = Partition(("c",), ((0,),))
    return HapticLoop("test", 1e-3, ("p",), (DeviceLevel("d", (0,), np.array([[osp]])),), partition, environment)


SPRING = NetworkLink(("p", GROUND), 300.0, 0.0)
UNMOVED = {
    "adrift": (),
    "held": (NetworkLink(("u", GROUND), 50.0, 0.1),),
    "linked by nothing": (NetworkLink(("u", "p"), 0.0, 0.0),),
    "held, and linked by nothing": (NetworkLink(("p", "u"), 0.0, 0.0), NetworkLink(("u", GROUND), 50.0, 0.0)),
}


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("links", UNMOVED.values(), ids=UNMOVED)
@pytest.mark.parametrize("wanted", [SpringDamperWanted(), LinearWanted((1,))], ids=["spring-damper", "linear"])
def test_an_unmoved_mass_changes_nothing(wanted: CouplingRequest, links: tuple[NetworkLink, ...], delay: int) -> None:
    with_it = design(one_port((SPRING, *links), (("u", 1.0),), delay), wanted).certificate
    without = design(one_port((SPRING,), (), delay), wanted).certificate
    assert np.array_equal(with_it.levels.Phi_E, without.levels.Phi_E)
    assert np.array_equal(np.array(with_it.levels.P_E), np.array(without.levels.P_E))


@pytest.mark.parametrize(("stiffness", "damping"), [(1e-9, 0.0), (0.0, 1e-9), (5.0, 0.0)])
def test_a_mass_that_a_port_barely_moves_is_kept(stiffness: float, damping: float) -> None:
    """A certificate without the mass, whose link to the port is then given the least stiffness or damping."""
    nothing = NetworkLink(("u", "p"), 0.0, 0.0)
    certificate = design(one_port((SPRING, nothing), (("u", 1.0),), 1), SpringDamperWanted()).certificate
    data = content(certificate)
    assert all(finding.holds for finding in prove(data | {"id": identity(data)}))
    data["environment"]["links"][1] |= {"stiffness": stiffness, "damping": damping}
    failing = [finding for finding in prove(data | {"id": identity(data)}) if not finding.holds]
    assert [finding.condition for finding in failing][:1] == ["E_hat is (-Phi_E)-ISP, (14)"]
    assert "the storage matrix has" in failing[0].argument


def test_a_chain_of_unmoved_masses_moves_once_it_is_linked() -> None:
    """Through a mass, a chain passes motion on; through the ground it does not."""
    chain = (NetworkLink(("a", "b"), 20.0, 0.1), NetworkLink(("b", GROUND), 10.0, 0.0), SPRING)
    masses = (("a", 0.1), ("b", 0.2))
    for joint, order in ((NetworkLink(("a", GROUND), 3.0, 0.0), 1), (NetworkLink(("p", "a"), 3.0, 0.0), 5)):
        certificate = design(one_port((*chain, joint), masses, 1), SpringDamperWanted()).certificate
        assert np.array(certificate.levels.P_E).shape == (order, order)


def test_an_environment_needing_nearly_the_whole_level_gets_a_linear_coupling() -> None:
    """k T (d - 1/2) = 0.995 Delta_D: (10) asks for Delta_V > 199 Delta_D."""
    loop = one_port((NetworkLink(("p", GROUND), 0.995 / 0.5e-3, 0.0),), (), 1)
    certificate = design(loop, LinearWanted((1,))).certificate
    assert certificate.levels.Delta_V[0][0, 0] > 199.0
    with pytest.raises(Infeasible, match="the environment needs"):
        design(one_port((NetworkLink(("p", GROUND), 1.001 / 0.5e-3, 0.0),), (), 1), LinearWanted((1,)))


def test_transparency_of_a_late_environment_is_proved() -> None:
    """Late displacements are states that nothing feeds back: no balancing of A gives them a scale."""
    aim = Transparency("loop-shaping", Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), 1e-3), Filter.one())
    certificate = design(
        one_port((NetworkLink(("p", GROUND), 200.0, 0.05),), (("u", 1.0),), 2),
        SpringDamperWanted(Wish("loop-shaping", aim)),
    ).certificate
    assert certificate.transparency is not None
    assert all(finding.holds for finding in prove(content(certificate) | {"id": certificate.id}))
