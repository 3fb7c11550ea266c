"""The contents of a loaded session, and what is derived from it."""

import copy
from pathlib import Path

import numpy as np
import pytest

from manyhands.design.models.axis import AxisKind
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import DEFAULT_HAND, Session, SessionError, load_session
from manyhands.launch.session.matrices import stated_system
from manyhands.launch.session.session import observable
from manyhands.nodes.kernel.intent import intent_from
from manyhands.protocol.messages import Role

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"

PLAIN = {
    "session": "plain",
    "period": 0.001,
    "devices": {
        "a": {"dof": 1, "osp": 1.0, "driver": "simulated", "mass": 0.2},
        "b": {"dof": 2, "osp": [1.0, 2.0], "driver": "simulated", "mass": [0.2, 0.3]},
        "c": {"dof": 2, "axes": ["x", "y"], "osp": [[1.0, 0.5], [0.5, 2.0]], "driver": "simulated", "mass": 1},
    },
    "couplings": {"left": {"ports": ["c.y", "a"]}, "right": {"ports": ["b.0", "c.x", "b.1"]}},
    "environment": {
        "type": "network",
        "links": [{"between": [port, "ground"], "stiffness": 100} for port in ("a", "b.0", "b.1", "c.x", "c.y")],
    },
    "design": {"coupling": "spring-damper"},
}


def plain(**changes: object) -> Session:
    return Session.model_validate({**copy.deepcopy(PLAIN), **changes})


def example(name: str, *overrides: str) -> Session:
    return load_session(SESSIONS / f"{name}.yaml", overrides)


def test_the_shipped_sessions() -> None:
    names = {path.stem: load_session(path).name for path in SESSIONS.glob("*.yaml")}
    assert names == {
        "ball": "ball",
        "browser": "browser",
        "carry": "carry",
        "gripper": "gripper",
        "handover": "handover",
        "insert": "insert",
        "mujoco": "mujoco",
        "example1": "example-1",
        "example1-centralised": "example-1-centralised",
        "example1-delayed": "example-1-delayed",
        "example1-operator": "example-1-operator",
        "example1-uncertain": "example-1-uncertain",
        "example1-uncoupled": "example-1-uncoupled",
        "example2": "example-2",
        "example2-closed-loop": "example-2-closed-loop",
        "example2-linear": "example-2-linear",
        "peg": "peg",
        "rub": "rub",
        "screw": "screw",
        "steering": "steering",
        "stretcher": "stretcher",
        "stroke": "stroke",
        "tray": "tray",
    }


def test_example_1() -> None:
    session = example("example1")
    assert session.period == 0.001
    assert session.ports == ("dx", "dy", "dz")
    assert session.blocks == (("dx",), ("dy",), ("dz",))
    assert session.environment.masses == {"hub": 3.0}
    assert [(link.between, link.stiffness, link.damping) for link in session.environment.links] == [
        (("dx", "hub"), 3800.0, 0.1),
        (("dy", "hub"), 3500.0, 0.2),
        (("dz", "hub"), 3300.0, 0.3),
        (("hub", "ground"), 2600.0, 0.5),
    ]
    device = session.devices["dy"]
    assert (device.mass, device.damping) == ((0.2,), (1.37,))
    assert device.hand.operator[0][0].num == (0.02, 1.2, 20.0)
    assert device.hand.force == ("-1.5*pulse(t, 0.15, 0.25)",)
    assert session.design.coupling == "spring-damper"
    assert session.given_stiffness is None
    assert session.given_damping is None


def test_the_variants_of_example_1_change_nothing_else() -> None:
    base = example("example1")
    centralised, uncoupled = example("example1-centralised"), example("example1-uncoupled")
    assert centralised.blocks == (("dx", "dy", "dz"),)
    assert uncoupled.design.coupling == "none"
    for variant in (centralised, uncoupled):
        assert variant.devices == base.devices
        assert variant.environment == base.environment
        assert variant.period == base.period


