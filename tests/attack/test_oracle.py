"""The oracle itself: it shares no code with the proof, its two ways agree, and it finds false claims."""

from __future__ import annotations

import ast
import copy
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import ctx, fmpq

from tests.attack.arithmetic import BITS, Floats, decimal, semidefinite
from tests.attack.hands import at_level, random_loop
from tests.attack.loop import Hand, Repeating, Tick, growth, period_map
from tests.attack.mechanisms import at_its_level, orientations, steps
from tests.attack.oracle import alone, judge
from tests.attack.parties import Reader, precise
from tests.attack.passivity import levels, statics
from tests.attack.sessions import KINDS

FOLDER = Path(__file__).parent
ORACLE = ("arithmetic", "parties", "passivity", "loop", "hands", "linkages", "mechanisms", "oracle")
T, OSP = 1e-3, 1.37


def imported(path: Path) -> set[str]:
    """The modules that a file imports, at its top or anywhere else."""
    out: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            out.add(node.module or "")
    return out


@pytest.mark.parametrize("name", ORACLE)
def test_the_oracle_imports_arithmetic_and_itself_alone(name: str) -> None:
    own = {f"tests.attack.{other}" for other in ORACLE}
    foreign = [
        module
        for module in imported(FOLDER / f"{name}.py") - own
        if module.split(".")[0] not in {"numpy", "scipy", "flint", *sys.stdlib_module_names}
    ]
    assert not foreign


def test_what_the_oracle_judges_is_seen_by_that_rule() -> None:
    """The campaign, which designs and proves, does not pass it."""
    assert any(module.startswith("manyhands") for module in imported(FOLDER / "campaign.py"))


def wall(K: float, tau: float = 0.0, kappa: float = 0.5, share: float = 1.0, c: float = 0.0) -> dict[str, Any]:
    """A certificate by hand: one user, a spring K, a wall of 1e9 N/m. It is true below 2740 N/m at tau = 0."""
    Lambda = OSP / (2.0 * kappa)
    J = Lambda - T / 2.0 * K
    return {
        "id": "",
        "session": "wall",
        "period": T,
        "tau": tau,
        "ports": ["p"],
        "devices": {"d": {"ports": ["p"], "osp": [[OSP]]}},
        "structure": {"v": ["p"]},
        "environment": {
            "type": "network",
            "masses": {},
            "links": [{"between": ["p", "ground"], "stiffness": 1e9, "damping": 0.0}],
            "delay": 0,
        },
        "coupling": {"class": "spring-damper", "blocks": {"v": {"stiffness": [[K]], "damping": [[0.0]]}}},
        "levels": {
            "kappa": kappa,
            "share": share,
            "c": c,
            "Delta_D": {"v": [[OSP]]},
            "Delta_V": {"v": [[0.999 * (Lambda * Lambda / J - Lambda)]]},
            "Phi_E": {"v": [[-400000.0]]},
        },
        "storage": {"E_hat": "energy", "V_hat": {}},
        "transparency": None,
        "margins": {},
        "method": {},
    }


def findings(data: dict[str, Any], draws: int = 4, steps: int = 30) -> list[str]:
    return judge(data, np.random.default_rng(1), draws, steps).findings


def test_what_is_true_has_no_findings() -> None:
    assert findings(wall(2600.0)) == []
    assert findings(wall(600.0, tau=T, kappa=2.2, share=0.05, c=0.5)) == []


