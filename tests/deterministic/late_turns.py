"""Random sessions whose tools are turned in MuJoCo, by devices in wall time, at delays that no certificate covers.

``make orientation`` runs 500 of them. Each is designed, certified and cut into bundles as a launch does it, and runs at
drawn instants, as :mod:`tests.deterministic.lateness` has them. Some hands exert the torques of their session, others
are *hostile*: without inertia, they turn to and fro within some ticks, or along the torque that they feel, which draws
most out of it, at up to the greatest speed that their device states, and what its torque adds to that. Signals and
answers are lost.

What a hand has put in by turning, E, is computed from its way and the torques alone, with no number of the law. After
every sample it has to be at least

    kinetic energy + account - owed - P t,

the theorem of decision 54 with what late ticks may have given out: what is owed still, and what was forgiven in the
time t since the first of them began.
Four courses of each session:

- *covered*: every delay is within the certificate's tau. Nothing may be owed, and nothing is forgiven;
- *enforced*: delays of up to six periods or bursts of 20 tau, processes that stop for 50 ms, missed and early ticks,
  with the tank. What is owed may be above the tank by the last two late ticks alone;
- *weaker*: the covered course, where devices burn b/1.3 in place of b: E is seen to fall below in some;
- *uncharged*: the enforced course, where late ticks are not charged: E is seen to fall below -E_0 - P t in some.

In the first two, forces and ledgers keep what :mod:`tests.deterministic.lateness` asks of them, every account is at
least deposits less grants, and the accounts of all hands together are at least 0.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from manyhands.design.errors import DesignError
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import load_session
from manyhands.nodes.device.orientation import DeviceOrientation, TurnedBody
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import DeviceBundle, TurnedHand
from manyhands.nodes.kernel.orientation import (
    NO_RIDER,
    UPRIGHT,
    OrientationSpring,
    difference,
    turned_by,
)
from manyhands.protocol.clock import Duration, from_seconds, seconds
from tests.deterministic.lateness import Course, Generator, Late, Plan, Tree, random_design, run

ROUNDING: Final = 1e-9
"""Of what was put in and taken out: below it nothing may be given out. Turns of 1e-8 rad are sums of doubles."""

LOST: Final = 0.02
"""The part of signals, and of answers, that do not come."""

PIECES: Final = 4
"""In so many pieces of a period a hostile hand turns evenly at least."""

WEAKER: Final = 1.3


def hostile_hands(seed: int) -> frozenset[str]:
    """The devices of the session of this seed that are in hostile hands."""
    rng = np.random.default_rng([seed, 1])
    return frozenset(f"d{i}" for i in range(3) if rng.random() < 0.6)


def session_tree(rng: Generator) -> Tree:
    """A session file as plain data: one to three devices, whose tools are turned in MuJoCo, some of them in slots.

    Args:
        rng: the random numbers.
    """
    T = float(rng.choice([1e-3, 1e-3, 5e-4, 2e-3]))
    devices: Tree = {}
    tools: list[str] = []
    for i in range(int(rng.integers(1, 4))):
        devices[f"d{i}"] = _device(rng, T, turns=i == 0 or rng.random() < 0.7)
        tools.append(_tool(rng, f"d{i}", i, T, devices[f"d{i}"].get("orientation")))
    careful = rng.random() < 0.7
    model = (
        f'<mujoco><option timestep="{T / 2}" integrator="{"implicitfast" if careful else "Euler"}" gravity="0 0 0"/>'
        f'<default><geom solref="{4 * T} 1" friction="0.6 0.005 0.0001"/></default><worldbody>{"".join(tools)}'
        '<body name="thing" pos="0 0.04 0"><freejoint/><geom type="box" size="0.05 0.01 0.01" mass="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    turning = [device["orientation"] for device in devices.values() if "orientation" in device]
    late = max(of["osp"] * of["limits"]["speed"] ** 2 * T for of in turning)
    return {
        "session": "late-turns",
        "period": T,
        "devices": devices,
        "couplings": {f"c{i}": {"devices": [name]} for i, name in enumerate(devices)},
        "environment": {
            "type": "engine",
            "engine": "mujoco",
            "stiffness": round(float(10.0 ** rng.uniform(2.3, 3.3)), 1),
            "tools": {name: [f"{name}_{axis}" for axis in "xyz"] for name in devices},
            "avatars": {name: f"{name}_turn" for name, device in devices.items() if "orientation" in device},
            "bodies": ["thing"],
            "model": model,
        },
        "design": {**random_design(rng, T), "period_tolerance": float(rng.choice([0.0, 0.1, 0.3]))},
        # in the size of what one late tick is charged with, at the greatest stiffness
        "faults": {
            "tank": {
                "energy": min(1.0, late * float(10.0 ** rng.uniform(0.0, 2.0))),
                "power": min(1.0, late / T * float(10.0 ** rng.uniform(-3.0, -0.5))),
            }
        },
    }


def _device(rng: Generator, T: float, turns: bool) -> Tree:
    osp = [round(float(10.0 ** rng.uniform(-0.5, 0.8)), 3) for _ in range(3)]
    hertz = rng.uniform(0.5, 8.0)
    device: Tree = {
        "dof": 3,
        "osp": osp,
        "driver": "simulated",
        "mass": [round(float(10.0 ** rng.uniform(-1.3, 0.3)), 4) for _ in osp],
        "limits": {"hand": 500.0},
        "hand": {
            "stiffness": round(float(10.0 ** rng.uniform(1.0, 3.0)), 2),
            "damping": round(float(rng.uniform(0.0, 5.0)), 3),
            "motion": [f"{size:.5f}*sin(2*pi*{hertz:.3f}*t)" for size in rng.uniform(-0.02, 0.02, 3)],
        },
    }
    if turns:
        b, speed = float(10.0 ** rng.uniform(-4.0, -2.3)), float(10.0 ** rng.uniform(0.7, 1.8))
        # some torques alone turn it faster than its greatest speed
        most = 10.0 ** float(rng.uniform(-0.7, 1.0)) * b * speed
        sizes, beats = rng.uniform(-0.25, 0.25, 3) * b * speed, 10.0 ** rng.uniform(-0.3, 2.0, 3)
        device["orientation"] = {
            "osp": b,
            "limits": {"torque": most, "speed": speed},
            "inertia": b * T * float(10.0 ** rng.uniform(-1.0, 1.5)),
            "torque": [f"{size:.6g}*sin(2*pi*{beat:.3f}*t)" for size, beat in zip(sizes, beats, strict=True)],
        }
    return device


def _tool(rng: Generator, name: str, place: int, T: float, orientation: Tree | None) -> str:
    """An avatar, heavy enough for any spring that is proved for its device; in every other case in a slot."""
    slides = "".join(
        f'<joint name="{name}_{axis}" type="slide" axis="{along}" damping="1"/>'
        for axis, along in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    z, ball, mass, inertia = 0.05 * (place - 1), "", 0.1, 1e-5
    if orientation is not None:
        b = orientation["osp"]
        inertia = 10.0 * b * T * float(10.0 ** rng.uniform(0.0, 2.0))  # at least 4 k T^2, with k at most 2 b/T
        ball = f'<joint name="{name}_turn" type="ball" damping="{b * rng.choice([0.0, 1.0, 3.0]):.6g}"/>'
    rails = ""
    if rng.random() < 0.5:
        rails = "".join(f'<geom type="box" pos="0 {y} {z}" size="0.03 0.002 0.02"/>' for y in (-0.0072, 0.0072))
    return (
        f'{rails}<body pos="0 0 {z}">{slides}{ball}'
        f'<inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia:.6g} {inertia:.6g} {inertia:.6g}"/>'
        '<geom type="capsule" fromto="-0.025 0 0 0.025 0 0" size="0.005"/></body>'
    )


class Instants(Plan):
    """The instants of one run: covered, periods vary as the certificate allows, for all devices alike; beyond, delays
    are up to six periods in every other session, and in the others late by bursts and stops alone.
    """

    def __init__(self, tau: int, period: int, kind: str, seed: int, rho: float) -> None:
        """Draw them; ``rho`` is the certificate's tolerance of periods."""
        super().__init__(tau, period, kind, seed)
        self._varies = max(0, min(int(rho * period), period - tau))
        self._drawn: dict[int, int] = {}
        self._base = tau // 2 if seed % 2 else 3 * period

    def wake(self, due: int) -> int:
        """When a sample is taken that is due at ``due``."""
        if self.kind != "covered":
            return super().wake(due)
        if due not in self._drawn:
            self._drawn[due] = int(self._rng.integers(0, self._varies + 1))
        return due + self._drawn[due]