def test_limits_are_by_axis_and_generous_by_default() -> None:
    by_default = plain().devices["b"].limits
    assert (by_default.force, by_default.displacement, by_default.speed) == ((1000.0,) * 2, (10.0,) * 2, (100.0,) * 2)
    limits = {"force": 8, "displacement": [0.2, 0.1]}
    devices: dict[str, object] = {**PLAIN["devices"], "b": {**PLAIN["devices"]["b"], "limits": limits}}  # type: ignore[dict-item,index]
    own = plain(devices=devices).devices["b"].limits
    assert (own.force, own.displacement, own.speed) == ((8.0, 8.0), (0.2, 0.1), (100.0, 100.0))


@pytest.mark.parametrize("name", ["example1", "example1-uncoupled"])
def test_the_default_limits_are_far_from_what_the_examples_reach(name: str) -> None:
    """The one without coupling is not stable: a limit that stopped it would hide what it is there to show."""
    session = example(name)
    run = Simulation(prepare(session, uncertified=True)).run(10_000)
    limits = session.devices["dx"].limits
    assert np.abs(run.f_v).max() < 0.5 * limits.force[0]
    assert np.abs(run.x).max() < 0.01 * limits.displacement[0]
    assert np.abs(np.diff(run.x, axis=0)).max() / session.period < 0.1 * limits.speed[0]


def test_observers_and_what_they_read() -> None:
    assert plain().observers == {}
    reads = ("telemetry", "b/sample", "b/force", "left/tool", "right/reaction", "environment/telemetry")
    session = plain(observers={"watch": {"reads": ["telemetry"]}, "scope": {"reads": list(reads)}})
    assert {name: observer.reads for name, observer in session.observers.items()} == {
        "watch": ("telemetry",),
        "scope": reads,
    }
    assert Session.model_validate(session.as_plain()) == session


def test_what_can_be_observed_of_each_role() -> None:
    """Each signal under the end nearer to the hand, and everybody's telemetry; never what sets up a session."""
    assert {role: observable(role) for role in Role} == {
        Role.DEVICE: ("sample", "force", "telemetry"),
        Role.COUPLING: ("tool", "reaction", "telemetry"),
        Role.ENVIRONMENT: ("telemetry",),
        Role.SUPERVISOR: (),
        Role.OBSERVER: (),
        Role.HAND: (),
    }


def test_roles_are_those_of_the_nodes_in_order() -> None:
    assert list(plain().roles.items()) == [
        ("a", Role.DEVICE),
        ("b", Role.DEVICE),
        ("c", Role.DEVICE),
        ("left", Role.COUPLING),
        ("right", Role.COUPLING),
        ("environment", Role.ENVIRONMENT),
    ]


def test_one_operator_on_three_axes_is_only_just_passive() -> None:
    session = example("example1-operator")
    assert session.ports == ("d.x", "d.y", "d.z")
    assert session.blocks == (("d.x",), ("d.y",), ("d.z",))
    hand = session.devices["d"].hand
    assert hand.kinds == (AxisKind.TRANSLATION,) * 3
    finding = hand.rational.passivity()
    assert finding.passive
    assert finding.smallest == pytest.approx(4.6e-5, rel=0.02)
    assert len(hand.force) == 3


def test_ports_and_blocks_keep_their_order() -> None:
    session = plain()
    assert session.ports == ("a", "b.0", "b.1", "c.x", "c.y")
    assert session.ports_of("c") == ("c.x", "c.y")
    assert session.blocks == (("c.y", "a"), ("b.0", "c.x", "b.1"))
    by_device = plain(couplings={"one": {"devices": ["c", "a"]}, "two": {"devices": ["b"]}})
    assert by_device.blocks == (("c.x", "c.y", "a"), ("b.0", "b.1"))


def test_a_single_named_axis_names_its_port() -> None:
    devices = {"a": {**PLAIN["devices"]["a"], "axes": ["0"]}}  # type: ignore[index]
    links = [{"between": ["a.0", "ground"], "damping": 1}]
    session = plain(
        devices=devices,
        couplings={"k": {"devices": ["a"]}},
        environment={"type": "network", "links": links},
    )
    assert session.ports == ("a.0",)


