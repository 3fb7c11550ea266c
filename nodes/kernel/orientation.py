"""The spring between a hand's orientation and a proxy's, on all of SO(3), and the bank that pays for what proxies give.

Orientations are unit quaternions (w, x, y, z) and turn the body's axes into the world's. R is the device's orientation,
Q that of its *proxy*, where the world would have the tool. D = R Q* is the rotation from the proxy to the device, by
the angle theta about the unit vector u. The spring is chordal, N*m and J:

    t(R, Q) = -k sin(theta) u = -2 k D_w D_v,        U(R, Q) = k (1 - cos(theta)) = 2 k |D_v|^2.

D and -D are the same rotation, and give the same numbers. The derivative of t with respect to a turn has a norm of at
most k everywhere, as that of a linear spring has: cos(theta) about u, and cos(theta/2) across.

**The test.** The world may propose any proxy. A step from Q- to Q at the orientation R yields

    y = U(R, Q-) - U(R, Q) - |t(R, Q) - t(R, Q-)|^2/(2 k),

for small angles the work k (R - Q)^T (Q - Q-) that the spring does on the proxy. The account of a hand is the sum of y.
Of a step that would leave less than the account may have, only a part is taken, along the shortest turn. The proxy that
rests yields 0, so a part always exists. With the account at 0 or above, a device that burns

    b >= k (lambda T + 3 tau)/2                                                                             (*)

gives out no energy by its orientation: docs/decisions/0054-orientation.md. (*) is the limit of a linear coupling, and
nothing is assumed of the world, of the proxies, or of how late they come: a proxy that did not come rests.

**The bank.** One hand may turn another's tool, so accounts may share. What a hand's account has beyond what it needs is
*deposited*: the hand binds itself to keep the account above it from then on. The world *grants* no more than was
deposited, and so no more than all hands together have given. Deposits and grants are sums that never fall, so that a
message that is lost or late costs time alone.

**Lives.** A hand whose process starts anew has an empty account, and so has a world that does. Each process of a hand
is a *life* with a number of its own. The bank counts the deposits of a life from the first sum that it hears, and its
grants from 0. It says with each sum of grants for which life it is, and a hand takes in no other. So nothing is
credited or spent twice, whoever starts anew.

**Lateness.** A tick that is later than (*) covers may give out energy. What it may give is *owed*, and the spring lets
go while more is owed than lateness may put in.

**On the wire** a hand says its orientation, the sum of its deposits and its life, and the world answers with a proxy, a
sum of grants and that life: :data:`RIDER` numbers each way. What comes is taken by :func:`unit` and :func:`total`
alone, to which any numbers may be given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector3 = tuple[float, float, float]
"""In the world's axes."""


class Quaternion(NamedTuple):
    """A unit quaternion, the rotation from a body's axes to the world's; by default none.

    A turn by an angle about the unit vector u is ``w`` = cos(angle/2), (``x``, ``y``, ``z``) = u sin(angle/2).

    Example:
        >>> import manyhands as mh
        >>> mh.Quaternion()
        Quaternion(w=1.0, x=0.0, y=0.0, z=0.0)
    """

    w: float = 1.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


UPRIGHT: Final = Quaternion()
"""No rotation: where every proxy and every device begins."""

RIDER: Final = 6
"""The numbers that ride with a signal for each hand that turns: four of an orientation, a sum in J, and a life."""

NO_RIDER: Final = (0.0,) * RIDER
"""What says nothing: no orientation, or no proxy."""

FIRST_LIFE: Final = 1.0
"""The life of a hand whose process has no other one before or after it, as in a simulation."""

MOST_LIFE: Final = 2**53
"""Lives are whole numbers from 1 to this one, which doubles have exactly."""

_UNIT: Final = 1e-6  # |q|^2 of an orientation on the wire is 1 within this

_HALVINGS: Final = 24  # of a step, in search of the part that the account allows: 6e-8 of it
_ROUNDING: Final = 1e-15  # of k, J: a step that yields less than nothing by so little is not counted as held

_HAIR: Final = 1e-12  # of k, J: what is asked for beyond what is lacking, lest a rounded sum be held for nothing


