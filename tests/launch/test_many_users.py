"""What many linked users cost a design, the bundles and a simulation: each user as much as the one before it.

Calls are counted and no times are measured, so that a busy machine changes nothing.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import Session, load_session

STEP = 10
USERS = (5, 15, 25, 35)
TICKS = 10


def session(users: int, folder: Path) -> Session:
    lines = ["session: many", "period: 0.001", "devices:"]
    lines += [f"  d{i}: {{dof: 1, osp: 1.37, driver: simulated, mass: 0.2}}" for i in range(users)]
    lines += [
        "couplings:",
        *(f"  c{i}: {{devices: [d{i}], wave_link: {{b: 20, interval: 0.004}}}}" for i in range(users)),
    ]
    lines += ["environment:", "  type: network", "  masses: {hub: 3.0}", "  links:"]
    lines += [f"    - {{between: [d{i}, hub], stiffness: 3500, damping: 0.2}}" for i in range(users)]
    lines += ["    - {between: [hub, ground], stiffness: 2600, damping: 0.5}"]
    lines += ["design: {coupling: spring-damper, objective: feasible}"]
    file = folder / f"{users}.yaml"
    file.write_text("\n".join(lines) + "\n")
    return load_session(file)


def calls(act: Callable[[], object]) -> int:
    """How many functions ``act`` calls, those of C included."""
    count = 0

    def note(_frame: FrameType, event: str, _argument: Any) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        act()
    finally:
        sys.setprofile(before)
    return count


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> list[Prepared]:
    """Sessions of :data:`USERS` users; all modules are imported with the first."""
    folder = tmp_path_factory.mktemp("many")
    return [prepare(session(users, folder)) for users in USERS]


def calls_of_a_pair(counts: list[int]) -> float:
    """How many calls each pair of users costs, beside what each user costs alone."""
    first, _, third = (after - before for before, after in pairwise(counts))
    assert first > 0
    return (third - first) / (2 * STEP**2)


def test_a_design_costs_a_pair_of_users_its_entries_in_the_worlds_matrices(prepared: list[Prepared]) -> None:
    assert calls_of_a_pair([calls(lambda one=one: prepare(one.session)) for one in prepared]) <= 7.0


def test_bundles_cost_a_pair_of_users_nothing(prepared: list[Prepared]) -> None:
    cut(prepared[0], RunPlan("simulated", None, ""))  # what is imported with the first is no user's
    assert calls_of_a_pair([calls(lambda one=one: cut(one, RunPlan("simulated", None, ""))) for one in prepared]) <= 0.5


def test_a_tick_costs_a_pair_of_users_nothing(prepared: list[Prepared]) -> None:
    counts = []
    for one in prepared:
        simulation = Simulation(one)
        counts.append(calls(lambda simulation=simulation: simulation.run(TICKS)))
        assert all(link.world.aligned for link in simulation.links.values())
    assert calls_of_a_pair(counts) <= 0.2 * TICKS
