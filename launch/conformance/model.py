"""The suite for models of the environment: it moves the tools along probe motions and keeps account of the energy.

A model that proposes proxies is tried with the law that a session puts around it
(:mod:`manyhands.nodes.environment.proxy`). Its springs then end in couplings that yield by :data:`COMPLIANCE`, and x_e
is where the tools are under the forces.

**What is judged, and from what.** With w(k) = (x_e(k) - x_e(k-1))/T the velocity of the tools and f(k) the forces:

- *exception*, *wrong answer*: every answer is one finite force for each port, of a bounded size.
- *blocking call*: the median of the answers' durations is at most T/2, and their p95 at most T.
- *wrong sign*: a slow press against the world costs work; a world that helps it on every side pulls instead of pushing.
- *level*: the least level phi of a passive environment, by

      sum over ticks of  -f^T w + phi w^T w  >=  0    at every tick of a probe from rest on.

  It is what the probes have found, and no proof: other motions may need more. What a session declares is enforced.
- *held*: in how many ticks with a force the proxy test shortened the step of a proxy. A model whose proxies move by
  themselves, or against the tools' motion, is held. This costs realism and never stability.
- *not repeatable*: a second model of the same factory answers the same motion by the same forces, to the last bit. Only
  then does ``simulate`` agree with ``launch``, and a recording can be replayed and audited.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from manyhands.launch.conformance.driver import BLOCKING, EXCEPTION, SIGN, WRONG_ANSWER
from manyhands.launch.conformance.judgement import Conformance, Judgement
from manyhands.launch.conformance.timing import CallTimer
from manyhands.nodes.environment.enforced import BlackBox, ForceLaw
from manyhands.nodes.environment.model import PROXY, REACT, STEP, AskedModel, EnvironmentModel
from manyhands.nodes.environment.proxy import ProxyLaw
from manyhands.nodes.kernel.factory import in_one_line

Array = NDArray[np.float64]

LEVEL = "level"
HELD = "held"
REPEATED = "not repeatable"

MOST_HELD = 0.01
"""Part of the steps with a force that may be shortened before it is reported."""

COMPLIANCE = 1e-3
"""m/N; D_V of each port, about that of a coupling for a device with 1 N·s/m of damping at 1 kHz."""

PRESS_TIME = 0.5
"""s; how long a slow press takes."""


YIELDING = "tools that yield"
"""The probe whose motion follows from the model's forces."""

MASS, SPRING, DAMPER = 0.2, 200.0, 1.0  # kg, N/m and N·s/m of a tool that yields


def probes(ports: int, T: float, reach: float) -> dict[str, Array]:
    """The motions of the tools, ticks x ports, m, by name; each begins at rest in 0.

    Args:
        ports: their number.
        T: period, s.
        reach: the greatest displacement, m.
    """
    ticks = max(20, round(PRESS_TIME / T))
    t = np.arange(2 * ticks) * T
    still = np.zeros((2 * ticks, ports))
    found = {"rest": still}
    press = np.sin(np.pi * np.arange(2 * ticks) / (2 * ticks)) ** 2  # in and out
    for port in range(ports):
        for way in (reach, -reach, reach / 4.0, -reach / 4.0):
            motion = still.copy()
            motion[:, port] = way * press
            found[f"press of port {port} by {way:g} m"] = motion
    shake = reach * np.sin(2.0 * np.pi * 8.0 * t)[:, None] * np.cos(np.arange(ports))
    step = np.where(t[:, None] < PRESS_TIME, 0.0, 0.2 * reach) * np.ones(ports)
    walk = np.cumsum(np.random.default_rng(1).normal(0.0, reach * np.sqrt(T), (2 * ticks, ports)), axis=0)
    return found | {"shake": shake, "step": step, "walk": np.clip(walk, -reach, reach), YIELDING: still}


class _Tools:
    """Tools that yield: masses on springs, drawn towards each other; a world that gives energy away moves them."""

    def __init__(self, ports: int, T: float, reach: float) -> None:
        self._T, self._goal = T, reach * np.cos(np.pi * np.arange(ports))
        self._x, self._v = np.zeros(ports), np.zeros(ports)

    def moved(self, f: Array, k: int) -> Array:
        """Their places at tick k, m, after the force f (N) of the tick before; each is at most 1 m away."""
        hand = SPRING * (min(1.0, k * self._T / PRESS_TIME) * self._goal - self._x) - DAMPER * self._v
        self._v = self._v + self._T * (f + hand) / MASS
        self._x = np.clip(self._x + self._T * self._v, -1.0, 1.0)
        return self._x


