"""Every pair of features works, with a trace of each, or is refused by a decision (docs/combinations.md)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from manyhands.design.errors import DesignError
from manyhands.design.models.environment import DelayedNetwork, NetworkBox
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import Session, SessionError
from manyhands.nodes.coupling.within import Within
from manyhands.nodes.environment.core import Core
from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore
from manyhands.nodes.environment.node import EnvironmentNode
from manyhands.nodes.environment.proxy import ProxyLaw
from manyhands.nodes.environment.scene import SceneLaw
from manyhands.nodes.kernel.allowance import LatenessAllowance
from manyhands.nodes.kernel.bundle import REALTIME, DeviceBundle, EnvironmentBundle, SimulatedHand
from manyhands.nodes.kernel.factory import FactoryError
from manyhands.nodes.rows import figures as names
from tests.deterministic.recorded import WatchedSession

from ...support.combinations import (
    BASE,
    DECISIONS,
    FEATURES,
    PAGE,
    PAIRS,
    REFUSALS,
    Pair,
    changes_of,
    decision_file,
    features_of,
    page,
    refusal_of,
)

MS = 1_000_000  # ns
TICKS, SHORT = 250, 100
LENGTHS = {"ladder": 400, "clutch": 400, "reserve for lateness": 200}
"""Ticks of a session in virtual time, where these take part; otherwise :data:`SHORT`."""

LEVEL = ("osp", "held", "linkage", "step")
"""Keys of a device on which a design depends."""

SILENT = range(40, 60)  # ticks
IN_PROCESSES = {"own period", "ladder", "co-location", "reserve for lateness"}
"""Features of processes: their pairs run as the product's nodes in virtual time, all others in one process."""

WORKING = [pair for pair in PAIRS if refusal_of(pair) is None]
REFUSED = [pair for pair in PAIRS if refusal_of(pair) is not None]


def named(pair: Pair) -> str:
    return " × ".join(pair)


@pytest.fixture(scope="module")
def base() -> Session:
    return Session.from_dict(BASE)


@pytest.fixture(scope="module")
def designs() -> dict[str, Prepared]:
    """By what a design depends on."""
    return {}


def prepared_of(session: Session, designs: dict[str, Prepared]) -> Prepared:
    """The session, designed; sessions that differ in hands, limits, processes or faults alone have one design."""
    plain = session.as_plain()
    levels = [[device.get(key) for key in LEVEL] for device in plain["devices"].values()]
    key = json.dumps([levels, *(plain[key] for key in ("couplings", "environment", "design"))])
    if key not in designs:
        designs[key] = prepare(session)
    return replace(designs[key], session=session)


@dataclass(frozen=True)
class Course:
    """A run of a pair.

    Attributes:
        prepared: its session.
        core: the environment at its end.
        rows: by node and trace.
        watched: the run as processes; None for one in one process.
    """

    prepared: Prepared
    core: Core
    rows: Mapping[tuple[str, str], np.ndarray]
    watched: WatchedSession | None = None

    @property
    def world(self) -> EnvironmentBundle:
        bundle = cut(self.prepared, RunPlan(REALTIME, None, ""))["environment"]
        assert isinstance(bundle, EnvironmentBundle)
        return bundle

    def device(self, name: str) -> DeviceBundle:
        bundle = cut(self.prepared, RunPlan(REALTIME, None, ""))[name]
        assert isinstance(bundle, DeviceBundle)
        return bundle

    def told(self, node: str) -> dict[str, float]:
        """The numbers of a node's report."""
        assert self.watched is not None
        report = self.watched.conductor.reports[node]
        return dict(report.figures)

    @property
    def law(self) -> Any:
        assert isinstance(self.core, EnforcedCore)
        return self.core._law

    @property
    def certified_world(self) -> Any:
        """The environment that a certificate is about."""
        prepared = self.prepared
        return prepared.world.environment if prepared.certificate is None else prepared.certificate.loop.environment