class MeteredBody(TurnedBody):
    """A simulated device, of which is known what its hand puts in.

    Attributes:
        put_in: what the hand has put in, J.
        work: the sum of the sizes of what that is made of, J.
    """

    def __init__(self, of: TurnedHand, T: float) -> None:
        """Begin at the instant 0."""
        super().__init__(of, T)
        self.put_in = self.work = 0.0
        self._inertia = of.inertia

    @property
    def kinetic(self) -> float:
        """Its kinetic energy, J."""
        return 0.5 * self._inertia * sum(omega * omega for omega in self._omega)

    def _move(self, dt: float) -> None:
        before, u, own = self._omega, self._u, self._hand
        super()._move(dt)
        # J domega/dt + b omega = own + u: what omega has turned by in dt
        turns = [
            ((o + t) * dt - self._inertia * (w - v)) / self._damping
            for o, t, v, w in zip(own, u, before, self._omega, strict=True)
        ]
        given = [o * turn for o, turn in zip(own, turns, strict=True)]
        self.put_in += sum(given)
        self.work += sum(map(abs, given)) + sum(abs(t * turn) for t, turn in zip(u, turns, strict=True))


class HostileBody(MeteredBody):
    """A device without inertia, whose hand turns it as draws most out of it."""

    def __init__(self, of: TurnedHand, T: float, b: float, speed: float, seed: int) -> None:
        """Begin upright.

        Args:
            of: what it burns.
            T: period, s.
            b: what it is taken to burn, N*m*s/rad.
            speed: the greatest, rad/s.
            seed: of its ways.
        """
        super().__init__(of, T)
        self._b, self._speed, self._rng = b, speed, np.random.default_rng(seed)
        self._way, self._axis, self._rate, self._left, self._half = 0, np.zeros(3), 0.0, 0, 1
        self._inertia = 0.0

    def _move(self, dt: float) -> None:
        for _ in range(PIECES):
            self._turn(dt / PIECES)

    def _turn(self, dt: float) -> None:
        number = self._begun
        if number >= self._left:
            rng = self._rng
            # some do one thing for good, for what a hand burns by other ways hides what it gains
            for_good = rng.random() < 0.7
            self._half = int(rng.choice([1, 1, 2, 3, 5]))
            self._left = number + (10**9 if for_good else int(rng.integers(2, 40)))
            self._way = int(rng.integers(3) if for_good else rng.integers(5))
            self._axis = rng.standard_normal(3)
            self._axis /= np.linalg.norm(self._axis)
            self._rate = self._speed * 10.0 ** rng.uniform(-1.0, 0.0)
        u = np.array(self._u)
        back = number // self._half % 2 == 1
        swing = self._axis * (self._rate if back else -self._rate)
        if self._way == 0 or (self._way == 1 and back):  # along the torque, always or back from where it turned to
            # a push where there is none: a spring that is late for its damping makes more of it
            omega = u * (0.5 / self._b) if float(np.linalg.norm(u)) > 0.1 * self._b * self._rate else swing
        elif self._way in (1, 2):  # to and fro
            omega = swing
        elif self._way == 3:  # upright again
            w, *v = difference(UPRIGHT, self.R)
            omega = np.array(v) * math.copysign(2.0 / dt, w)
        else:
            omega = self._rng.standard_normal(3) * 0.5 * self._rate
        most = self._speed + float(np.linalg.norm(u)) / self._b  # what its torque adds to the hand's own
        omega = omega * min(1.0, most / max(float(np.linalg.norm(omega)), 1e-300))
        burnt, given = self._damping * float(omega @ omega) * dt, float(u @ omega) * dt
        self.put_in += burnt - given
        self.work += burnt + abs(given)
        self.R = turned_by(self.R, (omega * dt).tolist())


