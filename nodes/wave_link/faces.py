"""The two faces of a wave link.

A tick of the user's face, in the coupling's process:

    f_c = (I + b D_V/T)^-1 (h c - b (p - x_c(k-1))/T),    x_c = p + D_V f_c,    a = c - 2 h^-1 f_c;

a tick of the world's face, in the environment's process, which plays a coupling with D_V = T b^-1:

    p = x_e(k-1) + T b^-1 h c,    x_e = p + T b^-1 f_e,    a = c + 2 h^-1 f_e.

**A life** is one pair of sums. The first life of a link has the number 0. When one of the two processes has died, both
faces go on in a new life, under a number that the link never had: the survivor calls ``renew``, and the successor of
the dead one is made with E_0 = 0. Messages of other lives are ignored. The energy of a dead tank and the energy in
transit are lost, and none is made.

**How a life begins.** The user's face is free, f_c = 0, and its U is h^-1 b x_c. The world's face takes its position
from the first message, x_e = b^-1 h U, and has no message to send before that; the environment keeps the block's clutch
at s = 0 until the face is ``aligned``, and engages it then. So both faces agree on where the tool is. At the user the
force comes by a ramp.

**A silence.** A face that hears nothing for :data:`~manyhands.nodes.wave_link.play_out.HOLD_AFTER` seconds is
*holding*: it holds the tool by c = h^-1 f_c(k-1) at the user and c = -h^-1 f_e(k-1) at the world, which leaves w = 0 as
long as the force does not change. It ships nothing. When messages come again, the incoming wave goes over from that
wave to the time line's by a ramp of :data:`RAMP` seconds. The *backlog*, what the line is ahead of what was played, is
made up slowly, by a wave that changes no force by more than :data:`MAKE_UP`. So is a wave that the tank did not pay
for.

**The gap between both tools** is the right one in the end, -f R/2b, as long as each face keeps

    h P = b x_c + F_c,  h U = b x_c - F_c    (user),        h P = b x_e - F_e,  h U = b x_e + F_e    (world),

with one F in both: P is the sum that it has played, U the one that it sends. F is the impulse of the force while waves
are played. It may be anything else in a silence.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.kernel.arithmetic import Floats, dot, linear_map, minus, plus
from manyhands.nodes.kernel.site_bounds import SiteBounds
from manyhands.nodes.wave_link.play_out import PlayOut
from manyhands.nodes.wave_link.tank import Tank

Vector = NDArray[np.float64]

RAMP: Final = 0.1
"""Time in which the incoming wave goes over to the time line's, s."""

MAKE_UP: Final = 0.25
"""The greatest force of the wave that makes up for an outage, N."""

LONGEST_SKIP: Final = 0.25
"""The longest time without ticks whose waves a face books, s; after a longer one it takes the time line up by the
ramp."""

_MAKE_UP_TIME: Final = 0.3  # time constant of the same, s
_SPARE: Final = 1.0  # time constant with which spare energy goes to the other face, s
_RESERVE: Final = 0.25  # part of E_0 that is no spare energy
_GREATEST: Final = 1e12  # of G, and of the length of U
_SQUARE: Final = _GREATEST * _GREATEST
_NOTHING: Final[Floats] = []
_NO_RIDERS: Final[tuple[float, ...]] = ()


class Sums(NamedTuple):
    """What one face sends the other; :class:`manyhands.protocol.messages.Wave` carries all but the life.

    Attributes:
        n: the sender's tick; the receiver uses the newest only.
        U: sum of T a over the ticks in which the sender plays, m numbers, W^(1/2)*s.
        G: energy shipped in this life, J.
        life: the number of the life.
        buttons: those at the user's end that are held down in that tick.
        riders: what rides with the tick's motion or force (:mod:`manyhands.nodes.kernel.orientation`).
    """

    n: int
    U: tuple[float, ...]
    G: float
    life: int = 0
    buttons: int = 0
    riders: tuple[float, ...] = ()


