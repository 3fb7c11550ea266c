"""What would help a coupling that is too stiff: changes that were tried, each with the figure where it begins to help.

A closed form of a limit is true only as long as nothing else decides: an environment that lacks passivity takes a part
of the devices' level, and the gains that are tried are a few. So a figure is not computed here. It is searched with the
function that decides, and a change is offered only if that function accepts it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from manyhands.design.models.coupling import CouplingBlock, SpringDamper
from manyhands.design.models.statespace import StateSpace
from manyhands.design.problem import HapticLoop

MOST_TRIED: Final = 12  # ports, and states of the environment beside them, up to which changes are tried

IN_PROPORTION: Final = ", the rest of its block in proportion"

_STATES = 48
_CLOSE = 1e-3  # relative: how closely a limit is found
_BELOW = (1.0 - _CLOSE, 0.985, 0.96)  # parts of a limit at which it is tried
_STEPS = 12  # from a limit down to a part of 1/_WIDEST of it, in logarithms; then halvings
_WIDEST = 50.0

Coupling = tuple[CouplingBlock, ...]
Certifies = Callable[[HapticLoop, Coupling], bool]
"""Whether levels are found that prove this loop stable with this coupling."""


class Excess(NamedTuple):
    """How far a block of V is beyond its limit.

    Attributes:
        block: its index.
        limit: N/m, of its stiffness, or of its stiffness plus 2/T times its damping.
        over: what it has, in units of the limit; at least 1.
        osp: of its devices that would put the limit at what it has, N*s/m.
        damped: whether the damping counts.
    """

    block: int
    limit: float
    over: float
    osp: float
    damped: bool


def what_helps(loop: HapticLoop, coupling: Coupling, excesses: Sequence[Excess], certifies: Certifies) -> list[str]:
    """The changes with which the loop is certified, in words.

    Args:
        loop: the haptic loop.
        coupling: V's blocks in the partition's order.
        excesses: of the blocks that are too stiff.
        certifies: decides.
    """
    if len(loop.ports) > MOST_TRIED or loop.environment.order > _STATES:
        return []
    out = []
    names, damped = loop.partition.names, any(excess.damped for excess in excesses)

    def softer(part: float) -> bool:
        changed = list(coupling)
        for excess in excesses:
            changed[excess.block] = _softened(coupling[excess.block], part / excess.over, excess.damped)
        return certifies(loop, tuple(changed))

    if (part := _greatest(softer, 1.0)) is not None:
        limits = {names[excess.block]: f"{part * excess.limit:.4g} N/m" for excess in excesses}
        each = set(limits.values())
        meaning = "stiffness plus 2/T times its damping" if damped else "stiffness"
        figure = each.pop() if len(each) == 1 else " and ".join(f"{limit} at {name}" for name, limit in limits.items())
        # a given state space is softened as a whole; of its stiffness alone nothing was tried
        whole = any(not isinstance(coupling[excess.block], SpringDamper) for excess in excesses)
        out.append(f"a {meaning} below {figure}{IN_PROPORTION if whole else ''}")
    most = max(excess.over for excess in excesses)
    ports = {port for excess in excesses for port in loop.partition.blocks[excess.block]}

    def stronger(part: float) -> bool:
        devices = tuple(
            replace(device, level=device.level * (most / part)) if ports.intersection(device.ports) else device
            for device in loop.devices
        )
        return certifies(replace(loop, devices=devices), coupling)

    if (part := _greatest(stronger, 1.0)) is not None:
        alone = len({f"{excess.osp:.6g}" for excess in excesses}) == 1
        figure = f"{excesses[0].osp / part:.4g} N*s/m" if alone else f"{most / part:.4g} times their own"
        out.append(f"devices with an osp above {figure}")
    if not damped and loop.environment.at_any_period and all(isinstance(block, SpringDamper) for block in coupling):

        def quicker(part: float) -> bool:
            period = loop.period * part / most
            return loop.tau <= period and certifies(replace(loop, period=period), coupling)

        if (part := _greatest(quicker, 1.0)) is not None:
            out.append(f"a period below {loop.period * part / most * 1e3:.3g} ms")
    if loop.tau and certifies(replace(loop, tau=0.0), coupling):
        out.append("a shorter delay inside the tick")
    return out


def _softened(block: CouplingBlock, factor: float, damped: bool) -> CouplingBlock:
    """The block with its stiffness times ``factor``, and its damping too where that counts."""
    if isinstance(block, SpringDamper):
        return SpringDamper(block.stiffness * factor, block.damping * (factor if damped else 1.0))
    static = None if block.static_gain is None else block.static_gain / factor
    return StateSpace(block.A, block.B, block.C / factor, block.D / factor, static)


def _greatest(helps: Callable[[float], bool], most: float) -> float | None:
    """The greatest part of ``most`` below which a change helps, up to a relative 0.1 %; None if there is none.

    Beside an environment that lacks passivity a gain may certify a coupling only close below its limit, and not a
    softer one. Such a gap is no limit to state: what is a little less has to help as well. The search begins at the
    top, for a program that fails at one number far below would otherwise be taken for the limit.
    """

    def well(part: float) -> bool:
        return all(helps(part * below) for below in _BELOW)

    if well(most):
        return most
    high = most
    for low in (most * _BELOW[0], *(most * math.pow(_WIDEST, -step / _STEPS) for step in range(1, _STEPS + 1))):
        if well(low):
            break
        high = low
    else:
        return None
    while high / low > 1.0 + _CLOSE:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if well(middle) else (low, middle)
    return low
