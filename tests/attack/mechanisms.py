"""What a certificate of version 6 says of mechanisms, judged anew: the devices' levels, and what encoder steps add.

A device that holds torques has less of its level, and one with dry friction has more of it below a speed. What is left
of each is exact in rationals, and stands in place of the osp in everything that the oracle does: the device of that
level is what the rest of the certificate speaks of, and hands that are at that level shake it most. What an orientation
burns has to pay for its spring, and for what torques of six joints take of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
from flint import fmpq

from tests.attack.arithmetic import Floats, decimal
from tests.attack.parties import Data, NoSystem, Reader

_TICKS = 500  # of an impulse response; a part of its sum is a lower bound
_ROUNDING = 1e-9  # of such a sum in floats


def at_its_level(data: Data) -> dict[str, Any]:
    """The same certificate of devices that are exactly what is left of their mechanisms, as fractions."""
    if data.get("version", 3) < 6:
        return dict(data)
    devices = {}
    for name, device in data["devices"].items():
        rows = [[_fraction(value) for value in row] for row in device["osp"]]
        for axis, change in enumerate(_changes(data, device)):
            rows[axis][axis] += change
        devices[name] = {"ports": device["ports"], "osp": rows}
    return {**data, "devices": devices}


def _changes(data: Data, device: Data) -> Iterator[Fraction]:
    """By axis, what friction adds to a level less what held torques take, N*s/m."""
    taken = _taken(data, device)
    forces = (data.get("encoder") or {}).get("force")
    for axis, port in enumerate(device["ports"]):
        added = Fraction(0)
        if "speed" in data and "friction" in device:
            w = _fraction(forces[data["ports"].index(port)]) if forces else Fraction(0)
            added = max(Fraction(0), _fraction(device["friction"][axis]) - w) / _fraction(data["speed"])
        yield added - taken


def _taken(data: Data, device: Data) -> Fraction:
    """The damping that pays for held torques, N*s/m."""
    if "held" not in device:
        return Fraction(0)
    T, tau, rho = (_fraction(data.get(key, 0)) for key in ("period", "tau", "period_tolerance"))
    kappa, force, speed = (_fraction(device["held"][key]) for key in ("kappa", "force", "speed"))
    turned = kappa * speed * ((1 + rho) * T + tau)
    if not turned < 2:
        raise NoSystem("a tip that turns too far")
    return kappa * force / (1 - turned / 2) * ((1 + rho) * T + 3 * tau) / 2


def orientations(data: Data) -> list[str]:
    """The claims about orientations that are contradicted, in rationals.

    A hand that swings about one axis, and a proxy that resonates, draw k (T/2 + 3 tau/2) omega^2 at most. Joints of six
    axes draw d (|v|^2 + L^2 |omega|^2) of a hand that goes to and fro, so nothing of it is paid where nothing is burnt
    by turning.
    """
    out = []
    T, tau, rho = (_fraction(data.get(key, 0)) for key in ("period", "tau", "period_tolerance"))
    for device in data["devices"].values():
        own, length = device.get("orientation", {}), device.get("held", {}).get("length")
        burns = _fraction(own["osp"]) if "osp" in own else Fraction(0)
        if "held" in device and "osp" in own and length is None:
            out.append("joints that hold an orientation's torque have a length")
        needed = _fraction(own["stiffness"]) * ((1 + rho) * T + 3 * tau) / 2 if "osp" in own else Fraction(0)
        if length is not None:
            needed += _fraction(length) ** 2 * _taken(data, device)
        if needed > burns:
            out.append("an orientation burns what its torque needs")
    return out


def _fraction(value: Any) -> Fraction:
    exact: fmpq = decimal(value)
    return Fraction(int(exact.p), int(exact.q))


def steps(data: Data) -> list[str]:
    """The claims about encoder steps that are contradicted: w by a part of the sum, friction exactly."""
    if not any("step" in device for device in data["devices"].values()):
        return []
    claim = data.get("encoder")
    if claim is None:
        return ["a step has its claim"]
    if claim["force"] is None:
        return ["what is not bounded is not covered"] if claim["covered"] else []
    at = {port: i for i, port in enumerate(data["ports"])}
    q, c = np.zeros(len(at)), [fmpq(0)] * len(at)
    for device in data["devices"].values():
        for axis, port in enumerate(device["ports"]):
            q[at[port]] = device.get("step", [0.0] * len(device["ports"]))[axis]
            c[at[port]] = decimal(device.get("friction", [0.0] * len(device["ports"]))[axis])
    out = []
    w = np.array(claim["force"], dtype=float)
    if np.any(_at_least(data, q / 2.0) * (1.0 - _ROUNDING) > w):
        out.append("w is what the steps add")
    if claim["covered"] and not all(own >= decimal(force) for own, force in zip(c, claim["force"], strict=True)):
        out.append("dry friction covers the steps")
    return out


def _at_least(data: Data, amplitude: Any) -> Any:
    """A lower bound of the force that displacements of these amplitudes (m) cause, N: with the worst signs so far."""
    reader = Reader(data, Floats())
    A_V, B_V, C_V, D_V = reader.coupling
    A_E, B_E, C_E, D_E = reader.environment
    m = len(D_E)
    left = np.linalg.inv(np.eye(m) + D_E @ D_V)
    total, most = np.zeros(m), 0.0
    for j in range(m):
        if not amplitude[j]:
            continue
        xi, eta, sums = np.zeros(len(A_V)), np.zeros(len(A_E)), np.zeros(m)
        for tick in range(_TICKS):
            x = np.zeros(m)
            x[j] = float(tick == 0)
            free = x + C_V @ xi
            f = -left @ (C_E @ eta + D_E @ free)
            tool = free + D_V @ f
            sums += np.abs(f)
            xi, eta = A_V @ xi + B_V @ f, A_E @ eta + B_E @ tool
            most = max(most, float(np.abs(f).max()))
            if tick > 10 and float(np.abs(f).max()) < 1e-13 * most:
                break
        total += sums * amplitude[j]
    return total if np.all(np.isfinite(total)) else np.full(m, np.inf)