def simulated(prepared: Prepared, pair: Pair) -> Course:
    simulation = Simulation(prepared)
    traces = simulation.traces(TICKS)
    silences = [Silence("cx", SILENT.start, SILENT.stop)] if "clutch" in pair else []
    simulation.run(TICKS, faults=silences, traces=traces)
    for name, ledger in simulation.ledgers.items():
        assert ledger.margin > -1e-9, name
    rows = {(node, kept.topic.trace): kept.values for node, topics in traces.by_node.items() for kept in topics}
    return Course(prepared, simulation.environment, rows)


def in_processes(prepared: Prepared, pair: Pair) -> Course:
    def happens(session: WatchedSession) -> None:
        def plan(at: float, act: Callable[[], None]) -> None:
            session.scheduler.after(int(at * MS), act)

        if "reserve for lateness" in pair:
            for at in range(50, 130, 12):
                plan(at, lambda: session.stop("cx", 4 * MS))
        if "ladder" in pair:
            plan(110, lambda: session._obey(session.conductor.shift("cy", 1)))
        if "clutch" in pair:
            plan(120, lambda: session.kill("cx"))

    ticks = max(LENGTHS.get(name, SHORT) for name in pair)
    watched = WatchedSession(prepared, happens, ticks)  # type: ignore[arg-type]
    assert watched.violations == []
    assert watched.conductor.faults == []
    node = watched.ran["environment"].node
    assert isinstance(node, EnvironmentNode)
    assert node.core is not None
    rows = {
        (name, trace): np.concatenate([message.traces[trace] for message in told if trace in message.traces])
        for name, told in watched.told.items()
        for trace in {trace for message in told for trace in message.traces}
    }
    return Course(prepared, node.core, rows, watched)


def first(values: np.ndarray) -> int:
    """The first tick in which any of the values is not 0."""
    return int(np.flatnonzero(np.any(values != 0.0, axis=1))[0])


def scene(course: Course) -> None:
    assert isinstance(course.law, SceneLaw)
    assert np.ptp(course.rows["environment", names.MASS_POSITION][:, 0]) > 1e-4


def driven_body(course: Course) -> None:
    assert isinstance(course.law, SceneLaw)
    assert np.ptp(course.rows["environment", names.MASS_POSITION][:, 3]) > 1e-3
    assert course.core.figures[names.DRIVE_TANK] != course.prepared.session.environment.tank


def proxies(course: Course) -> None:
    law = course.law
    assert isinstance(law, ProxyLaw)
    assert len(law.held) == 2
    assert np.abs(law._q).max() > 1e-4
    assert course.world.stiffness is not None
    np.testing.assert_array_equal(law._K, course.world.stiffness)


def engine(course: Course) -> None:
    assert course.law.masses == course.law._model.positions(1)
    assert np.ptp(course.rows["environment", names.MASS_POSITION][:, 0]) > 1e-5


def enforced_model(course: Course) -> None:
    assert isinstance(course.law, BlackBox)
    assert course.core.controller is not None
    assert course.core.controller.ticks > 0
    assert course.core.controller.energy > 0.0
    assert course.core.ledger is not None
    assert course.core.ledger.margin > -1e-9


def controller(course: Course) -> None:
    assert isinstance(course.core, EnforcedCore)
    assert course.core.controller is not None
    if not isinstance(course.law, BlackBox):
        assert course.core.controller.energy < 1e-6


def late_world(course: Course) -> None:
    if isinstance(course.core, EnforcedCore) and isinstance(course.law, BlackBox):
        assert course.law._model._model._known.maxlen == 3
    else:
        assert isinstance(course.certified_world, DelayedNetwork)
    assert first(course.rows["cx", names.FORCE]) > first(course.rows["cx", names.FREE_POSITION])