class _Face(ABC):
    """What both faces share: the account, the play-out, and the outgoing sums.

    Attributes:
        tank: the energy account, with L, G, the G heard and the ticks in which L limited a wave.
        ledger: sum of the energy that entered the link at this port and of the harvest, J.
        life: the number of the life.
        n: ticks of this life; the next message has it.
        silent: ticks since the newest message.
        refused: messages that no honest face sends.
        buttons: those at this end that are held down, which the next message has.
        heard: those at the other end, by its newest message.
        riders: what rides with this end's next message.
        ridden: what rode with the other end's newest message; nothing before the first of a life.
    """

    def __init__(
        self,
        b: Vector,
        T: float,
        peer_T: float,
        depth: float,
        *,
        E_0: float = 0.0,
        theta: Vector | None = None,
        smoothing: float | None = None,
        life: int = 0,
        bounds: SiteBounds | None = None,
    ) -> None:
        """Start a life at rest.

        Args:
            b: the impedance, m x m, symmetric and positive definite, N*s/m; the same at both faces.
            T: this face's period, s.
            peer_T: the other face's period, s.
            depth: how far the play-out stays behind the newest message, ticks of the other face.
            E_0: the tank's energy at the start, J; 0 for the successor of a face that has died.
            theta: the level that the certificate leaves to this face, m x m, N*s/m; None for 0.
            smoothing: time constant of the incoming wave, ticks of this face, 1 or more; None for what fits the depth.
            life: the number of the life.
            bounds: what the site can do at most, to which the face keeps; None for no bounds.

        Raises:
            ValueError: a matrix or a number is not as described.
        """
        b = np.array(b, dtype=np.float64)
        _check(b, T, peer_T, depth, E_0, theta)
        if bounds is not None and len(bounds.wave) != len(b):
            raise ValueError(f"found bounds of {len(bounds.wave)} ports; expected {len(b)}, as b has")
        eigenvalues, Q = np.linalg.eigh(b)
        roots = np.sqrt(2.0 * eigenvalues)
        self._h: Vector = (Q * roots) @ Q.T
        self._h_inverse: Vector = (Q / roots) @ Q.T
        self._b, self._T, self._peer_T = b, T, peer_T
        self._reflected = linear_map(2.0 * self._h_inverse)
        self._held = linear_map(self._h_inverse)
        self._sum_at = linear_map(self._h_inverse @ b)  # U of a face that is at x without force
        self._theta = None if theta is None or not np.any(theta) else linear_map(np.array(theta, dtype=np.float64) / T)
        self._reserve, self._spare = _RESERVE * E_0, min(1.0, T / _SPARE)
        self._longest_skip = math.ceil(LONGEST_SKIP / T)
        self._most, self._part = T * MAKE_UP / float(roots[-1]), T / _MAKE_UP_TIME
        self._given_smoothing, self._smoothing = smoothing, 1.0
        self._play = PlayOut(T, peer_T, depth)
        self.set_depth(depth)
        self.tank = Tank(T, E_0)
        self.ledger = 0.0
        self.refused = 0
        self._bounds, self._lent = bounds, E_0
        self._steps = [] if bounds is None else [T * one for one in bounds.wave]  # the greatest of U in a tick
        self._firsts = [] if bounds is None else list(bounds.first_sum(b))  # the greatest U of a first message
        self._power = math.inf if bounds is None else T * bounds.power  # the greatest energy of a tick's wave, J
        self._hold = 0.0  # how far the idle wave of a user's face holds the tool; at 0 it leaves the tool free
        self._zero: Floats = [0.0] * len(b)
        self._x = self._f = self._c = self._before = self._slope = self._zero
        self._line = self._zero
        self._fade = 0.0  # way back through the ramp of F after the face has begun to hold the tool
        self._begin(life)

    def renew(self, life: int) -> None:
        """Begin a new life with the energy of this tank; the other face, or its successor, begins it as well."""
        self.tank.renew()
        self._play.renew()
        self._begin(life)

    def _begin(self, life: int) -> None:
        self.life, self.n, self.silent = life, 0, 0
        self.buttons = self.heard = 0
        self.riders = self.ridden = _NO_RIDERS
        self._U = self._backlog = self._zero
        self._played = self._played_before = self._zero  # P, the sum that was played, and that of the tick before
        self._along = 0.0  # way through the ramp, from 0 to 1
        self._away = True  # whether the time line is taken up anew
        self._follows = False  # whether c(k) is the time line's own wave
        self.aligned = False
        self._told, self._told_at = _NOTHING, 0  # U of the last message within the bounds, and its n
        self._joined = 0  # the tick in which the face was aligned

    def hear(
        self, n: int, U: Sequence[float], G: float, life: int = 0, buttons: int = 0, riders: tuple[float, ...] = ()
    ) -> bool:
        """Take a message of the other face; returns whether it is the newest of this life.

        An older one, a duplicate and one of a different life change nothing. Neither does one that no honest face
        sends: with numbers that are not finite, a G that has fallen, or a wrong number of ports.
        """
        if life != self.life or n <= self._play.newest:
            return False
        sums = list(U)
        if not (self.tank.heard <= G <= _GREATEST and len(sums) == len(self._zero) and dot(sums, sums) <= _SQUARE):
            self.refused += 1
            return False
        self.tank.receive(G)
        self._play.hear(n, sums)
        self.silent, self.heard, self.ridden = 0, buttons, riders
        return True

    def skip(self, ticks: int) -> None:
        """Go through ``ticks`` in which the process did not run: the tool was held, so that no energy passed.

        Then n keeps to the time, and each of these ticks has the waves c = h^-1 f_c (-h^-1 f_e at the world) and
        a = -c, with w = 0. Without them the other face would take a process that was late for a weaker force.
        """
        play = self._play
        self.n += ticks
        self.silent += ticks
        if play.newest < 0:
            return
        played = min(ticks, self._longest_skip)
        for _ in range(played):
            self._played_before = self._played
            self._line = play.advance()
            self._c = c = self._holding_wave()
            if play.jumped:  # the next tick goes over by the ramp
                play.place(play.depth)
            elif play.starved:
                self._start_holding()
                self._before = c
                self._keep_sums(self._zero, holding=True)
            elif not self._away and self._along == 1.0:
                self._stay(c)
        if played < ticks:
            play.run_on(ticks - played)
            play.place(play.depth)

    def _stay(self, c: Floats) -> None:
        """Play the wave that holds the tool for a tick, where the tank has its energy meanwhile."""
        T, tank = self._T, self.tank
        cost = 0.5 * T * dot(c, c)
        if cost > tank.level:
            return
        self._played = [at + T * wave for at, wave in zip(self._played, c, strict=True)]
        self._U = [at - T * wave for at, wave in zip(self._U, c, strict=True)]
        self._ship(min(cost, max(0.0, tank.level - self._reserve)))

    def _ship(self, s: float) -> None:
        """Ship the energy s, J, as far as the other face can know that this one has it: G <= E_0 + H + n T P."""
        tank = self.tank
        if self._bounds is not None:
            s = min(s, self._lent + tank.heard + self._power * (self.n - self._joined) - tank.shipped)
        tank.ship(s)

    @abstractmethod
    def _holding_wave(self) -> Floats:
        """The wave that holds the tool under the last force, W^(1/2)."""

    def message(self) -> Sums:
        """The sums up to the tick that was stepped last.

        With bounds, what is told of U follows U by no more than the greatest wave in a tick, for the other face admits
        nothing beyond it. What is left is told later.
        """
        U = self._U if self._bounds is None else self._within_reach(self._U)
        return Sums(self.n, tuple(U), self.tank.shipped, self.life, self.buttons, self.riders)

    def _within_reach(self, U: Floats) -> Floats:
        before, ticks = self._told, self.n - self._told_at
        if before:
            most = [ticks * step for step in self._steps]
        else:
            before, most = self._zero, self._firsts
        for i in range(len(U)):
            if not -most[i] <= U[i] - before[i] <= most[i]:
                U = [at + max(-by, min(by, to - at)) for at, to, by in zip(before, U, most, strict=True)]
                break
        self._told, self._told_at = U, self.n
        return U

    @property
    def wave(self) -> Floats:
        """The incoming wave c of the tick that was stepped last, W^(1/2)."""
        return self._c

    @property
    def x(self) -> Floats:
        """x_c or x_e of the tick that was stepped last, m."""
        return self._x

    @property
    def holding(self) -> bool:
        """Whether no message came for so long that this face holds the tool; so it is before the first one."""
        return self._play.starved

    @property
    def pressed(self) -> int:
        """The buttons at the other end that are held down; none of an end that is silent."""
        return 0 if self.holding else self.heard

    @property
    def rides(self) -> tuple[float, ...]:
        """What rides with the other end's motion or force; nothing of an end that is silent."""
        return _NO_RIDERS if self.holding else self.ridden

    @property
    def depth(self) -> float:
        """How far the play-out is behind the newest message, ticks of the other face; negative beyond it."""
        return self._play.lag()

    @property
    def latency(self) -> float:
        """What the play-out and the smoothing of this face add to the round trip, s."""
        return self._play.depth * self._peer_T + (self._smoothing - 1.0) * self._T

    @property
    def lag(self) -> float:
        """This end's time, n T, less the other's time up to which waves are played, s, and the smoothing.

        Both count from instants of their own. So only the sum over both ends says something: it is the round trip R,
        with the network and the waits for ticks, and no clocks have to agree for it.
        """
        play = self._play
        return self.n * self._T - (play.newest - play.lag()) * self._peer_T + (self._smoothing - 1.0) * self._T

    @property
    def wanted_depth(self) -> float:
        """The depth that was set last, ticks of the other face."""
        return self._play.depth

    def set_depth(self, depth: float) -> None:
        """Change the depth, ticks of the other face; the play-out jumps there, and the wave follows by the ramp."""
        self._play.place(depth)
        given = self._given_smoothing
        self._smoothing = max(1.0, 0.25 * depth * self._peer_T / self._T if given is None else given)
        self._gain = 1.0 / (self._smoothing * self._T)

    def approach_depth(self, depth: float) -> None:
        """Change the depth, ticks of the other face, while the tool is in use.

        The play-out goes there by 2 % of its rate, and the smoothing stays what it is.
        """
        self._play.depth = depth

    def measure(self, outliers: int = 0) -> None:
        """Begin to measure the depth that the messages need, except in so many ticks."""
        self._play.measure(outliers)

    @property
    def measured(self) -> float:
        """The depth at which no message since :meth:`measure` would have come too late, except in its outliers; ticks
        of the other face.
        """
        return self._play.measured()

    def _incoming(self, moved: Floats) -> Floats:
        """c(k), paid for; ``moved`` is how far the tool would go without force, m."""
        play = self._play
        self.silent += 1
        self._played_before = self._played
        line = play.advance()
        self._follows = not (play.starved or self._away or play.jumped or self._along < 1.0)
        if play.starved:
            self._start_holding()
            self._before = c = self._idle(moved)
        elif not self._follows:
            c = self._taken_up(line, moved)
        else:
            if self._backlog is not self._zero:
                self._backlog = self._made_up(self._backlog)
            gain, late, P = self._gain, self._backlog, self._played
            c = [gain * (line[i] - late[i] - P[i]) for i in range(len(P))]
        self._line = line
        self._c = paid = self.tank.pay(c if self._bounds is None else self._possible(c, self._bounds))
        if paid is not c and self._follows:
            # what the tank did not pay for, or the site cannot do, comes later, and not at once: a longer wave costs
            # more than two short ones
            missing = self._smoothing * self._T
            self._backlog = [late + missing * (to - at) for late, to, at in zip(self._backlog, c, paid, strict=True)]
        return paid

    def _possible(self, c: Floats, bounds: SiteBounds) -> Floats:
        """c(k) itself, or the longest wave in its direction within the bounds of the site."""
        beyond, most = 1.0, bounds.wave
        for i in range(len(c)):
            beyond = max(beyond, abs(c[i]) / most[i])
        return c if beyond == 1.0 else [along / beyond for along in c]

    def _start_holding(self) -> None:
        """Hold the tool from the next wave on."""
        if self._along > 0.0:
            self._hold, self._fade = 1.0, self._along
        self._along, self._away = 0.0, True

    def _taken_up(self, line: Floats, moved: Floats) -> Floats:
        """c(k) on the way from the wave before a silence to that of the time line.

        The forces of both faces differ meanwhile. Their impulse is not made up for, so what was played is set anew
        in each of these ticks; the backlog is what the motion before has left.
        """
        if self._away or self._play.jumped:
            if not self._away:
                self._before, self._hold = self._c, 1.0
            self._away, self._along = False, 0.0
            self._slope = self._before
            self._backlog = [
                to - at - (self._smoothing - 1.0) * self._T * by
                for to, at, by in zip(line, self._played, self._slope, strict=True)
            ]
        else:
            weight, gain = 1.0 / self._smoothing, 1.0 / self._T
            self._slope = [
                by + weight * (gain * (to - at) - by) for by, to, at in zip(self._slope, line, self._line, strict=True)
            ]
        self._along = min(1.0, self._along + self._T / RAMP)
        behind = (self._smoothing - 1.0) * self._T
        self._played = [to - late - behind * by for to, late, by in zip(line, self._backlog, self._slope, strict=True)]
        part = _eased(self._along)
        idle = self._before if self._hold == 1.0 else self._idle(moved)
        return [held + part * (to - held) for held, to in zip(idle, self._slope, strict=True)]

    @abstractmethod
    def _idle(self, moved: Floats) -> Floats:
        """The wave of a face that does not hear."""

    def _made_up(self, backlog: Floats) -> Floats:
        """What is left of the backlog after this tick."""
        size = math.hypot(*backlog)
        step = min(self._part * size, self._most)
        if size <= 1e-12:
            return self._zero
        return [at * (1.0 - step / size) for at in backlog]

    def _leave(self, g: Floats, x: Floats, before: Floats, harvests: bool) -> None:
        """Book the outgoing wave a = c + 2 h^-1 g, with g the force on the link, N, and ship energy."""
        tank, T = self.tank, self._T
        a = plus(self._c, self._reflected(g))
        moved, harvest = self._zero, 0.0
        if self._theta is not None or not self._follows:
            moved = minus(x, before)
            if self._theta is not None and harvests:
                harvest = dot(moved, self._theta(moved))
        cost = tank.cost
        own = tank.earn(a, harvest)
        self.ledger += own - cost + harvest  # by (S), the energy of the force along the motion
        self.n += 1
        holding = self._play.starved
        if self._follows:
            c, P, U = self._c, self._played, self._U
            self._played = [P[i] + T * c[i] for i in range(len(c))]
            self._U = [U[i] + T * a[i] for i in range(len(c))]
        else:
            self._keep_sums(moved, holding)
        if not holding:
            if self._along < 1.0 and self._hold == 1.0:  # what the wave of the silence costs is paid here
                own = max(0.0, own - (1.0 - _eased(self._along)) * 0.5 * T * dot(self._before, self._before))
            s = min(own, max(0.0, tank.level - self._reserve))
            spare = tank.level - s - self._reserve - self._play.owed
            if spare > 0.0:
                s += self._spare * spare
            self._ship(s)

    def _keep_sums(self, moved: Floats, holding: bool) -> None:
        """Keep P and U in a tick of a face that holds the tool, or did so a moment ago: h (P + U) = 2 b x, of any F.

        Two faces that hold have forces that need not agree, and the impulse of the difference would have to be made up
        for by a motion: 1 N*s is worth 2.5 cm at b = 20 N*s/m. So F stands still in a silence, after a ramp; and then
        it follows the other face's until the ramp back is over.
        """
        way, before = self._sum_at(moved), self._played_before
        if holding:
            self._fade = max(0.0, self._fade - self._T / RAMP)
            part, T = _eased(self._fade), self._T
            played = zip(before, way, self._c, strict=True)
            self._played = [at + by + part * (T * wave - by) for at, by, wave in played]
        sums = zip(self._U, way, self._played, before, strict=True)
        self._U = [at + 2.0 * by - (to - come) for at, by, to, come in sums]


