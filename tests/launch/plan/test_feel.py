"""What is felt of a hard thing behind a soft coupling."""

from __future__ import annotations

import pytest

import manyhands as mh
from manyhands.launch.plan.feel import feel_lines, softened
from manyhands.launch.session import Session
from manyhands.launch.session.shipped import load_named


def light(wall: float, osp: float = 0.05) -> Session:
    """One light device at a wall."""
    return Session.from_dict(
        {
            "session": "light",
            "period": 0.001,
            "devices": {"pen": {"dof": 1, "osp": osp, "driver": "simulated", "mass": 0.05}},
            "couplings": {"c": {"devices": ["pen"]}},
            "environment": {"type": "network", "links": [{"between": ["pen", "ground"], "stiffness": wall}]},
            "design": {"coupling": "spring-damper", "tau": 0.001},
        }
    )


def test_a_wall_behind_a_far_softer_coupling_is_felt_as_two_springs_in_series() -> None:
    certificate = mh.certify(light(1000.0))
    K = certificate.stiffness[0, 0]
    (found,) = softened(light(1000.0), [certificate])
    assert (found.port, found.contact, found.coupling) == ("pen", 1000.0, K)
    assert found.felt == pytest.approx(1.0 / (1.0 / K + 1e-3), rel=1e-12)  # compliances add; rounding
    assert feel_lines(light(1000.0), [certificate]) == [
        f"light: pen: a contact of 1000 N/m will feel like {found.felt:.3g} N/m: the coupling is the limit"
    ]


def test_nothing_is_said_of_a_wall_that_is_no_harder_than_ten_couplings() -> None:
    certificate = mh.certify(light(1000.0))
    K = certificate.stiffness[0, 0]
    assert feel_lines(light(9.9 * K), [certificate]) == []
    assert len(feel_lines(light(10.1 * K), [certificate])) == 1


@pytest.mark.parametrize(
    ("name", "met"),
    [
        ("example1", {"dx": 3800.0, "dy": 3500.0, "dz": 3300.0}),
        ("rub", {"hand.x": 20000.0, "hand.y": 20000.0, "hand.z": 20000.0}),
        ("stroke", {f"{name}.{axis}": 5000.0 for name in ("anna", "ben") for axis in "xyz"}),
        ("mujoco", {f"{name}.{axis}": 2000.0 for name in ("left", "right") for axis in range(2)}),
    ],
)
def test_every_kind_of_world_says_how_hard_its_things_are(name: str, met: dict[str, float]) -> None:
    session = load_named(name, [])
    assert session.environment.hardest(session.ports).items() >= met.items()


def test_a_model_that_returns_forces_says_nothing_of_its_hardness() -> None:
    session = Session.from_dict(
        {
            "session": "own",
            "period": 0.001,
            "devices": {"pen": {"dof": 1, "osp": 1.0, "driver": "simulated", "mass": 0.1}},
            "couplings": {"c": {"devices": ["pen"]}},
            "environment": {"type": "python", "model": "nowhere:model", "level": 0.1},
            "design": {"coupling": "spring-damper", "tau": 0.0},
        }
    )
    assert session.environment.hardest(session.ports) == {}
