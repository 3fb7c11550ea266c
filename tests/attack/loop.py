"""The closed loop in plain matrices: devices with hands, couplings, clutches, environment, and the map of a period.

A device of the certificate's level osp is held by a passive hand, C = osp + skew, K = K' >= 0:

    M a + C v + K x + sum_j k_j n_j (n_j'x - q_j) = f,     mu_j q_j'' = k_j (n_j'x - q_j),

sampled every T, or up to (1 + rho) T where a certificate covers longer periods; its force changes tau_k after a sample.
Between coupling and environment, each block has a clutch of the ratio s(k), with x_c the coupling's end and x_e the
tool:

    x_e - x_e- = s (x_c - x_c-),     x_c = x + C_V xi + D_V f_c,     f_c = s f_e,     f_e = -(C_E eta + D_E x_e).

A sequence of delays, of ratios and of couplings that repeats is a linear map over its period, and its spectral radius
(Floquet) decides whether the loop is shaken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.attack.arithmetic import Array
from tests.attack.parties import Reader, Realisation


@dataclass(frozen=True)
class Hand:
    """A device's inertia and the passive hand that holds it, in SI units.

    Attributes:
        mass: m_i x m_i, positive definite, kg: of device and hand together.
        stiffness: m_i x m_i, positive semidefinite, N/m.
        gyration: m_i x m_i, skew, N*s/m.
        resonators: (mass, stiffness, direction) of each mass that a spring hangs on the device.
    """

    mass: list[list[float]]
    stiffness: list[list[float]]
    gyration: list[list[float]]
    resonators: tuple[tuple[float, float, tuple[float, ...]], ...] = ()


@dataclass(frozen=True)
class Tick:
    """What differs from tick to tick.

    Attributes:
        delays: of each device, as a part of tau.
        ratios: of each block's clutch.
        rungs: of each block, where a ladder has several; a block changes where its ratio is 0 and was
            in the tick before, and starts from rest.
        stretches: of each device, by which part of rho T its period is longer than T; none for periods of T.
    """

    delays: tuple[float, ...]
    ratios: tuple[float, ...]
    rungs: tuple[int, ...] = ()
    stretches: tuple[float, ...] = ()


@dataclass(frozen=True)
class Repeating:
    """A loop that repeats.

    Attributes:
        hands: one for each device.
        ticks: of a period.
        high: which member of the intervals the environment is.
    """

    hands: tuple[Hand, ...]
    ticks: tuple[Tick, ...]
    high: int = 0


def growth(readers: Sequence[Reader], sequence: Repeating) -> float:
    """Spectral radius of a period's map less 1, with a reader for each rung; above 0 the loop is shaken.

    Raises:
        ArithmeticError: a tick has no solution.
        NoSystem: the environment is none.
    """
    return readers[0].arithmetic.radius(period_map(readers, sequence))


def period_map(readers: Sequence[Reader], sequence: Repeating) -> Array:
    """The product of the ticks' matrices."""
    reader = readers[0].member(sequence.high)
    E = reader.environment
    Vs = [other.coupling for other in readers]
    tau = [other.arithmetic.number(other.data["tau"]) for other in readers]
    ticks = sequence.ticks
    if all(tick == ticks[0] for tick in ticks):
        ticks = ticks[:1]
    moving = any(ratio != 1.0 for tick in ticks for ratio in tick.ratios)
    rho = reader.arithmetic.number(reader.data.get("period_tolerance", 0.0))
    devices: dict[tuple[tuple[float, ...], ...], Realisation] = {}
    whole = None
    for tick in ticks:
        rungs = tick.rungs or (0,) * len(reader.data["structure"])
        latest = min(tau[rung] for rung in rungs) if len(tau) > 1 else tau[0]
        timing = (tick.delays, tick.stretches or (0.0,) * len(tick.delays))
        if timing not in devices:
            late, longer = ([reader.arithmetic.number(part) for part in parts] for parts in timing)
            periods = [reader.T * (1 + rho * part) for part in longer]
            devices[timing] = _held(reader, sequence.hands, [latest * part for part in late], periods)
        V = Vs[0] if len(Vs) == 1 else _mixture(reader, readers, Vs, rungs)
        step = _tick(reader, devices[timing], V, E, _ratios(reader, tick) if moving else None)
        whole = step if whole is None else step @ whole
    assert whole is not None
    return whole


def _ratios(reader: Reader, tick: Tick) -> Array:
    out, at = reader.arithmetic.zeros(len(reader.ports), len(reader.ports)), reader.ports.index
    for ratio, ports in zip(tick.ratios, reader.data["structure"].values(), strict=True):
        for port in ports:
            out[at(port), at(port)] = reader.arithmetic.number(ratio)
    return out


def _held(reader: Reader, hands: Sequence[Hand], delays: Sequence[Any], periods: Sequence[Any]) -> Realisation:
    """All devices: states of each, then the ports' forces of the tick before; input f, output x."""
    m, ports = len(reader.ports), reader.ports
    zeros = reader.arithmetic.zeros
    parts = []
    for device, hand, delay, period in zip(reader.data["devices"].values(), hands, delays, periods, strict=True):
        own = [ports.index(port) for port in device["ports"]]
        parts.append((own, _late_device(reader, device, hand, delay, period)))
    n = sum(len(free) for _, (free, _, _) in parts)
    A, B, C = zeros(n + m, n + m), zeros(n + m, m), zeros(m, n + m)
    for i in range(m):
        B[n + i, i] = reader.arithmetic.number(1)
    first = 0
    for at, (free, old, new) in parts:
        k = len(free)
        A[first : first + k, first : first + k] = free
        A[first : first + k, [n + i for i in at]] = old
        B[first : first + k, at] = new
        for j, i in enumerate(at):
            C[i, first + j] = reader.arithmetic.number(1)
        first += k
    return A, B, C, zeros(m, m)


