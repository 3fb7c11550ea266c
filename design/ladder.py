"""A ladder: couplings certified beforehand for delays inside the tick that are longer than the session's own.

The certificate assumes that a force acts at most tau after its sample. A run that measures a longer delay may change to
a softer coupling that is certified for it. Rung 0 is the session's certificate. Each further rung is a certificate of
the same loop with a longer tau, proved in the same way.

**How a rung is found.** The environment's level does not depend on the delay: rung 0's Phi_E and its storage prove it
at every rung. Only if (10) then leaves no coupling, the search takes a different level. With Phi_E <= s Delta_D, the
spring-damper class (:mod:`manyhands.design.levels.spring_damper`) is the same problem for every block, in ports where
Delta_D = I. Its best coupling is K = k Delta_D, B = b Delta_D with two numbers for all blocks, so that a rung costs one
program of one port.

| asked of rung 0 | its rungs |
|---|---|
| feasible or stiffest, any class | K = k Delta_D, B = b Delta_D with the same aim |
| loop-shaping or closed-loop, any class | springs and dampers by the same aim, searched at the rung's tau |
| a given coupling | the same coupling while it can be certified, then as for feasible |

Rungs of linear couplings are springs and dampers too, because a search in the linear class takes long and a rung only
has to be safe. Every rung records what the session asked, as rung 0 does. The rung's method records how its coupling
was found, and the id of its rung 0.

**Mixing.** Blocks change one by one, so that a loop may be at several rungs at once.
:mod:`manyhands.design.proof.ladder` proves that every mixture is certified.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from manyhands.design.certificate import Certificate, content
from manyhands.design.errors import DesignError, Infeasible
from manyhands.design.levels.contract import DeviceShare, margin_of
from manyhands.design.levels.spring_damper import centred, greatest_level, stiffest
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.coupling import SpringDamper
from manyhands.design.models.statespace import Matrix, symmetric_part
from manyhands.design.problem import (
    CouplingRequest,
    HapticLoop,
    LinearGiven,
    LinearWanted,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof.ladder import prove_ladder
from manyhands.design.synthesis import Found, certificate_of, environment_need, gain_of_stiffest, search, tools
from manyhands.design.theorem3 import check_spring_damper, devices

Progress = Callable[[str], None]

MOST_PORTS = 256
"""Up to this many ports a ladder gets three further rungs by default, above it one: a rung costs a whole proof."""

_SOFTENED = "spring-damper class in proportion to Delta_D"

_NO_RUNGS = (
    "no rungs: dry friction covers what the steps of encoders add to one coupling, and nothing is proved of a change "
    "from one to another"
)


@dataclass(frozen=True, eq=False)
class Ladder:
    """Certificates of one loop for growing delays, and what was proved of them together.

    Attributes:
        rungs: rung 0 is the session's own certificate; at least two rungs.
        independent: whether every mixture of rungs is proved, so that each coupling may change by itself. Otherwise
            all couplings have to change together.
        Phi_E: the environment's level that serves all rungs, m x m, N*s/m.
    """

    rungs: tuple[Certificate, ...]
    independent: bool
    Phi_E: Matrix

    __repr__ = brief_repr

    @property
    def taus(self) -> tuple[float, ...]:
        """The longest delay that each rung covers, s; growing."""
        return tuple(rung.tau for rung in self.rungs)


class LadderFound(NamedTuple):
    """The result of designing a ladder.

    Attributes:
        ladder: None if no rung beyond the certificate itself was found.
        notes: a sentence for each delay that has no rung, with the reason.
    """

    ladder: Ladder | None
    notes: tuple[str, ...]


def automatic_delays(loop: HapticLoop) -> tuple[float, ...]:
    """The default delays of a ladder, s: T/4, T/2 and T, or T alone for many ports; only those above the loop's tau."""
    parts = (0.25, 0.5, 1.0) if len(loop.ports) <= MOST_PORTS else (1.0,)
    return tuple(part * loop.period for part in parts if part * loop.period > loop.tau)


