"""The parts of a certificate that come in several kinds, as JSON values: requests, environments, couplings, aims.

All but the requests are read back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from manyhands.design.contract import ENERGY, ENFORCED
from manyhands.design.coupling import CouplingBlock, SpringDamper
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.discretisation import METHODS
from manyhands.design.environment import (
    DelayedNetwork,
    Environment,
    NetworkBox,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.network import Link, Network
from manyhands.design.operators import Rational
from manyhands.design.partition import Partition
from manyhands.design.problem import (
    CouplingRequest,
    LinearGiven,
    LinearWanted,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.statespace import Matrix, StateSpace, matrix
from manyhands.design.weighted_loop import Transparency
from manyhands.design.weights import Filter

MOST_DELAY = 64  # ticks: what is built grows with it


def describe_request(wanted: CouplingRequest, names: Sequence[str]) -> dict[str, Any]:
    """What is asked of a coupling, by the keys that a session's ``design:`` has for it.

    Left out is what a certificate has elsewhere: the delay, and a given coupling's numbers. Weights are in z.

    Args:
        wanted: the request.
        names: of the blocks of V, in the partition's order.
    """
    match wanted:
        case SpringDamperWanted(wish):
            return {"coupling": "spring-damper", **_describe_wish(wish)}
        case LinearWanted(orders, wish, poles):
            order = {"order": dict(zip(names, orders, strict=True))}
            fixed = [{"frequency": pole.frequency, "damping": pole.damping} for pole in poles or ()]
            return {"coupling": "linear", **_describe_wish(wish), **order} | ({"poles": fixed} if fixed else {})
        case SpringDamperGiven(_, aim) | LinearGiven(_, aim):
            return {"coupling": "given", **_describe_objective("feasible", aim)}
    return {"coupling": "none", **_describe_objective("feasible", None)}


def _describe_wish(wish: Wish) -> dict[str, Any]:
    out = {**_describe_objective(wish.objective, wish.aim), "algorithm": wish.algorithm}
    return out | ({"iterations": wish.iterations} if wish.algorithm == "complementarity" else {})


def _describe_objective(objective: str, aim: Transparency | None) -> dict[str, Any]:
    return {"objective": objective} if aim is None else {"objective": aim.objective, "weights": _weights(aim)}


def describe_environment(environment: Environment) -> dict[str, Any]:
    """The environment's physical data; an interval is [low, high]."""
    match environment:
        case Network():
            return _network(environment, environment, 0)
        case NetworkBox(low, high):
            return _network(low, high, 0)
        case DelayedNetwork(network, delay):
            return _network(network, network, delay)
        case StateSpaceEnvironment(_, system, method, delay):
            time = {"time": "discrete"} if method is None else {"time": "continuous", "method": method}
            return {"type": "state-space", **system_values(system), **time, "delay": delay}
        case TransferEnvironment(_, entries, method, delay):
            rows = [[{"num": list(num), "den": list(den)} for num, den in row] for row in entries]
            return {"type": "transfer-function", "entries": rows, "method": method, "delay": delay}
        case DeclaredEnvironment():
            return {"type": "declared", "level": environment.promised().tolist()}
    raise TypeError(f"expected an environment of a known kind, found {type(environment).__name__}")


def _network(low: Network, high: Network, delay: int) -> dict[str, Any]:
    return {
        "type": "network",
        "masses": {name: _interval(a, b) for (name, a), (_, b) in zip(low.masses, high.masses, strict=True)},
        "links": [
            {
                "between": list(a.ends),
                "stiffness": _interval(a.stiffness, b.stiffness),
                "damping": _interval(a.damping, b.damping),
            }
            for a, b in zip(low.links, high.links, strict=True)
        ],
        "delay": delay,
    }


def _interval(low: float, high: float) -> float | list[float]:
    return low if low == high else [low, high]