def check_model(
    name: str,
    make: Callable[[], EnvironmentModel],
    ports: tuple[str, ...],
    T: float,
    reach: float,
    level: float | None = None,
    timer: CallTimer | None = None,
    stiffness: float | None = None,
) -> Iterator[Judgement]:
    """Try a model.

    Args:
        name: of its factory, for the messages.
        make: makes one, at rest.
        ports: of the session.
        T: period, s.
        reach: the greatest displacement of a tool, m.
        level: the level that the session declares, N·s/m; None to report what the probes need.
        timer: what the answers are timed by.
        stiffness: of the springs to the model's proxies, N/m; None to ask it for forces.

    Raises:
        FactoryError: it cannot be made.
    """
    method = REACT if stiffness is None else PROXY
    if stiffness is not None and callable(getattr(make(), STEP, None)):
        method = STEP
        if problem := _positions_problem(make()):
            yield Judgement(WRONG_ANSWER, Conformance.BROKEN, problem)
            return
    trial, found = _Trial(name, make, ports, T, reach, method, stiffness, timer or CallTimer()), _Evidence()
    for probe, given in probes(len(ports), T, reach).items():
        both = []
        for _ in range(2):
            both.append(trial.run(probe, given))
            if (failed := both[-1].problem) is not None:
                yield failed
                return
        first, second = both
        found.add(probe, first, second, T)
    yield Judgement(EXCEPTION, Conformance.KEPT, f"no answer failed in {len(found.durations)} ticks")
    yield _duration(found.durations, T)
    if found.touched:
        yield _sign(found.pressed)
        yield _level(found.needed, found.worst, level) if stiffness is None else _held(found.held, found.active)
    else:
        text = f"no motion of up to {reach:g} m met a force; --reach tries further ones"
        yield from (Judgement(check, Conformance.OPEN, text) for check in (SIGN, LEVEL if stiffness is None else HELD))
    yield _repeated(found.repeated)


@dataclass(frozen=True)
class _Answers:
    """What a model has answered to one probe.

    Attributes:
        motion: of the tools under its forces, ticks x ports, m.
        forces: ticks x ports, N.
        durations: of its answers, ns.
        held: how many steps of proxies the proxy test shortened.
        active: in how many steps a proxy had a force or was held.
        problem: why the probe ended before its time; None where it did not.
    """

    motion: Array
    forces: Array
    durations: list[int]
    held: int
    active: int
    problem: Judgement | None = None


@dataclass(frozen=True)
class _Trial:
    """How a model is asked; the attributes are those of :func:`check_model`, and the method by which it is asked."""

    name: str
    make: Callable[[], EnvironmentModel]
    ports: tuple[str, ...]
    T: float
    reach: float
    method: str
    stiffness: float | None
    timer: CallTimer

    def run(self, probe: str, given: Array) -> _Answers:
        """Ask a new model along the motion ``given``, or along that of tools which yield to its forces.

        Raises:
            FactoryError: it cannot be made.
        """
        m = len(self.ports)
        asked, tools = _Noted(self.make(), self.method), _Tools(m, self.T, self.reach)
        model = AskedModel(self.name, cast(EnvironmentModel, asked), self.ports)
        law: ForceLaw = BlackBox(model)
        D = np.zeros((m, m))
        if self.stiffness is not None:
            law = ProxyLaw(model, self.stiffness * np.eye(m), None, self.T, [(port,) for port in range(m)])
            D = COMPLIANCE * np.eye(m)
        f, motion, durations, active = np.zeros_like(given), given.copy(), list[int](), 0
        for k in range(len(given)):
            if probe == YIELDING:
                motion[k] = tools.moved(f[k - 1], k)
            self.timer.begin()
            f[k] = law.propose(motion[k].copy(), D, motion[k].copy())
            durations.append(self.timer.end())
            if model.failure is not None:
                check = EXCEPTION if asked.raised else WRONG_ANSWER
                problem = Judgement(check, Conformance.BROKEN, f"in the probe {probe!r}: {model.failure}")
                return _Answers(motion, f, durations, sum(law.held), active, problem)
            motion[k] += D @ f[k]
            before = list(law.held)
            law.advance(motion[k], f[k])
            active += sum(bool(force) or now > was for force, now, was in zip(f[k], law.held, before, strict=False))
        return _Answers(motion, f, durations, sum(law.held), active)


