"""What encoder steps add to the forces: the bound is true and tight, proved, and dry friction of its size is enough."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import Certificate, content, differences, from_content, identity
from manyhands.design.errors import Infeasible
from manyhands.design.ladder import automatic_delays, design_ladder
from manyhands.design.levels.encoder import EncoderClaim
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.declared import DeclaredEnvironment
from manyhands.design.models.environment import (
    DelayedNetwork,
    NetworkBox,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.models.kind import Environment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.peak_gain import peak_gain
from manyhands.design.problem import (
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof import Finding, ProofInputError, prove
from manyhands.design.proof.ladder import prove_ladder
from manyhands.design.proof.quantisation import BOUNDED, MEASURED
from manyhands.design.quantisation import closed, steps
from manyhands.design.synthesis import design

from ..support.quantised import Hands, most_given

T = 1e-3
Q = 2e-5
COVERED = "dry friction covers what encoder steps add: c >= w at every port"
FREE = 1e3  # N: more than any step adds

two = Network(
    ("a", "b"),
    (("body", 0.3),),
    (
        NetworkLink(("a", "body"), 2000.0, 1.0),
        NetworkLink(("b", "body"), 500.0, 2.0),
        NetworkLink(("body", GROUND), 300.0, 4.0),
    ),
)
one = Network(
    ("a",), (("body", 0.3),), (NetworkLink(("a", "body"), 700.0, 1.0), NetworkLink(("body", GROUND), 200.0, 0.6))
)
wall = Network(("a",), (), (NetworkLink(("a", GROUND), 3000.0, 0.0),))


def loop(
    world: Environment, step: tuple[float, ...] = (Q, Q), friction: tuple[float, ...] = (FREE, FREE), tau: float = 0.0
) -> HapticLoop:
    """One-axis devices of 1 N*s/m, each with a coupling of its own."""
    devices = tuple(
        DeviceLevel(
            port, (i,), np.eye(1), None, (step[i],) if step[i] else None, (friction[i],) if friction[i] else None
        )
        for i, port in enumerate(world.ports)
    )
    m = len(world.ports)
    return HapticLoop("s", T, world.ports, devices, Partition(world.ports, tuple((i,) for i in range(m))), world, tau)


def springs(m: int, K: float = 1000.0, B: float = 0.0) -> CouplingRequest:
    return SpringDamperGiven(SpringDamper(K * np.eye(m), B * np.eye(m)))


def certified(world: Environment, *args: Any, tau: float = 0.0, **keys: Any) -> Certificate:
    return design(loop(world, *args, tau=tau, **keys), springs(len(world.ports), 300.0 if tau else 1000.0)).certificate


def force(certificate: Certificate) -> np.ndarray:
    assert certificate.encoder is not None
    assert certificate.encoder.force is not None
    return np.array(certificate.encoder.force)


def findings(data: dict[str, Any]) -> dict[str, Finding]:
    """Of data whose id is made anew."""
    return {finding.condition: finding for finding in prove({**data, "id": identity(data)})}


def plain(certificate: Certificate) -> dict[str, Any]:
    return copy.deepcopy(content(certificate))


def test_a_single_spring_needs_half_a_step_of_its_force() -> None:
    found = certified(wall, (Q,), (1.0,))
    K = 1.0 / (1.0 / 1000.0 + 1.0 / 3000.0)
    assert force(found) == pytest.approx([K * Q / 2.0], rel=2e-6)
    assert found.encoder is not None
    assert found.encoder.covered


def test_hands_find_energy_in_a_single_spring_exactly_where_its_friction_is_less() -> None:
    found, hands = certified(wall, (Q,), (1.0,)), Hands(ticks=1500)
    w = force(found)
    assert most_given(found, w, hands) == 0.0
    assert most_given(found, w / 1.5, hands) > 0.0


@pytest.mark.parametrize("tau", [0.0, T])
def test_no_hand_finds_energy_where_friction_covers_the_steps(tau: float) -> None:
    found = certified(two, tau=tau)
    assert most_given(found, force(found), Hands()) == 0.0


WORLDS: dict[str, Environment] = {
    "network": two,
    "late": DelayedNetwork(Network(("a",), (), (NetworkLink(("a", GROUND), 100.0, 0.05),)), 2),
    "matrices": StateSpaceEnvironment(one.ports, one.environment(T)),
    "rational": TransferEnvironment(("a",), ((((10.0, 800.0), (0.01, 1.0)),),), "backward-euler"),
}


@pytest.mark.parametrize("name", WORLDS)
def test_the_bound_is_reached_by_the_worst_rounding_and_proved(name: str) -> None:
    world = WORLDS[name]
    found = design(loop(world), SpringDamperWanted()).certificate
    w, Y = force(found), closed(found.loop.partition.join(found.blocks), world.environment(T))
    h, state = [Y.D], Y.B
    for _ in range(20_000):
        h.append(Y.C @ state)
        state = Y.A @ state
    worst = np.sum(np.abs(np.array(h)), axis=0) @ (steps(found.loop) / 2.0)  # each delta has the sign of its response
    np.testing.assert_allclose(w, worst, rtol=1e-5)
    assert np.all(w >= worst)
    of_proof = findings(plain(found))
    assert of_proof[BOUNDED].holds
    assert of_proof[COVERED].holds


def test_a_world_counted_in_series_is_bounded_with_its_coupling_as_it_is_run() -> None:
    counting = replace(loop(wall, (Q,), (1.0,)), series=(0.5,))
    found = design(counting, SpringDamperWanted()).certificate
    assert findings(plain(found))[BOUNDED].holds
    K = found.spring_damper
    assert K is not None
    assert force(found)[0] >= Q / 2.0 / (1.0 / K.stiffness[0, 0] + 0.5 / 3000.0)


def test_a_step_at_one_port_reaches_the_other_and_needs_friction_there() -> None:
    both, first = certified(two), certified(two, (Q, 0.0))
    w, of_first = force(both), force(first)
    assert np.all(of_first > 0.0)
    of_second = force(certified(two, (0.0, Q)))
    np.testing.assert_allclose(of_first + of_second, w, rtol=1e-5)
    lacking = certified(two, (Q, 0.0), (FREE, 0.0))
    assert lacking.encoder == EncoderClaim(first.encoder.force if first.encoder else None, False)
    assert findings(plain(lacking))[MEASURED].assumed


def test_a_force_that_is_too_small_is_refuted() -> None:
    data = plain(certified(two))
    data["encoder"]["force"][1] *= 1.0 - 3e-6
    assert not findings(data)[BOUNDED].holds
    alone = plain(certified(two, (Q, 0.0)))  # the force of one port's own step in place of both
    data = plain(certified(two))
    data["encoder"]["force"] = alone["encoder"]["force"]
    assert not findings(data)[BOUNDED].holds


def test_cover_is_claimed_only_with_the_friction_and_the_bound() -> None:
    data = plain(certified(two))
    w = data["encoder"]["force"]
    data["devices"]["b"]["friction"] = [w[1] * (1.0 - 1e-9)]
    assert not findings(data)[COVERED].holds
    data["devices"]["b"]["friction"] = [w[1]]
    assert findings(data)[COVERED].holds
    data["encoder"]["force"] = None
    assert not findings(data)[COVERED].holds


def test_no_certificate_is_silent_about_a_step() -> None:
    data = plain(certified(two))
    claim = data.pop("encoder")
    assert not all(finding.holds for finding in findings(data).values())
    data = plain(certified(two))
    for device in data["devices"].values():
        del device["step"]
    assert not all(finding.holds for finding in findings(data).values())
    bare = {**plain(design(loop(two, (0.0, 0.0), (0.0, 0.0)), springs(2)).certificate), "encoder": claim}
    with pytest.raises(ProofInputError, match="encoder: expected it in version 6 alone"):
        findings(bare)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": [-Q]}, r"devices\.a\.step: .* expected numbers of 0 or more"),
        ({"step": [0.0]}, r"devices\.a\.step: .* one greater than 0"),
        ({"friction": [1.0, 1.0]}, r"devices\.a\.friction: found 2 entries; expected 1"),
        ({"friction": "much"}, r"devices\.a\.friction"),
    ],
)
def test_hostile_numbers_are_refused_by_proof_and_reader(change: dict[str, Any], message: str) -> None:
    data = plain(certified(two))
    data["devices"]["a"] |= change
    with pytest.raises(ProofInputError, match=message):
        findings(data)
    with pytest.raises((ValueError, TypeError)):
        from_content({**data, "id": ""})


NOT_LINEAR: dict[str, tuple[Environment, str]] = {
    "intervals": (NetworkBox(wall, replace(wall, links=(NetworkLink(("a", GROUND), 4000.0, 0.0),))), "intervals"),
    "declared": (DeclaredEnvironment(("a",), np.zeros((1, 1))), "level"),
}


@pytest.mark.parametrize("name", NOT_LINEAR)
def test_a_world_that_is_no_one_linear_system_is_named_and_not_covered(name: str) -> None:
    world, word = NOT_LINEAR[name]
    found = design(loop(world, (Q,), (1.0,)), springs(1)).certificate
    assert found.encoder == EncoderClaim(None, False)
    finding = findings(plain(found))[MEASURED]
    assert finding.holds
    assert finding.assumed
    assert word in finding.argument
    data = plain(found)
    data["encoder"] = {"force": [1.0], "covered": True}
    assert not findings(data)[BOUNDED].holds


def test_responses_that_hardly_decay_are_not_bounded() -> None:
    adrift = Network(
        ("a",), (("far", 1e4),), (NetworkLink(("a", "far"), 1.0, 1e-6), NetworkLink(("far", GROUND), 1.0, 0.0))
    )
    found = design(loop(adrift, (Q,), (1.0,)), springs(1)).certificate
    assert found.encoder == EncoderClaim(None, False)
    data = plain(found)
    data["encoder"] = {"force": [1e3], "covered": False}  # far more than what the prover would sum in its time
    refused = findings(data)[BOUNDED]
    assert not refused.holds
    assert "not proved to decay" in refused.argument


def test_covered_steps_have_no_rungs() -> None:
    found = certified(two)
    ladder, notes = design_ladder(found, springs(2), automatic_delays(found.loop))
    assert ladder is None
    assert "dry friction" in notes[0]
    rungs = [plain(found), plain(certified(two, tau=T))]
    assert not prove_ladder([{**data, "id": identity(data)} for data in rungs], 0).one_loop.holds
    exact = certified(two, friction=(0.0, 0.0))
    assert design_ladder(exact, springs(2), (T / 2.0,)).ladder is not None


def test_the_claim_is_read_back_and_compared() -> None:
    found = certified(two, (Q, 0.0))
    assert found.version == 6
    again = from_content({**content(found), "id": found.id})
    assert (again.encoder, again.loop.devices[0].step, again.loop.devices[1].friction) == (found.encoder, (Q,), (FREE,))
    assert not differences(again, found.loop, springs(2))
    for other in (loop(two, (2 * Q, 0.0)), loop(two, (Q, 0.0), (FREE, 2 * FREE))):
        (text,) = differences(again, other, springs(2))
        assert text == "the encoder steps or friction differs"


def test_a_device_states_one_number_for_each_axis() -> None:
    for step in ((Q, Q), (-Q,), (0.0,), (float("nan"),)):
        with pytest.raises(ValueError, match="step: found"):
            DeviceLevel("a", (0,), np.eye(1), None, step)


def test_the_closed_loop_is_that_of_its_parts() -> None:
    V, E = SpringDamper(np.eye(2) * 500.0, np.eye(2)).realisation(T), two.environment(T)
    for z in (1.0, -1.0, np.exp(0.3j)):
        of_parts = E.response(z) @ np.linalg.inv(np.eye(2) + V.response(z) @ E.response(z))
        np.testing.assert_allclose(closed(V, E).response(z), of_parts, rtol=1e-8, atol=1e-6)
    assert isinstance(closed(V, E), StateSpace)


# --- dry friction as damping below a speed


def below(speed: float, step: float = 0.0, friction: float = 0.1, tau: float = 0.0) -> HapticLoop:
    """A spring at a wall, with a device of 0.1 N*s/m."""
    one_axis = DeviceLevel("a", (0,), np.array([[0.1]]), None, (step,) if step else None, (friction,))
    stiff = Network(("a",), (), (NetworkLink(("a", GROUND), 1e5, 0.0),))
    return HapticLoop("s", T, ("a",), (one_axis,), Partition(("a",), ((0,),)), stiff, tau, speed=speed)


def level(certificate: Certificate) -> float:
    return float(certificate.levels.Delta_D[0][0, 0])


def test_friction_counts_as_a_damping_below_the_speed() -> None:
    """1000 N/m at T = tau = 1 ms needs 2 N*s/m: 0.1 of the device, and 1.9 of 0.1 N below 53 mm/s."""
    found = design(below(0.0525, tau=T), springs(1, 990.0)).certificate
    assert level(found) == pytest.approx(0.1 + 0.1 / 0.0525, rel=1e-9)
    assert found.encoder is None
    with pytest.raises(Infeasible):
        design(below(0.0535, tau=T), springs(1, 990.0))


@pytest.mark.parametrize("tau", [0.0, T])
def test_hands_find_no_energy_below_the_speed_and_some_beyond_it(tau: float) -> None:
    speed, step = 0.05, 1e-5
    found = design(below(speed, step, tau=tau), SpringDamperWanted(Wish("stiffest"))).certificate
    hands = Hands(ticks=600)
    assert most_given(found, np.array([0.1]), hands, speed) == 0.0
    assert most_given(found, np.array([0.1]), hands, 40.0 * speed) > 0.0


def test_what_the_steps_take_of_the_friction_is_no_damping() -> None:
    without, taking = (design(below(0.05, step), SpringDamperWanted()).certificate for step in (0.0, 4e-5))
    w = force(taking)[0]
    assert level(without) == pytest.approx(0.1 + 0.1 / 0.05)
    assert level(taking) == pytest.approx(0.1 + (0.1 - w) / 0.05)
    assert findings(plain(taking))[BOUNDED].holds
    V, E = taking.loop.partition.join(taking.blocks), taking.loop.environment.environment(T)
    own = peak_gain(closed(V, E))[0, 0] * 4e-5 / 2.0
    assert own <= w <= 1.15 * own  # not much more is kept than the coupling asks for


def test_a_given_coupling_keeps_what_its_steps_add() -> None:
    found = design(below(0.05, 4e-5), springs(1, 1000.0)).certificate
    assert force(found)[0] == pytest.approx(1000.0 / 1.01 * 2e-5 * 1.02, rel=1e-5)


def test_friction_that_the_steps_use_up_is_refused() -> None:
    with pytest.raises(Infeasible, match=r"a: its dry friction of 1 mN does not cover what the steps of encoders add"):
        design(below(0.05, 4e-5, friction=1e-3), springs(1, 150.0))
    intervals = replace(below(0.05, 4e-5), environment=NOT_LINEAR["intervals"][0])
    with pytest.raises(Infeasible, match="is not known: the world is known up to intervals"):
        design(intervals, SpringDamperWanted())


def test_without_steps_friction_pays_in_any_world() -> None:
    for world, _ in NOT_LINEAR.values():
        found = design(replace(below(0.05), environment=world), SpringDamperWanted()).certificate
        assert level(found) == pytest.approx(2.1)


def test_the_prover_takes_no_more_than_the_friction_that_is_left() -> None:
    data = plain(design(below(0.05, 4e-5), SpringDamperWanted()).certificate)
    assert all(finding.holds for finding in findings(data).values())
    slower = [finding for finding in findings(data).values() if finding.assumed]
    assert [finding.condition for finding in slower] == ["every axis is slower than 0.05 m/s"]
    for change in (
        {"speed": data["speed"] * (1.0 + 1e-9)},
        {"speed": 0.0},
        {"speed": -1.0},
        {"encoder": {"force": [data["encoder"]["force"][0] + 1e-9], "covered": True}},
        {"encoder": {"force": data["encoder"]["force"], "covered": False}},
        {"encoder": {"force": None, "covered": False}},
    ):
        assert not all(finding.holds for finding in findings({**data, **change}).values())
    held = copy.deepcopy(data)
    held["devices"]["a"]["friction"] = [0.1 - 1e-9]
    assert not all(finding.holds for finding in findings(held).values())
    del held["devices"]["a"]["friction"]
    assert not all(finding.holds for finding in findings(held).values())
    silent = {key: value for key, value in data.items() if key != "speed"}
    assert not all(finding.holds for finding in findings(silent).values())


def test_the_speed_is_read_back_compared_and_in_version_6_alone() -> None:
    loop_below = below(0.05, 4e-5)
    found = design(loop_below, SpringDamperWanted()).certificate
    again = from_content({**content(found), "id": found.id})
    assert (again.loop.speed, again.loop.kept) == (0.05, tuple(force(found)))
    assert content(again) == content(found)
    assert not differences(again, loop_below, SpringDamperWanted())
    (text,) = differences(again, replace(loop_below, speed=0.1), SpringDamperWanted())
    assert text == "the speed below which it holds differs: the certificate has 0.05, the session 0.1"
    assert "below 0.05 m/s" in repr(found)
    bare = {**plain(design(loop(wall, (0.0,), (0.0,)), springs(1)).certificate), "speed": 0.05}
    with pytest.raises(ProofInputError, match="speed: expected it in version 6 alone"):
        findings(bare)
    for speed, kept in ((0.0, None), (float("inf"), None), (0.1, (1.0, 1.0)), (0.1, (-1.0,))):
        with pytest.raises(ValueError, match="found"):
            replace(loop_below, speed=speed, kept=kept)


def test_held_torques_and_friction_add_up() -> None:
    held = HeldTorque(5.0, 3.0, 1.0)
    both = below(0.05)
    both = replace(both, devices=(replace(both.devices[0], level=np.eye(1), held=held),))
    found = design(both, SpringDamperWanted()).certificate
    assert level(found) == pytest.approx(1.0 + 0.1 / 0.05 - held.damping(T, 0.0, 0.0))
    assert all(finding.holds for finding in findings(plain(found)).values())