def environment_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> Environment:
    """The environment that :func:`describe_environment` wrote.

    Raises:
        KeyError, TypeError, ValueError: something is missing or makes no environment.
    """
    kind = data["type"]
    if kind == "declared":
        m = len(ports)
        return DeclaredEnvironment(ports, matrix(data["level"], m, m))
    delay = data["delay"]
    if type(delay) is not int or not 0 <= delay <= MOST_DELAY:
        raise ValueError(f"environment.delay: found {delay!r}, expected a whole number from 0 to {MOST_DELAY}")
    if kind == "network":
        low, high = (_network_of(data, ports, end) for end in (0, 1))
        if low == high:
            return low if delay == 0 else DelayedNetwork(low, delay)
        if delay:
            raise ValueError("environment: found intervals and a delay, expected one of the two")
        return NetworkBox(low, high)
    if kind == "state-space":
        if data["time"] not in ("continuous", "discrete"):
            raise ValueError(f"environment.time: found {data['time']!r}, expected 'continuous' or 'discrete'")
        method = data["method"] if data["time"] == "continuous" else None
        if method is not None and method not in METHODS:
            raise ValueError(f"environment.method: found {method!r}, expected one of {', '.join(METHODS)}")
        return StateSpaceEnvironment(ports, read_system(data, continuous=method is not None), method, delay)
    if kind == "transfer-function":
        if data["method"] not in ("backward-euler", "tustin"):
            raise ValueError(f"environment.method: found {data['method']!r}, expected 'backward-euler' or 'tustin'")
        rows = tuple(tuple(_rational(entry) for entry in row) for row in data["entries"])
        return TransferEnvironment(ports, rows, data["method"], delay)
    expected = "'network', 'state-space', 'transfer-function' or 'declared'"
    raise ValueError(f"environment.type: found {kind!r}, expected {expected}")


def _network_of(data: Mapping[str, Any], ports: tuple[str, ...], end: int) -> Network:
    """The network with every interval at its low (0) or high (1) end."""

    def at(value: Any) -> float:
        if isinstance(value, list) and len(value) != 2:
            raise ValueError(f"environment: found {len(value)} numbers, expected an interval [low, high]")
        return float(value[end] if isinstance(value, list) else value)

    return Network(
        ports,
        tuple((str(name), at(mass)) for name, mass in data["masses"].items()),
        tuple(
            Link((str(a), str(b)), at(link["stiffness"]), at(link["damping"]))
            for link in data["links"]
            for a, b in [link["between"]]
        ),
    )


def _rational(data: Mapping[str, Any]) -> Rational:
    num, den = (tuple(matrix([data[key]])[0].tolist()) for key in ("num", "den"))
    return num, den


def describe_coupling(names: Sequence[str], coupling: tuple[CouplingBlock, ...]) -> dict[str, Any]:
    """The blocks of V: K and B of springs and dampers, A, B, C, D of linear ones."""
    blocks: dict[str, Any] = {}
    linear = False
    for name, part in zip(names, coupling, strict=True):
        if isinstance(part, SpringDamper):
            blocks[name] = {"stiffness": part.stiffness.tolist(), "damping": part.damping.tolist()}
        else:
            linear = True
            blocks[name] = system_values(part)
    return {"class": "linear" if linear else "spring-damper", "blocks": blocks}


def coupling_of(data: Mapping[str, Any], partition: Partition) -> tuple[CouplingBlock, ...]:
    """The blocks that :func:`describe_coupling` wrote, in the partition's order.

    Raises:
        KeyError, TypeError, ValueError: a block is missing, or has not its ports.
    """
    sizes = {name: len(block) for name, block in zip(partition.names, partition.blocks, strict=True)}
    blocks = data["blocks"]
    if set(blocks) != set(sizes):
        raise ValueError(f"coupling.blocks: found {sorted(blocks)}, expected {sorted(sizes)}")
    if data["class"] == "spring-damper":
        return tuple(
            SpringDamper(matrix(blocks[name]["stiffness"], m, m), matrix(blocks[name]["damping"], m, m))
            for name, m in sizes.items()
        )
    if data["class"] != "linear":
        raise ValueError(f"coupling.class: found {data['class']!r}, expected 'spring-damper' or 'linear'")
    systems = tuple(read_system(blocks[name]) for name in sizes)
    for (name, m), system in zip(sizes.items(), systems, strict=True):
        if (system.outputs, system.inputs) != (m, m):
            raise ValueError(f"coupling.blocks.{name}: expected {m} inputs and outputs")
    return systems


