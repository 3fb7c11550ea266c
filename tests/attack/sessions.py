"""Random sessions, designed: the starting points of the attack. Scales run from 1e-6 to 1e15 within one matrix.

Each kind draws a loop and a coupling, and lets `design` certify them; most are refused, as they should be.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from manyhands.design.certificate import content
from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.levels.orientation import OrientationLevel
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.series import counted_parts
from manyhands.design.synthesis import design
from tests.attack.linkages import Arm

Data = dict[str, Any]
Generator = np.random.Generator


def designed(loop: HapticLoop, wanted: CouplingRequest) -> Data | None:
    """The certificate's plain data as a file would give them; None where the design refuses."""
    try:
        with np.errstate(all="ignore"):
            certificate = design(loop, wanted).certificate
    except (DesignError, ValueError, ArithmeticError, np.linalg.LinAlgError):
        return None
    data: Data = json.loads(json.dumps(content(certificate) | {"id": certificate.id}))
    return data


def spread(rng: Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform, often a round one."""
    value = float(10.0 ** rng.uniform(low, high))
    return float(f"{value:.{rng.integers(1, 4)}g}") if rng.random() < 0.5 else value


def symmetric(rng: Generator, m: int, size: float, worst: float = 1.0) -> Matrix:
    """A positive definite matrix, symmetric to the last bit, with eigenvalues down to 10^-worst of ``size``."""
    if m == 1:
        return np.array([[size]])
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    S = size * (Q * 10.0 ** rng.uniform(-worst, 0.0, m)) @ Q.T
    return np.asarray((S + S.T) / 2.0)


def parts(rng: Generator, m: int) -> list[tuple[int, ...]]:
    """The ports in groups, each of one to three."""
    order, out = [int(i) for i in rng.permutation(m)], []
    while order:
        k = int(rng.integers(1, min(3, len(order)) + 1)) if rng.random() < 0.4 else 1
        out.append(tuple(order[:k]))
        order = order[k:]
    return out


def loop_of(rng: Generator, environment: Environment, T: float, osp: float, tau: float = 0.0) -> HapticLoop:
    """Devices of about this level, with axes of their own, any structure of V, and longer periods as often as not."""
    m = len(environment.ports)
    devices = tuple(
        DeviceLevel(f"d{i}", ports, symmetric(rng, len(ports), osp * spread(rng, -0.5, 0.5)))
        for i, ports in enumerate(parts(rng, m))
    )
    blocks = tuple(parts(rng, m))
    return HapticLoop(
        "attack", T, environment.ports, devices, Partition(tuple(f"c{i}" for i in range(len(blocks))), blocks),
        environment, tau, float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.0, 1.0), 0.1, 1.0])),
    )  # fmt: skip


def late(rng: Generator, T: float) -> float:
    """A delay inside the tick; none as often as not."""
    return float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.0, T), T / 2.0, T]))


def spring_damper(rng: Generator, loop: HapticLoop, aim: Transparency | None = None) -> CouplingRequest:
    """As stiff as the delay allows or softer; found by the design now and then."""
    if aim is None and rng.random() < 0.15:
        return SpringDamperWanted(Wish("stiffest" if rng.random() < 0.5 else "feasible"))
    t = loop.tau / loop.period
    least = 0.5 * (1.0 + loop.period_tolerance) + 1.5 * t
    limit = loop.Delta_D / (least * loop.period)
    part = float(rng.choice([0.999, rng.uniform(0.7, 1.0), rng.uniform(0.1, 0.9)])) * (1.0 if t == 0.0 else 0.97)
    damping = float(rng.uniform(-0.3, 1.0)) * (1.0 - part)
    K, B = part * limit, damping * loop.Delta_D / (2.0 * least)
    return SpringDamperGiven(SpringDamper((K + K.T) / 2.0, (B + B.T) / 2.0), aim)


# --- environments


def network(rng: Generator, m: int, osp: float, T: float, stiffest: float | None = None) -> Network:
    """Masses, springs and dampers; ordinary ones, or of any scale beside each other."""
    ports, n = tuple(f"p{i}" for i in range(m)), int(rng.integers(0, 3))
    ends = [*ports, *(f"m{i}" for i in range(n))]
    wide = stiffest is None and rng.random() < 0.4
    top = math.log10(stiffest) if stiffest is not None else 5.0

    def link(a: str, b: str) -> NetworkLink:
        k = spread(rng, -6.0, 15.0) if wide else spread(rng, top - 4.0, top)
        c = spread(rng, -6.0, 9.0) if wide else k * T * spread(rng, -3.0, 1.0)
        return NetworkLink((a, b), k * float(rng.random() < 0.9), c * float(rng.random() < 0.8))

    links = []
    for i, end in enumerate([*ends, *(str(e) for e in rng.choice(ends, size=rng.integers(0, 3)))]):
        others = [e for e in [*ends, GROUND] if e != end]
        links.append(link(end, GROUND if i == 0 else str(rng.choice(others))))
    size = osp * T * 10.0
    masses = tuple((f"m{i}", spread(rng, -6.0, 12.0) if wide else size * spread(rng, -2.0, 4.0)) for i in range(n))
    return Network(ports, masses, tuple(links))


def system(rng: Generator, m: int, size: float, T: float) -> StateSpaceEnvironment:
    """Springs with relaxations and resonances, D - n n'/(s + a) and the like: E(1) is symmetric to the last digit."""
    ports = tuple(f"p{i}" for i in range(m))
    D = symmetric(rng, m, size, float(rng.choice([1.0, 3.0, 9.0])))
    blocks, B, C = [], [], []
    for _ in range(int(rng.integers(1, 4))):
        n = rng.normal(size=m)
        a = spread(rng, -3.0, 0.5) / T
        weight = size * spread(rng, -3.0, 0.0)
        if rng.random() < 0.6:
            blocks.append(np.array([[-a]]))
            B.append(np.sqrt(weight * a) * n[None, :])
            C.append(-B[-1].T)
        else:
            blocks.append(np.array([[0.0, 1.0], [-a * a, -2.0 * a * spread(rng, -2.0, 0.3)]]))
            row = a * np.sqrt(weight) * n[None, :]
            B.append(np.vstack([np.zeros((1, m)), row]))
            C.append(np.hstack([-row.T, np.zeros((m, 1))]))
        D = D + np.array([[float(w) for w in r] for r in np.outer(n, n) * weight * float(rng.choice([0.0, 1.0, 2.0]))])
    A = np.zeros((sum(map(len, blocks)),) * 2)
    at = 0
    for block in blocks:
        A[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    D = (D + D.T) / 2.0
    method = rng.choice(["backward-euler", "tustin", "zoh", "discrete"])
    if method == "discrete":
        # poles inside the circle; B and C share their numbers, so that the statics stay symmetric
        sampled = np.eye(len(A)) + T * A
        if np.abs(np.linalg.eigvals(sampled)).max() >= 1.0:
            sampled, B, C = np.diag(rng.uniform(-0.9, 0.99, len(A))), [np.vstack(B)], [-np.vstack(B).T]
        root = math.sqrt(T)
        make = StateSpace if rng.random() < 0.5 else StateSpace.with_static_gain
        return StateSpaceEnvironment(ports, make(sampled, root * np.vstack(B), root * np.hstack(C), D))
    continuous = StateSpace(A, np.vstack(B), np.hstack(C), D)
    if rng.random() < 0.3:
        gain = symmetric(rng, m, size, 3.0)
        continuous = StateSpace.with_static_gain(A, np.vstack(B), np.hstack(C), gain, continuous=True)
    return StateSpaceEnvironment(ports, continuous, str(method), int(rng.choice([0, 0, 1, 2])))  # type: ignore[arg-type]


def transfer(rng: Generator, m: int, size: float, T: float) -> TransferEnvironment:
    """Springs, dampers, masses and relaxations of each port, and one law that joins the ports by signs."""
    wide = rng.random() < 0.4

    def law() -> tuple[list[float], list[float]]:
        k = spread(rng, -6.0, 12.0) if wide else size * spread(rng, -3.0, 0.0)
        b = (spread(rng, -6.0, 9.0) if wide else k * T * spread(rng, -2.0, 1.0)) * float(rng.random() < 0.7)
        M = (spread(rng, -6.0, 15.0) if wide else k * T * T * spread(rng, -1.0, 3.0)) * float(rng.random() < 0.5)
        num, den = [M, b, k], [1.0]
        if rng.random() < 0.4:
            a, r = spread(rng, -3.0, 0.0) / T, size * spread(rng, -3.0, 0.0)
            num, den = np.polyadd(np.polymul(num, [1.0, a]), [r, 0.0]).tolist(), [1.0, a]
        return num, den

    joining, signs = law(), rng.choice([-1.0, 0.0, 1.0], size=m)
    rows: list[list[Any]] = [[None] * m for _ in range(m)]
    for i in range(m):
        for j in range(m):
            sign = float(signs[i] * signs[j])
            num, den = [sign * c for c in joining[0]], joining[1]
            if i == j:
                own = law()
                num = np.polyadd(np.polymul(num, own[1]), np.polymul(own[0], den)).tolist()
                den = np.polymul(own[1], den).tolist()
            rows[i][j] = (tuple(map(float, num)), tuple(map(float, den)))
    proper = all(not any(num[: len(num) - len(den)]) for row in rows for num, den in row)
    method = "tustin" if proper and rng.random() < 0.5 else "backward-euler"
    ports = tuple(f"p{i}" for i in range(m))
    return TransferEnvironment(ports, tuple(map(tuple, rows)), method, int(rng.choice([0, 0, 0, 1])))  # type: ignore[arg-type]


STATICS = ("definite", "singular", "hidden negative", "skew", "one entry", "near singular", "far apart")


def static(rng: Generator, m: int) -> Matrix:
    """A static stiffness: truly positive, or not quite, beside entries that may be 1e21 times greater."""
    style = str(rng.choice(STATICS))
    if style == "definite":
        return symmetric(rng, m, spread(rng, -6.0, 15.0), float(rng.uniform(0.0, 12.0)))
    sizes = [spread(rng, -6.0, 15.0) for _ in range(m)]
    S = np.diag(sizes)
    if style == "hidden negative":
        S[0, 0] = -spread(rng, -12.0, 3.0)
    elif style == "singular":
        n = rng.choice([-1.0, 0.0, 1.0], size=m)
        S = sizes[0] * np.outer(n, n)
    elif m > 1 and style == "skew":
        k = spread(rng, -3.0, 4.0)
        S[:2, :2] = [[k, 0.8 * k], [-0.8 * k, k]]
    elif m > 1 and style == "one entry":
        S = symmetric(rng, m, sizes[0], 2.0)
        S[0, 1] = np.nextafter(S[0, 1], np.inf) if rng.random() < 0.5 else S[0, 1] + 1e-13 * sizes[0]
    elif m > 1 and style == "near singular":
        a, c = sizes[0], sizes[1]
        b = math.sqrt(a) * math.sqrt(c) * (1.0 + float(rng.choice([-1.0, 1.0])) * spread(rng, -16.0, -8.0))
        S[0, 1] = S[1, 0] = b
    return S


# --- kinds


def of_network(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    loop = loop_of(rng, network(rng, m, osp, T), T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_late_network(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    delay = int(rng.integers(1, 4))
    world = network(rng, m, osp, T, 0.3 * osp / (T * delay) * spread(rng, -1.5, 0.0))
    loop = loop_of(rng, DelayedNetwork(world, delay), T, osp, late(rng, T) if rng.random() < 0.5 else 0.0)
    return designed(loop, spring_damper(rng, loop))


def of_intervals(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    low = network(rng, m, osp, T)
    f = [1.0 + float(x) for x in rng.exponential(2.0, 3)]
    links = tuple(NetworkLink(a.ends, f[0] * a.stiffness, f[1] * a.damping) for a in low.links)
    high = Network(low.ports, tuple((name, f[2] * M) for name, M in low.masses), links)
    loop = loop_of(rng, NetworkBox(low, high), T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_levers(rng: Generator) -> Data | None:
    """A network, certain, by intervals or late, whose ends have scales from 0.01 to 100; now and then its gears jam."""
    T, osp, m = _scales(rng)
    delay = int(rng.choice([0, 0, 1, 2]))
    stiffest = 0.3 * osp / (T * delay) * spread(rng, -1.5, 0.0) if delay else None
    plain = network(rng, m, osp, T, stiffest)
    scale = {end: spread(rng, -2.0, 0.0 if delay else 2.0) for end in (*plain.ports, *(n for n, _ in plain.masses))}

    def arms(link: NetworkLink) -> tuple[float, float]:
        by = float(rng.choice([1.0, 1.0, 2.0, 0.5]))  # exact: the ratio of both arms stays the same
        a, b = (by * scale.get(end, 1.0) for end in link.ends)
        return (a, b * (1.0 + spread(rng, -14.0, -1.0))) if rng.random() < 0.03 else (a, b)

    low = tuple(replace(link, arms=arms(link)) for link in plain.links)
    try:
        one = Network(plain.ports, plain.masses, low)
        world: Environment = one
        if delay:
            world = DelayedNetwork(one, delay)
        elif rng.random() < 0.3:
            f = [1.0 + float(x) for x in rng.exponential(2.0, 3)]
            high = tuple(link.with_values(f[0] * link.stiffness, f[1] * link.damping) for link in low)
            world = NetworkBox(one, Network(plain.ports, tuple((n, f[2] * M) for n, M in plain.masses), high))
    except ValueError:
        return None
    loop = loop_of(rng, world, T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_system(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    loop = loop_of(rng, system(rng, m, osp / T * spread(rng, -2.0, 0.0), T), T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_transfer(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    loop = loop_of(rng, transfer(rng, m, osp / T * spread(rng, -2.0, 1.0), T), T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_statics(rng: Generator) -> Data | None:
    """Statics that are hardly positive, or hardly not, as matrices or under masses and dampers."""
    T, osp, m = _scales(rng)
    S, ports = static(rng, m), tuple(f"p{i}" for i in range(m))
    environment: Environment = StateSpaceEnvironment(ports, StateSpace.static(S))
    if rng.random() < 0.5:
        rows = [[((float(S[i, j]),), (1.0,)) for j in range(m)] for i in range(m)]
        for i in range(m):
            M, b = (spread(rng, -6.0, 15.0) * float(rng.random() < 0.6) for _ in range(2))
            rows[i][i] = ((M, b, float(S[i, i])), (1.0,))  # type: ignore[assignment]
        environment = TransferEnvironment(ports, tuple(map(tuple, rows)))
    loop = loop_of(rng, environment, T, osp, late(rng, T) if rng.random() < 0.3 else 0.0)
    return designed(loop, spring_damper(rng, loop))


def of_declared(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    ports = tuple(f"p{i}" for i in range(m))
    level = symmetric(rng, m, osp * 0.3 * float(rng.uniform(-1.0, 0.9)))
    loop = loop_of(rng, DeclaredEnvironment(ports, level), T, osp, late(rng, T))
    return designed(loop, spring_damper(rng, loop))


def of_linear(rng: Generator) -> Data | None:
    """V = v(z) Delta_D^-1 in each block, v of order 1 to 4: a spring with a damper, behind filters."""
    T, osp, m = _scales(rng)
    environment: Environment = network(rng, m, osp, T) if rng.random() < 0.6 else system(rng, m, 0.1 * osp / T, T)
    loop = loop_of(rng, environment, T, osp, late(rng, T) if rng.random() < 0.3 else 0.0)
    blocks = []
    for level in loop.Delta_D_blocks:
        k = float(rng.uniform(0.2, 0.95)) / ((0.5 * (1.0 + loop.period_tolerance) + 1.5 * loop.tau / T) * T)
        b = float(rng.uniform(-0.1, 0.4))
        num, den = np.array([T, 0.0]) / (T * k + b), np.array([1.0, -b / (T * k + b)])
        for _ in range(int(rng.integers(0, 4))):
            p, c = float(rng.uniform(-0.7, 0.95)), float(rng.uniform(-0.05, 0.3))
            num, den = np.polymul(num, [1.0 + c, -p - c]), np.polymul(den, [1.0, -p])
        S = np.linalg.inv(level)
        S, n, size = (S + S.T) / 2.0, len(den) - 1, len(level)
        a = np.zeros((n, n))
        a[0], a[np.arange(1, n), np.arange(n - 1)] = -den[1:], 1.0
        C = np.hstack([float(num[i + 1] - den[i + 1] * num[0]) * S for i in range(n)])
        I = np.eye(size)
        A, B = np.kron(a, I), np.kron(np.eye(n)[:, :1], I)
        if rng.random() < 0.3:  # its static gain stated in place of D
            blocks.append(StateSpace.with_static_gain(A, B, C, float(num.sum() / den.sum()) * S))
        else:
            blocks.append(StateSpace(A, B, C, float(num[0]) * S))
    return designed(loop, LinearGiven(tuple(blocks)))


def of_series(rng: Generator) -> Data | None:
    """A network that some ports meet by one spring of their own, of which a part is counted in series; or a state space
    or rational functions, of which as much is counted as leaves them passive, or less, or too much."""
    if rng.random() < 0.4:
        return _of_counted_springs(rng)
    T, osp, _ = _scales(rng)
    m = int(rng.integers(1, 7))
    ports, n = tuple(f"p{i}" for i in range(m)), int(rng.integers(0, 3))
    masses = tuple((f"m{i}", osp * T * 10.0 * spread(rng, -2.0, 4.0)) for i in range(n))
    inner = [*(name for name, _ in masses), GROUND]

    def link(a: str, b: str) -> NetworkLink:
        k = osp / T * spread(rng, -2.0, 3.0)
        return NetworkLink((a, b), k, k * T * spread(rng, -3.0, 0.5) * float(rng.random() < 0.8))

    links = [link(port, str(rng.choice(inner))) for port in ports]
    links += [link(link_.ends[0], link_.ends[1]) for link_ in links if rng.random() < 0.1]  # in parallel
    links += [link(a, str(rng.choice([b for b in inner if b != a]))) for a in inner[:-1]]
    if m > 1 and rng.random() < 0.3:
        links.append(link(ports[0], ports[1]))  # these two have no link of their own
    world: Network | NetworkBox = Network(ports, masses, tuple(links))
    if rng.random() < 0.3:
        f = 1.0 + float(rng.exponential(1.0))
        stiffer = tuple(NetworkLink(a.ends, f * a.stiffness, f * a.damping) for a in links)
        world = NetworkBox(world, Network(ports, masses, stiffer))
    loop = loop_of(rng, world, T, osp, late(rng, T))
    contacts = world.contacts()
    counted = [float(rng.choice([0.999, 0.5, rng.random()])) * float(port in contacts) for port in ports]
    aim = None
    if any(counted):
        loop = replace(loop, series=tuple(counted))
    if rng.random() < 0.3 and loop.punctual and isinstance(world, Network):
        aim = _some_aim(rng)
    return designed(loop, spring_damper(rng, loop, aim))


def _of_counted_springs(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    size = osp / T * spread(rng, -1.0, 1.5)
    world: Any = replace((system if rng.random() < 0.5 else transfer)(rng, m, size, T), delay=0)
    loop = loop_of(rng, world, T, osp, late(rng, T))
    most = counted_parts(loop)
    if not most or rng.random() < 0.1:
        most = tuple(float(c) for c in 0.5 / size * rng.random(m))
    by = float(rng.choice([1.0, rng.random(), 1.0 + spread(rng, -4.0, 0.0)]))
    loop = replace(loop, series=tuple(by * c for c in most))
    return designed(loop, spring_damper(rng, loop, _some_aim(rng) if rng.random() < 0.3 and loop.punctual else None))


def _some_aim(rng: Generator) -> Transparency:
    p = float(np.exp(-spread(rng, -2.0, -0.5)))
    objective = "loop-shaping" if rng.random() < 0.5 else "closed-loop"
    return Transparency(objective, Filter((1.0 - p,), (1.0, -p)), Filter((1.0,), (1.0,)))  # type: ignore[arg-type]


def of_held_torque(rng: Generator) -> Data | None:
    """A planar arm whose motors hold torques, before a network; kinematics are stated, and kappa a little too high."""
    T, osp, _ = _scales(rng)
    environment, tau, rho = network(rng, 2, osp, T), late(rng, T), float(rng.choice([0.0, 0.0, 0.1]))
    least = float(rng.uniform(0.5, 2.0))
    arm = Arm(*(spread(rng, -1.3, -0.3) for _ in range(2)), least, least + float(rng.uniform(0.1, 0.8)))  # type: ignore[call-arg]
    linkage = {
        "kind": "chain", "turns": ["z", "z"], "links": [[arm.upper, 0.0, 0.0], [arm.lower, 0.0, 0.0]],
        "low": [-1.0, arm.least], "high": [1.0, arm.most],
    }  # fmt: skip
    kappa = arm.worst()[0] * float(rng.uniform(1.15, 1.3))
    K_geo = 2.0 * osp * float(rng.uniform(0.05, 0.95)) / ((1.0 + rho) * T + 3.0 * tau)
    turned = float(rng.uniform(0.001, 0.2))
    held = HeldTorque(kappa, K_geo / kappa, turned / (kappa * ((1.0 + rho) * T + tau)), linkage)
    device = DeviceLevel("arm", (0, 1), symmetric(rng, 2, osp, 0.1), held)
    blocks = Partition(("c",), ((0, 1),)) if rng.random() < 0.5 else Partition(("cx", "cy"), ((0,), (1,)))
    loop = HapticLoop("attack", T, environment.ports, (device,), blocks, environment, tau, rho)
    try:
        return designed(loop, spring_damper(rng, loop))
    except Infeasible:
        return None


def of_orientation(rng: Generator) -> Data | None:
    """A device whose orientation has a torque, which joints hold together with the force, or which is held itself."""
    T, osp, _ = _scales(rng)
    environment, tau, rho = network(rng, 3, osp, T), late(rng, T), float(rng.choice([0.0, 0.0, 0.1]))
    half = ((1.0 + rho) * T + 3.0 * tau) / 2.0
    held, b, k = None, spread(rng, -4.0, -2.0), 0.0
    if rng.random() < 0.8:
        kappa, length = spread(rng, 0.0, 2.0), spread(rng, -2.0, -0.5)
        force = min(osp, b / length**2) * float(rng.uniform(0.05, 0.9)) / (half * kappa)
        turned = float(rng.uniform(0.001, 0.2))
        held = HeldTorque(kappa, force, turned / (kappa * ((1.0 + rho) * T + tau)), None, length)
        k = max(0.0, b - held.turning(T, tau, rho)) / half
    k = float(rng.uniform(0.1, 1.01)) * (k or b / half)
    level, own = symmetric(rng, 3, osp, 0.1), OrientationLevel(b, k, held)
    device = DeviceLevel("pen", (0, 1, 2), level, held, None, None, None, own)
    loop = HapticLoop("attack", T, environment.ports, (device,), Partition(("c",), ((0, 1, 2),)), environment, tau, rho)
    try:
        return designed(loop, spring_damper(rng, loop))
    except Infeasible:
        return None


def of_encoder_steps(rng: Generator) -> Data | None:
    """Devices that round; dry friction covers that, or not, or nearly."""
    T, osp, m = _scales(rng)
    world: Environment = network(rng, m, osp, T, osp / T) if rng.random() < 0.7 else system(rng, m, 0.1 * osp / T, T)
    loop = loop_of(rng, world, T, osp, late(rng, T))
    step = spread(rng, -7.0, -4.0)
    loop = _with(loop, [step * float(rng.choice([1.0, 1.0, 0.1])) for _ in loop.ports], None)
    wanted = spring_damper(rng, loop)
    data = designed(loop, wanted)
    if data is None or data["encoder"]["force"] is None:
        return data
    by = float(rng.choice([1.0, 1.0, 1.0001, 0.9999, 2.0]))
    return designed(_with(loop, None, [by * w or step for w in data["encoder"]["force"]]), wanted)


def of_dry_friction(rng: Generator) -> Data | None:
    """A claim below a speed: friction is as much damping as there is, or more or less, beside steps as often as not."""
    T, osp, m = _scales(rng)
    loop = loop_of(rng, network(rng, m, osp, T, osp / T), T, osp, late(rng, T))
    speed = spread(rng, -2.0, 0.0)
    friction = [osp * speed * spread(rng, -1.0, 0.5) for _ in loop.ports]
    steps = [0.2 * T * c / osp * float(rng.random()) for c in friction] if rng.random() < 0.5 else None
    loop = replace(_with(loop, steps, friction), speed=speed)
    found = designed(loop, SpringDamperWanted(Wish("stiffest" if rng.random() < 0.7 else "feasible")))
    return found


def _with(loop: HapticLoop, steps: list[float] | None, friction: list[float] | None) -> HapticLoop:
    """The loop whose devices have these steps and this friction, by port; as they were where there is None."""

    def of(device: DeviceLevel, values: list[float] | None, own: tuple[float, ...] | None) -> tuple[float, ...] | None:
        return own if values is None else tuple(values[port] for port in device.ports)

    devices = tuple(
        replace(device, step=of(device, steps, device.step), friction=of(device, friction, device.friction))
        for device in loop.devices
    )
    return replace(loop, devices=devices)


def of_transparency(rng: Generator) -> Data | None:
    T, osp, m = _scales(rng)
    environment: Environment = network(rng, m, osp, T) if rng.random() < 0.6 else system(rng, m, 0.1 * osp / T, T)
    loop = loop_of(rng, environment, T, osp)
    p = float(np.exp(-T * spread(rng, -2.0, -0.5) / T))
    low_pass = Filter((1.0 - p,), (1.0, -p))
    objective = "loop-shaping" if rng.random() < 0.5 else "closed-loop"
    aim = Transparency(objective, low_pass, Filter((1.0,), (1.0,)))  # type: ignore[arg-type]
    return designed(loop, spring_damper(rng, loop, aim))


def _scales(rng: Generator) -> tuple[float, float, int]:
    """T from 10 us to 10 ms, a device's level, ports."""
    return spread(rng, -5.0, -2.0), spread(rng, -1.5, 1.5), int(rng.choice([1, 1, 2, 2, 3]))


KINDS: dict[str, Callable[[Generator], Data | None]] = {
    "network": of_network,
    "late network": of_late_network,
    "intervals": of_intervals,
    "levers": of_levers,
    "state space": of_system,
    "transfer function": of_transfer,
    "statics": of_statics,
    "declared": of_declared,
    "linear coupling": of_linear,
    "transparency": of_transparency,
    "series": of_series,
    "held torque": of_held_torque,
    "orientation": of_orientation,
    "encoder steps": of_encoder_steps,
    "dry friction": of_dry_friction,
}


def ladder(rng: Generator) -> list[Data] | None:
    """Rungs of one loop for growing delays, each designed; devices that blocks split are among them."""
    T, osp, m = _scales(rng)
    m = max(m, 2)
    environment = network(rng, m, osp, T)
    loop = loop_of(rng, environment, T, osp)
    if rng.random() < 0.5:  # one device, split by all blocks
        level = symmetric(rng, m, osp)
        loop = HapticLoop(
            "attack", T, environment.ports, (DeviceLevel("d", tuple(range(m)), level),),
            Partition(tuple(f"c{i}" for i in range(m)), tuple((i,) for i in range(m))), environment, 0.0,
            loop.period_tolerance,
        )  # fmt: skip
    rungs: list[Data] = []
    for part in sorted({0.0, *(float(x) for x in rng.choice([0.1, 0.25, 0.5, 1.0], size=2))}):
        at = replace(loop, tau=part * T)
        data = designed(at, spring_damper(rng, at))
        if data is not None:
            rungs.append(data)
    return rungs if len(rungs) > 1 else None
