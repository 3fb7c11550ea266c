"""Computes the torques of a recorded orientation again, and the grants of its world.

Each row of a device has its orientation, what was proposed to it, and the state of its account after the tick. So the
torque of a tick, its proxy and its account follow from that row and the one before, by the device's own step
(:func:`manyhands.nodes.device.orientation.follow`), to the last bit. A device may always let go: its proxy is at the
device then, without a torque. After periods without a row the state is not known, and the tick is not checked.

What a world granted never exceeds what it had heard of deposits, which is computed again from the rows of both.

A hand whose orientation is *sensed* has a row of that alone: no torque acts on it, and it has no account. So its audit
checks that each row is a rotation, and that the world heard of no deposit and told it of no grant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.audit.events import Course, Happening
from manyhands.launch.audit.findings import Check, compare, gaps_of, within
from manyhands.launch.audit.recompute import Array
from manyhands.launch.recordings.run import RecordedRun, rows_of, there
from manyhands.nodes.device.orientation import NO_TORQUE, follow
from manyhands.nodes.environment.oriented_tools import bank_of
from manyhands.nodes.kernel.bundle import (
    WALL,
    DeviceBundle,
    DeviceRung,
    EnvironmentBundle,
    OrientationPart,
    SensedPart,
)
from manyhands.nodes.kernel.orientation import OrientationSpring, Quaternion
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import (
    ACCOUNT,
    AXIS_NAMES,
    HEARD,
    HEARD_NAMES,
    INSTANTS,
    PROPOSED,
    PROPOSED_NAMES,
    PROXY,
    QUATERNION_NAMES,
    TOLD,
    TORQUE,
)
from manyhands.protocol.clock import from_seconds

NAME: Final = "orientation"
BOUND: Final = "turned"

ROUNDING: Final = 1e-12
"""Of what was deposited and granted, by which an account may be below its bound."""

_SUMS: Final = "rounding of the sums"
_UNIT: Final = "rounding of a unit quaternion"
_FOLLOWS: Final = ("A", "D", "G")
_FREE: Final = "it ran free, or another process had begun, and its orientation meanwhile has no row"


def device_checks(run: RecordedRun, name: str, bundle: DeviceBundle, course: Course) -> list[Check]:
    """The checks of a device's orientation; none where that is no port."""
    if bundle.orientation is None:
        return []
    if isinstance(bundle.orientation, SensedPart):
        return [_rotations(run, name)]
    R, Q, u = (rows_of(run, name, trace) for trace in (names.ORIENTATION, PROXY, TORQUE))
    came, account = rows_of(run, name, PROPOSED), rows_of(run, name, ACCOUNT)
    again = np.full((len(R), len(AXIS_NAMES) + len(QUATERNION_NAMES) + len(_FOLLOWS)), np.nan)
    recorded = np.hstack([u, Q, account[:, : len(_FOLLOWS)]])
    known: Array | None = None
    acted = False  # whether the tick before had a torque
    ended = _ended(run, name, bundle)
    skipped = np.zeros(len(R), dtype=np.bool_)
    spring = _Stiffness(bundle.orientation, bundle.rungs)
    for k in np.flatnonzero(there(R) & there(account)).tolist():
        happened = course.before.get(k, _NOTHING)
        if happened.began:
            known = np.array([*R[k], 0.0, 0.0, 0.0, 0.0, 0.0])  # its proxy begins where it is
            acted = False
            spring.begin()
        if happened.rung is not None:
            spring.change(happened.rung)
        if k in course.rungs:
            spring.change(course.rungs[k])
        if known is None or happened.released or happened.unknown:
            skipped[k] = True
            spring.doubt()
        else:
            # motors that had let go by themselves leave nothing stored, nor have any in a late tick without a torque
            lost = bool(account[k, 4] > known[8] or ended[k] or not acted)
            tried = [_followed(one, known, R[k], came[k], account[k], recorded[k], lost) for one in spring.possible]
            again[k] = next((one for one in tried if tuple(one) == tuple(recorded[k].tolist())), tried[0])
            spring.rest(account[k, 5] == 0.0, not u[k].any())
        known, acted = np.array([*Q[k], *account[k, :5]]), bool(u[k].any())
    columns = (*AXIS_NAMES, *QUATERNION_NAMES, *_FOLLOWS)
    what = "its torque, its proxy and its account follow from its orientation and what was proposed"
    gaps = gaps_of(skipped, _FREE)
    least = account[:, 1:2] - account[:, 2:3]
    size = ROUNDING * (1.0 + float(np.nanmax(np.abs(account[:, 1:3]), initial=0.0)))
    held = "the account of its orientation never fell below what it may: D - G"
    remark = f"least {float(np.nanmin(account[:, :1], initial=0.0)):.4g} J"
    too_low = account[:, :1] < least - size
    return [
        compare(NAME, name, what, columns, recorded, again, gaps=gaps),
        within(
            BOUND, name, held, ("A",), account[:, :1], least, too_low, tolerance=size, source=_SUMS, remark=remark
        ),
    ]  # fmt: skip


