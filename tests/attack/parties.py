"""The environment and the coupling of a certificate, from its plain data: as state spaces, and as responses.

The two are computed in different ways, so that each checks the other (tests). Nothing of the product is used. E maps
the tool's displacement (m) to its force (N); V maps force to displacement. s = (z-1)/(Tz), or 2 (z-1)/(T (z+1)).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mat

from tests.attack.arithmetic import Arithmetic, Array, Precise, decimal, rational

Data = Mapping[str, Any]
Realisation = tuple[Array, Array, Array, Array]


class NoSystem(ValueError):
    """The data make no causal discrete system."""


@dataclass(frozen=True)
class Reader:
    """A certificate's numbers in one arithmetic.

    Attributes:
        data: the plain data.
        arithmetic: what its numbers become.
        high: which end of an interval each link and mass has, drawn by a seed; None for the lower ends.
    """

    data: Data
    arithmetic: Arithmetic
    high: int | None = None

    def member(self, high: int) -> Reader:
        """The same for a member of its intervals, if it has any."""
        return replace(self, high=high) if uncertain(self.data) else self

    @property
    def ports(self) -> list[str]:
        """The ports' names."""
        return list(self.data["ports"])

    @property
    def T(self) -> Any:
        """The period, s."""
        return self.arithmetic.number(self.data["period"])

    def matrix(self, rows: Sequence[Sequence[float]], shape: tuple[int, int] | None = None) -> Array:
        """A matrix of the file; ``shape`` restores what JSON loses in an empty one."""
        rows = [list(row) for row in rows]
        if shape is None:
            shape = (len(rows), len(rows[0]))
        out = self.arithmetic.zeros(*shape)
        for i, row in enumerate(rows):
            for j, value in enumerate(row):
                out[i, j] = self.arithmetic.number(value)
        return out

    def joined(self, parts: Mapping[str, Any] | Sequence[Any]) -> Array:
        """A matrix over all ports from its blocks by the structure, or whole."""
        if not isinstance(parts, Mapping):
            return self.matrix(parts)
        return self._placed({name: (self.data["structure"][name], rows) for name, rows in parts.items()})

    def osp(self) -> Array:
        """The devices' levels, m x m, N*s/m."""
        return self._placed({name: (device["ports"], device["osp"]) for name, device in self.data["devices"].items()})

    def _placed(self, parts: Mapping[str, tuple[Sequence[str], Any]]) -> Array:
        at = {port: i for i, port in enumerate(self.ports)}
        out = self.arithmetic.zeros(len(at), len(at))
        for ports, rows in parts.values():
            for i, row in zip(ports, rows, strict=True):
                for j, value in zip(ports, row, strict=True):
                    out[at[i], at[j]] = self.arithmetic.number(value)
        return out

    @cached_property
    def network(self) -> tuple[Array, Array, Array]:
        """Mass, damping and stiffness matrices over ports, then masses."""
        E, draw = self.data["environment"], np.random.default_rng(self.high)

        def value(span: Any) -> Any:
            if not isinstance(span, list):
                return self.arithmetic.number(span)
            return self.arithmetic.number(span[int(draw.integers(2)) if self.high is not None else 0])

        names = [*self.ports, *E["masses"]]
        at, m = {name: i for i, name in enumerate(names)}, len(self.ports)
        M, B, K = (self.arithmetic.zeros(len(names), len(names)) for _ in range(3))
        for i, mass in enumerate(E["masses"].values()):
            M[m + i, m + i] = value(mass)
        counted = self.data.get("series", {})
        for link in E["links"]:
            k, b = value(link["stiffness"]), value(link["damping"])
            for name in link["between"]:  # a part of the link's compliance is in V, and the rest of it is stiffer
                if name in counted:
                    k, b = (x / (1 - self.arithmetic.number(counted[name])) for x in (k, b))
            # the link's length is n'u, with the lever arm of each end in n
            arms = zip(link["between"], (1, -1), link.get("arms", (1, 1)), strict=True)
            n = [(at[name], sign * self.arithmetic.number(arm)) for name, sign, arm in arms if name != "ground"]
            for i, own in n:
                for j, other in n:
                    K[i, j] = K[i, j] + own * k * other
                    B[i, j] = B[i, j] + own * b * other
        return M, B, K

    # --- state spaces

    @cached_property
    def environment(self) -> Realisation:
        """E as a discrete state space, with its delay."""
        E = self.data["environment"]
        own = {"network": self._network, "state-space": self._system, "transfer-function": self._transfer}[E["type"]]()
        if E["type"] != "network" and "series" in self.data:
            own = self._pushed(own)
        return self._late(own, E["delay"])

    def _pushed(self, system: Realisation) -> Realisation:
        """E (I - c E)^-1: the force f of the displacement x' + c f."""
        A, B, C, D = system
        c = self.springs
        n, m = B.shape
        f = self.arithmetic.solve(self.eye(m) - D @ c, np.hstack([C, D]))  # of the states and x'
        moved = c @ f + np.hstack([self.arithmetic.zeros(m, n), self.eye(m)])
        after = np.hstack([A, self.arithmetic.zeros(n, m)]) + B @ moved
        return after[:, :n], after[:, n:], f[:, :n], f[:, n:]

    @property
    def springs(self) -> Array:
        """diag(c) of the compliances that are counted of a world that is no network."""
        out = self.arithmetic.zeros(len(self.ports), len(self.ports))
        for port, entry in self.data["series"].items():
            out[self.ports.index(port), self.ports.index(port)] = self.arithmetic.number(entry["compliance"])
        return out

    def eye(self, n: int) -> Array:
        """The identity."""
        out = self.arithmetic.zeros(n, n)
        for i in range(n):
            out[i, i] = self.arithmetic.number(1)
        return out

    def _network(self) -> Realisation:
        """States: deflections q and velocities v of the masses, and the ports' displacement, of the tick before."""
        M, B, K = self.network
        m, T, zeros = len(self.ports), self.T, self.arithmetic.zeros
        n = len(M) - m
        u, q = slice(0, m), slice(m, m + n)
        load = np.hstack([-K[q, q], M[q, q] / T, B[q, u] / T, -(B[q, u] / T + K[q, u])])  # of q-, v-, u-, u
        v = self.arithmetic.solve(M[q, q] / T + B[q, q] + K[q, q] * T, load) if n else load
        moved = v * T + np.hstack([self.eye(n), zeros(n, n + 2 * m)])
        here = np.hstack([zeros(m, 2 * n + m), self.eye(m)])
        before = np.hstack([zeros(m, 2 * n), self.eye(m), zeros(m, m)])
        f = K[u, u] @ here + B[u, u] @ ((here - before) / T)
        if n:
            f = f + K[u, q] @ moved + B[u, q] @ v
        after, k = np.vstack([moved, v, here]), 2 * n + m
        return after[:, :k], after[:, k:], f[:, :k], f[:, k:]

    def _system(self) -> Realisation:
        E, m, T = self.data["environment"], len(self.ports), self.T
        n = len(E["A"])
        A, B, C, D = self.matrices(E, n, m, E["time"] == "discrete")
        if E["time"] == "discrete" or n == 0:
            return A, B, C, D
        return self._discrete(A, B, C, D, E["method"], T)

    def matrices(self, part: Data, n: int, m: int, discrete: bool) -> Realisation:
        """A, B, C, D; where the static gain is stated in place of D, D is what that gain leaves."""
        A, B, C = self.matrix(part["A"], (n, n)), self.matrix(part["B"], (n, m)), self.matrix(part["C"], (m, n))
        if "D" in part:
            return A, B, C, self.matrix(part["D"], (m, m))
        D = self.matrix(part["static"], (m, m))
        return A, B, C, D - C @ self.arithmetic.solve(self.eye(n) - A if discrete else -A, B) if n else D

    def _discrete(self, A: Array, B: Array, C: Array, D: Array, method: str, T: Any) -> Realisation:
        n, m = B.shape
        solve = self.arithmetic.solve
        if method == "zoh":
            whole = np.vstack([np.hstack([A * T, B * T]), self.arithmetic.zeros(m, n + m)])
            whole = self.arithmetic.exponential(whole)
            return whole[:n, :n], whole[:n, n:], C, D
        if method == "backward-euler":  # x = x- + T (A x + B u)
            after = solve(self.eye(n) - A * T, np.hstack([self.eye(n), B * T]))
            return after[:, :n], after[:, n:], C @ after[:, :n], C @ after[:, n:] + D
        # x = x- + T/2 (A x + B u + A x- + B u-); the state is (I + T A/2) x- + T/2 B u-
        h = T / 2
        own = solve(self.eye(n) - A * h, np.hstack([self.eye(n), B * h]))
        X, Y = own[:, :n], own[:, n:]
        P = self.eye(n) + A * h
        return P @ X, P @ Y + B * h, C @ X, C @ Y + D

    def _transfer(self) -> Realisation:
        """Each entry as a polynomial in s, of backward differences, and a proper rest in companion form."""
        E, m, T = self.data["environment"], len(self.ports), self.T
        zeros, number = self.arithmetic.zeros, self.arithmetic.number
        parts: list[tuple[int, int, Realisation]] = []
        for i, row in enumerate(E["entries"]):
            for j, entry in enumerate(row):
                num, den = ([number(c) for c in trimmed(entry[key])] for key in ("num", "den"))
                quotient, rest = _divided(num, den)
                n = len(den) - 1
                if len(quotient) > 1 and E["method"] != "backward-euler":
                    raise NoSystem("an improper entry by Tustin has a pole at z = -1")
                if n:
                    A, B, C, D = zeros(n, n), zeros(n, 1), zeros(1, n), zeros(1, 1)
                    for k in range(n - 1):
                        A[k, k + 1] = number(1)
                    for k in range(n):
                        A[n - 1, k] = -den[n - k] / den[0]
                        C[0, k] = rest[n - 1 - k] / den[0]
                    B[n - 1, 0] = number(1)
                    parts.append((i, j, self._discrete(A, B, C, D, E["method"], T)))
                parts.append((i, j, self._differences(quotient[::-1])))
        n = sum(len(part[0]) for _, _, part in parts)
        A, B, C, D = zeros(n, n), zeros(n, m), zeros(m, n), zeros(m, m)
        at = 0
        for i, j, (a, b, c, d) in parts:
            k = len(a)
            A[at : at + k, at : at + k] = a
            B[at : at + k, j : j + 1] = b
            C[i : i + 1, at : at + k] = c
            D[i, j] = D[i, j] + d[0, 0]
            at += k
        return A, B, C, D

    def _differences(self, coefficients: list[Any]) -> Realisation:
        """c_0 + c_1 s + c_2 s^2 + ... by backward differences; the states are the differences of the tick before."""
        n, zeros, T = len(coefficients) - 1, self.arithmetic.zeros, self.T
        signal = zeros(1, n + 1)
        signal[0, n] = self.arithmetic.number(1)
        f, kept = signal * coefficients[0], []
        for k in range(n):
            kept.append(signal)
            before = zeros(1, n + 1)
            before[0, k] = self.arithmetic.number(1)
            signal = (signal - before) / T
            f = f + signal * coefficients[k + 1]
        after = np.vstack([zeros(0, n + 1), *kept])
        return after[:, :n], after[:, n:], f[:, :n], f[:, n:]

    def _late(self, system: Realisation, ticks: int) -> Realisation:
        """The forces of ``ticks`` ticks ago."""
        zeros = self.arithmetic.zeros
        for _ in range(ticks):
            A, B, C, D = system
            n, m = B.shape
            system = (
                np.vstack([np.hstack([A, zeros(n, m)]), np.hstack([C, zeros(m, m)])]),
                np.vstack([B, D]),
                np.hstack([zeros(m, n), self.eye(m)]),
                zeros(m, m),
            )
        return system

    @cached_property
    def coupling(self) -> Realisation:
        """V with its blocks at their ports; a spring with a damper has its deflection of the tick before as a state."""
        at = {port: i for i, port in enumerate(self.ports)}
        zeros, T = self.arithmetic.zeros, self.T
        parts = []
        for name, ports in self.data["structure"].items():
            block, m = self.data["coupling"]["blocks"][name], len(ports)
            if self.data["coupling"]["class"] == "spring-damper":
                K, B = self.matrix(block["stiffness"]), self.matrix(block["damping"])
                solved = self.arithmetic.solve(K + B / T, np.hstack([B / T, self.eye(m)]))
                A = C = solved[:, :m]
                B = D = solved[:, m:]
            else:
                n = len(block["A"])
                A, B, C, D = self.matrices(block, n, m, True)
            parts.append(([at[port] for port in ports], (A, B, C, D)))
        n, m = sum(len(part[1][0]) for part in parts), len(at)
        A, B, C, D = zeros(n, n), zeros(n, m), zeros(m, n), zeros(m, m)
        first = 0
        for ports_at, (a, b, c, d) in parts:
            k = len(a)
            A[first : first + k, first : first + k] = a
            B[first : first + k, ports_at] = b
            C[ports_at, first : first + k] = c
            D[np.ix_(ports_at, ports_at)] = d
            first += k
        return A, B, C, D

    # --- responses

    def environment_at(self, z: Any) -> Array:
        """E(z), m x m, with its delay, for what ``arithmetic.circle`` gives."""
        E, m = self.data["environment"], len(self.ports)
        euler = (z - 1) / (z * self.T)
        if E["type"] == "network":
            M, B, K = self.network
            whole = K + B * euler + M * euler**2
            out = whole[..., :m, :m]
            if len(M) > m:
                inner = self.arithmetic.solve(whole[..., m:, m:], whole[..., m:, :m])
                out = out - whole[..., :m, m:] @ inner
        elif E["type"] == "state-space":
            n = len(E["A"])
            A, B, C, D = self.matrices(E, n, m, E["time"] == "discrete")
            s = z
            if E["time"] == "continuous" and E["method"] == "zoh" and n:
                A, B, C, D = self._discrete(A, B, C, D, "zoh", self.T)
            elif E["time"] == "continuous":
                s = euler if E["method"] == "backward-euler" else (z - 1) * 2 / ((z + 1) * self.T)
            out = D + 0 * z * D
            if n:
                out = out + C @ self.arithmetic.solve(s * self.eye(n) - A, B + 0 * z * B)
        else:
            s = euler if E["method"] == "backward-euler" else (z - 1) * 2 / ((z + 1) * self.T)
            out = 0 * z * self.eye(m)
            for i, row in enumerate(E["entries"]):
                for j, entry in enumerate(row):
                    num, den = (self.polynomial(trimmed(entry[key]), s) for key in ("num", "den"))
                    value = num / den
                    out[..., i, j] = value[..., 0, 0] if isinstance(value, np.ndarray) else value
        if E["type"] != "network" and "series" in self.data:
            out = self.arithmetic.solve(self.eye(m) - out @ self.springs, out)
        return out * z ** (-E["delay"])

    @property
    def world(self) -> Reader:
        """The same without what is counted in series: its environment is the world as it is stated."""
        return replace(self, data={key: value for key, value in self.data.items() if key != "series"})

    def counted_at(self, z: Any) -> list[Any]:
        """What is counted at each port, of a network p/(k + b s), at z; 0 where nothing is."""
        parts, number = self.data.get("series", {}), self.arithmetic.number
        if not parts:
            return [0 * z for _ in self.ports]
        if self.data["environment"]["type"] != "network":
            return [self.springs[i, i] + 0 * z for i in range(len(self.ports))]
        _, B, K = self.world.network  # a port's own links are all that its row has
        s = (z - 1) / (z * self.T)
        return [
            number(parts[port]) / (K[i, i] + B[i, i] * s) if port in parts else 0 * z
            for i, port in enumerate(self.ports)
        ]

    def polynomial(self, coefficients: Sequence[float], s: Any) -> Any:
        """Its value at s; descending powers."""
        out = 0 * s
        for c in coefficients:
            out = out * s + self.arithmetic.number(c)
        return out

    def block_at(self, name: str, z: Any) -> Array:
        """V(z) of one block."""
        block, m = self.data["coupling"]["blocks"][name], len(self.data["structure"][name])
        if self.data["coupling"]["class"] == "spring-damper":
            s = (z - 1) / (z * self.T)
            return self.arithmetic.solve(
                self.matrix(block["stiffness"]) + self.matrix(block["damping"]) * s, self.eye(m) + 0 * z * self.eye(m)
            )
        n = len(block["A"])
        A, B, C, D = self.matrices(block, n, m, True)
        out = D + 0 * z * D
        if n:
            out = out + C @ self.arithmetic.solve(z * self.eye(n) - A, B + 0 * z * B)
        return out