def test_osp_levels_and_the_damping_that_they_need() -> None:
    session = plain()
    np.testing.assert_array_equal(session.osp_level("a"), [[1.0]])
    np.testing.assert_array_equal(session.osp_level("b"), np.diag([1.0, 2.0]))
    np.testing.assert_array_equal(session.osp_level("c"), [[1.0, 0.5], [0.5, 2.0]])
    assert session.devices["b"].damping == (1.0, 2.0)
    damping = session.devices["c"].damping
    assert damping == (1.5, 2.5)
    assert np.linalg.eigvalsh(np.diag(damping) - session.osp_level("c"))[0] >= 0.0


def test_the_hand_of_a_device_that_names_none() -> None:
    hand = plain().devices["c"].hand
    assert hand.rational.passivity().passive
    own = hand.operator[0][0]
    assert (own.num, own.den) == ((0.02, 1.2, 20.0), (1.0, 10.3, 100.0))
    assert hand.operator[1][1] == own
    assert hand.operator[0][1].num == (0.0,)
    assert hand.force == (DEFAULT_HAND["force"],) * 2
    force = intent_from("2*pulse(t, 0.1, 0.2)")
    assert [force(t) for t in (0.0, 0.1, 0.19, 0.2)] == [0.0, 2.0, 2.0, 0.0]


def test_a_hand_that_is_written_has_only_what_is_written() -> None:
    session = example("example1", "devices.dx.hand={mass: 0.1, stiffness: 20}")
    hand = session.devices["dx"].hand
    assert hand.operator[0][0].num == (0.0,)
    assert (hand.mass, hand.damping, hand.stiffness, hand.force, hand.motion) == (
        (0.1,),
        (0.0,),
        (20.0,),
        (0.0,),
        (0.0,),
    )


def test_given_couplings_become_full_matrices() -> None:
    design = {"coupling": "given", "stiffness": 700, "damping": [1, 2, 3, 4, 5]}
    session = plain(design=design)
    np.testing.assert_array_equal(session.given_stiffness, 700 * np.eye(5))
    np.testing.assert_array_equal(session.given_damping, np.diag([1.0, 2, 3, 4, 5]))
    rows = 700 * np.eye(5)
    rows[0, 4] = rows[4, 0] = 1.0  # a and c.y share a block
    session = plain(design={"coupling": "given", "stiffness": rows.tolist()})
    np.testing.assert_array_equal(session.given_stiffness, rows)
    np.testing.assert_array_equal(session.given_damping, np.zeros((5, 5)))


def test_given_matrices_have_full_shapes_also_without_states() -> None:
    matrices = {
        "left": {"A": [], "B": [], "C": [], "D": [[1, 0], [0, 1]]},
        "right": {"A": [[0.5]], "B": [[1, 2, 3]], "C": [[1], [2], [3]], "D": np.eye(3).tolist()},
    }
    session = plain(design={"coupling": "given", "matrices": matrices})
    assert session.design.matrices is not None
    blocks = {name: stated_system(block, name, continuous=False) for name, block in session.design.matrices.items()}
    shapes = {name: [V.A.shape, V.B.shape, V.C.shape, V.D.shape] for name, V in blocks.items()}
    assert shapes == {"left": [(0, 0), (0, 2), (2, 0), (2, 2)], "right": [(1, 1), (1, 3), (3, 1), (3, 3)]}


def test_overrides_are_checked_like_the_file() -> None:
    assert example("example1", "devices.dx.mass=0.3").devices["dx"].mass == (0.3,)
    with pytest.raises(SessionError) as caught:
        example("example1", "devices.dx.mass=-0.2")
    assert str(caught.value) == (
        "--set devices.dx.mass=-0.2: devices.dx.mass: found -0.2; expected a mass in kg greater than 0"
    )