class UserFace(_Face):
    """The face in the coupling's process: it plays the environment to one coupling block.

    A tick is :meth:`hear` for each message, :meth:`step`, :meth:`message`.

    Attributes:
        aligned: whether a message of this life was played; before that the face is free.
        free: whether the tick that was stepped last was a free end's, f_c = 0 and a = c, without energy or harvest.
    """

    def __init__(
        self,
        b: Vector,
        D_V: Vector,
        T: float,
        peer_T: float,
        depth: float,
        *,
        E_0: float = 0.0,
        theta: Vector | None = None,
        smoothing: float | None = None,
        life: int = 0,
        bounds: SiteBounds | None = None,
    ) -> None:
        """Start a life, free.

        Args:
            b: the impedance, m x m, symmetric and positive definite, N*s/m; the same at both faces.
            D_V: the block's feedthrough, m x m, m/N.
            T: the coupling's period, s.
            peer_T: the environment's period, s.
            depth: how far the play-out stays behind the newest message, ticks of the environment.
            E_0: the tank's energy at the start, J; 0 for the successor of a face that has died.
            theta: theta_c, m x m, N*s/m; None for 0.
            smoothing: time constant of the incoming wave, ticks of the coupling, 1 or more; None for what fits.
            life: the number of the life.
            bounds: what the site can do at most, to which the face keeps; None for no bounds.

        Raises:
            ValueError: a matrix or a number is not as described.
        """
        super().__init__(b, T, peer_T, depth, E_0=E_0, theta=theta, smoothing=smoothing, life=life, bounds=bounds)
        self._started = False
        self.free = True
        self._loose = 0  # ticks in which the face is still a free end, after a skip beyond LONGEST_SKIP
        self._let_go = self._zero  # the force from which a new life's ramp to 0 begins
        D_V = np.array(D_V, dtype=np.float64)
        if D_V.shape != self._b.shape:
            raise ValueError(f"found a feedthrough of shape {D_V.shape}; expected {self._b.shape}")
        closed = np.linalg.inv(np.eye(len(D_V)) + self._b @ D_V / self._T)
        self._driven, self._damped = linear_map(closed @ self._h), linear_map(closed @ self._b / self._T)
        self._deflection = linear_map(D_V)

    def renew(self, life: int) -> None:
        """Begin a new life with the energy of this tank; the force goes to 0 by a ramp, unless a message comes."""
        self._let_go, self._hold = self._f, 1.0 if any(self._f) else 0.0
        super().renew(life)

    def skip(self, ticks: int) -> None:
        """As for any face; after more than :data:`LONGEST_SKIP` it is a free end for :data:`RAMP`, before the ramp.

        A hand may have moved by any way meanwhile, for the device let go. Taken for the motion of one tick, that way
        would be a blow. The first samples may still be those of before.
        """
        super().skip(ticks)
        if self.aligned and ticks > self._longest_skip:
            self._loose = math.ceil(RAMP / self._T)

    def step(self, p: Floats) -> Floats:
        """f_c(k), N, for the block's free tool position p(k), m.

        The first p of all is where the tool is; the list is kept until the next call.
        """
        if not self._started:
            self._started, self._x = True, p
        before = self._x
        if not self.aligned:
            if self._play.newest >= 0:
                self.aligned, self._joined = True, self.n
                self._played = self._U = self._sum_at(before)
            elif self._hold == 0.0:  # a free end: both waves are h^-1 b w_c, and no energy passes
                self._x, self._U, self._f, self.free = p, self._sum_at(p), self._zero, True
                self._c = self.free_wave([to - at for to, at in zip(p, before, strict=True)])
                self.n += 1
                self.silent += 1
                return self._zero
            else:
                self._hold = max(0.0, self._hold - self._T / RAMP)
        moved = minus(p, before)
        if self._loose:
            return self._follow_freely(p, moved)
        self.free = False
        c = self._incoming(moved)
        self._f = f = self.force(c, moved)
        self._x = x = self.position(p, f)
        self._leave([-force for force in f], x, before, harvests=True)
        if not self.aligned:
            self._U = self._sum_at(x)
        return f

    def _follow_freely(self, p: Floats, moved: Floats) -> Floats:
        """A tick as a free end, f_c = 0 and x_c = p: a = c, so that no energy passes. A ramp follows."""
        self._loose, self.free = self._loose - 1, True
        self._x, self._f, self._c = p, self._zero, self.free_wave(moved)
        self._line, self._played_before, way = self._play.advance(), self._played, self._sum_at(moved)
        self._played, self._U = plus(self._played, way), plus(self._U, way)
        self._let_go = self._before = self._slope = self._zero
        self._hold = self._along = self._fade = 0.0
        self._away, self._follows = True, False
        self.n += 1
        self.silent += 1
        return self._zero

    def _idle(self, moved: Floats) -> Floats:
        """h^-1 f_c(k-1), which holds the tool; at the beginning of a life that of a force that goes to 0."""
        hold = self._hold
        if hold == 1.0:
            return self._holding_wave()
        f, T = [hold * force for force in self._let_go], self._T
        w = [(by + bent) / T for by, bent in zip(moved, self._deflection(f), strict=True)]
        return [motion + force for motion, force in zip(self._sum_at(w), self._held(f), strict=True)]

    def _holding_wave(self) -> Floats:
        """h^-1 f_c(k-1)."""
        return self._held(self._f)

    def force(self, c: Floats, moved: Floats) -> Floats:
        """f_c(k), N, for the wave c(k) and p(k) - x_c(k-1), m."""
        return minus(self._driven(c), self._damped(moved))

    def position(self, p: Floats, f: Floats) -> Floats:
        """x_c(k) = p(k) + D_V f_c(k), m."""
        return plus(p, self._deflection(f))

    def free_wave(self, moved: Floats) -> Floats:
        """The wave h^-1 b w_c of a free end, for p(k) - x_c(k-1), m."""
        return [by / self._T for by in self._sum_at(moved)]