def uncertain(data: Data) -> bool:
    """Whether the environment is a network with intervals."""
    E = data["environment"]
    if E["type"] != "network":
        return False
    spans = [*E["masses"].values(), *(link[key] for link in E["links"] for key in ("stiffness", "damping"))]
    return any(isinstance(span, list) for span in spans)


def trimmed(coefficients: Sequence[float]) -> list[float]:
    """Without leading zeros; the zero polynomial keeps one."""
    for i, c in enumerate(coefficients):
        if c:
            return list(coefficients[i:])
    return [0.0]


def _divided(num: list[Any], den: list[Any]) -> tuple[list[Any], list[Any]]:
    """Quotient and remainder of polynomials with descending powers; the remainder has one coefficient less than den."""
    rest, quotient = list(num), []
    while len(rest) >= len(den):
        c = rest[0] / den[0]
        quotient.append(c)
        rest = [a - c * b for a, b in zip(rest[1:], [*den[1:], *[0 * c] * len(rest)], strict=False)]
    zero = den[0] * 0
    return quotient or [zero], [zero] * (len(den) - 1 - len(rest)) + rest


def static_stiffness(data: Data) -> list[list[fmpq]] | None:
    """E(1) by the decimals of the file, exactly, behind what is counted; None where a pole at z = 1 leaves none."""
    out = _stated_stiffness(data)
    if out is None or "series" not in data:
        return out
    m = len(out)
    c = [decimal(data["series"][port]["compliance"]) if port in data["series"] else fmpq(0) for port in data["ports"]]
    left = fmpq_mat([[fmpq(int(i == j)) - out[i][j] * c[j] for j in range(m)] for i in range(m)])
    try:
        behind = left.solve(fmpq_mat(out))
    except ZeroDivisionError:
        return None
    return [[behind[i, j] for j in range(m)] for i in range(m)]