class Uncharged(OrientationSpring):
    """A spring whose late ticks cost nothing."""

    __slots__ = ()

    def charge(self, most: float) -> None:
        """Charge nothing."""


@dataclass
class Turned:
    """What became of the orientations of one run.

    Attributes:
        below: by how much E was below its bound at most, J; 0 where it never was.
        beyond: by how much E was below -E_0 - P t at most, less what its account has lent, J.
        owing: by how much more was owed than the tank and the last two late ticks, J; 0 where it never was.
        margin: the least distance of an account from deposits less grants, J.
        accounts: the least sum of the accounts of all hands, J.
        late: what late ticks may have given out in all, J.
        let_go: ticks in which a device has let go.
        torques: ticks with a torque.
        put_in: what hands have put in and taken out, J.
    """

    below: float = 0.0
    beyond: float = 0.0
    owing: float = 0.0
    margin: float = 0.0
    accounts: float = 0.0
    late: float = 0.0
    let_go: int = 0
    torques: int = 0
    put_in: float = 0.0
    hands: list[OrientationSpring] = field(default_factory=list)


class TurningLate(Late):
    """A device in wall time whose orientation is watched."""

    def __init__(
        self,
        bundle: DeviceBundle,
        allowance: LatenessAllowance | None,
        latency: int = 0,
        hostile: bool = False,
        *,
        told: Turned,
        seed: int,
        weaker: float = 1.0,
        charged: bool = True,
    ) -> None:
        """Begin upright.

        Args:
            bundle: of the device.
            allowance: what lateness may put in.
            latency: none.
            hostile: whether its hand is.
            told: what becomes of it.
            seed: of its ways, and of what is lost.
            weaker: it burns b over this.
            charged: whether late ticks are.
        """
        super().__init__(bundle, allowance, latency)
        self._told, self._allowance, self._rng = told, allowance, np.random.default_rng(seed)
        self._charges, self._before, self._first = [0.0, 0.0], 0.0, math.inf
        turning, part = self.tick.orientation, bundle.orientation
        self._turning: DeviceOrientation | None = turning
        if turning is None or part is None:
            return
        T = bundle.common.period
        of = replace(part.source, damping=part.source.damping / weaker)
        body = HostileBody(of, T, part.osp / weaker, part.speed, seed) if hostile else MeteredBody(of, T)
        self._body = turning._body = body
        if not charged:
            turning.spring = Uncharged(part.stiffness, part.torque)
        told.hands.append(turning.spring)

    @property
    def rides(self) -> Sequence[float]:
        """What rides with its sample, where that is not lost."""
        found = self.tick.rides
        return [0.0] * len(found) if self._rng.random() < LOST else found

    def sample(self, at: int) -> list[float]:
        """Sample, and hold what its hand has put in against the bound."""
        turning = self._turning
        late = 0.0 if turning is None else turning.spring.late
        sent = super().sample(at)
        if turning is not None:
            self._judge(turning, turning.spring.late - late)
        return sent

    def _judge(self, turning: DeviceOrientation, charge: float) -> None:
        told, spring, body = self._told, turning.spring, self._body
        allowance = self._allowance or LatenessAllowance(0.0)
        now = seconds(Duration(self.sampled))
        if charge > 0.0:
            self._charges = [self._charges[1], charge]
            self._first = min(self._first, self._before)  # a late tick is forgiven from its beginning on
        self._before = now
        forgiven = allowance.power * max(0.0, now - self._first)
        kept, rounding = body.put_in - body.kinetic - spring.account, ROUNDING * body.work
        told.below = min(told.below, kept + spring.owed + forgiven + rounding)
        told.beyond = min(told.beyond, kept + allowance.by(now) + rounding)
        if self._allowance is not None:
            told.owing = max(told.owing, spring.owed - allowance.energy - sum(self._charges) - rounding)

    def answer(self, f: list[float], at: int, came: Sequence[float] = NO_RIDER) -> None:
        """Answer; what came for the orientation may be lost."""
        super().answer(f, at, NO_RIDER if self._rng.random() < LOST else came)
        turning, told = self._turning, self._told
        if turning is None:
            return
        spring = turning.spring
        told.margin = min(told.margin, spring.account - (spring.deposited - spring.granted))
        told.accounts = min(told.accounts, sum(hand.account for hand in told.hands))
        told.torques += any(turning.torque)

    def end(self) -> None:
        """Count what it has done in all."""
        if self._turning is not None:
            self._told.late += self._turning.spring.late
            self._told.let_go += self._turning.let_go
            self._told.put_in += self._body.work


