"""From a session to the types of ``design``: the loop, and what is asked of its coupling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from manyhands.design.errors import Infeasible
from manyhands.design.models.coupling import Partition, SpringDamper
from manyhands.design.models.environment import (
    DeclaredEnvironment,
    DeclaredScene,
    DelayedNetwork,
    Environment,
    NetworkBox,
    ProxyEnvironment,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.models.network import Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
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
from manyhands.launch.session import AskedEnvironment, BlockMatrices, Session
from manyhands.launch.session.design import AUTO
from manyhands.launch.session.environment import NetworkEnvironment
from manyhands.launch.session.environment import StateSpaceEnvironment as GivenMatrices
from manyhands.launch.session.fields import Interval
from manyhands.launch.session.scene import SceneEnvironment


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
            DeviceLevel(name, tuple(index[p] for p in session.ports_of(name)), session.osp_level(name))
            for name in session.devices
        ),
        partition=Partition(
            tuple(session.couplings), tuple(tuple(index[p] for p in block) for block in session.blocks)
        ),
        environment=session_environment(session),
        tau=tau,
        period_tolerance=session.period_tolerance,
    )
    most = session.design.counted
    return loop if most is None else replace(loop, series=counted_parts(loop, most))


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


def session_environment(session: Session) -> Environment:
    """The environment as one of the types of ``design``."""
    given, ports = session.environment, session.ports
    if isinstance(given, SceneEnvironment):
        return DeclaredScene(given.scene(ports))
    if isinstance(given, AskedEnvironment):
        level, stiffness = given.level_matrix(len(ports)), given.stiffness_matrix(len(ports))
        if stiffness is not None:
            return ProxyEnvironment(ports, level, stiffness, given.content(ports), given.tank)
        return DeclaredEnvironment(ports, level, given.enforce)
    if isinstance(given, NetworkEnvironment):
        low = _network(given, ports, high=False)
        if given.uncertain:
            return NetworkBox(low, _network(given, ports, high=True))
        return DelayedNetwork(low, given.delay) if given.delay else low
    if isinstance(given, GivenMatrices):
        system = _system(given, "the environment", continuous=given.time == "continuous")
        return StateSpaceEnvironment(ports, system, given.method, given.delay)
    entries = tuple(tuple((entry.num, entry.den) for entry in row) for row in given.entries)
    return TransferEnvironment(ports, entries, given.method, given.delay)


def _system(given: GivenMatrices | BlockMatrices, what: str, *, continuous: bool) -> StateSpace:
    """The matrices, with D as stated, or computed from the static gain that is stated in its place.

    Raises:
        Infeasible: a static gain is stated, but a pole at s = 0 or z = 1 permits none.
    """
    A, B, C, last = given.arrays()
    if given.static is None:
        return StateSpace(A, B, C, last)
    try:
        return StateSpace.with_static_gain(A, B, C, last, continuous=continuous)
    except ValueError as error:
        raise Infeasible(f"{what}: {error}", ("state D instead", "give every mode a spring that holds it")) from error


def _network(given: NetworkEnvironment, ports: tuple[str, ...], high: bool) -> Network:
    """The network with every interval at one of its ends."""

    def end(value: float | Interval) -> float:
        interval = Interval.of(value)
        return interval.high if high else interval.low

    return Network(
        ports,
        tuple((name, end(mass)) for name, mass in given.masses.items()),
        tuple(NetworkLink(link.between, end(link.stiffness), end(link.damping)) for link in given.links),
    )


def coupling_request(session: Session) -> CouplingRequest:
    """What the session's ``design:`` asks for."""
    design = session.design
    if design.coupling == "none":
        return NoCoupling()
    aim = _aim(session)
    if design.coupling == "given":
        if design.matrices is not None:
            given = design.matrices
            blocks = tuple(_system(given[name], f"coupling {name}", continuous=False) for name in session.couplings)
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
