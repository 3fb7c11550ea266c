"""The table of combinations: every feature with what a session states for it, and every pair that is refused.

    python -m tests.support.combinations     # writes docs/combinations.md

``tests/launch/session/test_combinations.py`` prepares and runs every pair that is not refused, and compares the page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
DECISIONS: Final = ROOT / "docs" / "decisions"
PAGE: Final = ROOT / "docs" / "combinations.md"
MODELS: Final = "tests.support.combination_models"

Tree = Mapping[str, Any]

BASE: Final[Tree] = {
    "session": "pair",
    "period": 0.001,
    "devices": {
        "dx": {"dof": 1, "osp": 3, "driver": "simulated", "mass": 0.2,
               "hand": {"damping": 2, "force": "2.5*pulse(t, 0, 0.06)"}},
        "dy": {"dof": 1, "osp": 3, "driver": "simulated", "mass": 0.2,
               "hand": {"damping": 2, "force": "-4*pulse(t, 0, 0.06)"}},
    },
    "couplings": {"cx": {"devices": ["dx"]}, "cy": {"devices": ["dy"]}},
    "environment": {
        "type": "network",
        "masses": {"hub": 1.0},
        "links": [
            {"between": ["dx", "hub"], "stiffness": 500, "damping": 0.2},
            {"between": ["dy", "hub"], "stiffness": 500, "damping": 0.2},
            {"between": ["hub", "ground"], "stiffness": 500, "damping": 0.5},
        ],
    },
    "design": {"coupling": "spring-damper", "tau": 0.0003, "ladder": []},
}  # fmt: skip
"""Two users of one axis and a mass between them: Example 1 without its third user, in a softer world."""

SCENE: Final[Tree] = {
    "type": "scene",
    "tools": {"dx": {"at": [-0.03, 0, 0], "radius": 0.01}, "dy": {"at": [0.03, 0, 0], "radius": 0.01}},
    "bodies": {"ball": {"mass": 0.1, "at": [0, 0, 0], "radius": 0.02}},
    "links": [{"between": ["ball", "ground"], "stiffness": 20, "damping": 0.5}],
}
"""Two tools that touch a ball between them."""

AVATARS: Final = "\n".join(
    f'<body name="{name}" pos="{at} 0 0"><joint{joint} type="slide" axis="1 0 0"/>'
    f'<geom type="sphere" size="{radius}" mass="{mass}"/></body>'
    for name, at, joint, radius, mass in (
        ("puck", 0, "", 0.02, 0.1),
        ("dx", -0.0305, ' name="dx" damping="0.2"', 0.01, 0.05),
        ("dy", 0.0305, ' name="dy" damping="0.2"', 0.01, 0.05),
    )
)


@dataclass(frozen=True)
class Feature:
    """What a session may have.

    Attributes:
        decision: the number of the decision about it.
        changes: what a session states for it, by path of keys.
        shows: how a test sees that it is at work.
        within: features that it cannot be without; theirs is stated first.
    """

    decision: int
    changes: Tree
    shows: str
    within: tuple[str, ...] = ()


FEATURES: Final[Mapping[str, Feature]] = {
    "scene": Feature(
        41, {"environment": SCENE}, "contacts move the ball"),
    "driven body": Feature(
        41,
        {"environment": {
            **SCENE,
            "bodies": {
                **SCENE["bodies"],
                "piston": {"motion": ["0.003*sin(30*t)", 0, 0], "at": [-0.06, 0, 0], "radius": 0.02},
            },
            "tank": 0.05,
        }},
        "the piston moves, and its tank pays", ("scene",)),
    "proxies": Feature(
        42, {"environment": {"type": "python", "model": f"{MODELS}:Wall", "stiffness": 2000}},
        "springs to proxies exert the forces, and the test counts for each coupling"),
    "engine": Feature(
        42,
        {"environment": {
            "type": "engine", "engine": "mujoco", "stiffness": 2000, "tools": {"dx": "dx", "dy": "dy"},
            "bodies": ["puck"],
            "model": '<mujoco><option timestep="0.001" integrator="implicitfast" gravity="0 0 0"/>'
                     f"<worldbody>{AVATARS}</worldbody></mujoco>",
        }},
        "MuJoCo moves the puck", ("proxies",)),
    "enforced model": Feature(
        18, {"environment": {"type": "python", "model": f"{MODELS}:Active", "level": 0}},
        "the controller keeps forces back, and the ledger above its bound"),
    "controller": Feature(
        18, {"environment.enforce": True}, "a controller stands beneath the proved world, and does nothing"),
    "late world": Feature(
        10, {"environment.delay": 1}, "the certificate is of the late world, and the first force comes a tick late"),
    "uncertain world": Feature(
        12, {"environment.links.0.stiffness": {"between": [400, 600]}},
        "the certificate is of all worlds between, and the middle one runs"),
    "uncertain device": Feature(
        12, {"devices.dx.osp": {"between": [2.8, 3.2]}},
        "the certificate has the lower end, and the device's damping is the middle"),
    "held torques": Feature(
        50,
        {"devices.dx.held": "torque", "devices.dx.linkage": {"kappa": 20},
         "devices.dx.limits": {"force": 20, "speed": 2}},
        "the certificate has less of the device's level, and the device promises as much"),
    "encoder step": Feature(
        51, {"devices.dx.step": 1e-5},
        "the device has its step, and the certificate states what it adds to the force, or that it does not know"),
    "wave link": Feature(
        33, {"couplings.cx.wave_link": {"b": 10, "depth": 2, "tank": 0.02}},
        "site, world and users in the tick have certificates, and the world's end hears waves"),
    "own period": Feature(
        34, {"couplings.cx.wave_link.period": 0.0005}, "the site has two ticks in one of the world", ("wave link",)),
    "thinned waves": Feature(
        33, {"couplings.cx.wave_link.interval": 0.003}, "energy arrives with one tick in three", ("wave link",)),
    "series compliance": Feature(
        45, {"design.series": 0.9}, "the certificate counts a part of each link, and the stiffer world runs"),
    "transparency": Feature(
        11, {"design.objective": "loop-shaping", "design.weights.W1.emphasise": [0, 20]}, "the certificate claims a γ"),
    "ladder": Feature(
        16, {"design.ladder": [0.0006]},
        "a softer coupling is certified, and a coupling in the tick changes to it with its device"),
    "co-location": Feature(
        20, {"colocate": True}, "no link joins device and coupling, and one process reports of both"),
    "reserve for lateness": Feature(
        30, {"faults.tank": {"energy": 1e-6, "power": 0}},
        "late forces are changed, and the device's account stays above −10⁻⁶ J"),
    "energy budget": Feature(
        29, {"devices.dy.limits": {"power": 2e-4, "energy": 2e-4}},
        "the user's clutch is scaled, and the others receive no more than E + P t"),
    "clutch": Feature(
        15, {}, "a coupling falls silent: its user has no force, then the ramp; the other goes on"),
}  # fmt: skip
"""Every feature by its name. Worlds come first, since other keys change what they state."""

INSTEAD: Final[Mapping[tuple[str, str], Tree]] = {
    ("controller", "scene"): {},
    ("late world", "enforced model"): {"environment.parameters": {"ticks": 1}},
    ("uncertain world", "proxies"): {"environment.stiffness": {"between": [1500, 2500]}},
    ("uncertain world", "enforced model"): {"environment.level": {"between": [0, 0.1]}},
}
"""What a session states for the first of the two beside the second: a scene always has its controller, a model's delay
is the model's own, and other worlds have other numbers.
"""

Pair = tuple[str, str]


@dataclass(frozen=True)
class Refusal:
    """Pairs that are refused, and why.

    Attributes:
        decision: the number of the decision that says why there is no proof.
        says: words of that decision.
        error: words of the error.
        why: the reason in a sentence.
        pairs: which; of each feature in the first part with each in the second.
    """

    decision: int
    says: str
    error: str
    why: str
    pairs: tuple[tuple[str, ...], tuple[str, ...]]


_SCENES: Final = ("scene", "driven body")
_PROXIES: Final = ("proxies", "engine")
_LINKS: Final = ("wave link", "own period", "thinned waves")

REFUSALS: Final = (
    Refusal(
        46, "one kind of world", "unknown key",
        "the two laws would have to be solved in one tick, and nothing proves that solution",
        (_SCENES, (*_PROXIES, "enforced model"))),
    Refusal(
        46, "one kind of world", "unknown key",
        "an engine's avatars and a model's forces would have to be solved in one tick",
        (("engine",), ("enforced model",))),
    Refusal(
        46, "asked for one thing", "proxy",
        "a model is asked for forces or for positions, and one test keeps one of them",
        (("proxies",), ("enforced model",))),
    Refusal(
        46, "force of the same tick", "delay",
        "the proof is about the force of the same tick; what is late is a model under the controller",
        ((*_SCENES, *_PROXIES), ("late world",))),
    Refusal(
        46, "An interval says nothing", "a mapping",
        "the level holds at every stiffness, so that an interval says nothing",
        ((*_SCENES, *_PROXIES, "enforced model"), ("uncertain world",))),
    Refusal(
        12, "no energy covers a late force", "intervals",
        "the energy that proves all worlds between covers no late force",
        (("late world",), ("uncertain world",))),
    Refusal(
        45, "the same as stating a stiffer number", "with an environment of type",
        "their level is 0 at any stiffness: a stiffer number is the same as counting in series",
        ((*_SCENES, *_PROXIES, "enforced model"), ("series compliance",))),
    Refusal(
        45, "a world that is late by whole ticks", "with a delay",
        "f = −z⁻ᵈ E x cannot be cut inside a link", (("late world",), ("series compliance",))),
    Refusal(
        18, "that need E's dynamics are refused", "dynamics",
        "the aim is about E(z), and these worlds have none",
        ((*_SCENES, *_PROXIES, "enforced model"), ("transparency",))),
    Refusal(
        34, "An environment that is late is refused", "condition (A) fails",
        "at the port of a wave link nobody pays for what a late world lacks", (("late world",), _LINKS)),
    Refusal(
        45, "a link's b is there in place of the spring", "wave link",
        "across a wave link the world's spring is not there", (_LINKS, ("series compliance",))),
    Refusal(
        34, "They need E, which a site does not know", "does not know the environment",
        "the aim is about E(z), which a site does not know", (_LINKS, ("transparency",))),
)  # fmt: skip
"""Every pair that is refused."""


def refusal_of(pair: Pair) -> Refusal | None:
    """Why a pair is refused; None for one that works."""
    for refusal in REFUSALS:
        first, second = refusal.pairs
        if (pair[0] in first and pair[1] in second) or (pair[1] in first and pair[0] in second):
            return refusal
    return None


PAIRS: Final[tuple[Pair, ...]] = tuple(combinations_with_replacement(FEATURES, 2))
"""Every pair in the table's order; a feature with itself is the feature alone."""


