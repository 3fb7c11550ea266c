"""Computes the torques of a recorded orientation again, and the grants of its world.

Each row of a device has its orientation, what was proposed to it, and the state of its account after the tick. So the
torque of a tick, its proxy and its account follow from that row and the one before, by the device's own step
(:func:`manyhands.nodes.device.orientation.follow`), to the last bit. A device may always let go: its proxy is at the
device then, without a torque. After periods without a row the state is not known, and the tick is not checked.

What a world granted never exceeds what it had heard of deposits, which is computed again from the rows of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from manyhands.launch.audit.events import Course
from manyhands.launch.audit.findings import Check, compare, gaps_of, within
from manyhands.launch.audit.recompute import Array
from manyhands.launch.recordings.run import RecordedRun, rows_of, there
from manyhands.nodes.device.orientation import NO_TORQUE, follow
from manyhands.nodes.kernel.bundle import DeviceBundle, EnvironmentBundle
from manyhands.nodes.kernel.orientation import UPRIGHT, OrientationBank, OrientationSpring, Quaternion
from manyhands.nodes.rows import figures as names
from manyhands.protocol.channels import (
    ACCOUNT,
    AXIS_NAMES,
    HEARD,
    HEARD_NAMES,
    PROPOSED,
    PROPOSED_NAMES,
    PROXY,
    QUATERNION_NAMES,
    TOLD,
    TORQUE,
)

NAME: Final = "orientation"
BOUND: Final = "turned"

ROUNDING: Final = 1e-12
"""Of what was deposited and granted, by which an account may be below its bound."""

_SUMS: Final = "rounding of the sums"
_FOLLOWS: Final = ("A", "D", "G")
_FREE: Final = "it ran free, or another process had begun, and its orientation meanwhile has no row"


def device_checks(run: RecordedRun, name: str, bundle: DeviceBundle, course: Course) -> list[Check]:
    """The checks of a device's orientation; none where that is no port."""
    if bundle.orientation is None:
        return []
    R, Q, u = (rows_of(run, name, trace) for trace in (names.ORIENTATION, PROXY, TORQUE))
    came, account = rows_of(run, name, PROPOSED), rows_of(run, name, ACCOUNT)
    again = np.full((len(R), len(AXIS_NAMES) + len(QUATERNION_NAMES) + len(_FOLLOWS)), np.nan)
    recorded = np.hstack([u, Q, account[:, : len(_FOLLOWS)]])
    known: Array | None = None
    skipped = np.zeros(len(R), dtype=np.bool_)
    for k in np.flatnonzero(there(R) & there(account)).tolist():
        happened = course.before.get(k)
        if happened is not None and happened.began:
            known = np.array([*UPRIGHT, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        if known is None or (happened is not None and (happened.released or happened.unknown)):
            skipped[k] = True
        else:
            again[k] = _followed(bundle.orientation.stiffness, known, R[k], came[k], account[k], recorded[k])
        known = np.array([*Q[k], *account[k, :5], np.any(u[k] != 0.0)])
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


def _followed(k: float, before: Array, R: Array, came: Array, account: Array, recorded: Array) -> Sequence[float]:
    """Torque, proxy and account of a tick: by the law, or as the device lets go."""
    late, acted = account[4] > before[8], before[9]
    tried: list[Sequence[float]] = []
    # motors that had let go by themselves in a late tick leave nothing stored, nor have any in one without a torque
    for lost in (False, True) if late or not acted else (False,):
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
        came = rows_of(run, tool.device, PROPOSED)
        nothing = ~np.any(came != 0.0, axis=1)
        what = f"what was proposed to {tool.device} is what came there, or nothing came"
        expected = np.where(nothing[:, None], came, own)
        out.append(compare("agreement", tool.device, what, PROPOSED_NAMES, came, expected, owed=there(own)))
    balance = _balance(bundle, heard, told)
    what = "it granted no more than hands had deposited"
    size = ROUNDING * (1.0 + float(np.nanmax(np.abs(heard[:, 4 :: len(HEARD_NAMES)]), initial=0.0)))
    short = balance < -size
    nothing_left = np.zeros_like(balance)
    out.append(within(BOUND, name, what, ("balance",), balance, nothing_left, short, tolerance=size, source=_SUMS))
    return out


def _balance(bundle: EnvironmentBundle, heard: Array, told: Array) -> Array:
    """What may be granted still after each tick, J, by the bank's own arithmetic; below 0 where more was granted."""
    hands = tuple(tool.device for tool in bundle.oriented_tools)
    bank = OrientationBank(hands, power={tool.device: tool.power for tool in bundle.oriented_tools})
    out, width = np.full((len(heard), 1), np.nan), len(HEARD_NAMES)
    for k in np.flatnonzero(there(heard) & there(told)).tolist():
        for i, hand in enumerate(hands):
            deposited, life = heard[k, width * i + 4 : width * (i + 1)].tolist()
            bank.deposit(hand, deposited, life, k)
        short = 0.0
        for i, hand in enumerate(hands):
            total = float(told[k, len(PROPOSED_NAMES) * (i + 1) - 1])
            short += max(0.0, total - bank.grant(hand, total - bank.granted[hand]))
        out[k] = -short if short else bank.balance
    return out
