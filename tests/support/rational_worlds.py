"""Random passive worlds of springs, dampers, masses, relaxations and resonances, and an LMI of other code about them.

A world is a sum of terms n n' E(s) with a direction n over the ports,

    E(s) = k + b s + M s^2,      r s/(s + a),      c s^2/(s^2 + 2 d w s + w^2),

all passive. The session gets it as rational functions: the terms of each entry on one denominator. The LMI gets the
terms themselves: E(s)/s of each in the states of its energy, discretised by backward Euler, 1/s = Tz/(z-1). It asks for
the least multiple phi of the devices' level with which E_hat is (-phi Delta_D)-ISP. Some coupling is certified by
Theorem 3 exactly if phi < 1. It shares no code and no coordinates with the design.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import TransferEnvironment
from manyhands.design.models.statespace import Matrix
from manyhands.design.problem import DeviceLevel, HapticLoop

T = 1e-3
_STRICT = 1e-9  # the room that the LMI asks for, in states of energy
Generator = np.random.Generator


@dataclass(frozen=True)
class Term:
    """One term of a world.

    Attributes:
        n: direction over the ports; entries -1, 0, 1.
        num, den: E(s), descending powers of s.
        parameters: (k, b, M), (r, a) or (c, d, w).
    """

    n: tuple[int, ...]
    num: tuple[float, ...]
    den: tuple[float, ...]
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class RationalWorld:
    """A loop of one device a port and a world of terms.

    Attributes:
        terms: of the world.
        osp: level of each device, N*s/m.
        delay: ticks by which the world's forces are late.
    """

    terms: tuple[Term, ...]
    osp: tuple[float, ...]
    delay: int

    def loop(self) -> HapticLoop:
        """The loop, with the world as rational functions."""
        ports = tuple(f"p{i}" for i in range(len(self.osp)))
        entries = tuple(tuple(self._entry(i, j) for j in range(len(ports))) for i in range(len(ports)))
        devices = tuple(DeviceLevel(f"d{i}", (i,), np.array([[level]])) for i, level in enumerate(self.osp))
        blocks = Partition(tuple(f"c{i}" for i in range(len(ports))), tuple((i,) for i in range(len(ports))))
        world = TransferEnvironment(ports, entries, "backward-euler", self.delay)
        return HapticLoop("rational", T, ports, devices, blocks, world)

    def _entry(self, i: int, j: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        num, den = np.zeros(1), np.ones(1)
        for term in self.terms:
            if sign := term.n[i] * term.n[j]:
                num = np.polyadd(np.polymul(num, term.den), sign * np.polymul(term.num, den))
                den = np.polymul(den, term.den)
        return tuple(map(float, num)), tuple(map(float, den))

    def dissipation(self, angle: float) -> tuple[Matrix, float]:
        """The real Hermitian part of E_hat at e^{j angle}, from the terms, and the greatest entry of E_hat."""
        z = np.exp(1j * angle)
        s = 2j * np.sin(angle / 2.0) * np.exp(-0.5j * angle) / T  # (1 - 1/z)/T, without its cancellation
        E = sum(np.outer(t.n, t.n) * (np.polyval(t.num, s) / np.polyval(t.den, s)) for t in self.terms)
        E_hat = np.asarray(E / s * z**-self.delay)
        return np.asarray((E_hat + E_hat.conj().T).real / 2.0), float(np.abs(E_hat).max())

    def needed(self) -> float:
        """phi: the least multiple of the devices' level that E_hat needs, by an LMI; nan if it gives up."""
        A, B, C, D, stiffness = self._rest()
        scale = np.diag(np.array(self.osp) ** -0.5)
        B, C, D, E1 = B @ scale, scale @ C, scale @ D @ scale, scale @ stiffness @ scale
        n, m = B.shape
        P, phi = cp.Variable((n, n), symmetric=True), cp.Variable()
        G = np.hstack([A, B])
        kept = cp.bmat([[P, C.T / 2.0], [C / 2.0, (D + D.T) / 2.0 + phi * np.eye(m) - T / 2.0 * E1]])
        M = kept - G.T @ P @ G
        strict = [P >> _STRICT * np.eye(n), (M + M.T) / 2.0 >> _STRICT * np.eye(n + m)]
        program = cp.Problem(cp.Minimize(phi), strict)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # an answer that may be inaccurate is taken as one, below
                program.solve(solver=cp.CLARABEL)
        except cp.error.SolverError:
            return float("nan")
        return float(phi.value) if program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE) else float("nan")

    def _rest(self) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
        """E_hat less its integrators T/(z-1) E1, and E1; with the delay as in delayed velocities."""
        m = len(self.osp)
        parts = [_in_energy(term) for term in self.terms]
        n = sum(len(part[0]) for part in parts)
        A, B, C, D, E1 = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n)), np.zeros((m, m)), np.zeros((m, m))
        at = 0
        for term, (A_i, b_i, c_i, d_i, k_i) in zip(self.terms, parts, strict=True):
            own, direction = slice(at, at + len(A_i)), np.array(term.n, dtype=float)
            A[own, own], B[own], C[:, own] = A_i, np.outer(b_i, direction), np.outer(direction, c_i)
            D += d_i * np.outer(direction, direction)
            E1 += k_i * np.outer(direction, direction)
            at += len(A_i)
        for _ in range(self.delay):  # z^-1 Rest - T E1 z^-1
            A, B, C, D = (
                np.block([[A, B], [np.zeros((m, len(A) + m))]]),
                np.vstack([np.zeros((len(A), m)), np.eye(m)]),
                np.hstack([C, D - T * E1]),
                np.zeros((m, m)),
            )
        return A, B, C, D, E1