FALSE: dict[str, tuple[str, Any]] = {
    "Delta_D <= osp": ("levels.Delta_D.v", [[1.38]]),
    "Delta_D > 0": ("levels.Delta_D.v", [[0.0]]),
    "Delta_V > 0": ("levels.Delta_V.v", [[-1.0]]),
    "condition (10)": ("levels.Phi_E.v", [[1.36]]),
    "0 <= tau": ("tau", 2e-3),
    "the device keeps its share": ("levels.share", 1.01),
    "E_hat is (-Phi_E)-ISP": ("levels.Phi_E.v", [[-600000.0]]),
    "V_hat of v is Delta_V-OSP": ("levels.Delta_V.v", [[40.0]]),
    "a network's parts": ("environment.links", [{"between": ["p", "ground"], "stiffness": 1e9, "damping": -1e-9}]),
    "any passive hand": ("devices.d.osp", [[1.2]]),
    "the margin (10)": ("margins", {"(10)": 30.0}),
    "E(1) >= 0": (
        "environment",
        {"type": "transfer-function", "entries": [[{"num": [1e9, -1e-9], "den": [1.0]}]]}
        | {"method": "backward-euler", "delay": 0},
    ),
    "E(1) is symmetric": (
        "environment",
        {"type": "state-space", "A": [[-1.0]], "B": [[0.0]], "C": [[0.0]], "D": [[1.0]], "time": "discrete", "delay": 0}
        | {"D": [[1.0, 0.1], [0.1000000001, 1.0]], "B": [[0.0, 0.0]], "C": [[0.0], [0.0]]},
    ),
    "E is stable": (
        "environment",
        {"type": "state-space", "A": [[1.01]], "B": [[1.0]], "C": [[0.0]], "D": [[1e9]]}
        | {"time": "discrete", "delay": 0},
    ),
    "transparency": (
        "transparency",
        {"objective": "loop-shaping", "W1": {"num": [1.0], "den": [1.0]}, "W2": {"num": [1.0], "den": [1.0]}}
        | {"gamma": 1e9 / 2600.0 * (1.0 - 1e-9), "P": []},
    ),
}


@pytest.mark.parametrize("what", FALSE)
def test_every_promise_that_is_not_kept_is_found(what: str) -> None:
    path, value = FALSE[what]
    data: dict[str, Any] = wall(2600.0)
    *place, last = path.split(".")
    part = data
    for key in place:
        part = part[key]
    part[last] = value
    if what == "E(1) is symmetric":  # needs two ports, and nothing but the statics is asked for here
        assert statics(data) == [what]
        return
    assert [finding for finding in findings(data) if finding.startswith(what)]


@pytest.mark.parametrize(("tau", "limit"), [(0.0, 2740.0), (0.5e-3, 1200.0), (1e-3, 900.0)])
def test_a_spring_that_is_too_stiff_is_shaken(tau: float, limit: float) -> None:
    """By hands alone, and more surely with the environment at its level."""
    found = findings(wall(1.2 * limit, tau), 6, 60)
    assert any(finding.startswith("shaken") for finding in found)
    assert not any("shaken" in finding for finding in findings(wall(0.5 * limit, tau), 6, 60))


WORLDS: dict[str, dict[str, Any]] = {
    "network": {
        "type": "network",
        "masses": {"m": 0.7, "n": 0.01},
        "links": [
            {"between": ["p", "m"], "stiffness": 800.0, "damping": 0.3},
            {"between": ["m", "n"], "stiffness": [50.0, 70.0], "damping": 0.0},
            {"between": ["n", "ground"], "stiffness": 20.0, "damping": 1.0},
        ],
        "delay": 2,
    },
    "transfer function": {
        "type": "transfer-function",
        "entries": [[{"num": [0.0, 0.02, 3.0, 4.0, 100.0], "den": [0.5, 20.0]}]],
        "method": "backward-euler",
        "delay": 1,
    },
    "transfer function, Tustin": {
        "type": "transfer-function",
        "entries": [[{"num": [3.0, 4.0, 100.0], "den": [0.5, 20.0, 8.0]}]],
        "method": "tustin",
        "delay": 0,
    },
} | {
    f"state space, {method}": {
        "type": "state-space",
        "A": [[-3.0, 400.0], [-500.0, -9.0]],
        "B": [[1.0], [2.0]],
        "C": [[-5.0, 7.0]],
        "D": [[90.0]],
        "time": "continuous",
        "method": method,
        "delay": 1,
    }
    for method in ("backward-euler", "tustin", "zoh")
}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("long", [False, True])
def test_an_environment_has_the_response_of_its_states(world: str, long: bool) -> None:
    data = wall(2600.0) | {"environment": WORLDS[world]}
    reader = (precise(data) if long else Reader(data, Floats())).member(3)
    with ctx.workprec(BITS):
        z = reader.arithmetic.circle(np.array([0.7]))
        (A, B, C, D), direct = reader.environment, reader.environment_at(z)
        eye = reader.eye(len(A))
        response = C @ reader.arithmetic.solve(z * eye - A, B + 0 * z * B) + D
        difference = complex((response - direct).ravel()[0])
    assert abs(difference) < (1e-100 if long else 1e-9 * abs(complex(direct.ravel()[0])))


