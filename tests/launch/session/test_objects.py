"""A session from Python data: what files state, and objects of numpy, SciPy and python-control in their places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import control
import numpy as np
import pytest
import scipy.signal

from manyhands.design.models.statespace import LinearSystem
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.launch.session.shipped import load_named

SESSIONS = sorted((Path(__file__).parents[3] / "launch" / "sessions").glob("*.yaml"))
T = 1e-3
GELS: dict[str, Callable[[], Any]] = {
    "control.tf": lambda: control.tf([4000.0, 80000.0], [1.0, 160.0]),
    "scipy": lambda: scipy.signal.TransferFunction([4000.0, 80000.0], [1.0, 160.0]),
}


def data(**changes: Any) -> dict[str, Any]:
    """A session of one device and a wall."""
    return {
        "session": "wall",
        "period": T,
        "devices": {"d": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2}},
        "couplings": {"c": {"devices": ["d"]}},
        "environment": {"type": "network", "links": [{"between": ["d", "ground"], "stiffness": 5000}]},
        "design": {"coupling": "spring-damper"},
    } | changes


def environment(system: Any) -> dict[str, Any]:
    found: dict[str, Any] = Session.from_dict(data(environment=system)).to_dict()["environment"]
    return found


def refused(**changes: Any) -> str:
    with pytest.raises(SessionError) as caught:
        Session.from_dict(data(**changes))
    return str(caught.value)


@pytest.mark.parametrize("path", SESSIONS, ids=lambda path: path.stem)
def test_a_session_is_what_it_states(path: Path) -> None:
    session = load_session(path)
    assert Session.from_dict(session.to_dict()) == session
    assert Session.from_dict(session.as_plain()) == session
    assert len(str(session)) < 200


def test_what_was_settled_is_stated() -> None:
    session = load_named("example1").with_delay(3e-4)
    assert session.to_dict()["design"]["tau"] == 3e-4
    assert Session.from_dict(session.to_dict()) == session


def test_arrays_and_paths_are_plain_values() -> None:
    device = {"dof": np.int64(2), "osp": 1.37 * np.eye(2), "driver": "simulated", "mass": np.array([0.2, 0.3])}
    session = Session.from_dict(
        data(
            devices={"d": device},
            environment={
                "type": "network",
                "links": [{"between": (port, "ground"), "stiffness": np.float32(500)} for port in ("d.0", "d.1")],
            },
        )
    )
    assert session.devices["d"].mass == (0.2, 0.3)
    assert session.osp_level("d").tolist() == [[1.37, 0.0], [0.0, 1.37]]


@pytest.mark.parametrize("make", GELS.values(), ids=GELS)
def test_a_transfer_function_is_an_environment(make: Callable[[], Any]) -> None:
    entries = [[{"num": [4000.0, 80000.0], "den": [1.0, 160.0]}]]
    assert environment(make()) == {"type": "transfer-function", "entries": entries}


def test_a_matrix_of_transfer_functions_is_an_environment() -> None:
    num, den = [[[1000.0], [0.0]], [[0.0], [1000.0, 20.0]]], [[[1.0], [1.0]], [[1.0], [1.0, 160.0]]]
    system = control.tf(num, den)
    device = {"dof": 2, "osp": 1.37, "driver": "simulated", "mass": 0.2}
    found = Session.from_dict(data(devices={"d": device}, environment=system)).to_dict()["environment"]
    assert [[len(one["num"]) for one in row] for row in found["entries"]] == [[1, 1], [1, 2]]


@pytest.mark.parametrize(
    ("dt", "time"), [(0, "continuous"), (None, "continuous"), (T, "discrete"), (True, "discrete")], ids=str
)
def test_the_sample_time_of_a_system_decides_its_time(dt: float | None, time: str) -> None:
    found = environment(control.ss([[-0.5]], [[1.0]], [[1.0]], [[1000.0]], dt))
    assert (found["type"], found["time"], found["A"], found["D"]) == ("state-space", time, [[-0.5]], [[1000.0]])


@pytest.mark.filterwarnings("ignore:Setting the shape:DeprecationWarning")  # python-control 0.10 beside NumPy 2.5
def test_a_gain_without_states_is_an_environment() -> None:
    found = environment(control.ss([], [], [], [[1000.0]]))
    assert (found["A"], found["D"]) == ([], [[1000.0]])


def test_a_coupling_is_given_by_a_discrete_system() -> None:
    V = LinearSystem(np.array([[0.5]]), np.array([[1e-4]]), np.array([[1.0]]), np.array([[4e-4]]), T)
    for block in (V, control.ss(*V), scipy.signal.StateSpace(*V[:4], dt=V.dt)):
        session = Session.from_dict(data(design={"coupling": "given", "matrices": {"c": block}}))
        assert session.to_dict()["design"]["matrices"]["c"]["B"] == [[1e-4]]


def test_a_weight_is_given_by_a_transfer_function() -> None:
    weights = {"W1": control.tf([1.0], [0.05, 1.0])}
    asked = {"coupling": "spring-damper", "objective": "loop-shaping", "weights": weights}
    found = Session.from_dict(data(design=asked)).to_dict()["design"]["weights"]
    assert found == {"W1": {"num": [1.0], "den": [0.05, 1.0]}}


def test_wrong_objects_are_refused_by_their_place() -> None:
    system = control.ss([[0.5]], [[1.0]], [[1.0]], [[1000.0]], 2 * T)
    text = "session: environment: found the sample time 0.002 s; expected the session's period, 0.001 s, or "
    assert refused(environment=system) == text + "continuous time"
    discrete = control.tf([1.0], [1.0, 0.5], T)
    text = "session: environment: found a transfer function in z; expected one in s, or the system in state space"
    assert refused(environment=discrete) == text
    given = {"coupling": "given", "matrices": {"c": control.ss([[0.5]], [[1.0]], [[1.0]], [[1.0]])}}
    text = "session: design.matrices.c: found a system in continuous time; expected one in discrete time, dt = 0.001 s"
    assert refused(design=given) == text
    text = "session: couplings: found a linear system; expected one as environment, or as a block of design.matrices"
    assert refused(couplings=control.ss([[0.5]], [[1.0]], [[1.0]], [[1000.0]])) == text
    timeless = SimpleNamespace(A=[[1.0]], B=[[1.0]], C=[[1.0]], D=[[1.0]])
    assert refused(environment=timeless).endswith("expected the attribute dt, in s; 0 for continuous time")


def test_wrong_data_are_refused_by_their_place() -> None:
    assert refused(period={1, 2}).startswith("session: period: found a set; expected a number")
    assert refused(devices={1: {}}) == "session: devices: found the key 1; expected a name as the key"
    assert refused(period=np.nan).startswith("session: period: found .nan; expected")
    assert refused(devices={"d": {"dof": 1, "osp": -1.0}}).startswith("session: devices.d.osp: found -1.0; expected")
    nothing = {"coupling": "spring-damper", "objective": None}
    assert refused(design=nothing).startswith("session: design.objective: found nothing; expected")
    endless: list[Any] = []
    endless.append(endless)
    assert "found nesting deeper than 32" in refused(environment=endless)
    with pytest.raises(SessionError, match=r"^session: found 3; expected a mapping with the keys of a session file$"):
        Session.from_dict(3)  # type: ignore[arg-type]


def test_values_are_replaced_by_their_path() -> None:
    session = Session.from_dict(data())
    changed = session.replace({"design.tau": 5e-4, "environment.links.0.stiffness": 800, "faults.restarts": 0})
    assert (changed.design.tau, changed.faults.restarts) == (5e-4, 0)
    assert changed.to_dict()["environment"]["links"][0]["stiffness"] == 800
    assert session.design.tau is None
    assert session.replace({}) == session


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("design.tua", 0.1, "wall: design.tua: found the unknown key 'tua'; expected one of "),
        ("devices.x.mass", 0.1, "wall: devices: found no 'x'; expected d"),
        ("devices.d.mass", -1, "wall: devices.d.mass: found -1; expected a mass in kg greater than 0"),
        ("environment.links.1.stiffness", 1, "wall: environment.links: found no '1'; expected a position from 0 to 0"),
        ("period.x", 1, "wall: period: found 0.001; expected a mapping or a list there"),
        ("", 1, "wall: found the path ''; expected keys joined by dots, such as devices.dx.mass"),
        ("design.tau", {1}, "wall: design.tau: found a set; expected a number"),
    ],
)
def test_wrong_changes_are_refused_by_their_path(path: str, value: Any, message: str) -> None:
    with pytest.raises(SessionError) as caught:
        Session.from_dict(data()).replace({path: value})
    assert str(caught.value).startswith(message)