def uncertain_world(course: Course) -> None:
    box = course.certified_world
    assert isinstance(box, NetworkBox)
    assert [box.low.links[0].stiffness, box.high.links[0].stiffness] == [400, 600]
    running = course.prepared.loop.environment
    assert course.world.E is not None
    np.testing.assert_array_equal(course.world.E.A, running.nominal.environment(1e-3).A)


def uncertain_device(course: Course) -> None:
    levels = [one.level for proof in course.prepared.certificates for one in proof.loop.devices if one.name == "dx"]
    assert [level.tolist() for level in levels] == [[[2.8]]]
    source = course.device("dx").source
    assert isinstance(source, SimulatedHand)
    assert source.damping == (3.0,)


def held_torques(course: Course) -> None:
    own = [(proof, one) for proof in course.prepared.certificates for one in proof.loop.devices if one.name == "dx"]
    [(proof, one)] = own
    assert one.held is not None
    assert one.held.kappa == 20.0
    at = one.ports[0]
    left = float(proof.loop.Delta_D[at, at])
    assert 0.0 < left < one.level[0, 0]
    bundle = course.device("dx")
    assert bundle.held == one.held
    assert bundle.levels[0].tolist() == [[left]]


def encoder_step(course: Course) -> None:
    inertia = course.device("dx").inertia
    assert inertia is not None
    assert inertia.step == (1e-5,)
    claims = [proof.encoder for proof in course.prepared.certificates if any(d.step for d in proof.loop.devices)]
    [claim] = claims
    assert claim is not None
    assert claim.force is None or max(claim.force) > 1e-4
    assert not claim.covered


def wave_link(course: Course) -> None:
    assert course.prepared.world is not None
    assert [*course.prepared.parts] == ["cx", "in-tick"]
    assert [*course.world.waves] == ["cx"]
    assert np.abs(course.rows["environment", names.WAVE]).max() > 0.01
    heard = course.rows["environment", names.TANK][:, 2]
    assert heard[-1] > heard[0]


def own_period(course: Course) -> None:
    assert course.watched is not None
    ticks = {name: report.ticks for name, report in course.watched.conductor.reports.items()}
    assert ticks["dx"] == ticks["cx"] == 2 * ticks["environment"]
    assert ticks["dy"] == ticks["environment"]


def thinned_waves(course: Course) -> None:
    heard = course.rows["environment", names.TANK][:, 2]
    arrivals = np.flatnonzero(np.diff(heard))
    assert len(arrivals) > 10
    assert np.median(np.diff(arrivals)) == 3


def series_compliance(course: Course) -> None:
    certificate = course.prepared.certificate
    assert certificate is not None
    assert len(certificate.loop.series) == 2
    assert min(certificate.loop.series) > 0.0
    session = course.prepared.session
    stated = session.environment.for_design(session.ports)
    assert course.world.E is not None
    assert not np.array_equal(course.world.E.C, stated.environment(1e-3).C)


def transparency(course: Course) -> None:
    certificate = course.prepared.certificate
    assert certificate is not None
    assert certificate.transparency is not None
    assert 0.0 < certificate.transparency.gamma < 1e4
    assert certificate.transparency.aim.objective == "loop-shaping"


def ladder(course: Course) -> None:
    assert course.prepared.ladder is not None
    assert course.prepared.ladder.taus == (0.0003, 0.0006)
    for node in ("cy", "dy"):
        assert course.told(node)[names.RUNG] == 1.0


def colocation(course: Course) -> None:
    assert course.prepared.graph.carriers == {"cx": "dx", "cy": "dy"}
    assert {link.binder for link in course.prepared.graph.links} == {"environment"}
    assert course.watched is not None
    (join,) = course.watched.ran["dx"].joins
    assert isinstance(join, Within)
    ticks = {name: report.ticks for name, report in course.watched.conductor.reports.items()}
    assert ticks["cx"] == ticks["dx"] >= SHORT


