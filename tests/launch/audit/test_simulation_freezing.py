"""Freezing a user: with three of them, the others and the environment keep their promises, with and without a return.

The cases are of two kinds: shipped sessions, and random ones with other networks, devices, axes and delays; hands,
intentions and instants are drawn anew in each case.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import Certificate, content
from manyhands.design.peak_gain import peak_gain
from manyhands.design.proof import prove
from manyhands.design.proof.claim import read
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.session import Session, load_session
from manyhands.nodes.environment.clutch import LET_GO, SLOWEST
from manyhands.nodes.kernel.timeouts import RAMP
from tests.support.reduction import at_any_ratio, reduced

from ...support.cases import cases

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
SHIPPED = ("example1", "example1-operator", "example1-delayed", "example1-uncertain")
RANDOM = tuple(f"random {seed}" for seed in range(cases(2, 4)))
CASES = 13  # of each session: 104 in all in `make test-long`
TICKS = 240


def random_plain(rng: np.random.Generator) -> dict[str, Any]:
    """Three users with one or two axes each, coupled through two masses and directly."""
    dofs = rng.integers(1, 3, 3)
    devices = {
        f"d{i}": {"dof": int(n), "osp": float(rng.uniform(1.0, 3.0)), "driver": "simulated", "mass": 0.2}
        for i, n in enumerate(dofs)
    }
    ports = [[f"d{i}.{a}" if n > 1 else f"d{i}" for a in range(n)] for i, n in enumerate(dofs)]
    links: list[dict[str, Any]] = []

    def link(a: str, b: str, most: float) -> None:
        stiffness, damping = float(rng.uniform(0.1, 1.0) * most), float(rng.uniform(0.05, 0.5))
        links.append({"between": [a, b], "stiffness": stiffness, "damping": damping})

    for port in (port for user in ports for port in user):
        link(port, str(rng.choice(["hub", "block"])), 4000.0)
    for one, two in ((0, 1), (1, 2)):
        link(str(rng.choice(ports[one])), str(rng.choice(ports[two])), 500.0)
    link("hub", "block", 3000.0)
    link("hub", "ground", 3000.0)
    return {
        "session": "random",
        "period": 0.001,
        "devices": devices,
        "couplings": {f"c{i}": {"devices": [f"d{i}"]} for i in range(3)},
        "environment": {
            "type": "network",
            "masses": {"hub": float(rng.uniform(0.5, 5.0)), "block": float(rng.uniform(0.2, 2.0))},
            "links": links,
        },
        "design": {"coupling": "spring-damper", "tau": float(rng.choice([0.0, 1e-4]))},
    }


SERIES = "example1, in series"  # the world's own springs are counted in series with the couplings


@pytest.fixture(scope="module", params=[*SHIPPED, *RANDOM, SERIES])
def base(request: pytest.FixtureRequest) -> Prepared:
    """A certified session; which hand holds its devices is no part of the certificate."""
    if request.param in SHIPPED:
        return prepare(load_session(SESSIONS / f"{request.param}.yaml"))
    if request.param == SERIES:
        return prepare(load_session(SESSIONS / "example1.yaml", ["design.series=true", "design.objective=stiffest"]))
    plain = random_plain(np.random.default_rng(RANDOM.index(request.param)))
    return prepare(Session.model_validate(plain, context={"folder": Path()}))


def held(base: Prepared, rng: np.random.Generator) -> Prepared:
    """The session with other hands and intentions."""
    plain = base.session.as_plain()
    for device in plain["devices"].values():
        axes = range(device["dof"])
        scale = float(rng.choice([0.2, 1.0, 5.0]))
        hand: dict[str, Any] = {
            "operator": {"num": [0.02 * scale, 1.2 * scale, 20.0 * scale], "den": [1.0, 10.3, 100.0]},
            "stiffness": float(rng.uniform(0.0, 200.0)),
        }
        if rng.random() < 0.5:
            begins = rng.uniform(0.0, 0.1, device["dof"])
            pushes = rng.uniform(-4.0, 4.0, device["dof"])
            hand["force"] = [f"{pushes[a]}*pulse(t, {begins[a]}, {begins[a] + 0.15})" for a in axes]
        else:
            wide, fast = rng.uniform(-0.02, 0.02, device["dof"]), rng.uniform(5.0, 60.0, device["dof"])
            hand["motion"] = [f"{wide[a]}*sin({fast[a]}*t)" for a in axes]
        device["hand"] = hand
    session = Session.model_validate(plain, context={"folder": Path()})
    return dataclasses.replace(base, session=session)


def coupling_ends(prepared: Prepared, recording: Recording, silence: Silence | None) -> np.ndarray:
    """x_c = x + V f_v, ticks x m, by block; nan for a silent one. One that returns is at rest, and its own force 0."""
    out = np.full_like(recording.x, np.nan)
    partition = prepared.loop.partition
    for name, ports, V in zip(partition.names, partition.blocks, prepared.blocks, strict=True):
        at = list(ports)
        spans = [(0, len(out))]
        if silence is not None and name == silence.coupling:
            spans = [(0, silence.begin)] + ([] if silence.end is None else [(silence.end, len(out))])
        for begin, end in spans:
            out[begin:end, at] = recording.x[begin:end, at] + V.simulate(recording.f_v[begin:end, at])
    return out


def keeps_its_promises(simulation: Simulation) -> None:
    assert set(simulation.ledgers) == {*simulation.devices, *simulation.couplings, "environment"}
    for name, ledger in simulation.ledgers.items():
        assert ledger.minimum >= 0.0, name
        assert math.isfinite(ledger.total)


def proved(certificate: Certificate) -> bool:
    return all(finding.holds for finding in prove(content(certificate) | {"id": certificate.id}))


@pytest.mark.wide
def test_the_others_keep_their_promises_and_feel_no_step(base: Prepared, request: pytest.FixtureRequest) -> None:
    number = [*SHIPPED, *RANDOM, SERIES].index(request.node.callspec.params["base"])
    names, T = base.loop.partition.names, base.session.period
    assert base.certificate is not None
    E = base.loop.environment.environment(T)
    gain = peak_gain(E)  # of forces over positions, and so of their changes: N/m
    assert np.all(np.isfinite(gain))
    moved = 0
    for case in range(CASES):
        rng = np.random.default_rng([number, case])
        prepared = held(base, rng)
        name = str(rng.choice(names))
        begin = int(rng.integers(30, 90))
        end = begin + int(rng.integers(1, 50))
        for_ever, passing = Silence(name, begin), Silence(name, begin, end)
        without = Simulation(prepared)
        returned, unharmed = copy.deepcopy(without), copy.deepcopy(without)
        free = unharmed.run(begin + 1)
        left = without.run(TICKS, faults=[for_ever])
        back = returned.run(TICKS, faults=[passing])

        keeps_its_promises(without)
        keeps_its_promises(returned)
        assert proved(reduced(base.certificate, [name]))

        # until then nothing differs by a bit
        for signal in ("x", "f_v"):
            np.testing.assert_array_equal(getattr(free, signal)[:begin], getattr(left, signal)[:begin])
            np.testing.assert_array_equal(getattr(left, signal)[:end], getattr(back, signal)[:end])
        mine = list(base.loop.partition.blocks[names.index(name)])
        others = [port for port in range(len(base.session.ports)) if port not in mine]
        assert np.all(left.f_v[begin:, mine] == 0.0)
        assert np.all(back.f_v[begin : end + 1, mine] == 0.0)

        # at the freezing tick and at the ramp's first: no more than the tool's motion of that tick, through D_E
        D_V = base.loop.partition.embed([block.D for block in base.blocks])
        D_E, at_others = E.D, np.ix_(others, others)
        loop = np.eye(len(others)) + D_E[at_others] @ D_V[at_others]
        passed = np.linalg.solve(loop, D_E[np.ix_(others, mine)])
        ends = coupling_ends(prepared, free, None)
        tool = ends[begin, mine] - ends[begin - 1, mine]
        size = 1e-9 * (1.0 + float(np.max(np.abs(back.f_v))))
        step = left.f_v[begin, others] - free.f_v[begin, others]
        np.testing.assert_allclose(step, passed @ tool, rtol=0, atol=size)
        np.testing.assert_array_equal(back.f_v[end, others], left.f_v[end, others])
        ends = coupling_ends(prepared, back, passing)
        first = math.sin(0.5 * math.pi / RAMP) ** 2
        tool = first * (ends[end + 1, mine] - ends[end, mine])
        step = back.f_v[end + 1, others] - left.f_v[end + 1, others]
        np.testing.assert_allclose(step, -passed @ tool, rtol=0, atol=size)

        # and at every tick what the environment makes of the fastest tool motion, whatever the ratios are
        for recording, silence in ((left, for_ever), (back, passing)):
            motion = np.abs(np.diff(coupling_ends(prepared, recording, silence), axis=0))
            fastest = np.nanmax(motion, axis=0) + LET_GO
            steps = np.abs(np.diff(recording.f_v[:, others], axis=0))
            assert np.all(steps <= (gain @ fastest)[others] + size)
            moved += float(np.max(steps)) > 1e-3
        # the returned user is coupled again, and its force rose with the ramp
        assert returned.environment.clutches.all[list(returned.couplings).index(name)].ratio >= SLOWEST - 1e-12
    assert moved > CASES  # something happened at the others in most of the runs


def test_any_ratios_are_certified(base: Prepared) -> None:
    assert base.certificate is not None
    certificate = base.certificate
    assert at_any_ratio(read(content(certificate) | {"id": certificate.id})).holds


def example() -> Prepared:
    return prepare(load_session(SESSIONS / "example1.yaml"))


def test_the_offset_is_worked_off_by_a_hand_that_moves() -> None:
    hand = "{operator: {num: [0.02, 1.2, 20], den: [1, 10.3, 100]}, stiffness: 500, motion: '0.03*sin(7*t)'}"
    prepared = prepare(load_session(SESSIONS / "example1.yaml", [f"devices.dx.hand={hand}"]))
    simulation = Simulation(prepared)
    at_the_end = copy.deepcopy(simulation)
    plan = [Silence("cx", 300, 700)]
    simulation.run(700 + RAMP + 1, faults=plan)
    at_the_end.run(2500, faults=plan)
    before, after = (float(it.environment.clutches.all[0].offset[0]) for it in (simulation, at_the_end))
    assert abs(before) > 0.01
    assert 0.0 < after / before < 0.85
    keeps_its_promises(at_the_end)


def test_two_may_be_silent_at_once_and_one_twice() -> None:
    prepared = example()
    simulation = Simulation(prepared)
    plan = [Silence("cx", 100, 250), Silence("cy", 150, 150 + RAMP), Silence("cx", 300)]
    run = simulation.run(500, faults=plan)
    keeps_its_promises(simulation)
    x, y, z = range(3)
    assert np.all(run.f_v[100:251, x] == 0.0)
    assert np.all(run.f_v[252:300, x] != 0.0)
    assert np.all(run.f_v[300:, x] == 0.0)
    assert np.all(run.f_v[150:251, y] == 0.0)
    assert np.all(run.f_v[252:, y] != 0.0)
    assert np.all(run.f_v[210:, z] != 0.0)  # its own push begins at 200
    assert [simulation.environment.clutches.all[block].ratio == 0.0 for block in range(3)] == [True, False, False]


def test_one_that_was_never_there() -> None:
    simulation = Simulation(example())
    run = simulation.run(400, faults=[Silence("cz", 0)])
    keeps_its_promises(simulation)
    assert np.all(run.f_v[:, 2] == 0.0)
    assert np.any(run.f_v[:, 1] != 0.0)
    assert np.any(run.x[:, 2] != 0.0)  # its hand moves on


def test_a_returning_coupling_starts_at_rest_with_a_new_ledger() -> None:
    simulation = Simulation(example())
    before = simulation.couplings["cx"], simulation.ledgers["cx"]
    kept = simulation.couplings["cy"]
    simulation.run(200, faults=[Silence("cx", 150, 180)])
    assert simulation.couplings["cx"] is not before[0]
    assert simulation.ledgers["cx"] is simulation.couplings["cx"].ledger
    assert simulation.couplings["cy"] is kept


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ([Silence("cq", 1)], "found a silence of 'cq'; expected one of cx, cy, cz"),
        ([Silence("cx", -1)], "found a silence of cx from tick -1 to None; expected it to begin at 0 or later"),
        ([Silence("cx", 5, 5)], "found a silence of cx from tick 5 to 5; expected"),
        (
            [Silence("cx", 5), Silence("cx", 9)],
            "found silences of cx from tick 5 and from 9; expected the first to end",
        ),
        ([Silence("cx", 9, 12), Silence("cx", 5, 9)], "found silences of cx from tick 5 and from 9"),
    ],
)
def test_a_plan_that_is_none_is_refused(faults: list[Silence], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Simulation(example()).run(10, faults=faults)
