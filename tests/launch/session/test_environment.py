"""Environments of every kind, intervals, and their use in a run."""

import json
from pathlib import Path

import numpy as np
import pytest

from manyhands.launch.session import (
    Interval,
    NetworkEnvironment,
    Session,
    SessionError,
    StateSpaceEnvironment,
    TransferFunctionEnvironment,
    limits,
    load_session,
)
from manyhands.launch.session.matrices import stated_system

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"

STATES = (
    "environment={type: state-space, A: [[-1]], B: [[1, 0, 0]], C: [[1], [0], [0]], "
    "D: [[9, 0, 0], [0, 9, 0], [0, 0, 9]]}"
)
ENTRIES = "environment={type: transfer-function, entries: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}"


def example(name: str, *overrides: str) -> Session:
    return load_session(SESSIONS / f"{name}.yaml", overrides)


def network(session: Session) -> NetworkEnvironment:
    assert isinstance(session.environment, NetworkEnvironment)
    return session.environment


def test_the_uncertain_example_surrounds_example_1() -> None:
    session, base = example("example1-uncertain"), example("example1")
    uncertain, certain = network(session), network(base)
    assert uncertain.uncertain
    assert not certain.uncertain
    assert [link.between for link in uncertain.links] == [link.between for link in certain.links]
    pairs = [(uncertain.masses["hub"], certain.masses["hub"])]
    for link, true in zip(uncertain.links, certain.links, strict=True):
        pairs += [(link.stiffness, true.stiffness), (link.damping, true.damping)]
    for interval, value in pairs:
        assert isinstance(interval, Interval)
        assert isinstance(value, float)
        assert interval.nominal == pytest.approx(value, rel=1e-15)
        assert (interval.low, interval.high) == pytest.approx((0.9 * value, 1.1 * value), rel=1e-15)
    for name, device in session.devices.items():
        np.testing.assert_array_equal(session.osp_level(name), [[1.37]])
        assert (device.osp_low, device.osp.high) == (((1.37,),), ((1.6,),))
        assert device.damping == ((1.37 + 1.6) / 2,)
    assert session.blocks == base.blocks
    assert session.design == base.design


def test_an_interval_is_written_back_as_it_is_read() -> None:
    plain = example("example1-uncertain").as_plain()
    assert plain["devices"]["dx"]["osp"] == {"between": [[1.37], [1.6]]}
    assert plain["environment"]["masses"] == {"hub": {"between": [2.7, 3.3]}}
    assert plain["environment"]["links"][0]["stiffness"] == {"between": [3420.0, 4180.0]}


def test_an_interval_without_width_is_a_number() -> None:
    one = "{between: [3500, 3500]}"
    session = example("example1", f"environment.links.1.stiffness={one}", "environment.delay=2")
    assert session == example("example1", "environment.delay=2")
    assert example("example1", "devices.dx.osp={between: [1.37, 1.37]}") == example("example1")


def test_intervals_of_levels_go_axis_by_axis() -> None:
    key = "devices.d.osp"
    session = example("example1-operator", f"{key}={{between: [1.2, [1.2, 1.3, 1.4]]}}")
    device = session.devices["d"]
    np.testing.assert_array_equal(device.osp_low, 1.2 * np.eye(3))
    np.testing.assert_array_equal(device.osp.high, np.diag([1.2, 1.3, 1.4]))
    assert device.damping == (1.2, 1.25, (1.2 + 1.4) / 2)
    with pytest.raises(SessionError, match=r"lower end 1\.5 above the higher end 1\.4"):
        example("example1-operator", f"{key}={{between: [[1.2, 1.2, 1.5], 1.4]}}")


def test_a_spring_that_may_be_absent_is_a_link_still() -> None:
    session = example("example1", "environment.links.3={between: [hub, ground], stiffness: {between: [0, 2600]}}")
    assert network(session).links[3].stiffness == Interval(0.0, 2600.0)


def test_a_number_is_an_interval_of_itself() -> None:
    assert Interval.of(3.0) == Interval(3.0, 3.0)
    assert Interval.of(Interval(1.0, 2.0)) == Interval(1.0, 2.0)
    assert Interval.of(3.0).nominal == 3.0