class WorldFace(_Face):
    """The face in the environment's process: it plays a coupling with the feedthrough ``D_V`` = T b^-1.

    A tick is :meth:`hear` for each message, :meth:`tool`, :meth:`step`, :meth:`message`.

    Attributes:
        D_V: m x m, m/N; it never changes.
        aligned: whether a message of this life was played. The environment engages the block's clutch, and sends the
            face's messages, from then on; before that the clutch is at s = 0.
    """

    def __init__(
        self,
        b: Vector,
        T: float,
        peer_T: float,
        depth: float,
        *,
        E_0: float = 0.0,
        theta: Vector | None = None,
        smoothing: float | None = None,
        life: int = 0,
        bounds: SiteBounds | None = None,
    ) -> None:
        """Start a life at rest.

        Args:
            b: the impedance, m x m, symmetric and positive definite, N*s/m; the same at both faces.
            T: the environment's period, s.
            peer_T: the coupling's period, s.
            depth: how far the play-out stays behind the newest message, ticks of the coupling.
            E_0: the tank's energy at the start, J; 0 for the successor of a face that has died.
            theta: theta_e, m x m, N*s/m; None for 0.
            smoothing: time constant of the incoming wave, ticks of the environment, 1 or more; None for what fits.
            life: the number of the life.
            bounds: what the site can do at most, to which the face keeps; None for no bounds.

        Raises:
            ValueError: a matrix or a number is not as described.
        """
        super().__init__(b, T, peer_T, depth, E_0=E_0, theta=theta, smoothing=smoothing, life=life, bounds=bounds)
        self._hold = 1.0
        self.D_V = wave_feedthrough(self._b, T)
        self._deflection, self._driven = linear_map(self.D_V), linear_map(self.D_V @ self._h)
        self._place = linear_map(np.linalg.inv(self._b) @ self._h)  # x of a face without force, from U
        self._towards = linear_map(self._h_inverse @ self._b / T)  # the wave of a motion without force
        self._p = self._zero

    def tool(self) -> Floats:
        """p(k), m: the position that the tool takes without force."""
        if not self.aligned and self._play.newest >= 0:
            self.aligned, self._joined = True, self.n
            self._played = self._U = self._play.first
            self._x, self._f = self._place(self._U), self._zero
        self._p = self.free_position(self._x, self._incoming(self._zero))
        return self._p

    def step(self, f: Floats, harvests: bool = True) -> None:
        """Take f_e(k) at the face, N, for the last :meth:`tool`.

        Args:
            f: the environment's answer to this block, behind its clutch; the list is kept until the next call.
            harvests: whether theta_e is earned; not in a tick in which the block's clutch has s < 1.
        """
        before, self._f = self._x, f
        self._x = x = self.position(self._p, f)
        self._leave(f, x, before, harvests)

    def free_position(self, before: Floats, c: Floats) -> Floats:
        """p(k) = x_e(k-1) + T b^-1 h c(k), m."""
        return plus(before, self._driven(c))

    def position(self, p: Floats, f: Floats) -> Floats:
        """x_e(k) = p(k) + T b^-1 f_e(k), m."""
        return plus(p, self._deflection(f))

    @property
    def signals(self) -> tuple[Floats, Floats]:
        """p(k), m, and f_e(k), N, of the tick that was stepped last."""
        return self._p, self._f

    def _idle(self, moved: Floats) -> Floats:
        """-h^-1 f_e(k-1), which holds the tool."""
        return self._holding_wave()

    def _possible(self, c: Floats, bounds: SiteBounds) -> Floats:
        """The same within the bounds, and with p(k) no further than the tool of the site can be."""
        place, p = bounds.place, self.free_position(self._x, c)
        for i in range(len(p)):
            if abs(p[i]) > place[i]:
                p = [max(-most, min(most, at)) for at, most in zip(p, place, strict=True)]
                c = self._towards(minus(p, self._x))
                break
        return super()._possible(c, bounds)

    def _holding_wave(self) -> Floats:
        """-h^-1 f_e(k-1)."""
        return [-kept for kept in self._held(self._f)]


