"""What lateness does to a device, in joules (:class:`InterfaceAccount`), and its bound (:class:`DeviceInterface`).

**The account.** The certificate takes a device to be (share Delta_D)-OSP, from the force f(k) of its couplings to

    y(k) = (w(k) + K g(k))/T,    w(k) = x'(k) - x'(k-1),    g(k) = f(k) - f(k-1),    K = kappa T Delta_D^-1,

with x' the displacement that the couplings received. That holds as long as each force acts within the delay tau and
each period is within its tolerance. The device's own process can check it in every tick, whatever the hand intends. Let
r be the force that is really exerted, and let x move by d in a time h in which r is constant. The mechanism and its
passive hand take in r^T d, of which the device burns at least d^T Delta_D d / h (Cauchy-Schwarz). So with

    e(k) = sum over ticks of  f^T w + f^T K g - T y^T (share Delta_D) y
           - sum over pieces of  r^T d - d^T Delta_D d / h

the couplings have been given e(k) less than the device took in. At delays and periods that the certificate covers,
e(k) >= f^T K f / 2 >= 0. Beyond, e falls by the energy that lateness has put into the loop.

**The bound.** The interface keeps e(k) >= -(E_0 + P t) for every sequence of delays, by two means: how far x' follows
x, and how strongly and for how long a force acts. The proofs are in docs/decisions/0030-lateness-in-joules.md. They
rest on one inequality. Whatever the couplings answer to a motion w, a tick adds to e - f^T K f / 2 at least

    f(k-1)^T w - m w^T Delta_D w / T + c g^T T Delta_D^-1 g,    m = share + a^2/(b - c),
    a = 1/2 - share kappa,    b = kappa a,

with the c of the certificate's device. So B = E_0 + P t + e - f^T K f / 2 is known before the answer, and the
interface chooses w so that B stays above what the force may still cost until it is replaced or ends,

    R = h p(r),    p(r) = max over v of r^T v - v^T Delta_D v  <=  r^T Delta_D^-1 r / 4,

with h the time left, and v within the device's limit of speed. Where a mass and the hand's force are stated, v is
within what they allow as well (:mod:`manyhands.nodes.device.speed_bound`), until a motion shows that they are not so.
So the bound rests on that limit and on these statements: it holds for every motion that keeps them, on each axis and in
the mean over each piece. A faster one costs more than R holds by at most h (r^T Delta_D^-1 r / 4 - p(r)) a piece. It is
seen at the next sample at the earliest. Then the account is below its bound by no more than this excess, and nothing is
exerted until the motion has paid for it.

Of all motions that keep B >= R it takes the nearest to the real one. All that is missing stays as an offset x - x',
which is made up slowly, as far as the account pays for it. What is left is first for late forces: until there is a
reserve for the delays that were seen, nothing is made up. A force that lasts longer than B pays for ends by itself.

**A device's own latency** shifts its samples against its forces: the time of the account is that of the forces, and a
sample is of so much earlier. A force may then act after the next sample was taken. It is booked from when it acts, and
R holds all that still acts. No force ends before the device can be told.

**Held torques.** The motors of a linkage hold the torques t = J(q_k)^T r in place of r. Then the tip is pushed by
another force as it moves on, and a piece takes in t^T (q' - q) in place of r^T d. The two roles of Delta_D part then.
What couplings are promised is what held torques leave of it (:mod:`manyhands.design.levels.held_torque`): Delta_D in y,
K, m and c above stands for that. What the mechanism burns in a piece is d^T Delta_D d / h as before.

The driver states the work W of its motors, and a piece costs W - d^T Delta_D d / h. It does so in any number of pieces,
for W is their sum, and of their burns d^T Delta_D d / h is the least.

What a force may still cost is bounded by how far it may stray. After a path l since the joints were read the tip is
pushed by r and at most |r| (e^(kappa l) - 1) beside it. No force acts for longer than L after its sample, so that l is
at most v L with v the limit of speed. Each piece's work depends on the ends of its motion alone, so let every joint
have moved evenly (or the tip, where poses are ranges of its coordinates). That path is at most (2/kappa) arcsin(kappa
|d|/2) long, for its direction turns by no more than kappa for each unit of it. So with x = kappa v L < 2

    t^T (q' - q)  <=  r^T d + E |r| |d|,    E = s (e^(s x) - 1),    s = arcsin(x/2)/(x/2),

and p(r) holds with |r_i| + E |r| on each axis in place of |r_i|. So does all that follows from the stated inertia. The
bound then rests on the limit of speed of the whole path from the sample on, and on the poses that kappa is of. A driver
that cannot tell W is refused; where it cannot tell it once, the piece counts at h p(r).

**Dry friction** parts the two roles of Delta_D as well. A device that burns at least sum c_i |v_i| besides takes in
r^T d of a piece, and burns at least d^T Delta_D d / h + sum c_i |d_i| of it, for its way on an axis is at least |d_i|.
What couplings are promised is the level L = Delta_D + diag((c - w)/v*), less what held torques may give out, in y, K, m
and c above; w is what the certificate keeps for the steps of encoders (:mod:`manyhands.design.levels.dry_friction`).

*While every axis is no faster than v*, at the delays and periods that are covered, e(k) >= f^T K f / 2.* For then
|d_i| <= v* h in each piece, so that c_i |d_i| >= (c_i - w_i) d_i^2 / (v* h): a piece burns at least d^T L d / h, and
what holds of a device of the level L holds of this one. The mean over each piece is enough. Beyond v* a piece burns
less than that by at most sum (c_i - w_i) (d_i^2 / (v* h) - |d_i|), and e falls as it does by lateness. It is bounded
likewise, at every speed within the limit, with

    p(r) = max over v of sum (|r_i| - c_i) |v_i| - v^T Delta_D v,

so that a force of |r_i| <= c_i on each axis costs nothing, however long it acts and however fast the device is. The
several pieces of an unknown motion count as before, less c_i |d_i| for their sum d, or at h_j p(r_j) each. Friction
only brakes: how far a device comes by its inertia is bounded as without it, and R has |r_i| - c_i in place of |r_i|.

The whole c counts, without w: the account has the device's true displacements, and what the steps put in shows as the
work of the motion that was sent. That is paid by w_i |d_i| in a linear loop as a whole, and not in each account, so
that with steps e may fall below v* too. Then the bound holds, and nothing else is claimed.

**Measured displacements** are known to a step q, and c_i |d_i| would count steps and noise as ways. In place of it the
account books (c_i - w_i) z_i, with z_i what a play adds to the least way of all motions that the samples allow
(:mod:`manyhands.nodes.device.play`). The sum of z_i is at no sample more than the way that was gone, and so the account
never books more than c - w has burnt. Here w is taken off: the motion that is sent is the one that is booked, so that
what the steps put in does not show in e, and w_i |d_i| is what pays for it.

Only the sums are bounded, and not each piece. So the reserve counts nothing of this friction in advance, p(r) is as
without any, and what is booked is a gain on top: the induction is that of a device without friction. Below v* the
account may still fall, by what a play leaves out: (c_i - w_i) d_i^2 / (v* T) is promised of each step d_i = q of noise,
and nothing burnt. The tank pays for that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from manyhands.design.levels.contract import DeviceShare
from manyhands.design.levels.dry_friction import DryFriction
from manyhands.design.levels.held_torque import HeldTorque
from manyhands.design.levels.mechanism import NothingLeft, promised_level
from manyhands.nodes.device.given import ForceGiven
from manyhands.nodes.device.play import Play
from manyhands.nodes.device.speed_bound import SpeedBound
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.arithmetic import Floats, dot, linear_map, minus
from manyhands.nodes.kernel.bundle import DeviceBundle
from manyhands.nodes.kernel.inertia import Inertia
from manyhands.nodes.kernel.timeouts import longest_hold
from manyhands.protocol.clock import Duration, Instant, from_seconds

Matrix = NDArray[np.float64]

_NS: Final = 1e-9

_ROUNDING: Final = 1.0 + 1e-9  # of a displacement at the limit of speed: differences of positions, in doubles


class InterfaceAccount:
    """The account e(k) of one device.

    Attributes:
        burn: v -> Delta v, with Delta the level that is promised, N*s/m.
        compliance: f -> Delta^-1 f.
        balance: e - f^T K f / 2, J, with the motion received so far counted at its least. It has no answer to wait for.
        least: the least e so far, J; at most 0.
        f: the force f(k) that the couplings sent last, N.
        exerted: the force that the device exerts, N.
        until: the instant at which it ends by itself, since tick 0's; None where it is held.
        broken: the axis that has moved further than the stated inertia allows, which no longer counts since; or None.
    """

    def __init__(
        self,
        osp: Matrix,
        promise: DeviceShare,
        T: float,
        speed: Sequence[float],
        inertia: Inertia | None = None,
        level: Matrix | None = None,
        strays: float = 0.0,
        friction: Sequence[float] | None = None,
        play: Play | None = None,
    ) -> None:
        """Begin at rest in x = 0, without a force; time begins with the first sample.

        Args:
            osp: Delta_D, m_i x m_i, N*s/m.
            promise: kappa, share and c of the rung that the session begins with.
            T: period, s.
            speed: the device's limit of speed on each axis, m/s; a faster device lets go.
            inertia: what is stated of the device's mass and its hand; None where nothing is.
            level: what is promised at that rung, with what friction adds and less what held torques may give out; None
                for Delta_D.
            strays: E of :func:`straying`; 0 where the force itself is held.
            friction: c on each axis, N; with a play c - w; None for none.
            play: finds the ways that friction burns on, of measured displacements; None where the true ones are given.
        """
        self._T, self._speed, self._strays = T, tuple(speed), strays
        self._reach = None if inertia is None else SpeedBound(inertia)
        self._friction = None if friction is None else list(friction)
        self._play = play
        self.burns(osp)
        zero = [0.0] * osp.shape[0]
        self.f, self.exerted = zero, zero
        self.until: Instant | None = None
        self.balance = self.least = 0.0
        self._soft, self._stored = zero, 0.0  # Delta_D^-1 f, and f^T K f / 2
        self._x = zero
        self._at: Instant | None = None  # of the last call of sampled
        self._since = Instant(0)  # from which on the present force is exerted and not yet among the parts
        self._parts: list[tuple[Floats, int, int]] = []  # forces since the last sample, with beginning and end, ns
        self._moved: Floats | None = None  # w(k), until its answer
        self.broken: int | None = None
        self.change(promise, level)

    def burns(self, osp: Matrix) -> None:
        """Burn Delta_D of ``osp``, N*s/m, from now on; call this only before :meth:`change`."""
        joins = bool(np.any(osp - np.diag(np.diag(osp))))
        self._least: Floats = [float(np.linalg.eigvalsh(osp)[0])] * len(osp) if joins else np.diag(osp).tolist()
        self._burned, self._yields = linear_map(osp), linear_map(_inverse(osp))

    def change(self, promise: DeviceShare, level: Matrix | None = None) -> None:
        """Promise a different level from now on; call this only where the last two forces are zero."""
        self._share, self._kappa, self.weight = promise.share, promise.kappa, promise.weight
        self.burn = self._burned if level is None else linear_map(level)
        self.compliance = self._yields if level is None else linear_map(_inverse(level))

    @property
    def energy(self) -> float:
        """e(k), J."""
        return self.balance + self._stored

    def sampled(self, x: Floats, at: Instant, work: float | None = None) -> None:
        """The device was at x (m) at the instant ``at``: book what the forces have done since the last call.

        ``work`` is that of its motors since then, J; infinite where it is unknown this once. It is None where the force
        itself is held, whose work is r^T d.

        Where more than one force acted since then, each one's part d_j of the motion d is unknown. Then the parts count
        that cost most. With r the mean force over the time h,

            max of sum r_j^T d_j - d_j^T Delta_D d_j / h_j  =  r^T d - d^T Delta_D d / h
                                                            + sum h_j (r_j - r)^T Delta_D^-1 (r_j - r) / 4,

        and it is at most the sum of h_j times :meth:`cost`, with no limit on an axis that was seen to be faster. Of dry
        friction c |d_i| is booked, for the parts' ways are at least as long as their sum. Of measured displacements it
        is what the play finds, on top of that.
        """
        known, self._at = self._at, at
        last, self._x = self._x, x
        if self._play is not None and self._friction is not None:
            self.balance += dot(self._friction, self._play.moved(x))
        if known is None or at <= known:
            self._since = at
            return
        self._close(at)
        acted, self._parts = self._parts, []
        if acted[-1][2] > at:  # a force that was exerted already acts later than this sample was taken
            self._parts = [(r, max(begin, at), end) for r, begin, end in acted if end > at]
            acted = [(r, begin, min(end, at)) for r, begin, end in acted if begin < at]
        parts = [(r, (end - begin) * _NS) for r, begin, end in acted]
        h = (at - known) * _NS
        d = minus(x, last)
        reach = self._reach
        before = None if reach is None else reach.fastest
        if reach is not None:
            reach.saw(d, parts if self._strays == 0.0 else [(self._felt(r), h) for r, h in parts])
            if reach.broken is not None:  # what was stated is not so: from now on the limit of speed alone counts
                self.broken, self._reach = reach.broken, None
                before = None
        several = len(parts) > 1 or work == math.inf
        mean = parts[0][0]
        spread = 0.0
        if work is None and several:
            mean = [sum(r[axis] * time for r, time in parts) / h for axis in range(len(d))]
            for r, time in parts:
                beside = minus(r, mean)
                spread += 0.25 * time * dot(beside, self._yields(beside))
        cost = (dot(mean, d) if work is None else work) - dot(d, self._burned(d)) / h + spread
        if self._friction is not None and self._play is None:
            cost -= sum([c * abs(way) for c, way in zip(self._friction, d, strict=True)])
        if several:
            limits = zip(d, self._speed, strict=True)
            within = [v if abs(way) <= _ROUNDING * v * h else math.inf for way, v in limits]
            cost = min(cost, self._most_of(parts, within, before))
        self.balance -= cost

    def _most_of(self, parts: Sequence[tuple[Floats, float]], within: Sequence[float], u: Floats | None) -> float:
        """The most that forces r (N), which acted for h (s) each, can have cost from a speed of at most u on, J."""
        reach, total = self._reach, 0.0
        for r, h in parts:
            if reach is None or u is None:
                total += h * self.cost(r, within)
            else:
                felt = self._felt(r)
                total += h * self.cost(r, list(map(min, within, reach.speeds(u, felt, h))))
                u = reach.grown(u, felt, h)
        return total

    def _felt(self, r: Floats) -> Floats:
        """A bound of what pushes the tip on each axis while r (N) stands, N: r itself where it is held."""
        if self._strays == 0.0:
            return r
        beside = self._strays * math.hypot(*r)
        return [abs(force) + beside for force in r]

    def _close(self, at: Instant) -> None:
        """Keep how long the present force was exerted until ``at``, and how long none was after its end."""
        since, until = self._since, self.until
        if at <= since:
            return
        ended = at if until is None or until >= at else max(until, since)
        if ended > since:
            self._parts.append((self.exerted, since, ended))
        if at > ended:
            self._parts.append(([0.0] * len(self._x), ended, at))
        self._since = at

    @property
    def ahead(self) -> tuple[Instant, float]:
        """From when on the present force acts after the last sample, and what it costs at most until then, J.

        With a latency the forces before it may still act when a sample is taken.
        """
        parts = [(r, (end - begin) * _NS) for r, begin, end in self._parts]
        return self._since, self._most_of(parts, self._speed, self._fastest)

    @property
    def _fastest(self) -> Floats | None:
        """The bound u at the last sample, m/s."""
        return None if self._reach is None else self._reach.fastest

    def costs(self, r: Floats, begin: Instant, h: float) -> float:
        """The most that r (N) can cost if it acts for h (s) from ``begin`` on, J.

        Until ``begin`` the forces act that do so already.
        """
        reach = self._reach
        if reach is None:
            return h * self.cost(r)
        u = self._at_most(begin)
        return h * self.cost(r, list(map(min, self._speed, reach.speeds(u, self._felt(r), h))))

    def lasts(self, r: Floats, begin: Instant, paid: float) -> float:
        """For how long r (N) may act from ``begin`` on where ``paid`` (J, at least 0) is there for it, s.

        With an inertia it is the greater of paid/p(r) and the h of  sum |r_i| (u_i h + a_i h^2 / 2) = paid,  for what
        the motion burns is left out there.
        """
        power = self.cost(r)
        if power == 0.0:
            return math.inf
        reach = self._reach
        if reach is None or paid == 0.0:
            return paid / power
        rate, growth = reach.work(self._at_most(begin), self._felt(r))
        return max(paid / power, 2.0 * paid / (rate + math.sqrt(rate * rate + 2.0 * growth * paid)))

    def _at_most(self, begin: Instant) -> Floats:
        """The bound u at ``begin``, m/s: grown from the last sample on by the forces that act until then."""
        reach = self._reach
        if reach is None:
            raise AssertionError("asked only where an inertia is stated")
        u = reach.fastest
        for r, first, end in self._parts:
            u = reach.grown(u, self._felt(r), (end - first) * _NS)
        left = (begin - max(self._since, self._at or self._since)) * _NS
        return reach.grown(u, self._felt(self.exerted), left) if left > 0.0 else u

    def cost(self, r: Floats, speed: Sequence[float] | None = None) -> float:
        """p(r), W: the most that r (N) can cost in a second, the greatest r^T v - v^T Delta_D v, and more by torques.

        Dry friction takes c off the force on each axis, whose v is in the force's direction, where true displacements
        are given.
        The device moves at no more than its limit of speed in the mean: nothing enforces that between two samples.
        Where Delta_D joins axes, its least eigenvalue stands for it.

        Args:
            r: N.
            speed: the greatest |v| on each axis, m/s; None for the limits.
        """
        most_power, limits, felt, dry = (
            0.0,
            speed or self._speed,
            self._felt(r),
            None if self._play is not None else self._friction,
        )
        for axis in range(len(r)):
            size, d = abs(felt[axis]), self._least[axis]
            if dry is not None:
                size = max(0.0, size - dry[axis])
            v = min(size / (2.0 * d), limits[axis])
            most_power += v * (size - d * v)
        return most_power

    def least_gain(self, w: Floats) -> float:
        """The least that the answer to the motion w can add, f^T w - m w^T Delta_D w / T, J, f the last force."""
        return dot(self.f, w) - self.weight * dot(w, self.burn(w)) / self._T

    def received(self, w: Floats, gain: float) -> None:
        """The couplings received the motion w(k), m: book ``gain``, the least that their answer can add, J."""
        self.balance += gain
        self._moved = w

    def answered(self, f: Floats) -> None:
        """The couplings answered the motion with f(k), N: book what it adds above the least.

        Where ticks were left out, the answers in between are unknown. Then nothing is added.
        """
        w, self._moved = self._moved, None
        before, self.f = self.f, f
        soft, self._soft = self._soft, self.compliance(f)
        half = 0.5 * self._kappa * self._T
        if w is not None:
            g = minus(f, before)
            step = minus(self._soft, soft)
            a = 0.5 - self._share * self._kappa
            self.balance += 2.0 * a * (dot(g, w) + half * dot(g, step))
            if self.weight > self._share:
                self.balance += (self.weight - self._share) * dot(w, self.burn(w)) / self._T
        self._stored = half * dot(f, self._soft)

    def skipped(self) -> None:
        """The session has gone on to a later tick: the answer to the last motion, if any, will not be known."""
        self._moved = None

    def exert(self, r: Floats, at: Instant, until: Instant | None) -> None:
        """The device exerts r (N) from ``at`` on, until the next call and no longer than ``until``."""
        self._close(at)
        self.exerted, self.until = r, until
        self.least = min(self.least, self.energy)


def _inverse(level: Matrix) -> Matrix:
    return np.array(np.linalg.inv(level), dtype=np.float64)


def straying(held: HeldTorque, speed: Sequence[float], longest: float) -> float:
    """E, by which part the push on a tip may differ from the force that its motors' torques stand for.

    Args:
        held: how its torques are held.
        speed: its limit of speed on each axis, m/s; a tip that is faster on all of them counts as fast as ``held`` has.
        longest: L, for how long after its sample a force acts at most, s.

    Raises:
        ValueError: in that time a tip may turn too far for any bound.
    """
    x = held.kappa * max(held.speed, math.hypot(*speed)) * longest
    if not x < 2.0:
        raise ValueError(
            f"held: found a tip that may turn by {x:.3g} while a force is held for up to {longest:g} s; expected "
            "kappa times speed times that time to be less than 2"
        )
    s = math.asin(0.5 * x) / (0.5 * x)
    return s * math.expm1(s * x)


CALM: Final = 0.02
"""Part by which the delay that the interface expects follows the delay of each tick: it takes some 50 ticks."""

LONGEST: Final = 2.0
"""The longest delay that the interface expects, in periods: a single long one would make it hold back too much."""

PEAK: Final = 4.0
"""The longest delay that the tank holds a reserve for, in periods, where such delays are seen."""

MEMORY: Final = 2.0
"""s; the time constant with which the longest delay is forgotten. P makes up what a rarer one takes."""

IN_A_ROW: Final = 1.5
"""The reserve's time, in terms of a period with such a delay. After it nobody knows how fast the device moves, and the
next force may come late as well: one period alone would not pay for that."""

SAVED: Final = 0.5
"""Part of what a motion has brought that the tank keeps while an offset is left and the reserve is not full. More would
keep nearly every motion of a tapping hand from the couplings."""

REGAINED: Final = 0.2
"""Part of E_0 that a motion may be asked to bring back in a tick, of what late forces took since the last one. All of
it would throw the motion sent outwards by millimetres after a stall, for which the account counts the worst case."""

RECOVERY: Final = 0.3
"""s; the time constant with which an offset is made up. What is sent burns energy as a moving device does, so that a
fast return would cost the tank more than a slow one; and a force must not step."""

REST: Final = 1e-6
"""m; an offset that is made up in one tick."""

ROOM: Final = 2.0
"""What the tank holds beyond E_0, in terms of the cost that the present force may have in the expected time."""


class DeviceInterface:
    """A device's motion and force on their way to and from its couplings: the account e(k), kept above -E_0.

    That holds for every motion within the limit of speed (the module's docstring states what a faster one costs).

    A tick is :meth:`send`, :meth:`force` and :meth:`applied`. Without E_0 the account is only kept, and motion and
    force pass unchanged.

    Attributes:
        account: the account.
        tank: what is left of E_0 + P t, at least 0, J; it gains what the motion leaves over, up to a bound.
        allowed: E_0 + P t, how far e(k) may be below 0 now, J.
        margin: the least e(k) + E_0 + P t so far, J.
        given: how much of the force that was asked for the device exerted, by force and by time.
        ticks: the number of ticks in which the motion or the force was changed.
        kept_back: the energy that the changed motions kept from being lost, J.
        offset: the greatest offset so far between the device and the motion sent, of any axis, m.
        speed: the device's mean speed between the last two samples that were sent, m/s.
        shortened: whether the last :meth:`send` has brought :attr:`until` nearer, which the driver must be given.
    """

    def __init__(
        self,
        osp: Matrix,
        promise: DeviceShare,
        tau: float,
        tolerance: float,
        T: float,
        speed: Sequence[float],
        longest: Duration,
        allowance: LatenessAllowance | None,
        latency: Duration = Duration(0),  # noqa: B008 -- a number
        inertia: Inertia | None = None,
        held: HeldTorque | None = None,
        friction: DryFriction | None = None,
        steps: Sequence[float] | None = None,
    ) -> None:
        """Begin at rest in x = 0, with a full tank.

        Args:
            osp: Delta_D, m_i x m_i, N*s/m.
            promise: kappa, share and c of the rung that the session begins with.
            tau: the delay that the certificate covers, s.
            tolerance: the part of a period by which a period may be longer.
            T: period, s.
            speed: the device's limit of speed on each axis, m/s; a faster device lets go.
            longest: the longest time from a sample on for which its force is held, ns.
            allowance: E_0 and P, what lateness may put into the loop; None for no bound.
            latency: how much older than its call each sample is, and how much later than its call each force acts,
                together, ns.
            inertia: what is stated of the device's mass and its hand; None where nothing is.
            held: how its motors hold torques; None where the force itself is held.
            friction: what it burns of dry friction; None where nothing is stated.
            steps: q on each axis, m, to which the displacements are known that friction counts on; None for true ones.

        Raises:
            ValueError: of held torques nothing is left of Delta_D, or a tip may turn too far while a force is held.
        """
        self._T, self._osp, self._held, self._friction = T, osp, held, friction
        strays = 0.0 if held is None else straying(held, speed, longest * _NS)
        dry = None if friction is None else friction.least if steps is None else friction.left
        play, level = None if steps is None else Play(steps), self._left_by(tau, tolerance)
        self.account = InterfaceAccount(osp, promise, T, speed, inertia, level, strays, dry, play)
        self._bounded = allowance is not None
        self._allowance = allowance or LatenessAllowance(0.0)
        self.tank = self.allowed = self.margin = self._allowance.energy
        self._first: Instant | None = None  # instant of a force
        self._longest, self._latency, self._speed = longest, latency, tuple(speed)
        self._tau = self._expected = self._seen = tau
        self._tolerance = tolerance
        self._sent: Floats = [0.0] * len(speed)
        self._goal = self._sent
        self._x: Floats = self._sent  # of the sample
        self._at: Instant | None = None  # likewise
        self.speed, self.shortened = 0.0, False
        self._since = Instant(0)  # since when the present force is exerted
        self._exact = True  # whether the device knew where it was then
        self._sample: tuple[Floats, Instant, float | None, Floats, float] | None = None  # sent, and not booked yet
        self._answer: Floats | None = None  # likewise
        self._power = 0.0  # of the exerted force at the limit of speed, W
        self._booked, self._changed = 0.0, False
        self.ticks, self.kept_back, self.offset = 0, 0.0, 0.0
        self.given = ForceGiven(from_seconds(T))
        self._whole: Instant | None = None  # when the present force ends if the account does not bring that nearer
        self._next_whole: Instant | None = None  # likewise of the force that is decided and not applied yet
        self._lowered = False  # whether the account lowers that force
        self._drawn = 0.0  # the tank after the last motion was sent, less E_0 + P t, J

    @property
    def exerted(self) -> Floats:
        """The force that the device exerts, N."""
        return self.account.exerted

    @property
    def until(self) -> Instant | None:
        """The instant at which it ends by itself; None where it is held."""
        return self.account.until

    def withhold(self) -> None:
        """The force of the tick, which :meth:`force` has decided, is not exerted: it came too late to act."""
        self.ticks += not self._changed
        self._changed = self._lowered = True

    def change(self, promise: DeviceShare, tau: float, tolerance: float, osp: Matrix | None = None) -> None:
        """Follow a change of rung; call this only where the last two forces are zero.

        Args:
            promise: kappa, share and c of the rung.
            tau: the delay that it covers, s.
            tolerance: the part of a period by which a period may be longer.
            osp: Delta_D from now on, N*s/m; None for the same.
        """
        if osp is not None:
            self._osp = osp
            self.account.burns(osp)
        self.account.change(promise, self._left_by(tau, tolerance))
        self._tau, self._tolerance = tau, tolerance

    def _left_by(self, tau: float, tolerance: float) -> Matrix | None:
        """What is promised where the certificate covers these, N*s/m; None for Delta_D itself."""
        if self._held is None and self._friction is None:
            return None
        try:
            return promised_level(self._osp, self._held, self._friction, self._T, tau, tolerance)
        except NothingLeft as error:
            raise ValueError(
                f"held: found nothing left of Delta_D at a delay of {tau:g} s; expected a positive rest"
            ) from error

    def send(self, x: Floats, goal: Floats, now: Instant, work: float | None = None) -> Floats:
        """The displacement to send: the nearest to ``goal`` that is paid for.

        If the exerted force may last longer than the tank pays for, :attr:`until` comes nearer, and at most to ``now``.

        Args:
            x: the device's displacement, m.
            goal: what it would send without a bound, m.
            now: the instant of the call; the sample was taken earlier by the latency.
            work: of the motors until the sample, since the last work that was given, J, as of
                :meth:`InterfaceAccount.sampled`.
        """
        at = Instant(now - self._latency)
        self._settle()
        self.shortened = False
        account, before, last = self.account, self._sent, self._at
        if last is not None and at > last:
            self.speed = math.dist(x, self._x) / ((at - last) * _NS)
        self._x, self._at = x, at
        w = minus(goal, before)
        gain = account.least_gain(w)
        left = self._left(at)
        # a lower bound of the tank, whatever the motion since the last force has cost; most ticks need no more
        paid = self.tank + gain - (at - self._since) * _NS * self._power
        enough = paid >= (left * self._power if self._power > 0.0 else 0.0)
        if not self._bounded or (enough and self._exact and self._sent is self._goal):
            self._goal = self._sent = goal
            self._changed = False
            self._sample = x, at, work, w, gain
            return goal
        known = self.tank
        account.sampled(x, at, work)
        self._book()
        brought = max(0.0, self.tank - known)
        acts, committed = account.ahead  # with a latency, earlier forces may act until after this sample
        acts = max(acts, at)
        left = self._left(acts)
        expected = max(0.0, max(self._tau, self._expected) - (acts - at) * _NS)
        exerted = self._power > 0.0
        reserve = committed + (account.costs(account.exerted, acts, min(left, expected)) if exerted else 0.0)
        own = minus(goal, self._goal)
        offset = minus(self._goal, before)
        part = 1.0 if max(map(abs, offset)) <= REST else min(1.0, self._T / RECOVERY)
        wanted = w if part == 1.0 else [way + part * rest for way, rest in zip(own, offset, strict=True)]
        late = 0.0
        if exerted and self._sent is not self._goal and self._seen > self._tau:
            late = account.costs(account.exerted, acts, IN_A_ROW * ((1.0 + self._tolerance) * self._T + self._seen))
        cost, spare = self._recovery(own, wanted, max(reserve, late))
        if cost > spare:
            part *= spare / cost
            wanted = [way + part * rest for way, rest in zip(own, offset, strict=True)]
        regained = self.tank + REGAINED * self._allowance.energy
        reserve = max(reserve, min(late, regained, self._drawn + self.allowed + SAVED * brought))
        kept = self._nearest(wanted, reserve - self.tank)
        self._goal = goal
        self._changed = kept != wanted
        gain = account.least_gain(kept)
        if kept == w:
            self._sent = goal
        else:
            self._sent = [at + way for at, way in zip(before, kept, strict=True)]
            self.offset = max(self.offset, *(abs(to - at) for to, at in zip(goal, self._sent, strict=True)))
            self.kept_back += max(0.0, gain - account.least_gain(own))
        account.received(kept, gain)
        self._book()
        self._drawn = self.tank - self.allowed
        paid = self.tank - committed
        # a force of which motors exert nothing, limp as they are, may last: it costs nothing
        if account.cost(account.exerted) > 0.0 and paid < account.costs(account.exerted, acts, left):
            end = max(now, Instant(acts + int(1e9 * account.lasts(account.exerted, acts, max(0.0, paid)))))
            if account.until is None or end < account.until:
                self.shortened, account.until = True, end
        return self._sent

    @property
    def behind(self) -> float:
        """The offset between the device and the motion sent last, of any axis, m."""
        return max(map(abs, minus(self._goal, self._sent)))

    def force(self, f: Floats, held: Floats, at: Instant) -> tuple[Floats, Instant | None]:
        """Take the couplings' answer; returns what to exert from ``at`` on, and until when at the longest.

        The whole force is exerted where the tank pays for the time in which the next one is expected, and a part of it
        otherwise. The motion since the sample is not known yet. It counts at the most that it may have cost.

        Args:
            f: what the couplings sent, N.
            held: the part of it within the device's limits, N.
            at: the present instant.
        """
        self._answer = f
        self.given.ask(f, held)
        self._lowered = False
        if not self._bounded:
            return held, None
        account, T, sampled = self.account, self._T, at if self._at is None else self._at
        late = max(0.0, (at - sampled) * _NS)
        self._expected += CALM * (min(late, LONGEST * T) - self._expected)
        self._seen = max(min(late, PEAK * T), self._seen * (1.0 - T / MEMORY))
        expected = max(self._tau, self._expected)
        until = self._next_whole = Instant(sampled + self._longest)
        before, power = self._power, account.cost(held)
        self._power = power
        longest = (until - at) * _NS
        if self._sample is not None:  # nothing is booked yet: the least that the tank can hold
            paid = self.tank + self._sample[4] - (at - self._since) * _NS * before
            least = min(paid, self._most(power))
            if least >= power * longest:
                return held, until
        self._settle()
        self.tank = min(self.tank, self._most(power))
        if power > 0.0:
            acts, spent = account.ahead
            acts = max(acts, sampled)
            still = min(max(0.0, (at - acts) * _NS), self._left(acts))
            spent += account.costs(account.exerted, acts, still) if before > 0.0 else 0.0
            paid = max(0.0, self.tank - spent + account.least_gain(self._best(f)))
            needed = (1.0 + self._tolerance) * T + expected - late
            if account.costs(held, at, needed) > paid:
                ratio = self._part(held, at, needed, paid)
                held = [ratio * force for force in held]
                self._power = account.cost(held)
                self._changed = self._lowered = True
            if paid < account.costs(held, at, longest):
                until = Instant(at + int(1e9 * account.lasts(held, at, paid)))
        self.ticks += self._changed
        return held, until

    def applied(
        self, x: Floats | None, at: Instant, exerted: Floats, until: Instant | None, work: float | None = None
    ) -> Instant:
        """The device exerts ``exerted`` (N) from the instant ``at`` on, as :meth:`force` has decided.

        Args:
            x: where it was at that instant, m; None where it cannot tell. Then the account counts the worst case.
            at: the instant.
            exerted: N.
            until: the end of the force.
            work: of the motors until then, as of :meth:`send`; for nothing where ``x`` is None.

        Returns:
            The instant at which the force before had ended.
        """
        self._settle()
        before, whole = self.account.until, self._whole
        ended = at if before is None else min(before, at)
        early = before is not None and whole is not None and before < whole
        self.given.applied(at, ended, early, exerted, self._lowered)
        self._whole = self._next_whole
        self._exact = x is not None
        if x is not None:
            self.account.sampled(x, at, work)
            self._book()
        self._since = at
        self._grow(at)
        if self._bounded:
            self.tank = min(self.tank, self._most(self._power))
        self.account.exert(exerted, at, until)
        self.margin = min(self.margin, self.account.energy + self.allowed)
        return ended

    def released(self, at: Instant) -> None:
        """The device exerts no force from ``at`` on: no answer came in time."""
        until = self.account.until
        self.account.until = at if until is None else min(until, at)
        self.given.let_go()

    def conclude(self, at: Instant) -> None:
        """The process ends at ``at``."""
        until = self.account.until
        self.given.conclude(at, at if until is None else min(until, at))

    def skipped(self) -> None:
        """The session has gone on to a later tick: the answer to the motion sent last will not be known."""
        self._settle()
        self.account.skipped()
        self.given.skipped()

    def _settle(self) -> None:
        """Book what :meth:`send` and :meth:`force` have put off until nobody waits."""
        if self._sample is not None:
            x, at, work, w, gain = self._sample
            self._sample = None
            self.account.sampled(x, at, work)
            self.account.received(w, gain)
        if self._answer is not None:
            self.account.answered(self._answer)
            self._answer = None
        self._book()

    def _grow(self, at: Instant) -> None:
        """Put P into the tank, for the time since the force before."""
        first = self._first = at if self._first is None else self._first
        if self._allowance.power > 0.0:
            allowed = self._allowance.by((at - first) * _NS)
            self.tank += allowed - self.allowed
            self.allowed = allowed

    def _most(self, power: float) -> float:
        """The most that the tank may hold, J, so that an hour's motion does not pay for a minute's lateness."""
        return self._allowance.energy + ROOM * (self._T + max(self._tau, self._expected, self._seen)) * power

    def _book(self) -> None:
        """Take over what the account has booked since the last call."""
        balance = self.account.balance
        self.tank += balance - self._booked
        self._booked = balance

    def _left(self, at: Instant) -> float:
        """How long the exerted force may still last at ``at``, s."""
        until = self.account.until
        return math.inf if until is None else max(0.0, (until - at) * _NS)

    def _recovery(self, own: Floats, wanted: Floats, reserve: float) -> tuple[float, float]:
        """What it costs to make up an offset by moving ``wanted`` in place of ``own``, m, and what there is for it, J.

        Only what the tank has above ``reserve`` and E_0 is: an offset that took the rest would leave late forces
        without a reserve, and the hand would move in against less than was asked, which makes the offset greater
        again. The gain is concave in the motion, so that a part s of the way costs at most s of all.
        """
        there = self.account.least_gain(own)
        spare = self.tank + there - max(reserve, self._allowance.energy)
        return there - self.account.least_gain(wanted), max(0.0, spare)

    def _part(self, r: Floats, begin: Instant, h: float, paid: float) -> float:
        """The greatest part s of r that costs at most ``paid`` (J) in h (s) from ``begin`` on, to a thousandth."""
        low, high = 0.0, 1.0
        for _ in range(10):
            middle = 0.5 * (low + high)
            if self.account.costs([middle * force for force in r], begin, h) <= paid:
                low = middle
            else:
                high = middle
        return low

    def _best(self, f: Floats) -> Floats:
        """The motion along T Delta_D^-1 f / 2m, within the limit of speed, that adds most under f, m."""
        scale = self._T / (2.0 * self.account.weight)
        best = [scale * way for way in self.account.compliance(f)]
        part = min([1.0, *(v * self._T / abs(way) for way, v in zip(best, self._speed, strict=True) if way)])
        return best if part == 1.0 else [part * way for way in best]

    def _nearest(self, w: Floats, need: float) -> Floats:
        """The motion on the way from :meth:`_best` to w that adds at least ``need`` (J), and is nearest to w.

        The motions that add so much are a ball in the metric of Delta_D. Where the limit of speed does not bind, the
        way leads to its centre, so that the result is the nearest of all.
        """
        account = self.account
        there = account.least_gain(w)
        if there >= need:
            return w
        best = self._best(account.f)
        most = account.least_gain(best)
        if most <= need:
            return best
        way = minus(w, best)
        curve = account.weight * dot(way, account.burn(way)) / self._T
        slope = there - most + curve
        # (most - need) + slope s - curve s^2 = 0; of the two forms of the root the one without cancellation
        root = math.sqrt(slope * slope + 4.0 * curve * (most - need))
        s = (slope + root) / (2.0 * curve) if slope > 0.0 else 2.0 * (most - need) / (root - slope)
        return [at + min(1.0, s) * to for at, to in zip(best, way, strict=True)]


def interface_of(bundle: DeviceBundle) -> DeviceInterface:
    """The interface of a device in wall time, at rest; a force is held until it is stale, and one period more.

    What torques of six axes give out is paid for beside its account (:mod:`manyhands.nodes.device.covered`). So the
    device counts as one that burns what they leave, and holds the force itself. Its stated inertia bounds no speed
    then, for its tip is pushed by more than the force.
    """
    rung, T, twisting = bundle.rungs[0], bundle.common.period, bundle.twisting is not None
    return DeviceInterface(
        bundle.levels[0] if twisting else bundle.osp,
        rung.share,
        rung.tau,
        rung.period_tolerance,
        T,
        bundle.limits.speed,
        longest_hold(bundle.common),
        bundle.allowance,
        from_seconds(bundle.timing.latency),
        None if twisting else bundle.inertia,
        None if twisting else bundle.held,
        bundle.friction,
        bundle.measured,
    )