@dataclass
class _Evidence:
    """What the probes have shown so far.

    Attributes:
        durations: of the answers of each first model, ns.
        needed: the least level of a passive environment, N·s/m.
        worst: the probe that needs it.
        pressed: the work that the world did on each slow press, J.
        held: how many steps of proxies the proxy test shortened.
        active: in how many steps a proxy had a force or was held.
        touched: in how many steps there was a force.
        repeated: whether each second model answered as the first.
    """

    durations: list[int] = field(default_factory=list)
    needed: float = 0.0
    worst: str = "none"
    pressed: list[float] = field(default_factory=list)
    held: int = 0
    active: int = 0
    touched: int = 0
    repeated: bool = True

    def add(self, probe: str, first: _Answers, second: _Answers, T: float) -> None:
        """Take in the answers of two models of the same factory to one probe."""
        self.durations += first.durations
        self.held, self.active = self.held + second.held, self.active + second.active
        self.touched += int(np.count_nonzero(second.forces))
        self.repeated = self.repeated and first.forces.tobytes() == second.forces.tobytes()
        w = np.diff(second.motion, axis=0, prepend=second.motion[:1]) / T
        work, burnt = np.cumsum((w * first.forces).sum(axis=1)), np.cumsum((w**2).sum(axis=1))
        moved = burnt > 0.0
        most = float((work[moved] / burnt[moved]).max(initial=0.0))
        if most > self.needed:
            self.needed, self.worst = most, probe
        if probe.startswith("press"):
            self.pressed.append(float(work[len(work) // 2]) * T)


def _positions_problem(engine: Any) -> str:
    """What is wrong with the positions of an engine's bodies; empty where nothing is."""
    try:
        found = np.array(engine.positions(), dtype=np.float64)
    except Exception as error:  # noqa: BLE001 -- foreign code: reported, whatever it is
        return f"found {in_one_line(error)} from positions(); expected x, y and z of each reported body"
    if found.ndim != 1 or len(found) % 3 or not np.all(np.isfinite(found)):
        return f"found positions() of the shape {found.shape}; expected three finite numbers for each reported body"
    return ""


class _Noted:
    """A model, and whether it has raised an exception."""

    def __init__(self, model: EnvironmentModel, method: str) -> None:
        """Note what ``model`` does; it then has the one method by which it is asked."""
        self.raised = False
        ask = getattr(model, method)

        @wraps(ask)  # so that its parameters are seen
        def asked(x: Array, of: object, **also: object) -> object:
            self.raised = True
            answer: object = ask(x, of, **also)
            self.raised = False
            return answer

        setattr(self, method, asked)


def _duration(durations: list[int], T: float) -> Judgement:
    p50, p95 = (float(value) / 1e3 for value in np.percentile(durations, (50, 95)))
    found = f"an answer takes p50 {p50:.3g} µs, p95 {p95:.3g} µs"
    if p50 > 0.5e6 * T or p95 > 1e6 * T:
        expected = f"a median of at most {0.5e6 * T:g} µs and a p95 of at most {1e6 * T:g} µs, the period"
        return Judgement(BLOCKING, Conformance.BROKEN, f"found {found}; expected {expected}")
    return Judgement(BLOCKING, Conformance.KEPT, found)


def _sign(pressed: list[float]) -> Judgement:
    if min(pressed) >= 0.0 < max(pressed):
        text = f"found that a slow press is helped by up to {max(pressed):.3g} J, and hindered on no side"
        return Judgement(SIGN, Conformance.BROKEN, f"{text}; expected forces on the hand, such as -c * x_e of a spring")
    return Judgement(SIGN, Conformance.KEPT, f"a slow press costs up to {max(0.0, -min(pressed)):.3g} J")


def _held(held: int, active: int) -> Judgement:
    text = f"the proxy test shortened {held} of {active} steps in which a proxy had a force or was to have one"
    return Judgement(HELD, Conformance.OPEN if held > MOST_HELD * active else Conformance.KEPT, text)


def _repeated(repeated: bool) -> Judgement:
    if repeated:
        return Judgement(REPEATED, Conformance.KEPT, "a second model gives the same forces")
    text = "found other forces of a second model for the same motion; expected the same"
    return Judgement(REPEATED, Conformance.BROKEN, f"{text}: its runs can be neither replayed nor audited")


def _level(needed: float, worst: str, level: float | None) -> Judgement:
    if level is None:
        text = f"the probes need a level of {needed:.3g} N·s/m, the most for {worst!r}; declare it, or less if enforced"
        return Judgement(
            LEVEL, Conformance.OPEN if needed else Conformance.KEPT, text if needed else "passive in every probe"
        )
    if needed > level:
        text = (
            f"found that the probe {worst!r} needs {needed:.3g} N·s/m; expected at most {level:g}, the declared level"
        )
        return Judgement(LEVEL, Conformance.BROKEN, f"{text}: its controller would change the model's forces")
    return Judgement(LEVEL, Conformance.KEPT, f"the probes need {needed:.3g} N·s/m, declared {level:g}")