def unit(numbers: Sequence[float]) -> Quaternion | None:
    """The orientation of four numbers from elsewhere, normalised; None where they are no unit quaternion."""
    w, x, y, z = numbers
    square = w * w + x * x + y * y + z * z
    if not abs(square - 1.0) <= _UNIT:  # so for NaN
        return None
    return normalised(numbers)


def is_life(number: float) -> bool:
    """Whether a number from elsewhere is that of a life."""
    return 1.0 <= number <= MOST_LIFE and number == math.floor(number)


def total(number: float) -> float:
    """The sum of deposits or grants that a number from elsewhere states, J; 0 where it is none."""
    return number if 0.0 <= number < math.inf else 0.0


def difference(R: Quaternion, Q: Quaternion) -> Quaternion:
    """R Q*, the rotation from Q to R in the world's axes."""
    return Quaternion(
        R.w * Q.w + R.x * Q.x + R.y * Q.y + R.z * Q.z,
        -R.w * Q.x + R.x * Q.w - R.y * Q.z + R.z * Q.y,
        -R.w * Q.y + R.y * Q.w - R.z * Q.x + R.x * Q.z,
        -R.w * Q.z + R.z * Q.w - R.x * Q.y + R.y * Q.x,
    )


def product(P: Quaternion, Q: Quaternion) -> Quaternion:
    """P Q, the rotation Q and then P, in the world's axes."""
    return difference(P, Quaternion(Q.w, -Q.x, -Q.y, -Q.z))


def torque(k: float, R: Quaternion, Q: Quaternion) -> Vector3:
    """t(R, Q), N*m, on the device; the proxy feels the opposite one."""
    w, x, y, z = difference(R, Q)
    c = -2.0 * k * w
    return (c * x, c * y, c * z)


def energy(k: float, R: Quaternion, Q: Quaternion) -> float:
    """U(R, Q), J."""
    _, x, y, z = difference(R, Q)
    return 2.0 * k * (x * x + y * y + z * z)


def angle(R: Quaternion, Q: Quaternion) -> float:
    """Theta between two orientations, rad, 0 ... pi."""
    w, x, y, z = difference(R, Q)
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