def _late_device(reader: Reader, device: Any, hand: Hand, delay: Any, period: Any) -> tuple[Array, Array, Array]:
    """What a period makes of the states (x, v, q, q'), of the force before, and of the new one."""
    arithmetic, m, r = reader.arithmetic, len(device["ports"]), len(hand.resonators)
    n = 2 * m + 2 * r
    M, K, G = (reader.matrix(part) for part in (hand.mass, hand.stiffness, hand.gyration))
    C, W = reader.matrix(device["osp"]) + G, arithmetic.zeros(n + m, n + m)
    pull = arithmetic.zeros(m, n + m)
    pull[:, :m], pull[:, m : 2 * m] = -K, -C
    for i in range(m):
        W[i, m + i] = pull[i, n + i] = arithmetic.number(1)
    for j, (mass, stiffness, direction) in enumerate(hand.resonators):
        k, d = arithmetic.number(stiffness), [arithmetic.number(x) for x in direction]
        at, speed = 2 * m + j, 2 * m + r + j
        W[at, speed] = arithmetic.number(1)
        W[speed, at] = -k / arithmetic.number(mass)
        for a in range(m):
            W[speed, a] = k * d[a] / arithmetic.number(mass)
            pull[a, at] = pull[a, at] + k * d[a]
            for b in range(m):
                pull[a, b] = pull[a, b] - k * d[a] * d[b]
    W[m : 2 * m] = arithmetic.solve(M, pull)

    def moved(seconds: Any) -> tuple[Array, Array]:
        whole = arithmetic.exponential(W * seconds)
        return whole[:n, :n], whole[:n, n:]

    rest = period - delay
    if not delay > 0:
        free, new = moved(period)
        return free, arithmetic.zeros(n, m), new
    early, old = moved(delay)
    if not rest > 0:
        return early, old, arithmetic.zeros(n, m)
    late, new = moved(rest)
    return late @ early, late @ old, new


def _mixture(reader: Reader, readers: Sequence[Reader], Vs: Sequence[Realisation], rungs: Sequence[int]) -> Realisation:
    """Each block at its rung. The states of all rungs stand side by side; those that are left are at rest at once."""
    out = [reader.arithmetic.zeros(*part.shape) for part in _beside(reader, Vs)]
    n_before = 0
    for number, V in enumerate(Vs):
        A, B, C, D = V
        first = 0
        for block, (name, ports) in enumerate(reader.data["structure"].items()):
            k = _block_order(readers[number], name)
            if rungs[block] == number:
                at = [reader.ports.index(port) for port in ports]
                own, here = slice(first, first + k), slice(n_before + first, n_before + first + k)
                out[0][here, here] = A[own, own]
                out[1][here, :] = B[own, :]
                out[2][at, here] = C[at, own]
                out[3][np.ix_(at, at)] = D[np.ix_(at, at)]
            first += k
        n_before += len(A)
    return out[0], out[1], out[2], out[3]


def _beside(reader: Reader, Vs: Sequence[Realisation]) -> list[Array]:
    n, m = sum(len(V[0]) for V in Vs), len(reader.ports)
    return [reader.arithmetic.zeros(*shape) for shape in ((n, n), (n, m), (m, n), (m, m))]


def _block_order(reader: Reader, name: str) -> int:
    block = reader.data["coupling"]["blocks"][name]
    return len(block["A"]) if reader.data["coupling"]["class"] == "linear" else len(block["stiffness"])


def _tick(reader: Reader, G: Realisation, V: Realisation, E: Realisation, S: Array | None) -> Array:
    """One tick of the states (device, xi, eta), and with clutches (x_e-, x_c-) after them."""
    (A_G, B_G, C_G, _), (A_V, B_V, C_V, D_V), (A_E, B_E, C_E, D_E) = G, V, E
    zeros, solve, m = reader.arithmetic.zeros, reader.arithmetic.solve, len(D_E)
    sizes = [len(A_G), len(A_V), len(A_E), *([m, m] if S is not None else [])]
    n, starts = sum(sizes), np.cumsum([0, *sizes])

    def state(i: int) -> Array:
        out = zeros(sizes[i], n)
        for k in range(sizes[i]):
            out[k, starts[i] + k] = reader.arithmetic.number(1)
        return out

    I = state(0)[:0]
    eye = reader.eye(m)
    device, xi, eta = state(0), state(1), state(2)
    p = C_G @ device + C_V @ xi if len(A_V) else C_G @ device
    load = C_E @ eta if len(A_E) else zeros(m, n)
    if S is None:
        f = -solve(eye + D_E @ D_V, load + D_E @ p)
        x_e = p + D_V @ f
        after = [I]
    else:
        x_e_before, x_c_before = state(3), state(4)
        f_e = -solve(eye + D_E @ S @ D_V @ S, load + D_E @ (x_e_before + S @ (p - x_c_before)))
        f = S @ f_e
        x_c = p + D_V @ f
        x_e = x_e_before + S @ (x_c - x_c_before)
        after = [x_e, x_c]
    rows = [A_G @ device + B_G @ f]
    rows.append(A_V @ xi + B_V @ f if len(A_V) else zeros(0, n))
    rows.append(A_E @ eta + B_E @ x_e if len(A_E) else zeros(0, n))
    return np.vstack([*rows, *after])