def test_long_numbers_are_the_decimals_of_the_file() -> None:
    assert decimal(0.1) == fmpq(1, 10)
    assert decimal(1e-6) * 10**6 == 1
    assert semidefinite([[fmpq(1), fmpq(1)], [fmpq(1), fmpq(1)]])
    assert not semidefinite([[fmpq(1), fmpq(1)], [fmpq(1), fmpq(1)]], strict=True)
    assert not semidefinite([[fmpq(0), fmpq(1)], [fmpq(1), fmpq(5)]])
    assert not semidefinite([[decimal(1e15), fmpq(0)], [fmpq(0), decimal(-1e-11)]])


def split_device() -> dict[str, Any]:
    """Two ports of one device in two blocks, behind a network with a mass."""
    data = wall(700.0, tau=0.4e-3)
    links = [{"between": [p, "m"], "stiffness": 900.0, "damping": 0.2} for p in "pq"]
    links.append({"between": ["m", "ground"], "stiffness": 300.0, "damping": 0.4})
    return data | {
        "ports": ["p", "q"],
        "devices": {"d": {"ports": ["q", "p"], "osp": [[1.5, 0.3], [0.3, 1.2]]}},
        "structure": {"v": ["p"], "w": ["q"]},
        "environment": {"type": "network", "masses": {"m": 0.3}, "links": links, "delay": 0},
        "coupling": {
            "class": "spring-damper",
            "blocks": {n: {"stiffness": [[500.0]], "damping": [[0.1]]} for n in "vw"},
        },
    }


HELD = Hand(
    [[0.2, 0.05], [0.05, 0.1]],
    [[60.0, 0.0], [0.0, 0.0]],
    [[0.0, 0.4], [-0.4, 0.0]],
    ((0.03, 90.0, (0.6, 0.8)),),
)


