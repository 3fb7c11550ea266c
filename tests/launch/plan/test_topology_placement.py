"""A chain shares a processor; without a priority the kernel places the environment and a single chain."""

from __future__ import annotations

from pathlib import Path

import pytest

from manyhands.launch.plan.topology import placement, topology
from manyhands.launch.session import load_session
from manyhands.launch.session.session import ENVIRONMENT

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


@pytest.mark.parametrize(
    ("file", "processors", "expected"),
    [
        ("example1.yaml", [0, 1], {"dx": 0, "cx": 0, "dy": 1, "cy": 1, "dz": 0, "cz": 0}),
        ("example1.yaml", [2, 5, 7, 9], {"dx": 2, "cx": 2, "dy": 5, "cy": 5, "dz": 7, "cz": 7}),
        ("example1.yaml", [3], {}),
        ("example1-centralised.yaml", [0, 1], {}),  # one block joins all three
        ("example1-operator.yaml", [0, 1], {}),  # one device joins all three
    ],
)
def test_chains_are_dealt_to_the_processors(file: str, processors: list[int], expected: dict[str, int]) -> None:
    assert placement(topology(load_session(SESSIONS / file)), processors) == expected


@pytest.mark.parametrize(("processors", "expected"), [([0, 1], 1), ([2, 5, 7, 9], 9), ([4, 6, 8], 8)])
def test_an_environment_that_comes_before_others_gets_the_least_used_processor(
    processors: list[int], expected: int
) -> None:
    graph = topology(load_session(SESSIONS / "example1.yaml"))
    places = placement(graph, processors, raised=True)
    assert places == {**placement(graph, processors), ENVIRONMENT: expected}


def test_a_user_at_four_times_the_rate_has_a_processor_alone() -> None:
    links = [f"couplings.{name}.wave_link={{b: 10, period: {T}}}" for name, T in (("cy", 25e-5), ("cz", 1e-3))]
    graph = topology(load_session(SESSIONS / "example1.yaml", [*links, "couplings.cx.wave_link={b: 10}"]))
    shared = {"dx": 1, "cx": 1, "dz": 1, "cz": 1}
    assert placement(graph, [0, 1]) == {"dy": 0, "cy": 0, **shared}
    assert placement(graph, [0, 1], raised=True) == {"dy": 0, "cy": 0, **shared, ENVIRONMENT: 1}


def test_one_user_alone_comes_before_others_as_well() -> None:
    graph = topology(load_session(SESSIONS / "rub.yaml"))
    assert placement(graph, [0, 1], raised=True) == {"hand": 0, "to_hand": 0, ENVIRONMENT: 1}
    assert placement(graph, [0, 1]) == {}
    assert placement(graph, [0], raised=True) == {}


def test_nodes_elsewhere_take_no_processor_and_leave_the_environment_its_own() -> None:
    graph = topology(load_session(SESSIONS / "example1.yaml"))
    one = {"dx", "cx"}
    assert placement(graph, [0, 1], raised=True, remote=one) == {"dy": 0, "cy": 0, "dz": 1, "cz": 1, ENVIRONMENT: 1}
    two = {"dx", "cx", "dy", "cy"}
    assert placement(graph, [0, 1], raised=True, remote=two) == {"dz": 0, "cz": 0, ENVIRONMENT: 1}
    assert placement(graph, [0, 1], raised=False, remote=two) == {}
    assert placement(graph, [0, 1], raised=True, remote={*two, "dz", "cz"}) == {ENVIRONMENT: 1}
