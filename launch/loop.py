"""From a session to the haptic loop that design knows, and to what is asked of its coupling."""

from __future__ import annotations

from manyhands.design.coupling import SpringDamper
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.environment import (
    DelayedNetwork,
    Environment,
    NetworkBox,
    StateSpaceEnvironment,
    TransferEnvironment,
)
from manyhands.design.errors import Infeasible
from manyhands.design.network import Link, Network
from manyhands.design.partition import Partition
from manyhands.design.problem import (
    MOST_ITERATIONS,
    CouplingRequest,
    DeviceLevel,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    NoCoupling,
    Pole,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.statespace import StateSpace
from manyhands.design.weighted_loop import Transparency
from manyhands.design.weights import Filter
from manyhands.launch.session import BlockMatrices, PythonEnvironment, Session
from manyhands.launch.session.environment import NetworkEnvironment
from manyhands.launch.session.environment import StateSpaceEnvironment as GivenMatrices
from manyhands.launch.session.interval import Interval


def haptic_loop(session: Session) -> HapticLoop:
    """The loop: ports, levels, block structure and environment, all in the session's order."""
    index = {port: i for i, port in enumerate(session.ports)}
    return HapticLoop(
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
        environment=_environment(session),
        tau=session.design.tau,
    )


def _environment(session: Session) -> Environment:
    """The environment as design knows it."""
    given, ports = session.environment, session.ports
    if isinstance(given, PythonEnvironment):
        return DeclaredEnvironment(ports, given.level_matrix(len(ports)), given.enforce)
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
    """The matrices, with D as stated or from the static gain that is stated in its place.

    Raises:
        Infeasible: a static gain is stated, and a pole at s = 0 or z = 1 leaves none.
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
        tuple(Link(link.between, end(link.stiffness), end(link.damping)) for link in given.links),
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
    poles = None if design.poles is None else tuple(Pole(pole.frequency, pole.damping) for pole in design.poles)
    return LinearWanted(orders, wish, poles)


def _aim(session: Session) -> Transparency | None:
    """The transparency problem, its weights discretised by backward Euler."""
    design, T = session.design, session.period
    if design.objective not in ("loop-shaping", "closed-loop"):
        return None
    W1, W2 = (Filter.from_continuous(W.num, W.den, T) for W in (design.W1, design.W2))
    return Transparency(design.objective, W1, W2)