class _Stiffness:
    """K of a device's spring from tick to tick: it changes with the rung, once no torque has acted for two ticks.

    Attributes:
        possible: what k may be in this tick, N*m/rad; more than one where rows before it are missing.
    """

    def __init__(self, part: OrientationPart, rungs: Sequence[DeviceRung]) -> None:
        self._k = [part.stiffness_at(rung) for rung in rungs]
        self.begin()

    def begin(self) -> None:
        """A process begins, at rung 0."""
        self.possible, self._next, self._rested = [self._k[0]], self._k[0], False

    def change(self, rung: int) -> None:
        """The device is to change to this rung."""
        self._next = self._k[rung]

    def doubt(self) -> None:
        """What the device did before this tick has no row: it may have changed, and has exerted nothing."""
        self.possible, self._rested = [*dict.fromkeys((*self.possible, self._next))], True

    def rest(self, lets_go: bool, no_torque: bool) -> None:
        """A tick is over: whether its greatest torque was 0, and whether it had none."""
        if lets_go and self._rested:
            self.possible = [self._next]
        self._rested = no_torque


_NOTHING: Final = Happening()


def _rotations(run: RecordedRun, name: str) -> Check:
    """Whether each orientation of a sensed hand is one."""
    R = rows_of(run, name, names.ORIENTATION)
    square = np.sum(R * R, axis=1, keepdims=True)
    wrong = there(R)[:, None] & ~(np.abs(square - 1.0) <= ROUNDING)
    what = "its orientation is sensed: each is a rotation, and no torque acts"
    one = np.ones_like(square)
    return within(NAME, name, what, ("|R|²",), square, one, wrong, tolerance=ROUNDING, source=_UNIT)


def _ended(run: RecordedRun, name: str, bundle: DeviceBundle) -> NDArray[np.bool_]:
    """In which ticks the torque before may have ended by itself before the tick's sample."""
    if bundle.time != WALL:
        return np.zeros(run.ticks_of(name), dtype=np.bool_)
    timing, instants = bundle.timing, rows_of(run, name, INSTANTS)
    at_most = from_seconds(timing.latency) - from_seconds(timing.actuation_delay) - from_seconds(timing.jitter)
    found: NDArray[np.bool_] = instants[:, 2] + at_most < instants[:, 0]
    return found