def reserve(course: Course) -> None:
    assert course.device("dx").allowance == LatenessAllowance(1e-6, 0.0)
    told = course.told("dx")
    assert told[names.INTERFACE_TICKS] > 0.0
    assert told[names.INTERFACE_MARGIN] > -1e-9


def budget(course: Course) -> None:
    energy, elapsed = course.core.energy, 1e-3 * len(course.rows["environment", names.TOOL_POSITION])
    assert energy.scaled[1] > 0
    assert energy.given[1] <= 2e-4 + 2e-4 * elapsed + 1e-12
    assert energy.scaled[0] == 0  # it has its default budget


def clutch(course: Course) -> None:
    f = course.rows["dx", names.FORCE]
    if course.watched is None:
        assert np.any(f[: SILENT.start])
        assert not np.any(f[SILENT.start : SILENT.stop])
        assert np.all(np.diff(course.rows["cy", names.FREE_POSITION][SILENT.start : SILENT.stop], axis=0))
    else:
        assert course.watched.restarts > 0
        assert course.told("environment")[names.ABSENCES] > 0.0
    assert course.core.clutches.all[0].ratio > 0.0


TRACES: Mapping[str, Callable[[Course], None]] = {
    "scene": scene,
    "driven body": driven_body,
    "proxies": proxies,
    "engine": engine,
    "enforced model": enforced_model,
    "controller": controller,
    "late world": late_world,
    "uncertain world": uncertain_world,
    "uncertain device": uncertain_device,
    "held torques": held_torques,
    "encoder step": encoder_step,
    "wave link": wave_link,
    "own period": own_period,
    "thinned waves": thinned_waves,
    "series compliance": series_compliance,
    "transparency": transparency,
    "ladder": ladder,
    "co-location": colocation,
    "reserve for lateness": reserve,
    "energy budget": budget,
    "clutch": clutch,
}


@pytest.mark.parametrize("pair", WORKING, ids=named)
def test_a_pair_works_and_both_leave_their_trace(pair: Pair, base: Session, designs: dict[str, Prepared]) -> None:
    features = features_of(pair)
    if "engine" in features:
        pytest.importorskip("mujoco")
    prepared = prepared_of(base.replace(changes_of(pair)), designs)
    assert prepared.certified
    course = (in_processes if IN_PROCESSES & {*features} else simulated)(prepared, pair)
    for name in features:
        TRACES[name](course)


@pytest.fixture(scope="module")
def plain(base: Session, designs: dict[str, Prepared]) -> dict[bool, Course]:
    """The session without any feature, as processes and in one."""
    prepared = prepared_of(base, designs)
    return {True: in_processes(prepared, ("", "")), False: simulated(prepared, ("", ""))}


@pytest.mark.parametrize("name", FEATURES)
def test_a_feature_that_is_not_there_leaves_no_trace(name: str, plain: dict[bool, Course]) -> None:
    with pytest.raises((AssertionError, KeyError)):
        TRACES[name](plain[name in IN_PROCESSES])


@pytest.mark.parametrize("pair", REFUSED, ids=named)
def test_a_pair_is_refused_with_its_reason(pair: Pair, base: Session) -> None:
    refusal = refusal_of(pair)
    assert refusal is not None
    with pytest.raises((SessionError, DesignError, NotCertified, FactoryError)) as caught:
        Simulation(prepare(base.replace(changes_of(pair))))
    assert refusal.error in str(caught.value)


@pytest.mark.parametrize("refusal", REFUSALS, ids=lambda one: one.error)
def test_a_decision_says_why(refusal: Any) -> None:
    text = " ".join(decision_file(refusal.decision).read_text(encoding="utf-8").split())
    assert refusal.says in text


def test_every_feature_has_a_trace_and_a_decision() -> None:
    assert [*TRACES] == [*FEATURES]
    for feature in FEATURES.values():
        assert decision_file(feature.decision).parent == DECISIONS


def test_the_page_is_that_of_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m tests.support.combinations writes it anew"