def wave_feedthrough(b: Vector, T: float) -> Vector:
    """D_V = T b^-1 of the world's face, m x m, m/N, with T the environment's period, s."""
    inverse = np.linalg.inv(b)
    feedthrough: Vector = T * (inverse + inverse.T) / 2.0
    return feedthrough


def _eased(along: float) -> float:
    """sin^2(pi/2 along): from 0 to 1 without a corner."""
    return math.sin(0.5 * math.pi * along) ** 2


def _check(b: Vector, T: float, peer_T: float, depth: float, E_0: float, theta: Vector | None) -> None:
    """Check the data of a face.

    Raises:
        ValueError: a matrix or a number is not as described.
    """
    m = b.shape[0] if b.ndim == 2 else 0
    if m == 0 or b.shape != (m, m) or not np.array_equal(b, b.T) or not np.linalg.eigvalsh(b)[0] > 0.0:
        raise ValueError(f"found an impedance b = {b.tolist()}; expected a symmetric, positive definite matrix")
    for name, found, unit in (("T", T, "s"), ("peer_T", peer_T, "s")):
        if not 0.0 < found < math.inf:
            raise ValueError(f"found a period {name} = {found!r} {unit}; expected a positive one")
    for name, found in (("depth", depth), ("E_0", E_0)):
        if not 0.0 <= found < math.inf:
            raise ValueError(f"found {name} = {found!r}; expected 0 or more")
    if theta is None:
        return
    level = np.array(theta, dtype=np.float64)
    if level.shape != (m, m) or not np.array_equal(level, level.T) or not np.linalg.eigvalsh(level)[0] >= 0.0:
        raise ValueError(f"found theta = {level.tolist()}; expected a symmetric, positive semidefinite matrix")
