"""Every kind of environment by the name that a certificate has for it: written, read, and asked what the others ask."""

import json
from dataclasses import replace

import numpy as np
import pytest

from manyhands.design.environments import KINDS, environment_of
from manyhands.design.errors import Infeasible
from manyhands.design.models.axis import TRANSLATING
from manyhands.design.models.contacts import GROUND
from manyhands.design.models.declared import DeclaredEnvironment, DeclaredScene, ProxyEnvironment
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.scene import Body, ContactScene, SceneLink, ToolSphere
from manyhands.design.models.statespace import StateSpace
from manyhands.design.wave_link import WaveLinkFace, WorldPromise

PORTS = ("a", "b")
T = 1e-3


def network(stiffness: float) -> Network:
    links = (NetworkLink(("a", "m"), stiffness, 0.1), NetworkLink(("m", "b"), 700.0, 0.2))
    return Network(PORTS, (("m", 0.5),), (*links, NetworkLink(("m", GROUND), 300.0, 0.3)))


ENTRY = ((0.3, 500.0), (1.0,))
NONE = ((0.0,), (1.0,))
SCENE = ContactScene(
    PORTS,
    tools=(
        ToolSphere("a", (0,), (0,), (0.0, 0.0, 0.0)),
        ToolSphere("b", (1,), (0,), (0.1, 0.0, 0.0)),
    ),
    bodies=(Body("m", 0.5, (0.0, 0.1, 0.0), 0.0),),
    links=(SceneLink(("m", GROUND), 300.0, 0.3),),
)
ALL: dict[str, Environment] = {
    "network": network(900.0),
    "box": NetworkBox(network(800.0), network(900.0)),
    "late network": DelayedNetwork(network(900.0), 2),
    "matrices": StateSpaceEnvironment(PORTS, StateSpace.static(500.0 * np.eye(2)), "zoh"),
    "discrete, late": StateSpaceEnvironment(PORTS, StateSpace.static(500.0 * np.eye(2)), None, 1),
    "functions": TransferEnvironment(PORTS, ((ENTRY, NONE), (NONE, ENTRY))),
    "declared": DeclaredEnvironment(PORTS, 0.2 * np.eye(2)),
    "scene": DeclaredScene(SCENE),
    "proxies": ProxyEnvironment(PORTS, 0.1 * np.eye(2), 900.0 * np.eye(2), "digest", 0.5),
    "face": WaveLinkFace(PORTS, id="w", b=10.0 * np.eye(2), tank=1.0, harvest=(0.1, 0.2), round_trip=0.02),
    "world": WorldPromise(PORTS, -0.1 * np.eye(2), id="p"),
}


@pytest.mark.parametrize("name", ALL)
def test_every_kind_is_read_as_it_was_written(name: str) -> None:
    environment = ALL[name]
    data = json.loads(json.dumps(environment.terms()))
    assert environment_of(data, PORTS) == environment


def test_every_name_of_the_table_is_written_by_a_kind() -> None:
    assert {environment.terms()["type"] for environment in ALL.values()} == {*KINDS}


@pytest.mark.parametrize("kind", ["rubber", ["network"], None])
def test_another_name_is_refused_with_all_that_are_known(kind: object) -> None:
    with pytest.raises(ValueError, match=r"environment\.type: found .*; expected one of 'network', ") as caught:
        environment_of({"type": kind}, PORTS)
    assert all(repr(name) in str(caught.value) for name in KINDS)


@pytest.mark.parametrize("name", ALL)
def test_a_kind_runs_matrices_or_what_keeps_its_declared_level(name: str) -> None:
    environment = ALL[name]
    running = environment.nominal.running(T)
    if environment.declared_level is None:
        assert running.E is not None
        assert running.level is None
        np.testing.assert_array_equal(running.E.D, environment.environment(T).D)
        assert (running.storage is not None) == (environment.passive_network is not None)
        assert environment.rows({}, TRANSLATING) == {}
        assert environment.verdict("c") == "proved"
    else:
        assert running.E is None
        np.testing.assert_array_equal(running.level, environment.declared_level)
        np.testing.assert_array_equal(environment.promised(), environment.declared_level)
        with pytest.raises(Infeasible):
            environment.split(T)
        assert environment.rows({"felt stiffness": 100.0}, TRANSLATING)
        assert "proved" in environment.verdict("c")
        assert environment.controlled == (name in ("declared", "scene"))


def test_what_is_late_or_in_discrete_time_says_so() -> None:
    assert {name for name, environment in ALL.items() if environment.late} == {"late network", "discrete, late"}
    assert {name for name, environment in ALL.items() if not environment.at_any_period} == {"discrete, late"}
    counts = {name: environment.counts for name, environment in ALL.items() if environment.counts}
    assert counts == {"network": "part", "box": "part", "matrices": "compliance", "functions": "compliance"}
    stiffened = ALL["matrices"].stiffened({"a": 1e-4})
    with pytest.raises(TypeError, match="expected the world itself"):
        stiffened.terms()
    with pytest.raises(TypeError, match="expected a world of which something may be counted"):
        ALL["declared"].stiffened({"a": 1e-4})


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("declared", {"enforced": False}),
        ("declared", {"level": 0.3 * np.eye(2)}),
        ("scene", {"scene": replace(SCENE, links=())}),
        ("proxies", {"stiffness": 901.0 * np.eye(2)}),
        ("proxies", {"content": None}),
        ("proxies", {"tank": 0.0}),
        ("face", {"b": 11.0 * np.eye(2)}),
        ("face", {"harvest": (0.1, 0.3)}),
        ("face", {"round_trip": None}),
        ("face", {"mass": np.eye(2)}),
        ("world", {"id": "q"}),
        ("world", {"ports": ("a", "c")}),
    ],
)
def test_two_of_a_kind_are_equal_as_all_their_numbers_are(name: str, change: dict[str, object]) -> None:
    one = ALL[name]
    assert isinstance(one, DeclaredEnvironment)
    assert replace(one) == one
    assert replace(one, **change) != one  # type: ignore[arg-type]
    assert all(one != other for key, other in ALL.items() if key != name)