def design_ladder(
    first: Certificate, wanted: CouplingRequest, delays: tuple[float, ...], progress: Progress | None = None
) -> LadderFound:
    """Find and prove a rung for each delay, and prove the rungs together.

    A delay without a rung is left out with a note. If no coupling exists for a delay, all longer delays are left out
    too. Where dry friction covers the steps of encoders, there is no ladder, with a note.

    Args:
        first: rung 0.
        wanted: what was asked of its coupling.
        delays: s, growing, above the tau of ``first`` and at most the period.
        progress: called with a line of text for each rung.

    Raises:
        ValueError: the delays do not grow, or are out of these bounds.
    """
    bounds = (first.tau, *delays)
    if any(b <= a for a, b in zip(bounds, delays, strict=False)) or bounds[-1] > first.loop.period:
        raise ValueError(f"found delays of {delays} s; expected them to grow from {first.tau} s to the period at most")
    if first.encoder is not None and first.encoder.covered:
        return LadderFound(None, (_NO_RUNGS,))
    rungs, notes = [first], []
    for number, tau in enumerate(delays):
        if progress is not None:
            progress(f"a rung for {tau * 1e3:.4g} ms")
        try:
            rungs.append(_rung(first, wanted, tau))
        except Infeasible as error:
            left = ", ".join(f"{delay * 1e3:.4g} ms" for delay in delays[number:])
            notes.append(f"no rung for a delay of {left}: {error}")  # a coupling for a longer delay serves a shorter
            break
        except DesignError as error:
            notes.append(f"no rung for a delay of {tau * 1e3:.4g} ms: {error}")
    while len(rungs) > 1:
        if (ladder := _in_common(tuple(rungs))) is not None:
            return LadderFound(ladder, tuple(notes))
        lost = rungs.pop()
        notes.append(
            f"no rung for a delay of {lost.tau * 1e3:.4g} ms: no level of the environment serves it and the shorter "
            "ones"
        )
    return LadderFound(None, tuple(notes))


def _at(loop: HapticLoop, tau: float) -> HapticLoop:
    """The loop at a longer delay, s: springs of orientations are as stiff there as they are proved."""
    T, rho = loop.period, loop.period_tolerance
    devices = tuple(
        device if device.orientation is None else replace(device, orientation=device.orientation.within(T, tau, rho))
        for device in loop.devices
    )
    return replace(loop, tau=tau, devices=devices)


def _rung(first: Certificate, wanted: CouplingRequest, tau: float) -> Certificate:
    """The certificate for a longer delay, of the first coupling that can be certified.

    Raises:
        Infeasible: no coupling can be certified.
        DesignError: no coupling was certified, for a different reason.
    """
    loop = _at(first.loop, tau)
    reason: DesignError | None = None
    for find in _ways(loop, wanted, first):
        try:
            found = find()
            method = {**found.method, "rung of": first.id}
            return certificate_of(loop, wanted, replace(found, method=method), environment=first.levels)
        except DesignError as error:
            reason = error
    need = _need(first, loop)
    if need > 0.0:  # a different level of the environment may need less of Delta_D
        found = _softened(loop, environment_need(loop), stiff=False)
        return certificate_of(loop, wanted, replace(found, method={**found.method, "rung of": first.id}))
    raise reason or AssertionError("there is always a way to look for a rung")


def _ways(loop: HapticLoop, wanted: CouplingRequest, first: Certificate) -> Iterator[Callable[[], Found]]:
    """The methods to find a rung's coupling, in the order of preference."""
    stiff = False
    match wanted:
        case SpringDamperGiven() | LinearGiven():
            yield lambda: Found(first.coupling, {"algorithm": "given"}, wanted.aim)
        case SpringDamperWanted(wish) | LinearWanted(_, wish):
            stiff = wish.objective == "stiffest"
            if wish.aim is not None:
                same = SpringDamperWanted(Wish(wish.objective, wish.aim))
                yield lambda: search(loop, same)
    yield lambda: _softened(loop, _need(first, loop), stiff)


