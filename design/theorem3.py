"""Theorem 3 of [Bianchini2010]_: is the loop stable with a *given* coupling?

Each party's level is found by the cheapest exact way that there is, and the parties are independent but for one number:

- the device: what a delay inside the tick leaves of Delta_D (:mod:`manyhands.design.delay`);
- each block of V: springs and dampers have a greatest level in closed form (:mod:`manyhands.design.spring_damper`), a
  linear block on one port has one too, found by a small program; a linear block on several ports has many that are not
  comparable, and the joint program (:mod:`manyhands.design.theorem3_program`) chooses among them;
- the environment: the level that leaves (10) the greatest margin (:mod:`manyhands.design.environment_level`) and its
  storage function from one Riccati equation; or, for large networks and for networks known up to intervals, its
  mechanical energy, which needs no matrix (:mod:`manyhands.design.physical`).

What comes out is a claim: :mod:`manyhands.design.proof` proves it, by other means.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Literal

import numpy as np

from manyhands.design.contract import ENERGY, ENFORCED, DeviceShare, Levels, margin
from manyhands.design.coupling import CouplingBlock, SpringDamper, realisations
from manyhands.design.declared import DeclaredEnvironment
from manyhands.design.delay import device_share, least_gain
from manyhands.design.environment import NetworkBox
from manyhands.design.errors import Infeasible, SolverFailure
from manyhands.design.necessary import check_block, check_spring_damper
from manyhands.design.physical import physical_level
from manyhands.design.problem import HapticLoop
from manyhands.design.riccati import level_and_storage
from manyhands.design.spring_damper import greatest_level
from manyhands.design.statespace import Matrix, StateSpace, symmetric_part
from manyhands.design.theorem3_program import GREATEST_LEVELS, RELAX, BlockLevel, block_level, joint_levels

Progress = Callable[[str], None]

MOST_SEARCHED = 250  # order of Rest above which a passive network is proved by its energy instead of a matrix
MOST_JOINT = (
    48  # ports and states of Rest up to which the joint program is solved; its cost grows with the fourth power
)
_GIVEN_UP = 1e-9  # of a level in closed form, so that it holds in exact arithmetic: far above rounding
# (2 kappa - 1 - 3 tau/T) T/tau; the share is greatest at 2
_GAINS = (0.02, 0.05, 0.1, 0.2, 0.35, 0.6, 1.0, 1.5, 2.0, 3.0)


def certify_given(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    progress: Progress | None = None,
    hint: DeviceShare | None = None,
    known: tuple[BlockLevel, ...] = (),
) -> Levels:
    """Find levels that prove the loop stable with this coupling.

    Args:
        loop: the haptic loop.
        coupling: V's blocks in the partition's order, springs and dampers or linear; ports in the block's order.
        progress: told what is being done.
        hint: a gain kappa to be tried first, that the coupling was made for.
        known: levels of the blocks at that gain which its synthesis has proved already; used where the search for
            greater ones fails, or finds none that (10) holds with.

    Returns:
        The levels with the greatest margin of (10) that was found; exact but for rounding and small reserves, save for
        linear blocks of several ports in large sessions, and for environments proved by their energy.

    Raises:
        Infeasible: no levels exist; the coupling is not certified.
        SolverFailure: a solver gave no usable answer.
    """
    blocks = realisations(coupling, loop.period)
    best: Levels | None = None
    greatest = 0.0
    first: Infeasible | SolverFailure | None = None
    for most in _caps(coupling):
        for device in dict.fromkeys((*((hint,) if hint is not None else ()), *devices(loop))):
            try:
                found = _levels(loop, device, _promises(loop, coupling, blocks, device, most), progress)
            except (Infeasible, SolverFailure) as error:
                first = first or error
                continue
            reached = margin(loop.partition, found)
            if best is None or reached > greatest:
                best, greatest = found, reached
        if best is not None:
            return best
    if hint is not None and known:
        with suppress(Infeasible, SolverFailure):  # the first failure says more: it is about the greatest levels
            return _levels(loop, hint, known, progress)
    raise first or Infeasible("no levels satisfy Theorem 3 with this coupling", RELAX)


def certify_beside(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    environment: Levels,
    hint: DeviceShare | None = None,
) -> Levels:
    """Find levels beside an environment's level that is known already: no delay inside the tick changes it.

    Args:
        loop: the haptic loop.
        coupling: V's blocks, as for :func:`certify_given`.
        environment: whose Phi_E and storage are taken; proved for the same environment and period.
        hint: a gain kappa to be tried first.

    Returns:
        The levels at the first gain at which (10) holds, the greatest share first: the quickest, not the best.

    Raises:
        Infeasible: there is no such gain.
        SolverFailure: a solver gave no usable answer.
    """
    blocks = realisations(coupling, loop.period)
    first: Infeasible | SolverFailure | None = None
    for most in _caps(coupling):
        for device in dict.fromkeys((*((hint,) if hint is not None else ()), *devices(loop))):
            try:
                own = _promises(loop, coupling, blocks, device, most)
            except (Infeasible, SolverFailure) as error:
                first = first or error
                continue
            Delta_V, P_V = tuple(level.Delta for level in own), tuple(level.P for level in own)
            found = Levels(device, loop.Delta_D_blocks, Delta_V, environment.Phi_E, environment.P_E, P_V)
            if margin(loop.partition, found) > 0.0:
                return found
    raise first or Infeasible("condition (10) fails beside the environment's level", RELAX)


def _caps(coupling: tuple[CouplingBlock, ...]) -> tuple[float, ...]:
    """The caps on the blocks' levels to be tried in turn: one where every level is in closed form, which has none."""
    closed = all(isinstance(part, SpringDamper) for part in coupling)
    return GREATEST_LEVELS[:1] if closed else GREATEST_LEVELS