def _stated_stiffness(data: Data) -> list[list[fmpq]] | None:
    E = data["environment"]
    if E["type"] == "transfer-function":
        rows = []
        for row in E["entries"]:
            ends = [(decimal(entry["num"][-1]), decimal(entry["den"][-1])) for entry in row]
            if any(below == 0 for _, below in ends):
                return None
            rows.append([above / below for above, below in ends])
        return rows
    return _at_rest(E, E["time"] == "discrete")


def static_compliance(data: Data, name: str) -> list[list[fmpq]] | None:
    """V(1) of a linear block by the decimals of the file, exactly."""
    return _at_rest(data["coupling"]["blocks"][name], True)


def _at_rest(part: Data, discrete: bool) -> list[list[fmpq]] | None:
    if "static" in part:
        return rational(part["static"])
    out, n, m = rational(part["D"]), len(part["A"]), len(part["D"])
    if n == 0:
        return out
    a = rational(part["A"])
    inner = fmpq_mat([[(fmpq(int(i == j)) if discrete else fmpq(0)) - a[i][j] for j in range(n)] for i in range(n)])
    try:
        steady = fmpq_mat(rational(part["C"])) * inner.solve(fmpq_mat(rational(part["B"])))
    except ZeroDivisionError:
        return None
    return [[out[i][j] + steady[i, j] for j in range(m)] for i in range(m)]


def precise(data: Data) -> Reader:
    """The same data in long numbers."""
    return Reader(data, Precise())
