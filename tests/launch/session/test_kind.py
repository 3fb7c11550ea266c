"""A kind of environment that no module names: a session of it is planned, certified, run and shown like any other."""

from collections.abc import Iterator
from typing import get_args

import numpy as np
import pytest

from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.engine import require_engine
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import ENVIRONMENT, Session
from manyhands.launch.session.environment import KINDS
from manyhands.launch.session.fields import Problem
from manyhands.launch.session.kind import EnvironmentKind
from manyhands.nodes.kernel.bundle import SIMULATED, EnvironmentBundle

LINKS = [{"between": [f"d{axis}", "ground"], "stiffness": 900.0, "damping": 0.2} for axis in "xy"]


class Posts(EnvironmentKind):
    """A spring and a damper from each port to the ground."""

    type: str = "posts"
    stiffness: float
    damping: float
    enforce: bool = False

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """None."""
        return iter(())

    def for_design(self, ports: tuple[str, ...]) -> Environment:
        """A network of as many links."""
        links = tuple(NetworkLink((port, GROUND), self.stiffness, self.damping) for port in ports)
        return Network(ports, (), links)


def session(environment: object = None) -> Session:
    device = {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2, "hand": {"force": "sin(9*t)"}}
    return Session.from_dict(
        {
            "session": "posts",
            "period": 0.001,
            "devices": {"dx": device, "dy": device},
            "couplings": {"cx": {"devices": ["dx"]}, "cy": {"devices": ["dy"]}},
            "environment": {"type": "network", "links": LINKS} if environment is None else environment,
            "design": {"coupling": "spring-damper"},
        }
    )


@pytest.fixture
def posts() -> Session:
    return session().model_copy(update={"environment": Posts(stiffness=900.0, damping=0.2)})


def of_environment(prepared: Prepared) -> EnvironmentBundle:
    found = cut(prepared, RunPlan(SIMULATED, None, ""))[ENVIRONMENT]
    assert isinstance(found, EnvironmentBundle)
    return found


def test_a_kind_without_a_name_elsewhere_is_certified_and_run_as_the_network_that_it_is(posts: Session) -> None:
    require_engine(posts)
    assert posts.foreign_code == {}
    new, plain = prepare(posts), prepare(session())
    assert new.id == plain.id
    np.testing.assert_array_equal(Simulation(new).run(200).f_v, Simulation(plain).run(200).f_v)
    own, other = of_environment(new), of_environment(plain)
    assert (own.scene, own.model, own.stiffness, own.masses, own.tank) == (None, None, None, (), 0.0)
    assert own.storage is not None
    np.testing.assert_array_equal(own.storage, other.storage)


def test_a_kind_that_answers_nothing_more_has_nothing_to_draw_or_count(posts: Session) -> None:
    environment = posts.environment
    assert environment.masses_and_springs(posts.ports) == ({}, ())
    assert environment.geometry(posts.ports) is None
    assert environment.without_series == "an environment of type posts"


def test_every_kind_has_its_line_in_the_table_under_its_own_name() -> None:
    def kinds(of: type[EnvironmentKind]) -> set[type[EnvironmentKind]]:
        return {of, *(kind for part in of.__subclasses__() for kind in kinds(part))}

    own = {kind for kind in kinds(EnvironmentKind) if kind.__module__.startswith("manyhands.")}
    assert {kind for kind in own if not kind.__abstractmethods__} == {*KINDS.values()}
    assert [get_args(kind.model_fields["type"].annotation) for kind in KINDS.values()] == [(name,) for name in KINDS]