def features_of(pair: Pair) -> tuple[str, ...]:
    """The features of a pair, with those that they cannot be without, in the table's order."""
    named = {name for one in pair for name in (one, *FEATURES[one].within)}
    return tuple(name for name in FEATURES if name in named)


def changes_of(pair: Pair) -> dict[str, Any]:
    """What a session of this pair states, by path of keys; two worlds in one are the keys of both."""
    names, out = features_of(pair), dict[str, Any]()
    for name in names:
        instead = [INSTEAD[name, other] for other in names if (name, other) in INSTEAD]
        for path, value in (instead[0] if instead else FEATURES[name].changes).items():
            out[path] = {**out[path], **value} if path == "environment" and path in out else value
    return out


def page() -> str:
    """docs/combinations.md."""
    refused = sorted({refusal.decision for refusal in REFUSALS})
    links = "\n".join(f"[{number}]: {_link(number)}" for number in refused)
    return TEMPLATE.format(features=_features(), table=_table(), reasons=_reasons(), links=links)


TEMPLATE: Final = """\
# Combinations

What may stand together in one session. Every cell of the table is a test. A session of both features is designed,
proved and run, and both leave their trace; or it is refused, and a decision says why there is no proof.

<!-- written by python -m tests.support.combinations, and run by tests/launch/session/test_combinations.py -->

## Features

The session has two users of one axis, and a mass between them. A feature adds what the third column says, in the form
of [`--set`](session-file/text.md#overriding-values).

| | feature | stated | seen by |
|---|---|---|---|
{features}

An *uncertain* device or world is one of which a number is an [interval](session-file/text.md#interval); the key
`interval` of a wave link is *thinned waves*. The *reserve for lateness* is `faults.tank`; a wave link and a driven body
have tanks of their own. A mesh is a shipped model of proxies, and stands where these do. A scene always has its
controller, without the key. A model that returns forces is late by itself, without the key. A ladder is that of the
users in the tick.

## Which work

✓ works. A number is the decision by which the pair is refused.

{table}

## Why the others do not

| | with | decision | because |
|---|---|---|---|
{reasons}

{links}
"""
"""The page around its tables."""