def by_its_equations(state: np.ndarray, ratios: tuple[float, ...], delay: float) -> np.ndarray:
    """A tick of :func:`split_device` under ``HELD``: each party by its own equation, the device by fine steps.

    The states are x, v, q, q' of the device in its own order (q, p), the forces before, the deflections of V, the
    mass's place and speed, the tools before, x_e and x_c before.
    """
    motion, old, d, (q_m, v_m), u, x_e, x_c = np.split(state, [6, 8, 10, 12, 14, 16])
    x, S = motion[:2][::-1], np.diag(ratios)

    def parties(f_e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far f_e is from the network's force, and all that follows from it."""
        f_c = S @ f_e
        deflection = (f_c + 0.1 / T * d) / (500.0 + 0.1 / T)
        end = x + deflection
        tool = x_e + S @ (end - x_c)
        load = 0.3 * v_m / T - 2100.0 * q_m + 900.0 * tool.sum() + 0.2 * ((tool - u) / T).sum()
        speed = load / (0.3 / T + 0.8 + T * 2100.0)
        place = q_m + T * speed
        force = 900.0 * (tool - place) + 0.2 * ((tool - u) / T - speed)
        return f_e + force, np.concatenate([f_c, deflection, [place, speed], tool, tool, end])

    offset, _ = parties(np.zeros(2))
    columns = np.array([parties(e)[0] - offset for e in np.eye(2)]).T
    _, after = parties(np.linalg.solve(columns, -offset))  # what is not is linear in f_e

    def rate(y: np.ndarray, force: np.ndarray) -> np.ndarray:
        n = np.array([0.6, 0.8])
        osp, stretch = np.array([[1.5, 0.3], [0.3, 1.2]]), n @ y[:2] - y[4]
        pull = force - (osp + np.array(HELD.gyration)) @ y[2:4] - np.array(HELD.stiffness) @ y[:2]
        pull = pull - 90.0 * n * stretch
        return np.concatenate([y[2:4], np.linalg.solve(np.array(HELD.mass), pull), [y[5], 90.0 * stretch / 0.03]])

    steps = 400
    h = T / steps
    for k in range(steps):  # Runge and Kutta
        force = (old if (k + 0.5) * h < delay else after[:2])[::-1]
        a = rate(motion, force)
        b = rate(motion + h / 2 * a, force)
        c = rate(motion + h / 2 * b, force)
        motion = motion + h / 6 * (a + 2 * b + 2 * c + rate(motion + h * c, force))
    return np.concatenate([motion, after])


def test_a_tick_is_what_its_equations_say() -> None:
    data = split_device()
    ticks = (Tick((0.5,), (1.0, 0.3)), Tick((1.0,), (0.6, 0.0)), Tick((0.0,), (0.2, 1.0)))
    whole = period_map([Reader(data, Floats())], Repeating((HELD,), ticks))
    start = np.random.default_rng(2).normal(size=len(whole)) * 1e-3
    found = start
    for tick in ticks:
        found = by_its_equations(found, tick.ratios, tick.delays[0] * data["tau"])
    np.testing.assert_allclose(whole @ start, found, rtol=1e-7, atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize(("rho", "limit"), [(0.25, 2192.0), (1.0, 1370.0)])
def test_a_spring_for_periods_of_T_is_shaken_by_longer_ones(rho: float, limit: float) -> None:
    assert not any("shaken" in finding for finding in findings(wall(1.2 * limit), 6, 60))
    unsteady = {"period_tolerance": rho, "version": 4}
    found = findings(wall(1.2 * limit) | unsteady, 6, 60)
    assert "the device keeps its share" in found
    assert any("shaken" in finding for finding in found)
    kappa = 0.5 * (1.0 + rho)
    assert findings(wall(0.9 * limit, kappa=kappa, share=0.5 / kappa) | unsteady, 6, 60) == []


def test_an_environment_at_its_level_is_lossless_beside_it() -> None:
    data = wall(1000.0)
    data["levels"]["Phi_E"] = {"v": [[0.7]]}
    rng = np.random.default_rng(4)
    for _ in range(20):
        reader = Reader(at_level(rng, data), Floats())
        for angle in (0.3, 1.7, 2.9):
            z = reader.arithmetic.circle(np.array([angle]))
            hat = complex((reader.environment_at(z) * (z * T / (z - 1.0))).ravel()[0])
            assert abs(hat.real + 0.7) < 1e-8 * abs(hat)


def test_long_numbers_agree_with_floats() -> None:
    rng = np.random.default_rng(5)
    for _ in range(6):
        data = copy.deepcopy(split_device())
        loop = random_loop(rng, data)
        in_floats = growth([Reader(data, Floats())], loop)
        with ctx.workprec(BITS):
            certain = growth([precise(data)], loop)
        assert math.isclose(in_floats, certain, abs_tol=1e-7)


def test_a_rung_is_left_at_rest() -> None:
    """A block that changes its rung at ratio 0 has no memory of the one before when it comes back."""
    data = split_device()
    hand = Hand([[0.2, 0.0], [0.0, 0.2]], [[0.0, 0.0], [0.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    softer = json.loads(json.dumps(data))
    softer["coupling"]["blocks"]["v"]["stiffness"] = [[100.0]]
    readers = [Reader(data, Floats()), Reader(softer, Floats())]
    ticks = (Tick((0.0,), (0.0, 1.0), (1, 0)), Tick((0.0,), (1.0, 1.0), (1, 0)))
    whole = period_map(readers, Repeating((hand,), ticks))
    start = np.zeros(len(whole))
    start[6] = 1.0  # the deflection of v at rung 0, before the change
    assert np.abs(whole @ start).max() == 0.0
    start[6], start[8] = 0.0, 1.0  # that of v at rung 1, which runs
    assert np.abs(whole @ start).max() > 0.0


def test_nobody_at_the_device_is_a_hand_too() -> None:
    data = wall(1000.0)
    data["environment"]["links"][0]["stiffness"] = -100.0
    assert alone(data) > 1e-4
    assert alone(wall(1000.0)) == 0.0


def of_kind(kind: str, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first designed certificate of a kind that fits."""
    for seed in range(100):
        data = KINDS[kind](np.random.default_rng(seed))
        if data is not None and fits(data):
            return data
    raise AssertionError(f"no {kind} fits")


def test_what_steps_add_is_summed_anew() -> None:
    data = of_kind("encoder steps", lambda data: bool(data["encoder"]["force"]) and data["encoder"]["covered"])
    assert steps(data) == []
    less = copy.deepcopy(data)
    less["encoder"]["force"] = [0.7 * force for force in data["encoder"]["force"]]
    assert steps(less) == ["w is what the steps add"]
    for device in less["devices"].values():
        device["friction"] = [0.5 * c for c in device["friction"]]
    assert "dry friction covers the steps" in steps(less)
    assert "w is what the steps add" in judge(less, np.random.default_rng(1)).findings
    del less["encoder"]
    assert steps(less) == ["a step has its claim"]


def test_friction_counts_below_the_speed_alone_and_less_what_steps_take() -> None:
    data = of_kind("dry friction", lambda data: data.get("encoder", {}).get("covered", False))
    assert levels(at_its_level(data)) == []
    for change in (
        lambda other: other.update(speed=1.01 * other["speed"]),
        lambda other: other["encoder"].update(force=[1.05 * w for w in other["encoder"]["force"]]),
        lambda other: [d.update(friction=[0.99 * c for c in d["friction"]]) for d in other["devices"].values()],
    ):
        other = copy.deepcopy(data)
        change(other)
        assert "Delta_D <= osp" in levels(at_its_level(other))


def test_held_torques_take_from_a_level_what_their_numbers_say() -> None:
    data = of_kind("held torque", lambda data: True)
    assert levels(at_its_level(data)) == []
    for key in ("kappa", "force"):
        other = copy.deepcopy(data)
        other["devices"]["arm"]["held"][key] *= 1.01
        assert "Delta_D <= osp" in levels(at_its_level(other))


def test_an_orientation_burns_what_its_torque_and_its_joints_need() -> None:
    data = of_kind("orientation", lambda data: "length" in data["devices"]["pen"].get("held", {}))
    assert orientations(data) == levels(at_its_level(data)) == []
    pen = data["devices"]["pen"]
    over = float(pen["orientation"]["osp"]) / 1e-12
    for part, key, value in (
        ("orientation", "stiffness", over),
        ("held", "length", 10.0 * over),
        ("held", "kappa", over),
    ):
        other = copy.deepcopy(data)
        other["devices"]["pen"][part][key] = value
        other["devices"]["pen"]["held"]["speed"] = 1e-30
        assert orientations(other) == ["an orientation burns what its torque needs"]
    other = copy.deepcopy(data)
    del other["devices"]["pen"]["held"]["length"]
    assert orientations(other) == ["joints that hold an orientation's torque have a length"]
    other = copy.deepcopy(data)
    other["devices"]["pen"]["orientation"] = {"sensed": True, "stiffness": 1.0}
    assert orientations(other) == ["an orientation burns what its torque needs"]
    assert "an orientation burns what its torque needs" in judge(other, np.random.default_rng(1)).findings