def _in_energy(term: Term) -> tuple[Matrix, Matrix, Matrix, float, float]:
    """A, b, c, d of Rest and E1 of one term, for n = 1; the states are square roots of energies."""
    if len(term.parameters) == 3 and len(term.den) == 1:
        k, b, M = term.parameters
        d = k * T + b + M / T  # M (w - w-)/T, with the state sqrt(M/T) w-
        if M == 0.0:
            return np.zeros((0, 0)), np.zeros(0), np.zeros(0), d, k
        root = np.sqrt(M / T)
        return np.zeros((1, 1)), np.array([root]), np.array([-root]), d, k
    if len(term.parameters) == 2:
        r, a = term.parameters  # r/(s + a)
        F, g = np.array([[-a]]), np.array([np.sqrt(r)])
    else:
        c, damping, w = term.parameters  # c s/(s^2 + 2 d w s + w^2)
        F, g = np.array([[-2.0 * damping * w, -w], [w, 0.0]]), np.array([np.sqrt(c), 0.0])
    R = np.linalg.inv(np.eye(len(F)) - T * F)
    return R, T * R @ g, g @ R, float(T * g @ R @ g), 0.0


def random_world(rng: Generator) -> RationalWorld:
    """One or two ports, human scales, poles from 0.01 to 1000/s; one in six is late by a tick."""
    m, late = int(rng.choice([1, 1, 2])), rng.random() < 1.0 / 6.0
    softer = 10.0 ** rng.uniform(-2.5, -0.5) if late else 1.0

    def some(low: float, high: float) -> float:
        return float(10.0 ** rng.uniform(low, high))

    def law(n: tuple[int, ...]) -> list[Term]:
        k, b = softer * some(1.0, 3.5), softer * some(-1.0, 1.0) * float(rng.random() < 0.7)
        M = softer * some(-2.0, 0.5) * float(rng.random() < 0.5)
        out = [Term(n, (M, b, k), (1.0,), (k, b, M))]
        for _ in range(rng.integers(1, 4)):
            pole, size = some(-2.0, 3.0), softer * some(1.0, 3.5)
            if rng.random() < 0.7:
                out.append(Term(n, (size, 0.0), (1.0, pole), (size, pole)))
            else:
                d = float(rng.uniform(0.05, 1.2))
                out.append(Term(n, (size, 0.0, 0.0), (1.0, 2.0 * d * pole, pole * pole), (size, d, pole)))
        return out

    terms = [term for i in range(m) for term in law(tuple(int(i == j) for j in range(m)))]
    if m > 1:
        terms += law(tuple(int(sign) for sign in rng.choice([-1, 1], size=m)))
    return RationalWorld(tuple(terms), tuple(some(-0.5, 0.7) for _ in range(m)), int(late))