def angles(R: NDArray[np.float64], Q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Theta of each row of two traces of unit quaternions, ticks x 4: ticks, rad; NaN where a number is not finite."""
    with np.errstate(invalid="ignore", over="ignore"):  # a trace is what a node has sent
        near = np.where(np.einsum("ij,ij->i", R, Q) < 0.0, -Q.T, Q.T).T  # Q and -Q are one orientation
        apart, together = np.linalg.norm(R - near, axis=1), np.linalg.norm(R + near, axis=1)
        known = np.isfinite(apart + together)
    return np.where(known, 4.0 * np.arctan2(apart, together), np.nan)


def yielded(k: float, R: Quaternion, old: Quaternion, new: Quaternion) -> float:
    """Y of a proxy's step from ``old`` to ``new``, J: what it adds to the account of a hand that is at R."""
    a, b = torque(k, R, old), torque(k, R, new)
    change = (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
    return energy(k, R, old) - energy(k, R, new) - change / (2.0 * k)


def turned_by(R: Quaternion, turn: Sequence[float]) -> Quaternion:
    """R, turned by the rotation vector ``turn`` in the world's axes, rad."""
    x, y, z = turn
    far = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 if far < 1e-8 else math.sin(0.5 * far) / far  # sin is its argument to the last digits
    return normalised(product(Quaternion(math.cos(0.5 * far), scale * x, scale * y, scale * z), R))


def normalised(numbers: Sequence[float]) -> Quaternion:
    """The unit quaternion in the direction of four numbers that are not all 0."""
    norm = math.sqrt(math.fsum(number * number for number in numbers))
    return Quaternion(*(number / norm for number in numbers))


def between(old: Quaternion, new: Quaternion, part: float) -> Quaternion:
    """The orientation a part of the way from ``old`` to ``new`` along the shortest turn; 0 is ``old``, 1 is ``new``."""
    cosine = old.w * new.w + old.x * new.x + old.y * new.y + old.z * new.z
    sign = -1.0 if cosine < 0.0 else 1.0
    half = math.acos(min(abs(cosine), 1.0))
    if half < 1e-6:  # sin is its argument to the last digits
        a, b = 1.0 - part, part * sign
    else:
        a, b = math.sin((1.0 - part) * half) / math.sin(half), sign * math.sin(part * half) / math.sin(half)
    return normalised([a * p + b * q for p, q in zip(old, new, strict=True)])


class OrientationSpring:
    """The spring of one hand, with its account: the device's part of the law.

    Attributes:
        proxy: Q(k), after the last tick.
        account: the sum of what the proxy's steps yielded, J.
        deposited: what of it was given to the bank, J; never falls.
        granted: what the bank has given, J; never falls.
        owed: what late ticks may have given out and nothing has paid for yet, J.
        late: what late ticks may have given out in all, J; never falls.
        held: ticks in which less than the proposed step was taken.
        most: the greatest torque, N*m; beyond it the proxy follows the device. It may change from tick to tick.

    Example:
        A wrist is turned about x by 0.1 rad, and the world holds its tool upright:

        >>> import math
        >>> import manyhands as mh
        >>> wrist = mh.OrientationSpring(stiffness=0.8, most=0.15)
        >>> tilted = mh.Quaternion(math.cos(0.05), math.sin(0.05))
        >>> print(f"{wrist.turn(tilted, mh.Quaternion())[0]:.4f} N*m")
        -0.0799 N*m
    """

    __slots__ = ("_k", "account", "deposited", "granted", "held", "late", "most", "owed", "proxy")

    def __init__(self, stiffness: float, most: float = math.inf, at: Quaternion = UPRIGHT) -> None:
        """Begin at rest, with the proxy at the device.

        Args:
            stiffness: k, N*m/rad.
            most: the greatest torque of the device, N*m; beyond it the proxy follows the device.
            at: the device's orientation.

        Raises:
            ValueError: the stiffness is not finite and positive, or the torque not positive.
        """
        if not 0.0 < stiffness < math.inf:
            raise ValueError(f"stiffness: found {stiffness!r} N*m/rad; expected a finite positive number")
        if not most > 0.0:
            raise ValueError(f"torque: found {most!r} N*m; expected a positive number")
        self._k, self.most = stiffness, most
        self.proxy = at
        self.account = self.deposited = self.granted = self.owed = self.late = 0.0
        self.held = 0

    def turn(self, R: Quaternion, proposed: Quaternion | None, granted: float = 0.0) -> Vector3:
        """The torque of this tick, N*m.

        Args:
            R: where the device is.
            proposed: the proxy that the world proposes; None where nothing came in time.
            granted: by the bank so far, J; what is less than before, came late.
        """
        self.granted = max(self.granted, granted)
        floor = self.deposited - self.granted  # the account is never below it
        if proposed is not None and proposed != self.proxy:
            step = yielded(self._k, R, self.proxy, proposed)
            if self.account + step < floor:
                self.held += step < -_ROUNDING * self._k
                proposed, step = self._part_of(R, proposed, floor)
            self.proxy, self.account = proposed, self.account + step
        t = torque(self._k, R, self.proxy)
        if t[0] * t[0] + t[1] * t[1] + t[2] * t[2] > self.most * self.most or angle(R, self.proxy) > math.pi / 2:
            t = self._follow(R)
        self.deposited = max(self.deposited, self.account + self.granted)
        return t

    def lacks(self, R: Quaternion, proposed: Quaternion) -> float:
        """What the account lacks for the whole step to ``proposed``, J; 0 where it has enough."""
        step = 0.0 if proposed == self.proxy else yielded(self._k, R, self.proxy, proposed)
        short = self.deposited - self.granted - self.account - step
        return short + _HAIR * self._k if short > 0.0 else 0.0

    def release(self, R: Quaternion) -> None:
        """Let go: the proxy comes to the device, and the torque is 0. What the spring had stored is lost."""
        self.account += yielded(self._k, R, self.proxy, R)
        self.proxy = R
        self.deposited = max(self.deposited, self.account + self.granted)

    def change(self, stiffness: float, R: Quaternion) -> None:
        """Take another stiffness, N*m/rad, at rest: the proxy comes to the device first, so that nothing is stored."""
        self.release(R)
        self._k = stiffness

    def lose(self, R: Quaternion) -> None:
        """Begin anew at R: the torque has ended at an unknown orientation, and what the spring had stored is lost."""
        self.proxy = R

    def charge(self, most: float) -> None:
        """Count a tick that was later than the damping pays for, and may have given out ``most``, J."""
        self.owed += most
        self.late += most

    def pay(self, energy: float) -> None:
        """Take ``energy`` off what is owed, J: it is forgiven, or was burnt while no torque acted."""
        self.owed = max(0.0, self.owed - energy)

    def _part_of(self, R: Quaternion, proposed: Quaternion, floor: float) -> tuple[Quaternion, float]:
        """The proxy a part of the step further, and what that yields; the part is found by halving."""
        least, most = 0.0, 1.0
        found, gained = self.proxy, 0.0
        for _ in range(_HALVINGS):
            part = 0.5 * (least + most)
            there = between(self.proxy, proposed, part)
            step = yielded(self._k, R, self.proxy, there)
            if self.account + step < floor:
                most = part
            else:
                least, found, gained = part, there, step
        return found, gained

    def _follow(self, R: Quaternion) -> Vector3:
        """Take the proxy towards the device until the torque is at most the greatest one; that yields 0 or more."""
        far = angle(R, self.proxy)
        near = math.asin(min(self.most / self._k, 1.0))
        # a hair less than the limit, for the turn is rounded
        there = between(self.proxy, R, 1.0 - min(near / far, 1.0) * (1.0 - 1e-12))
        self.account += yielded(self._k, R, self.proxy, there)
        self.proxy = there
        return torque(self._k, R, there)


class OrientationBank:
    """The world's part of the law: what hands have deposited is granted to those whose proxies need it.

    Attributes:
        balance: what may be granted still, J; never below 0.

    Example:
        >>> import manyhands as mh
        >>> bank = mh.OrientationBank(("left", "right"))
        >>> bank.deposit("left", 0.0)
        >>> bank.deposit("left", 0.002)
        >>> bank.grant("right", 0.005)
        0.002
    """

    __slots__ = ("_deposited", "_first", "_granted", "_lives", "_power", "balance")

    def __init__(self, hands: tuple[str, ...], tank: float = 0.0, power: Mapping[str, float] | None = None) -> None:
        """Open an account for each hand.

        Args:
            hands: their names.
            tank: what the world may give beyond what it was given, J; at least 0.
            power: by hand, what it can put in during a tick at most, J; None for no bound.
        """
        self._deposited: dict[str, float | None] = dict.fromkeys(hands)
        self._granted = dict.fromkeys(hands, 0.0)
        self._lives = dict.fromkeys(hands, 0.0)
        self._first = dict.fromkeys(hands, (0.0, 0))  # the first sum of a life, and its tick
        self._power = dict.fromkeys(hands, math.inf) if power is None else dict(power)
        self.balance = tank

    @property
    def granted(self) -> Mapping[str, float]:
        """By hand, what it was granted so far in its life, J."""
        return self._granted

    @property
    def lives(self) -> Mapping[str, float]:
        """By hand, the life that it was heard of last; 0 for none."""
        return self._lives

    def deposit(self, hand: str, total: float, life: float = FIRST_LIFE, tick: int = 0) -> None:
        """Take in what a hand says that it has deposited so far, J; what is less than before came late.

        The first sum of a life counts as spent already, for the bank itself may have started anew. No hand has
        deposited more than it can have put in since then, and what it was granted.

        Args:
            hand: its name.
            total: the sum, J, at least 0.
            life: of the hand's process; what is no life is not taken in.
            tick: k.
        """
        if not is_life(life):
            return
        if life != self._lives[hand]:
            self._lives[hand], self._deposited[hand], self._granted[hand] = life, None, 0.0
        before = self._deposited[hand]
        if before is None:
            self._deposited[hand], self._first[hand] = total, (total, tick)
            return
        first, since = self._first[hand]
        possible = first + max(1, tick - since) * self._power[hand] + self._granted[hand]
        more = min(total, possible) - before
        if more > 0.0:
            self._deposited[hand] = before + more
            self.balance += more

    def grant(self, hand: str, asked: float) -> float:
        """Grant a hand what its proxy's step needs, J, as far as the balance goes; returns the sum of its grants."""
        given = min(max(asked, 0.0), self.balance)
        self.balance -= given
        self._granted[hand] += given
        return self._granted[hand]