def _features() -> str:
    rows = []
    for number, (name, feature) in enumerate(FEATURES.items(), 1):
        stated = [f"`{path}={_shown(path, value)}`" for path, value in feature.changes.items()]
        if feature.within and "environment" not in feature.changes:
            stated.insert(0, f"a {feature.within[-1]}")
        told = " and ".join(stated) or "nothing"
        rows.append(f"| {number} | [{name}]({_link(feature.decision)}) | {told} | {feature.shows} |")
    return "\n".join(rows)


def _table() -> str:
    numbers = [str(number) for number in range(1, len(FEATURES) + 1)]
    head = [f"| | | {' | '.join(numbers)} |", "|---|---|" + "---|" * len(numbers)]
    rows = [
        f"| {number} | {name} | {' | '.join(_cell((name, other)) for other in FEATURES)} |"
        for number, name in zip(numbers, FEATURES, strict=True)
    ]
    return "\n".join(head + rows)


def _cell(pair: Pair) -> str:
    refusal = refusal_of(pair)
    return "✓" if refusal is None else f"[{refusal.decision}]"


def _reasons() -> str:
    return "\n".join(
        f"| {', '.join(one.pairs[0])} | {', '.join(one.pairs[1])} | [{one.decision}] | {one.why} |" for one in REFUSALS
    )


def _shown(path: str, value: object) -> str:
    """A value as a session file has it; of a world its type and its keys."""
    if path == "environment" and isinstance(value, Mapping):
        return ", ".join([f"{{type: {value['type']}", *(f"{key}: …" for key in value if key != "type")]) + "}"
    match value:
        case bool():
            return str(value).lower()
        case Mapping():
            return "{" + ", ".join(f"{key}: {_shown('', one)}" for key, one in value.items()) + "}"
        case list():
            return "[" + ", ".join(_shown("", one) for one in value) + "]"
    return str(value)


def _link(decision: int) -> str:
    return f"decisions/{decision_file(decision).name}"


def decision_file(number: int) -> Path:
    """The page of a decision."""
    (found,) = DECISIONS.glob(f"{number:04}-*.md")
    return found


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