def storage_of(value: Any, environment: Environment) -> Matrix | Literal["energy", "enforced"]:
    """E_hat's storage; a declared environment has none, and no other may do without.

    Raises:
        ValueError: another word, or not a matrix.
    """
    if isinstance(environment, DeclaredEnvironment):
        if value != ENFORCED:
            raise ValueError(f"storage.E_hat: expected {ENFORCED!r} for a declared environment")
        return ENFORCED
    if isinstance(value, str):
        if value != ENERGY:
            raise ValueError(f"storage.E_hat: found {value[:40]!r}, expected {ENERGY!r} or a matrix")
        return ENERGY
    return square(value)


def matrices_by_block(data: Mapping[str, Any], partition: Partition) -> tuple[Matrix, ...]:
    """One square matrix for each block, in the partition's order."""
    if set(data) != set(partition.names):
        raise ValueError(f"found matrices for {sorted(data)}, expected them for {sorted(partition.names)}")
    return tuple(
        matrix(data[name], len(block), len(block))
        for name, block in zip(partition.names, partition.blocks, strict=True)
    )


def describe_aim(aim: Transparency) -> dict[str, Any]:
    """The transparency problem with its weights in z."""
    return {"objective": aim.objective, **_weights(aim)}


def _weights(aim: Transparency) -> dict[str, Any]:
    return {name: {"num": list(W.num), "den": list(W.den)} for name, W in (("W1", aim.W1), ("W2", aim.W2))}


def aim_of(data: Mapping[str, Any]) -> Transparency:
    """The aim that :func:`describe_aim` wrote."""
    if data["objective"] not in ("loop-shaping", "closed-loop"):
        found = data["objective"]
        raise ValueError(f"transparency.objective: found {found!r}, expected 'loop-shaping' or 'closed-loop'")
    W1, W2 = (Filter(*_rational(data[name])) for name in ("W1", "W2"))
    return Transparency(data["objective"], W1, W2)


def system_values(system: StateSpace) -> dict[str, Any]:
    """A, B, C and D as rows, or the static gain where that was stated instead of D."""
    last = {"D": system.D.tolist()} if system.static_gain is None else {"static": system.static_gain.tolist()}
    return {"A": system.A.tolist(), "B": system.B.tolist(), "C": system.C.tolist(), **last}


def read_system(data: Mapping[str, Any], *, continuous: bool = False) -> StateSpace:
    """The system whose matrices were written; JSON has no shape for a matrix without rows or columns.

    Raises:
        KeyError, TypeError, ValueError: a matrix is missing, or is none of that shape.
    """
    if not data["A"] and (data["B"] or any(data["C"])):
        raise ValueError("expected B and C without entries where A has none")
    if "static" in data:
        if "D" in data:
            raise ValueError("found both D and static, expected one of them")
        A, B, C = (data[key] if data["A"] else [] for key in "ABC")
        return StateSpace.with_static_gain(A, B, C, data["static"], continuous=continuous)
    D = matrix(data["D"])
    if not data["A"]:
        return StateSpace.static(D)
    return StateSpace(matrix(data["A"]), matrix(data["B"]), matrix(data["C"]), D)


def square(rows: Any) -> Matrix:
    """A square matrix, which may have no rows: what has no states stores nothing."""
    return matrix(rows, len(rows), len(rows)) if rows else np.zeros((0, 0))