def course(
    prepared: Prepared, seed: int, kind: str, ticks: int, weaker: float = 1.0, charged: bool = True
) -> tuple[Course, Turned]:
    """Run a session at the instants of ``seed``, covered or beyond."""
    assert prepared.certificate is not None
    session, told = prepared.session, Turned()
    hostile = [name for name in session.devices if name in hostile_hands(seed)]
    own = prepared.certificate
    plan = Instants(from_seconds(own.tau), from_seconds(session.period), kind, seed, own.period_tolerance)
    made: list[TurningLate] = []

    def make(bundle: DeviceBundle, allowance: LatenessAllowance | None, latency: int, is_hostile: bool) -> Late:
        own = seed * 10 + len(made)
        made.append(
            TurningLate(bundle, allowance, latency, is_hostile, told=told, seed=own, weaker=weaker, charged=charged)
        )
        return made[-1]

    found = run(prepared, plan, ticks, session.faults.tank, hostile=hostile, make=make)
    for device in made:
        device.end()
    return found, told


@dataclass(frozen=True)
class Outcome:
    """The four courses of one session."""

    seed: int
    tank: float
    tau: float
    covered: tuple[Course, Turned]
    enforced: tuple[Course, Turned]
    weaker: Turned
    uncharged: Turned

    @property
    def violations(self) -> tuple[str, ...]:
        """A sentence for each promise that was not kept."""
        found = []
        for name, (run_of, turned) in (("within tau", self.covered), ("beyond", self.enforced)):
            if run_of.broken:
                found.append(f"{name}: {run_of.broken}")
            for what, least in (
                ("less put in by turning than its bound", turned.below),
                ("an account below deposits less grants", turned.margin),
                ("accounts below 0 in all", turned.accounts),
                ("more owed than the tank and two ticks", -turned.owing),
            ):
                if least < -1e-15:
                    found.append(f"{name}: found {what} by {-least:.3g} J; expected none")
        if self.covered[1].late:
            found.append(f"within tau: found late ticks charged with {self.covered[1].late:.3g} J; expected none")
        if self.covered[0].least < -1e-9:
            found.append(f"within tau: found an account of a force at {self.covered[0].least:.3g} J; expected 0 J")
        if self.enforced[0].margin < -1e-9:
            found.append(f"beyond: found an account of a force {-self.enforced[0].margin:.3g} J below its bound")
        return tuple(found)