def test_matrices_have_full_shapes_and_a_method() -> None:
    environment = example("example1", STATES).environment
    assert isinstance(environment, StateSpaceEnvironment)
    assert (environment.time, environment.method, environment.delay) == ("continuous", "backward-euler", 0)
    system = stated_system(environment, "the environment", continuous=True)
    assert [matrix.shape for matrix in (system.A, system.B, system.C, system.D)] == [(1, 1), (1, 3), (3, 1), (3, 3)]
    np.testing.assert_array_equal(system.D, 9 * np.eye(3))
    static = example("example1", STATES, *(f"environment.{name}=[]" for name in "ABC")).environment
    assert isinstance(static, StateSpaceEnvironment)
    system = stated_system(static, "the environment", continuous=True)
    assert [matrix.shape for matrix in (system.A, system.B, system.C, system.D)] == [(0, 0), (0, 3), (3, 0), (3, 3)]


@pytest.mark.parametrize("method", ["backward-euler", "tustin", "zoh"])
def test_the_method_is_of_continuous_time(method: str) -> None:
    environment = example("example1", STATES, f"environment.method={method}").environment
    assert isinstance(environment, StateSpaceEnvironment)
    assert environment.method == method
    discrete = example("example1", STATES, "environment.time=discrete")
    assert isinstance(discrete.environment, StateSpaceEnvironment)
    assert discrete.environment.method is None
    assert Session.model_validate(discrete.as_plain()) == discrete
    with pytest.raises(SessionError, match=r"environment\.method: found .* with 'time: discrete'"):
        example("example1", STATES, "environment.time=discrete", f"environment.method={method}")


def test_entries_may_be_numbers_and_improper() -> None:
    improper = "{num: [0, 0.3, 0.5, 900], den: [0, 1]}"
    rows = f"[[{improper}, 0, 0], [0, 800, 0], [0, 0, 700]]"
    overrides = f"environment={{type: transfer-function, entries: {rows}, delay: 1}}"
    environment = example("example1", overrides).environment
    assert isinstance(environment, TransferFunctionEnvironment)
    first, second = environment.entries[0][0], environment.entries[1][1]
    assert (first.degrees, first.proper) == ((2, 0), False)  # leading zeros count for nothing
    assert (second.num, second.den, second.degrees, second.proper) == ((800.0,), (1.0,), (0, 0), True)
    assert environment.entries[0][1].degrees == (-1, 0)
    assert (environment.method, environment.delay) == ("backward-euler", 1)


def test_a_proper_environment_may_be_discretised_by_tustin() -> None:
    entry = "{num: [1, 900], den: [0, 0.01, 1]}"
    rows = f"[[{entry}, 0, 0], [0, {entry}, 0], [0, 0, {entry}]]"
    session = example("example1", f"environment={{type: transfer-function, method: tustin, entries: {rows}}}")
    assert isinstance(session.environment, TransferFunctionEnvironment)
    assert session.environment.method == "tustin"


def test_the_degrees_of_entries_are_limited_together() -> None:
    entry = {"num": [1.0], "den": [1.0] * 17}
    plain = example("example1").as_plain()
    m = 6  # 36 entries of degree 16 make 576
    plain["devices"] = {"d": {"dof": m, "osp": 1.37, "driver": "simulated", "mass": 0.2, "hand": {}}}
    plain["couplings"] = {"c": {"devices": ["d"]}}
    plain["environment"] = {"type": "transfer-function", "entries": [[entry] * m] * m}
    with pytest.raises(ValueError, match="refused") as caught:
        Session.model_validate(plain)
    assert "degrees of 576 together" in repr(caught.value.errors())  # type: ignore[attr-defined]
    plain["environment"]["entries"] = [[entry] * 5 + [0.0]] * m  # 480
    Session.model_validate(plain)


def test_an_environment_of_the_largest_order_can_be_written() -> None:
    """The bounds on the file leave room for what the bound on the order allows."""
    n = limits.MAX_ENVIRONMENT_ORDER
    values = n * n + 2 * n + 1 + 2 * (n + 1)  # of A, B, C and D, and their rows
    assert values < limits.MAX_NODES
    text = json.dumps([[-1.2345678901234567e-100] * n] * n)
    assert len(text) < limits.MAX_FILE_BYTES


@pytest.mark.parametrize("delay", [0, 16])
@pytest.mark.parametrize("environment", ["environment.type=network", STATES, ENTRIES])
def test_every_kind_may_be_late(environment: str, delay: int) -> None:
    assert example("example1", environment, f"environment.delay={delay}").environment.delay == delay