def _need(first: Certificate, loop: HapticLoop) -> float:
    """The least s with rung 0's Phi_E <= s Delta_D, dimensionless: the part that it needs of the rung's Delta_D.

    Held torques leave less of a level the longer the delay is; without them Delta_D is that of rung 0.
    """
    Phi_E = first.levels.Phi_E
    if not loop.partition.admits(Phi_E):
        return _greatest_ratio(Phi_E, loop.Delta_D)
    return max(map(_greatest_ratio, loop.partition.restrict(Phi_E), loop.Delta_D_blocks))


def _greatest_ratio(Phi: Matrix, Delta: Matrix) -> float:
    inverse = np.linalg.inv(np.linalg.cholesky(Delta))
    return float(np.linalg.eigvalsh(symmetric_part(inverse @ Phi @ inverse.T))[-1])


def _softened(loop: HapticLoop, needed: float, stiff: bool) -> Found:
    """The best coupling K = k Delta_D, B = b Delta_D, by the one-port problem that all blocks have in common.

    Args:
        loop: with the rung's delay.
        needed: part of Delta_D that the environment needs.
        stiff: whether to find the stiffest coupling; otherwise the coupling furthest inside the conditions.

    Raises:
        Infeasible: no such coupling exists.
    """
    unit, member = np.eye(1), stiffest if stiff else centred
    best: tuple[float, SpringDamper, DeviceShare] | None = None
    first: Infeasible | None = None
    for device in (gain_of_stiffest(loop, needed),) if stiff else devices(loop):
        try:
            found = member(unit / (2.0 * device.kappa), needed * unit, device.part, loop.period, "of every port")
        except Infeasible as error:
            first = first or error
            continue
        distance = found.distance / (2.0 * device.kappa)  # in units of Delta_D
        if best is None or distance > best[0]:
            best = distance, found.coupling, device
    if best is None:
        raise first or Infeasible("no spring-damper coupling satisfies Theorem 3")
    _, own, device = best
    k, b = float(own.stiffness[0, 0]), float(own.damping[0, 0])
    coupling = tuple(SpringDamper(k * Delta, b * Delta) for Delta in loop.Delta_D_blocks)
    method = {"algorithm": f"{_SOFTENED}, {'stiffest' if stiff else 'centred'}"} | tools()
    return Found(coupling, method, device=_roomiest((device, *devices(loop)), own, needed, loop.period))


def _roomiest(gains: tuple[DeviceShare, ...], coupling: SpringDamper, needed: float, T: float) -> DeviceShare:
    """Among ``gains``, the gain with the greatest margin of (10), on one port with Delta_D = 1; the first serves."""
    unit = np.eye(1)

    def reached(device: DeviceShare) -> float:
        Lambda = unit / (2.0 * device.kappa)
        try:
            check_spring_damper("of every port", coupling, Lambda, T, device.kappa)
        except Infeasible:
            return -np.inf
        return margin_of(device.share * unit, greatest_level(coupling, Lambda, T), needed * unit)

    return max(gains, key=reached)


def _in_common(rungs: tuple[Certificate, ...]) -> Ladder | None:
    """The ladder with the Phi_E that proves most: every mixture, or else (10) at every rung; None if no Phi_E does."""
    Phi_E, partition = rungs[0].levels.Phi_E, rungs[0].loop.partition
    alike = all(np.array_equal(rung.levels.Phi_E, Phi_E) for rung in rungs[1:])
    if alike and partition.admits(Phi_E) and not any(device.held for device in rungs[0].loop.devices):
        # Each rung's own proof has shown (10) with this Phi_E. It has no entries between blocks, so that every mixture
        # follows: see proof/ladder.py.
        return Ladder(rungs, True, Phi_E)
    data = [content(rung) | {"id": rung.id} for rung in rungs]
    together: Ladder | None = None
    tried: list[Matrix] = []
    for number, rung in enumerate(rungs):
        Phi_E = rung.levels.Phi_E
        if any(np.array_equal(Phi_E, other) for other in tried):
            continue
        tried.append(Phi_E)
        proof = prove_ladder(data, number)
        if not (proof.one_loop.holds and proof.together.holds):
            continue
        if proof.independent.holds:
            return Ladder(rungs, True, Phi_E)
        together = together or Ladder(rungs, False, Phi_E)
    return together