def devices(loop: HapticLoop) -> tuple[DeviceShare, ...]:
    """The gains kappa to be tried, the most promising first: one without delay, a handful with one."""
    if loop.tau == 0.0:
        return (DeviceShare(),)
    out = []
    tau_hat = loop.tau / loop.period
    for gain in _GAINS:
        kappa = least_gain(tau_hat) + gain * tau_hat / 2.0
        try:
            found = device_share(kappa, tau_hat)
        except ValueError:  # so little above the least gain that nothing is left in floating point
            continue
        out.append(DeviceShare(kappa, found.share, found.c))
    return tuple(sorted(out, key=lambda device: -device.share))


def _levels(loop: HapticLoop, device: DeviceShare, own: tuple[BlockLevel, ...], progress: Progress | None) -> Levels:
    """The levels for one gain kappa, with what the blocks promise there."""
    Delta_V = tuple(level.Delta for level in own)
    Phi_E, P_E = _environment(loop, device, Delta_V, progress)
    return Levels(device, loop.Delta_D_blocks, Delta_V, Phi_E, P_E, tuple(level.P for level in own))


def _promises(
    loop: HapticLoop,
    coupling: tuple[CouplingBlock, ...],
    blocks: tuple[StateSpace, ...],
    device: DeviceShare,
    most: float,
) -> tuple[BlockLevel, ...]:
    """What each block promises for one gain kappa; linear ones levels up to ``most``."""
    gains = loop.loop_gain(device.kappa)
    for name, part, K, Delta_D in zip(loop.partition.names, coupling, gains, loop.Delta_D_blocks, strict=True):
        if isinstance(part, SpringDamper):
            check_spring_damper(name, part, Delta_D / (2.0 * device.kappa), loop.period, device.kappa)
        else:
            check_block(name, part, K, loop.period, device.kappa)
    # the greatest level of each block, or levels that go together where they are not comparable
    own: list[BlockLevel] = []
    for name, part, K, Delta_D in zip(loop.partition.names, coupling, gains, loop.Delta_D_blocks, strict=True):
        if isinstance(part, SpringDamper):
            own.append(BlockLevel(_closed_form(name, part, Delta_D / (2.0 * device.kappa), loop.period), None))
        elif part.inputs == 1 or not _small(loop) or isinstance(loop.environment, DeclaredEnvironment):
            own.append(block_level(name, part, K, Delta_D, loop.period, most))
    if len(own) == len(blocks):
        return tuple(own)
    joint = joint_levels(loop, blocks, loop.split, device, most)
    return tuple(BlockLevel(Delta, P) for Delta, P in zip(joint.Delta_V, joint.P_V, strict=True))


def _small(loop: HapticLoop) -> bool:
    return len(loop.ports) <= MOST_JOINT and loop.environment.order + len(loop.ports) <= MOST_JOINT


def _closed_form(name: str, coupling: SpringDamper, Lambda: Matrix, T: float) -> Matrix:
    """Delta_V a hair below the greatest level of a block."""
    greatest = greatest_level(coupling, Lambda, T)
    level = symmetric_part((1.0 - _GIVEN_UP) * greatest - _GIVEN_UP * Lambda)
    least = float(np.linalg.eigvalsh(level)[0])
    if least <= 0.0:
        raise Infeasible(
            f"coupling {name}: the greatest level of V_hat has the eigenvalue {least:.4g} N*s/m, expected > 0",
            ("raise the coupling's damping", "raise its stiffness towards half its limit"),
        )
    return level


def _environment(
    loop: HapticLoop, device: DeviceShare, Delta_V: tuple[Matrix, ...], progress: Progress | None
) -> tuple[Matrix, Matrix | Literal["energy", "enforced"]]:
    """Phi_E and what proves it, or keeps it."""
    environment, T, partition = loop.environment, loop.period, loop.partition
    if isinstance(environment, DeclaredEnvironment):
        return _declared(loop, environment, device, Delta_V), ENFORCED
    Delta_G = tuple(device.share * Delta for Delta in loop.Delta_D_blocks)
    network = environment.passive_network
    if network is not None and (isinstance(environment, NetworkBox) or environment.order > MOST_SEARCHED):
        return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY
    split = loop.split
    if network is not None and split.rest.order < environment.order:  # masses that drift: no storage matrix is definite
        return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY
    try:
        found, P_E = level_and_storage(
            split, T, partition.embed(Delta_G), partition.embed(Delta_V), partition, progress
        )
        return found.Phi_E, P_E
    except (Infeasible, SolverFailure):
        if network is None:
            raise
        return physical_level(network, T, Delta_G, Delta_V, partition), ENERGY


def _declared(
    loop: HapticLoop, environment: DeclaredEnvironment, device: DeviceShare, Delta_V: tuple[Matrix, ...]
) -> Matrix:
    """The declared level, where (10) holds with it."""
    Phi_E = environment.promised()
    left = margin(loop.partition, Levels(device, loop.Delta_D_blocks, Delta_V, Phi_E, ENFORCED, ()))
    if left <= 0.0:
        raise Infeasible(
            "condition (10) fails with the environment's declared level: "
            f"its least eigenvalue is {left:.4g} N*s/m, expected > 0",
            (
                "declare a smaller level",
                "use devices with more damping (a greater osp)",
                "raise the coupling's damping, or soften it",
            ),
        )
    return Phi_E