def prepared_session(seed: int) -> Prepared | None:
    """The random session of this seed with its certificate; None where nothing can be certified."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "late.yaml"
        path.write_text(json.dumps(session_tree(np.random.default_rng(seed))))
        try:
            return prepare(load_session(path))
        except DesignError:
            return None


def outcome_of(seed: int, ticks: int) -> Outcome | None:
    """Design and run the session of this seed; None where nothing can be certified."""
    prepared = prepared_session(seed)
    if prepared is None or prepared.certificate is None:
        return None
    return Outcome(
        seed,
        prepared.session.faults.tank.energy,
        prepared.certificate.tau / prepared.session.period,
        course(prepared, seed, "covered", ticks),
        course(prepared, seed, "beyond", ticks),
        course(prepared, seed, "covered", ticks, weaker=WEAKER)[1],
        course(prepared, seed, "beyond", ticks, charged=False)[1],
    )


def campaign(sessions: int, ticks: int, seed: int, processes: int) -> Iterator[Outcome]:
    """The outcomes of this many certified sessions, in the order in which they end."""
    done = 0
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for outcome in pool.imap_unordered(partial(outcome_of, ticks=ticks), range(seed, seed + 100 * sessions)):
            if outcome is None:
                continue
            yield outcome
            done += 1
            if done == sessions:
                return


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign; returns 1 if a promise was not kept, or if nothing would have happened otherwise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=500, help="certified sessions to run (500)")
    parser.add_argument("--ticks", type=int, default=200, help="ticks of each run (200)")
    parser.add_argument("--seed", type=int, default=1, help="of the first session (1)")
    parser.add_argument("--processes", type=int, default=2, help="processes to share the work (2)")
    asked = parser.parse_args(arguments)
    outcomes: list[Outcome] = []
    for outcome in campaign(asked.sessions, asked.ticks, asked.seed, asked.processes):
        outcomes.append(outcome)
        for text in outcome.violations:
            print(f"seed {outcome.seed}: {text}", flush=True)  # noqa: T201 -- what a campaign is for
        if len(outcomes) % 50 == 0:
            print(f"{len(outcomes)} of {asked.sessions}", file=sys.stderr, flush=True)  # noqa: T201
    bad = sum(bool(outcome.violations) for outcome in outcomes)
    weaker = sum(outcome.weaker.below < 0.0 for outcome in outcomes)
    uncharged = sum(outcome.uncharged.beyond < 0.0 for outcome in outcomes)
    both = [turned for o in outcomes for turned in (o.covered[1], o.enforced[1])]
    beyond = [o.enforced[1] for o in outcomes]
    say = partial(print, flush=True)
    say(f"{len(outcomes)} sessions, {sum(c.ticks for o in outcomes for c, _ in (o.covered, o.enforced))} ticks with a")
    say(f"torque in {sum(t.torques for t in both)} samples, {sum(t.put_in for t in both):.3g} J put in and taken out")
    say(f"least margin of an account {min(t.margin for t in both):.3g} J, of all {min(t.accounts for t in both):.3g} J")
    say(f"put in below the bound by {abs(min(t.below for t in both)):.3g} J at most")
    say(f"beyond tau {sum(t.late for t in beyond):.3g} J charged, {sum(t.let_go for t in beyond)} ticks let go")
    say(f"at b/{WEAKER:g} {weaker} sessions below, by up to {-min(o.weaker.below for o in outcomes):.3g} J")
    say(f"not charged {uncharged} sessions below, by up to {-min(o.uncharged.beyond for o in outcomes):.3g} J")
    say(f"promises not kept: {bad}")
    return 1 if bad or not weaker or not uncharged else 0


if __name__ == "__main__":
    sys.exit(main())
