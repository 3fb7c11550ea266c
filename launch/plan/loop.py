"""From a session to the types of ``design``: the loop, and what is asked of its coupling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from manyhands.design.levels.orientation import OrientationLevel
from manyhands.design.models.axis import AxisKind
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    MOST_ITERATIONS,
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    PolePair,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.series import counted_parts
from manyhands.launch.session import Session
from manyhands.launch.session.design import AUTO
from manyhands.launch.session.matrices import stated_system


class NotCertified(Exception):
    """A run was refused because its session is not certified; the text states the reason and a remedy.

    Example:
        >>> import manyhands as mh
        >>> try:
        ...     mh.run("example1-uncoupled", 1.0, clock="simulated")
        ... except mh.NotCertified as error:
        ...     print(str(error)[:42])
        example-1-uncoupled is not certified: ther
    """


def haptic_loop(session: Session) -> HapticLoop:
    """The loop: ports, levels, block structure and environment, all in the session's order.

    A session that states no delay is designed for none, as in [Bianchini2010]_. One that asks for a measured delay gets
    it by :meth:`Session.with_delay` before it comes here.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    tau = stated_delay(session)
    index = {port: i for i, port in enumerate(session.ports)}
    loop = HapticLoop(
        session=session.name,
        period=session.period,
        ports=session.ports,
        devices=tuple(
            device_level(session, name, tuple(index[p] for p in session.ports_of(name)), tau)
            for name in session.devices
        ),
        partition=Partition(
            tuple(session.couplings), tuple(tuple(index[p] for p in block) for block in session.blocks)
        ),
        environment=session.environment.for_design(session.ports),
        tau=tau,
        period_tolerance=session.period_tolerance,
        speed=session.design.speed,
    )
    most = session.design.counted
    return loop if most is None else replace(loop, series=counted_parts(loop, most))


def device_level(session: Session, name: str, ports: tuple[int, ...], tau: float = 0.0) -> DeviceLevel:
    """What a device promises and states of its mechanism, at these places in a loop's ports, up to the delay tau, s."""
    device = session.devices[name]
    step = device.step if device.step is not None and any(device.step) else None
    friction = None if device.friction is None else device.friction.least
    turning = tuple(port for port, kind in zip(ports, device.kinds, strict=True) if kind is AxisKind.ROTATION) or None
    orientation = None
    if device.orientation is not None:
        k = session.orientation_stiffness(name, tau, session.period_tolerance)
        held = device.held_torque if device.twists else None
        orientation = OrientationLevel(device.orientation.osp, k, held)  # no osp where it is sensed
    return DeviceLevel(name, ports, session.osp_level(name), device.held_torque, step, friction, turning, orientation)


def stated_delay(session: Session) -> float:
    """The delay inside the tick that the session is designed for, s.

    Where the session states none, it is what its devices state of themselves: the age of their samples and the delay of
    their forces, and 0 without either. Where it states one, it is at least that.

    Raises:
        NotCertified: the delay is to be measured, and has not been.
    """
    if session.design.tau == AUTO:
        raise NotCertified(
            f"{session.name}: design.tau: found {AUTO}, and no measurement; expected a delay in s, or a command that "
            "measures it (launch, design)"
        )
    return session.latency if session.design.stated_tau is None else session.design.stated_tau


def coupling_request(session: Session) -> CouplingRequest:
    """What the session's ``design:`` asks for."""
    design = session.design
    if design.coupling == "none":
        return NoCoupling()
    aim = _aim(session)
    if design.coupling == "given":
        if design.matrices is not None:
            given = design.matrices
            blocks = tuple(
                stated_system(given[name], f"coupling {name}", continuous=False) for name in session.couplings
            )
            return LinearGiven(blocks, aim)
        stiffness, damping = session.given_stiffness, session.given_damping
        if stiffness is None or damping is None:
            raise AssertionError("a validated session gives stiffness and damping, or matrices")
        return SpringDamperGiven(SpringDamper(stiffness, damping), aim)
    wish = Wish(design.objective, aim, design.algorithm, design.iterations or MOST_ITERATIONS)
    if design.coupling == "spring-damper":
        return SpringDamperWanted(wish)
    orders = tuple(design.order_of(name) for name in session.couplings)
    poles = None if design.poles is None else tuple(PolePair(pole.frequency, pole.damping) for pole in design.poles)
    return LinearWanted(orders, wish, poles)


def _aim(session: Session) -> Transparency | None:
    """The transparency problem, its weights discretised by backward Euler."""
    design, T = session.design, session.period
    if design.objective not in ("loop-shaping", "closed-loop"):
        return None
    W1, W2 = (Filter.from_continuous(W.num, W.den, T) for W in (design.W1, design.W2))
    return Transparency(design.objective, W1, W2)


Progress = Callable[[str], None]