def _followed(
    k: float, before: Array, R: Array, came: Array, account: Array, recorded: Array, may_be_lost: bool
) -> Sequence[float]:
    """Torque, proxy and account of a tick: by the law, or as the device lets go."""
    tried: list[Sequence[float]] = []
    for lost in (False, True) if may_be_lost else (False,):
        for lets_go in (False, True):
            spring = OrientationSpring(k, at=Quaternion(*(R if lost else before[:4]).tolist()))
            spring.account, spring.deposited, spring.granted = before[4:7].tolist()
            here = Quaternion(*R.tolist())
            if lets_go:
                spring.release(here)
                torque = NO_TORQUE
            elif account[5] > 0.0:
                torque = follow(spring, here, came.tolist(), float(account[5]))
            else:
                continue
            tried.append((*torque, *spring.proxy, spring.account, spring.deposited, spring.granted))
            if tried[-1] == tuple(recorded.tolist()):
                return tried[-1]
    return tried[0]


def world_checks(run: RecordedRun, name: str, bundle: EnvironmentBundle) -> list[Check]:
    """The checks of the world of tools that hands turn; none without any."""
    if not bundle.oriented_tools:
        return []
    heard, told = rows_of(run, name, HEARD), rows_of(run, name, TOLD)
    out = []
    for i, tool in enumerate(bundle.oriented_tools):
        own = told[:, len(PROPOSED_NAMES) * i : len(PROPOSED_NAMES) * (i + 1)]
        if tool.sensed:
            stated = np.column_stack([heard[:, len(HEARD_NAMES) * i + 4], own[:, -1]])
            what = f"{tool.device} is sensed and has no account: it deposited nothing, and was granted nothing"
            none = np.where(np.isfinite(stated), 0.0, np.nan)
            out.append(compare("agreement", tool.device, what, ("D", "G"), stated, none))
            continue
        came = rows_of(run, tool.device, PROPOSED)
        nothing = ~np.any(came != 0.0, axis=1)
        what = f"what was proposed to {tool.device} is what came there, or nothing came"
        if run.recorded.behind_wave_link(tool.device):
            expected, owed = _told_earlier(came, own), there(came)
        else:
            expected, owed = own, there(own)
        expected = np.where(nothing[:, None], came, expected)
        out.append(compare("agreement", tool.device, what, PROPOSED_NAMES, came, expected, owed=owed))
    balance = _balance(bundle, heard, told)
    if all(tool.sensed for tool in bundle.oriented_tools):
        return out
    what = "it granted no more than hands had deposited"
    size = ROUNDING * (1.0 + float(np.nanmax(np.abs(heard[:, 4 :: len(HEARD_NAMES)]), initial=0.0)))
    short = balance < -size
    nothing_left = np.zeros_like(balance)
    out.append(within(BOUND, name, what, ("balance",), balance, nothing_left, short, tolerance=size, source=_SUMS))
    return out


def _told_earlier(came: Array, told: Array) -> Array:
    """Each row of what came over a wave link, where the world told it in any tick, and else zeros.

    Of a world with a tick that was not recorded nobody knows what it told, so there such a row is not checked.
    """
    known = there(told)
    ever = {row.tobytes() for row in told[known]}
    other = 0.0 if known.all() else np.nan
    return np.array([row if row.tobytes() in ever else np.full(len(row), other) for row in came]).reshape(came.shape)


def _balance(bundle: EnvironmentBundle, heard: Array, told: Array) -> Array:
    """What may be granted still after each tick, J, by the bank's own arithmetic; below 0 where more was granted."""
    hands = {tool.device: i for i, tool in enumerate(bundle.oriented_tools) if not tool.sensed}
    bank = bank_of(bundle.oriented_tools)
    out, width = np.full((len(heard), 1), np.nan), len(HEARD_NAMES)
    for k in np.flatnonzero(there(heard) & there(told)).tolist():
        for hand, i in hands.items():
            deposited, life = heard[k, width * i + 4 : width * (i + 1)].tolist()
            bank.deposit(hand, deposited, life, k)
        short = 0.0
        for hand, i in hands.items():
            total = float(told[k, len(PROPOSED_NAMES) * (i + 1) - 1])
            short += max(0.0, total - bank.grant(hand, total - bank.granted[hand]))
        out[k] = -short if short else bank.balance
    return out
