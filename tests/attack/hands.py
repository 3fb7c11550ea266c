"""Passive hands, delays and clutches at which a loop is most likely to be shaken, and a search among them.

A hand is described by logarithms, so that a search moves by factors: from a device that stops within a tick to one that
hardly does, without a spring or with one up to the Nyquist frequency, and with masses hung on it by springs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from tests.attack.arithmetic import Array
from tests.attack.loop import Hand, Repeating, Tick, growth
from tests.attack.parties import Data, NoSystem, Reader


def random_hand(rng: np.random.Generator, osp: Sequence[Sequence[float]], T: float) -> Hand:
    """Of one device: a dense mass and spring over its axes, with a gyroscopic part where there are several."""
    m = len(osp)
    damping = float(np.trace(np.array(osp))) / m
    mass = damping * T * 10.0 ** rng.uniform(-1.5, 4.0)
    M = mass * _dense(rng, m)
    K, G = np.zeros((m, m)), np.zeros((m, m))
    if rng.random() < 0.5:
        K = mass * (math.pi / T) ** 2 * 10.0 ** rng.uniform(-8.0, 0.0) * _dense(rng, m)
    if m > 1 and rng.random() < 0.3:
        G = damping * 10.0 ** rng.uniform(-1.0, 2.0) * np.triu(rng.normal(size=(m, m)), 1)
        G = G - G.T
    resonators = []
    for _ in range(int(rng.choice([0, 0, 1, 2]))):
        hung = mass * 10.0 ** rng.uniform(-2.0, 1.5)
        rate = math.pi / T * 10.0 ** rng.uniform(-3.0, 0.3)
        direction = rng.normal(size=m) if m > 1 else np.ones(1)
        resonators.append((hung, hung * rate**2, tuple(float(x) for x in direction / np.linalg.norm(direction))))
    return Hand(M.tolist(), K.tolist(), G.tolist(), tuple(resonators))


def _dense(rng: np.random.Generator, m: int) -> Any:
    """A symmetric positive definite matrix of size about 1, symmetric to the last bit."""
    if m == 1:
        return np.ones((1, 1))
    Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
    S = (Q * 10.0 ** rng.uniform(-1.5, 0.5, m)) @ Q.T
    return (S + S.T) / 2.0


def random_ticks(rng: np.random.Generator, data: Data, rungs: int = 1, independent: bool = True) -> tuple[Tick, ...]:
    """A sequence that repeats: delays within [0, tau], ratios within [0, 1], rungs that change after two ticks at 0.

    Periods are of T, and up to (1 + rho) T where the certificate covers them.
    """
    devices, blocks = len(data["devices"]), len(data["structure"])
    delays: list[tuple[float, ...]]
    style = rng.choice(["none", "latest", "latest", "constant", "two", "any"]) if _late(data, rungs) else "none"
    length = {"two": 2, "any": int(rng.integers(2, 7))}.get(str(style), 1)
    part = {"none": 0.0, "latest": 1.0, "constant": float(rng.random())}.get(str(style), 0.0)
    if style == "two":
        delays = [(0.0,) * devices, (1.0,) * devices]
    elif style == "any":
        delays = [tuple(_end(rng) for _ in range(devices)) for _ in range(length)]
    else:
        delays = [(part,) * devices]
    stretches: list[tuple[float, ...]] = [()]
    if data.get("period_tolerance"):
        number = int(rng.choice([1, 1, len(delays), 2]))
        stretches = [tuple(_end(rng) for _ in range(devices)) for _ in range(number)]
        stretches = [(1.0,) * devices] if rng.random() < 0.5 else stretches
    clutch = rng.choice(["engaged", "engaged", "constant", "moving"])
    ratios = [(1.0,) * blocks]
    at: list[tuple[int, ...]] = [tuple(int(rng.integers(rungs)) for _ in range(blocks))]
    if rungs > 1 and not independent:
        at = [(at[0][0],) * blocks]
    if clutch == "constant":
        ratios = [tuple(float(rng.choice([0.0, 1.0, rng.random()])) for _ in range(blocks))]
    elif clutch == "moving":
        ratios = [tuple(_end(rng) for _ in range(blocks)) for _ in range(int(rng.integers(2, 9)))]
        if rungs > 1:
            for _ in ratios[1:]:
                here = [int(rng.integers(rungs)) for _ in range(blocks)]
                at.append(tuple(here if independent else here[:1] * blocks))
            ratios = _changing(ratios, at)
    length = math.lcm(len(delays), len(ratios), len(at), len(stretches))
    if length > 24:
        delays, stretches, length = delays[:1], stretches[:1], math.lcm(len(ratios), len(at))
    return tuple(
        Tick(
            delays[k % len(delays)],
            ratios[k % len(ratios)],
            at[k % len(at)] if rungs > 1 else (),
            stretches[k % len(stretches)],
        )
        for k in range(length)
    )


def _changing(ratios: Sequence[tuple[float, ...]], at: Sequence[tuple[int, ...]]) -> list[tuple[float, ...]]:
    """The ratios, 0 where decision 16 asks for it: in the tick of a change of rung, and in the one before."""
    changes = [[here != before for here, before in zip(at[k], at[k - 1], strict=True)] for k in range(len(at))]
    out = []
    for k, row in enumerate(ratios):
        following = changes[(k + 1) % len(at)]
        out.append(tuple(0.0 if changes[k][b] or following[b] else ratio for b, ratio in enumerate(row)))
    return out


def _late(data: Data, rungs: int) -> bool:
    return rungs > 1 or data["tau"] > 0


def _end(rng: np.random.Generator) -> float:
    return float(rng.choice([0.0, 1.0, rng.random()]))


def random_loop(rng: np.random.Generator, data: Data, rungs: int = 1, independent: bool = True) -> Repeating:
    """A loop that the certificate, or the ladder, speaks of."""
    hands = tuple(random_hand(rng, device["osp"], data["period"]) for device in data["devices"].values())
    return Repeating(hands, random_ticks(rng, data, rungs, independent), int(rng.integers(2**31)))


def worst(
    rng: np.random.Generator, readers: Sequence[Reader], draws: int, steps: int, independent: bool = True
) -> tuple[float, Repeating | None, int]:
    """The greatest growth among random loops, and from there by steps that are kept where they make it greater.

    Returns:
        The growth of a period (spectral radius less 1), its loop, and how many loops were looked at.
    """
    data, best, found, looked = readers[0].data, -math.inf, None, 0
    for _ in range(draws):
        loop = random_loop(rng, data, len(readers), independent)
        looked += 1
        value = _growth(readers, loop)
        if value > best:
            best, found = value, loop
    size = 1.0
    for _ in range(steps if found is not None else 0):
        assert found is not None
        hands = tuple(_moved(rng, hand, size) for hand in found.hands)
        loop = replace(found, hands=hands)
        looked += 1
        value = _growth(readers, loop)
        if value > best:
            best, found = value, loop
        else:
            size = max(0.8 * size, 0.02)
    return best, found, looked


def _growth(readers: Sequence[Reader], loop: Repeating) -> float:
    try:
        value = growth(readers, loop)
    except (ArithmeticError, NoSystem, np.linalg.LinAlgError, ValueError):
        return -math.inf
    return value if math.isfinite(value) else -math.inf


def _moved(rng: np.random.Generator, hand: Hand, size: float) -> Hand:
    """Masses and springs by factors; the definite matrices stay so."""
    a, b = (float(10.0 ** (size * rng.normal())) for _ in range(2))
    resonators = tuple(
        (mass * float(10.0 ** (size * rng.normal())), k * float(10.0 ** (size * rng.normal())), direction)
        for mass, k, direction in hand.resonators
    )
    return Hand((a * np.array(hand.mass)).tolist(), (b * np.array(hand.stiffness)).tolist(), hand.gyration, resonators)


def at_level(rng: np.random.Generator, data: Mapping[str, Any]) -> dict[str, Any]:
    """The same loop with a linear environment exactly at Phi_E: -Phi_E w beside what neither takes nor gives energy.

    Its entries are fractions: rounded, a lossless part that is large beside Phi_E would not be lossless.

    Lossless, from w = (u - u-)/T to a force, are r g g'w times (1 + s z^-n)/(1 - s z^-n), s = 1 or -1, and times
    (z^2 - 1)/(z^2 - 2 c z + 1). This is the worst that a passivity controller lets through, and the worst of all
    environments that a certificate's levels speak of.
    """
    ports, T = data["ports"], Fraction(repr(data["period"]))
    m, claimed = len(ports), data["levels"]["Phi_E"]
    Phi = np.zeros((m, m))
    if data["environment"]["type"] == "declared":
        Phi = np.array(data["environment"]["level"], dtype=float)
    elif isinstance(claimed, list):
        Phi = np.array(claimed, dtype=float)
    else:
        for name, rows in claimed.items():
            at = [ports.index(port) for port in data["structure"][name]]
            Phi[np.ix_(at, at)] = rows
    osp = float(np.mean([np.trace(np.array(d["osp"])) / len(d["osp"]) for d in data["devices"].values()]))
    # states: u-, then those of the lossless terms; rows over (states, w)
    systems = []
    for _ in range(int(rng.integers(1, 4))):
        g = rng.normal(size=m) * math.sqrt(osp * 10.0 ** rng.uniform(-3.0, 4.0))
        if rng.random() < 0.6:
            n, sign = int(rng.integers(1, 4)), float(rng.choice([1.0, 1.0, -1.0]))
            A, b, c = np.zeros((n, n)), np.zeros(n), np.zeros(n)
            A[np.arange(1, n), np.arange(n - 1)] = 1.0  # r of k ticks ago
            A[0, n - 1] += sign
            b[0], c[n - 1] = 1.0, 2.0 * sign
        else:
            cos = float(rng.uniform(-1.0, 1.0))
            A, b, c = np.array([[2.0 * cos, -1.0], [1.0, 0.0]]), np.array([1.0, 0.0]), np.array([2.0 * cos, -2.0])
        A, b, c, g = (_exactly(M) for M in (A, b, c, g))
        systems.append((A, np.outer(b, g), np.outer(g, c), np.outer(g, g)))
    n = sum(len(system[0]) for system in systems)
    A, B, C = (_exactly(np.zeros(shape)) for shape in ((n + m, n + m), (n + m, m), (m, n + m)))
    D = np.array([[-Fraction(repr(entry)) / T for entry in row] for row in Phi.tolist()], dtype=object)
    B[:m] = _exactly(np.eye(m))
    first = m
    for a, b, c, d in systems:
        k = len(a)
        A[first : first + k, first : first + k] = a
        B[first : first + k] = b / T
        A[first : first + k, :m] = -b / T
        C[:, first : first + k] = c
        D = D + d / T
        first += k
    C[:, :m] = -D
    E = {"type": "state-space", "time": "discrete", "delay": 0}
    E |= {key: M.tolist() for key, M in zip("ABCD", (A, B, C, D), strict=True)}
    kept = {key: value for key, value in data.items() if key != "series"}  # the level is that of what is left
    return {**kept, "environment": E}


def _exactly(M: Array) -> Array:
    """The same numbers as fractions."""
    return np.array([Fraction(value) for value in M.ravel().tolist()], dtype=object).reshape(M.shape)