def test_the_message_of_the_architecture(tmp_path: Path) -> None:
    path = tmp_path / "example.yaml"
    path.write_text((SESSIONS / "example1.yaml").read_text().replace("mass: 0.2 ", "mass: -0.2 ", 1))
    with pytest.raises(SessionError) as caught:
        load_session(path)
    assert str(caught.value) == f"{path}:9: devices.dx.mass: found -0.2; expected a mass in kg greater than 0"


@pytest.mark.parametrize("key", ["devices.dx.hand", "devices.dx.damping", "devices.dx.axes", "design.stiffness"])
def test_an_optional_key_left_empty_is_not_left_out(key: str) -> None:
    with pytest.raises(SessionError, match=f"{key}: found nothing; expected a value, or the key left out"):
        example("example1", f"{key}=")


@pytest.mark.parametrize(
    "operator",
    [
        "{num: [1], den: [1e-300, 1]}",
        "{num: [1e25], den: [1]}",
        "{num: [1, 1, 1], den: [1.0e+24, 1.0e-24]}",
        "{num: [" + "1, " * 18 + "], den: [1]}",
        "1e13",
        "-1e-3",
    ],
)
def test_operators_of_extreme_size_are_refused(operator: str) -> None:
    with pytest.raises(SessionError, match=r"devices\.dx\.hand\.operator"):
        example("example1", f"devices.dx.hand.operator={operator}")


@pytest.mark.parametrize(("key", "value"), [("devices.dx.mass", "1e-13"), ("environment.links.0.stiffness", "1e13")])
def test_quantities_of_extreme_size_are_refused(key: str, value: str) -> None:
    with pytest.raises(SessionError, match=rf"{key}: found 1.*, of a size from .* to 1e\+12"):
        example("example1", f"{key}={value}")


def test_ports_are_limited() -> None:
    device = {"dof": 32, "osp": 1.0, "driver": "simulated", "mass": 1.0, "hand": {}}
    devices = {f"d{i}": device for i in range(65)}
    with pytest.raises(ValueError, match="refused") as caught:
        plain(devices=devices)
    assert "2080 ports" in repr(caught.value.errors())  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("content", "times", "values"),
    [
        (b"0,1\n0.5,2\n", (0.0, 0.5), (1.0, 2.0)),
        (b"t,value\n0,1\n0.5,2", (0.0, 0.5), (1.0, 2.0)),
        (b"\xef\xbb\xbftime, force\r\n0, 1\r\n\r\n0.5, -2e0\r\n", (0.0, 0.5), (1.0, -2.0)),
    ],
)
def test_a_trace_is_read_beside_the_session_file(
    tmp_path: Path, content: bytes, times: tuple[float, ...], values: tuple[float, ...]
) -> None:
    (tmp_path / "push.csv").write_bytes(content)
    (tmp_path / "s.yaml").write_text((SESSIONS / "example1.yaml").read_text())
    session = load_session(tmp_path / "s.yaml", ["devices.dx.hand.force={trace: push.csv}"])
    (trace,) = session.devices["dx"].hand.force
    assert not isinstance(trace, float | str)
    assert (trace.times, trace.values) == (times, values)
    assert Session.model_validate(session.as_plain()) == session


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "0 samples"),
        (b"t,v\n", "0 samples"),
        (b"0,1,2\n", "line 1"),
        (b"t,v\nt,v\n", "line 2"),
        (b"0,one\n", "line 1"),
        (b"0.1,0\n", "the first time is 0.1 s"),
        (b"0,0\n0,1\n", "sample 2"),
        (b"0,0\n1,nan\n", "sample 2 is not finite"),
        (b"0,0\n" + b"1" * 300, "line 2: more than 200 characters"),
        (b"0,\xff\n", "not UTF-8"),
    ],
)
def test_traces_that_are_none(tmp_path: Path, content: bytes, found: str) -> None:
    (tmp_path / "push.csv").write_bytes(content)
    (tmp_path / "s.yaml").write_text((SESSIONS / "example1.yaml").read_text())
    with pytest.raises(SessionError) as caught:
        load_session(tmp_path / "s.yaml", ["devices.dx.hand.force={trace: push.csv}"])
    assert found in caught.value.found
    assert "increasing from 0" in caught.value.expected
