"""What a session may request from the design: orders, poles, objectives, weights, tau."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manyhands.launch.plan.loop import haptic_loop
from manyhands.launch.session import Rational, Session, SessionError, load_session
from manyhands.launch.session.matrices import is_hurwitz
from manyhands.nodes.kernel.friction_curve import FrictionCurve

from ...support.cases import cases

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"


def example(name: str, *overrides: str) -> Session:
    return load_session(SESSIONS / f"{name}.yaml", overrides)


def gain(weight: Rational, frequency: float) -> float:
    """|W(jw)| at a frequency in Hz."""
    s = 2j * math.pi * frequency
    return float(abs(np.polyval(weight.num, s) / np.polyval(weight.den, s)))


def test_what_is_left_out() -> None:
    design = example("example1").design
    assert (design.algorithm, design.objective, design.tau) == ("convex", "feasible", None)
    assert (design.order, design.poles, design.weights, design.iterations) == (None,) * 4
    assert design.W1 == design.W2 == Rational(num=(1.0,), den=(1.0,))
    assert example("example1").orders == (0, 0, 0)


@pytest.mark.parametrize(
    ("name", "coupling", "objective", "orders", "tau"),
    [
        ("example2", "spring-damper", "loop-shaping", (0, 0, 0), None),
        ("example2-linear", "linear", "loop-shaping", (4, 4, 4), None),
        ("example2-closed-loop", "spring-damper", "closed-loop", (0, 0, 0), None),
        ("example1-delayed", "spring-damper", "feasible", (0, 0, 0), 0.0003),
    ],
)
def test_the_further_examples_change_the_design_alone(
    name: str, coupling: str, objective: str, orders: tuple[int, ...], tau: float | None
) -> None:
    session, base = example(name), example("example1")
    assert (session.devices, session.couplings, session.environment, session.period) == (
        base.devices,
        base.couplings,
        base.environment,
        base.period,
    )
    design = session.design
    assert (design.coupling, design.objective, session.orders, design.tau) == (coupling, objective, orders, tau)
    if objective != "feasible":
        assert Rational(num=(1.0,), den=(1 / 125, 1.0)) == design.W1
        assert Rational(num=(1.0,), den=(1.0,)) == design.W2


def test_orders_by_coupling() -> None:
    session = example("example2-linear", "design.order={cz: 1, cx: 2, cy: 16}")
    assert session.orders == (2, 16, 1)  # in the order of the couplings
    assert example("example2-linear", "design.order={cz: 1, cx: 2, cy: 3}", "design.order.cx=7").orders == (7, 3, 1)


def test_fixed_poles() -> None:
    poles = "design.poles=[{frequency: 52.0, damping: 0.053}, {frequency: 300}]"
    session = example("example2-linear", poles)
    assert session.design.poles is not None
    assert [(pole.frequency, pole.damping) for pole in session.design.poles] == [(52.0, 0.053), (300.0, 1.0)]
    by_coupling = example("example2-linear", poles, "design.order={cx: 4, cy: 4, cz: 4}")
    assert by_coupling.design.poles == session.design.poles
    with pytest.raises(SessionError, match="4 poles, in pairs, for order 2"):
        example("example2-linear", poles, "design.order={cx: 4, cy: 2, cz: 4}")


def test_the_band_from_zero_is_a_low_pass() -> None:
    weight = example("example2", "design.weights.W1={emphasise: [0, 20]}").design.W1
    assert weight.num == (1.0,)
    np.testing.assert_allclose(weight.den, (1.0 / (40.0 * math.pi), 1.0), rtol=1e-15)
    np.testing.assert_allclose([gain(weight, f) for f in (0.0, 20.0)], [1.0, math.sqrt(0.5)], rtol=1e-12)


def test_two_band_edges_give_a_band_pass_of_unit_peak() -> None:
    weight = example("example2", "design.weights.W2={emphasise: [5, 20]}").design.W2
    edges = [gain(weight, f) for f in (5.0, 20.0)]
    np.testing.assert_allclose(edges, [math.sqrt(0.5)] * 2, rtol=1e-12)
    assert gain(weight, 10.0) == pytest.approx(1.0, rel=1e-12)
    assert max(gain(weight, f) for f in np.logspace(-2.0, 3.0, 1001)) <= 1.0 + 1e-12  # rounding of the evaluation
    assert gain(weight, 0.0) == 0.0


def test_an_override_begins_the_weights() -> None:
    overrides = ["design.objective=loop-shaping", "design.weights.W1.emphasise=[0,20]"]
    session = example("example1", *overrides)
    assert session.design.W1 == example("example2", "design.weights.W1={emphasise: [0, 20]}").design.W1
    also = example("example1", *overrides, "design.weights.W2.num=[1]", "design.weights.W2.den=[1, 1]")
    assert Rational(num=(1.0,), den=(1.0, 1.0)) == also.design.W2
    with pytest.raises(SessionError) as caught:
        example("example1", "design.weights.W1.emphasise=[0,20]")
    assert str(caught.value).startswith("--set design.weights.W1.emphasise=[0,20]: design.weights: found weights with")
    with pytest.raises(SessionError, match="design: found no 'wieghts'; expected one of coupling, objective"):
        example("example1", "design.wieghts.W1.emphasise=[0,20]")


def test_an_override_does_not_mix_the_two_forms_of_a_weight() -> None:
    with pytest.raises(SessionError, match=r"design\.weights\.W1\.emphasise: found emphasise besides num"):
        example("example2", "design.weights.W1.emphasise=[0,20]")


@pytest.mark.parametrize("den", [[1, 2, 1], [1, 3, 3, 1], [-1, -2], [0, 1, 1], [5]])
def test_stable_weights(den: list[float]) -> None:
    example("example2", f"design.weights.W1={{num: [1], den: {den}}}")


@pytest.mark.parametrize("den", [[1, 0], [1, 0, 4], [1, 1, 4, 4], [1, -2, 1], [1, 2, -1], [1, 1e-20, 1, 0]])
def test_weights_that_are_unstable_or_on_the_edge_of_it(den: list[float]) -> None:
    with pytest.raises(SessionError, match=r"design\.weights\.W1\.den: found an unstable weight"):
        example("example2", f"design.weights.W1={{num: [1], den: {den}}}")


@settings(deadline=None, max_examples=cases(50, 200))
@given(roots=st.lists(st.tuples(st.integers(-9, 4), st.integers(0, 9)), min_size=1, max_size=5), gain=st.integers(1, 9))
def test_a_polynomial_is_hurwitz_by_its_roots(roots: list[tuple[int, int]], gain: int) -> None:
    """Built exactly from its factors, s - a and (s - a)^2 + b^2, of which the real parts a are known."""
    polynomial = [-gain]
    for a, b in roots:
        factor = [1, -a] if b == 0 else [1, -2 * a, a * a + b * b]
        product = [0] * (len(polynomial) + len(factor) - 1)
        for i, p in enumerate(polynomial):
            for j, q in enumerate(factor):
                product[i + j] += p * q
        polynomial = product
    assert is_hurwitz([0, *polynomial]) == all(a < 0 for a, _ in roots)


def test_a_bands_edge_may_be_half_the_tick_rate() -> None:
    example("example2", "design.weights.W1={emphasise: [0, 500]}")
    with pytest.raises(SessionError, match="at most 250 Hz"):
        example("example2", "design.weights.W1={emphasise: [0, 500]}", "period=0.002")


def test_a_delay_to_be_measured_is_no_stated_one() -> None:
    asked = example("example1", "design.tau=auto", "design.ladder=[0.0002, 0.0006]")
    assert (asked.design.tau, asked.design.stated_tau) == ("auto", None)
    assert example("example1").design.stated_tau is None
    assert example("example1", "design.tau=0").design.stated_tau == 0.0
    assert Session.model_validate(asked.as_plain()) == asked
    with pytest.raises(SessionError, match=r"design.tau: found 'Auto'; expected .* or auto$"):
        example("example1", "design.tau=Auto")


@pytest.mark.parametrize(
    ("stated", "tau", "left"),
    [
        ("[0.0002, 0.0006]", 0.0002, (0.0006,)),
        ("[0.0002, 0.0006]", 0.0, (0.0002, 0.0006)),
        ("[0.0002, 0.0006]", 0.001, ()),
        ("[]", 0.0002, ()),
    ],
)
def test_a_measured_delay_leaves_the_longer_ones_of_the_ladder(stated: str, tau: float, left: tuple[float]) -> None:
    asked = example("example1", f"design.ladder={stated}")
    settled = asked.with_delay(tau)
    assert (settled.design.tau, settled.design.ladder) == (tau, left)
    assert Session.model_validate(settled.as_plain()) == settled
    assert asked.with_delay(tau).ports == asked.ports
    assert example("example1").with_delay(tau).design.ladder is None


def test_tau_may_be_a_whole_period() -> None:
    assert example("example1", "design.tau=0.001").design.tau == 0.001
    with pytest.raises(SessionError, match="at most the period"):
        example("example1", "design.tau=0.001", "period=0.0005")


def test_a_period_may_be_longer_by_up_to_the_whole() -> None:
    assert example("example1").design.period_tolerance == 0.0
    assert example("example1", "design.period_tolerance=1").design.period_tolerance == 1.0
    for value in ("-0.1", "1.01", ".nan", "often"):
        with pytest.raises(SessionError, match=r"design\.period_tolerance: found .*; expected .*a part of the period"):
            example("example1", f"design.period_tolerance={value}")


def test_the_level_of_a_given_coupling_may_be_asked_for() -> None:
    given = ["design.coupling=given", "design.stiffness=704.9", "design.damping=0.0372"]
    design = example("example2", *given).design
    assert (design.coupling, design.objective, design.wanted) == ("given", "loop-shaping", False)


def test_the_papers_algorithm_with_a_cap() -> None:
    design = example("example1", "design.algorithm=complementarity", "design.iterations=20").design
    assert (design.algorithm, design.iterations, design.wanted) == ("complementarity", 20, True)
    linear = example("example1", "design={coupling: linear, order: 2, algorithm: complementarity}")
    assert (linear.design.wanted, linear.orders) == (True, (2, 2, 2))


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["design.speed=0.1"], "design.speed: found 0.1 without any friction; expected the friction of a device"),
        (
            ["design.speed=0.1", "devices.dx.friction={least: 1}", "couplings.cx.wave_link={b: 10}"],
            "design.speed: found 0.1 with the wave link of 'cx'; expected no wave link, or no speed",
        ),
        (["design.speed=0", "devices.dx.friction={least: 1}"], "design.speed: found 0; expected a speed in m/s"),
    ],
)
def test_a_speed_needs_friction_and_no_wave_link(overrides: list[str], words: str) -> None:
    with pytest.raises(SessionError, match=words.replace("(", r"\(")):
        example("example1", *overrides)


def test_friction_is_stated_by_axis_and_is_written_as_it_is_read() -> None:
    session = example("example1", "devices.dx.friction={least: 0.5}", "devices.dx.step=1e-5", "design.speed=0.1")
    device = session.devices["dx"]
    assert device.friction is not None
    assert (device.friction.least, device.step, session.design.speed) == ((0.5,), (1e-5,), 0.1)
    assert session.as_plain()["devices"]["dx"]["friction"] == {"least": [0.5]}
    assert Session.model_validate(session.as_plain()).devices["dx"].friction == device.friction


def test_what_a_simulated_device_burns_beyond_its_least_is_no_claim() -> None:
    """The certificate is the one of the least alone, and the bundle has the curve."""
    curve = "{least: 0.5, most: 0.7, pitch: 0.004, static: 0.9, stribeck: 0.01}"
    plain, curved = (
        example("example1", f"devices.dx.friction={stated}", "design.speed=0.1") for stated in ("{least: 0.5}", curve)
    )
    for one in (plain, curved):
        assert haptic_loop(one).devices[0].friction == (0.5,)
    friction = curved.devices["dx"].friction
    assert friction is not None
    assert friction.simulated == FrictionCurve((0.5,), (0.7,), (0.004,), (0.9,), (0.01,))
    assert Session.model_validate(curved.as_plain()).devices["dx"].friction == friction


@pytest.mark.parametrize(
    ("friction", "words"),
    [
        ("{least: 0.5, static: 0.9}", "static: found static alone; expected stribeck as well, or no static"),
        ("{least: 0.5, pitch: 0.004}", "pitch: found pitch alone; expected most as well, or no pitch"),
        ("{least: 0.5, most: 0.4, pitch: 0.004}", "most: found 0.4 N; expected at least the least friction, 0.5 N"),
        ("{least: 0.5, static: 0.4, stribeck: 1}", "static: found 0.4 N; expected at least the least friction"),
        ("{least: 0.5, static: 0.9, stribeck: 0}", "stribeck: found 0; expected a speed in m/s"),
        ("{least: 0.5, slip: 0.9}", "friction.slip: found the unknown key 'slip'; expected one of least, most"),
    ],
)
def test_a_friction_that_does_not_fit_together_is_refused(friction: str, words: str) -> None:
    with pytest.raises(SessionError, match=re.escape(words)):
        example("example1", f"devices.dx.friction={friction}")


@pytest.mark.parametrize("key", ["step=1e-5", "friction={least: 1}"])
def test_a_pointer_has_neither_encoder_nor_friction(key: str) -> None:
    name = next(iter(example("browser").devices))
    with pytest.raises(SessionError, match="with 'driver: browser'; expected driver: simulated"):
        example("browser", f"devices.{name}.{key}")
