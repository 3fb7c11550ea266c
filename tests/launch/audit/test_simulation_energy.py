"""A guest that lies within its limits, against its energy budget: whole sessions, simulated in one process."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from manyhands.launch.app.design_report import print_report
from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.look.display import MOST_SHOWN, energy_line
from manyhands.launch.plan.bundles import budgets
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.plan.topology import topology
from manyhands.launch.run.breaches import QUIET, UserIncidents
from manyhands.launch.run.outcome import node_entry
from manyhands.launch.session import load_session
from manyhands.nodes.environment.core import EnvironmentCore
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.kernel.energy_budget import EnergyBudget
from manyhands.protocol.clock import Instant
from manyhands.protocol.messages import Figures, Report, Role, Telemetry

EXAMPLE = Path(__file__).parents[3] / "launch" / "sessions" / "example1.yaml"
QUIET_HANDS = [f"devices.{name}.hand.force=0" for name in ("dx", "dy", "dz")]
T = 1e-3


class Liar:
    """A driver that reports any motion, whatever force it exerts."""

    axes = 1

    def __init__(self, frequency: float, amplitude: float) -> None:
        self._omega, self._amplitude = 2.0 * math.pi * frequency * T, amplitude
        self._x = [0.0]

    def sample(self, tick: int, at: Instant) -> list[float]:
        self._x = [self._amplitude * math.sin(self._omega * tick)]
        return self._x

    def apply(self, f: object, at: Instant, until: Instant | None = None) -> list[float]:
        """The hand does not give way."""
        return self._x

    def release(self, at: Instant) -> list[float]:
        """The same."""
        return self._x

    def idle(self, due: Instant) -> None:
        """Nothing is put off."""

    def intended_work(self) -> float:
        return 0.0

    def figures(self) -> Figures:
        return Figures()

    def close(self) -> None:
        """Nothing is held."""


@pytest.fixture(scope="module")
def designed() -> Prepared:
    """Example 1: what its hands do, and its limits, are no part of the design."""
    return prepare(load_session(EXAMPLE))


AT_THE_BALL = {"dx": {"at": [-0.03, 0, 0], "radius": 0.01}, "dy": {"at": [0.03, 0, 0], "radius": 0.01}}
WORLDS: dict[str, dict[str, object]] = {
    "network": {},
    "controller": {"environment.enforce": True},
    "scene": {
        "environment": {
            "type": "scene",
            "tools": {**AT_THE_BALL, "dz": {"at": [0, 1, 0]}},
            "bodies": {"ball": {"mass": 0.1, "at": [0, 0, 0], "radius": 0.02}},
        }
    },
    "proxies": {"environment": {"type": "python", "model": f"{__name__}:Nearby", "stiffness": 3000}},
    "model": {"environment": {"type": "python", "model": f"{__name__}:Nearby", "level": 0}},
}


class Nearby:
    """Tools are free for a millimetre; beyond, a wall."""

    def __init__(self, ports: tuple[str, ...], period: float, parameters: object) -> None: ...

    def proxy(self, x: np.ndarray, k: int) -> np.ndarray:
        return np.clip(x, -1e-3, 1e-3)

    def react(self, x_e: np.ndarray, k: int) -> np.ndarray:
        return 300.0 * (np.clip(x_e, -1e-3, 1e-3) - x_e)


@pytest.mark.parametrize("world", WORLDS)
def test_a_device_that_is_switched_on_away_from_rest_joins_within_its_budget(world: str) -> None:
    """Its first sample is no step that a limit bounds: it is at 2.5 cm at once."""
    on = {"dof": 1, "osp": 1.37, "driver": "trace", "trace": {"times": [0, 1], "values": [-0.025, -0.025]}}
    limits = {"limits": {"power": 0.01, "energy": 0.05}}
    quiet = {f"devices.{name}.hand.force": 0 for name in ("dx", "dz")}
    session = load_session(EXAMPLE).replace({"devices.dy": on | limits, **quiet, **WORLDS[world]})
    simulation = Simulation(prepare(session))
    energy, settle, rooms = simulation.environment.energy, simulation.environment.settle, list[float]()

    def watched() -> None:
        settle()
        rooms.append(energy.room(1))

    simulation.environment.settle = watched  # type: ignore[method-assign]
    f = simulation.run(150).f_v
    assert min(rooms) > 0.049
    assert not np.any(f[0])
    assert simulation.environment.clutches.all[1].ratio == 1.0


@pytest.mark.parametrize(("frequency", "enforce"), [(1.0, "false"), (6.0, "false"), (6.0, "true")])
def test_the_others_receive_no_more_of_a_guest_than_its_budget(
    designed: Prepared, frequency: float, enforce: str
) -> None:
    """Without a budget the one at 6 Hz puts 10 J into the others in 2.5 s."""
    limits = "devices.dx.limits={speed: 2, power: 0.5, energy: 1}"
    session = load_session(EXAMPLE, [*QUIET_HANDS, limits, f"environment.enforce={enforce}"])
    simulation = Simulation(
        replace(designed, session=session), {"dx": Liar(frequency, min(0.2, 1.9 / (2.0 * math.pi * frequency)))}
    )
    energy, settle = simulation.environment.energy, simulation.environment.settle
    given, ratios, rooms = [0.0], [], []

    def watched() -> None:
        settle()
        given.append(energy.given[0])
        rooms.append(energy.room(0))
        ratios.append([simulation.environment.clutches.all[block].ratio for block in range(3)])

    simulation.environment.settle = watched  # type: ignore[method-assign]
    recording = simulation.run(2500)
    excess = np.array(given) - 0.5 * T * np.arange(len(given))
    assert np.max(excess - np.minimum.accumulate(excess)) <= 1.0 * (1.0 + 1e-9)
    assert min(rooms) >= 0.0
    # what the others' mechanisms have really received, by their own samples and forces
    work = np.sum(recording.f_v[:-1, 1:] * np.diff(recording.x[:, 1:], axis=0))
    assert work <= 1.0 + 0.5 * 2.5
    assert energy.given[1:] == pytest.approx([0.0, 0.0], abs=1e-9)  # no other is charged,
    assert np.min(np.array(ratios)[:, 1:]) == 1.0  # nor scaled
    assert isinstance(simulation.environment, EnforcedCore if enforce == "true" else EnvironmentCore)
    assert energy.stops[0] >= 1
    assert energy.scaled[0] > 100
    assert all(ledger.minimum >= -1e-9 for name, ledger in simulation.ledgers.items() if name != "dx")


def test_a_strong_honest_hand_is_not_scaled(designed: Prepared) -> None:
    """20 N at 3 Hz, under the defaults."""
    session = load_session(EXAMPLE, ['devices.dx.hand.force="20*sin(2*pi*3*t)"'])
    simulation = Simulation(replace(designed, session=session))
    simulation.run(2000)
    assert simulation.environment.energy.scaled == [0, 0, 0]
    assert simulation.environment.energy.given[0] > 0.1


def test_the_default_is_the_devices_ability_and_at_most_a_hands() -> None:
    limits = [
        "devices.dx.limits={force: 8, speed: 2, displacement: 0.2}",
        "devices.dy.limits={power: 3, energy: 4}",
    ]
    assert budgets(load_session(EXAMPLE, limits)) == (
        EnergyBudget(16.0, 3.2, 3.2),
        EnergyBudget(3.0, 4.0, 10.0),
        EnergyBudget(40.0, 100.0, 10.0),
    )


class TestSentences:
    def told(
        self, tick: int, let_go: float | None = None, quicker: float = 0.0, **tables: Mapping[str, float]
    ) -> Telemetry:
        return Telemetry(tick, Figures({} if let_go is None else {"let_go": let_go, "quicker": quicker}, tables), {})

    def incidents(self) -> UserIncidents:
        return UserIncidents(topology(load_session(EXAMPLE)), T)

    def test_a_device_that_let_go_is_reported_with_its_mover(self) -> None:
        incidents = self.incidents()
        assert incidents.receive("dy", self.told(100, let_go=1.0)) == []  # the environment has not reported that tick
        assert incidents.receive("environment", self.told(99, moved={"cx/cy": 1.0})) == []
        (sentence,) = incidents.receive("environment", self.told(199, moved={"cx/cy": 2.0, "cz/cy": 0.5, "cx/cz": 9.0}))
        assert sentence.startswith("dy was beyond its limits")
        assert sentence.endswith("it had received 2.5 J from others, 2 J of it from cx (dx)")

    @pytest.mark.parametrize("colocate", ["true", "false"])
    def test_a_device_in_one_process_with_its_coupling_is_named_with_it(self, colocate: str) -> None:
        """Such a device had no couplings here: it read "right_seat ()", and "nobody else has moved it" of a victim."""
        graph = topology(load_session(EXAMPLE.with_name("ball.yaml"), [f"colocate={colocate}"]))
        incidents = UserIncidents(graph, T)
        (sentence,) = incidents.receive(
            "environment", self.told(100, stops={"right_seat": 1.0}, given={"right_seat": 1.25})
        )
        assert sentence.startswith("right_seat (right) was beyond its energy budget")
        incidents.receive("left", self.told(150, let_go=1.0))
        (sentence,) = incidents.receive("environment", self.told(199, moved={"right_seat/left_seat": 14.8}))
        assert sentence.startswith("left was beyond its limits")
        assert sentence.endswith("it had received 14.8 J from others, 14.8 J of it from right_seat (right)")

    @pytest.mark.parametrize(("speed", "named"), [(2500.0, False), (3.0, True)])
    def test_nobody_is_named_for_a_jump_that_takes_far_more_energy_than_was_received(
        self, speed: float, named: bool
    ) -> None:
        """A library reports mm, of a device whose mass nobody has stated."""
        incidents = self.incidents()
        incidents.receive("dy", Telemetry(100, Figures({"let_go": 1.0, "speed": speed}, {}), {}))
        (sentence,) = incidents.receive("environment", self.told(100, moved={"cx/cy": 8e-4}))
        assert ("cx" in sentence) == named
        assert ("see its sensor, and the units of its driver" in sentence) != named

    def test_why_a_device_let_go_again_so_soon_is_told_a_little_later(self) -> None:
        """A driver whose unit changes a moment after its user was pushed: what was said of the push is not all."""
        incidents = self.incidents()
        incidents.receive("dy", self.told(100, let_go=1.0))
        assert len(incidents.receive("environment", self.told(100, moved={"cx/cy": 1.0}))) == 1
        incidents.receive("dy", self.told(1000, let_go=2.0))
        incidents.receive("environment", self.told(1000, moved={"cx/cy": 1.0}))
        incidents.receive("dy", self.told(2000, let_go=3.0, quicker=1.0))
        assert incidents.receive("environment", self.told(2000, moved={"cx/cy": 1.0})) == []
        later = 100 + round(QUIET / T)
        assert incidents.receive("environment", self.told(later - 1, moved={"cx/cy": 5.0})) == []
        (sentence,) = incidents.receive("environment", self.told(later, moved={"cx/cy": 5.0}))
        assert "it moved further in a tick than its stated mass" in sentence
        assert sentence.endswith("; that was at 2.0 s")
        assert incidents.receive("environment", self.told(3 * later, moved={"cx/cy": 5.0})) == []

    def test_a_device_that_moved_itself_is_reported_so(self) -> None:
        incidents = self.incidents()
        incidents.receive("dy", self.told(100, let_go=1.0))
        (sentence,) = incidents.receive("environment", self.told(100, moved={"cy/cx": 3.0}))
        assert sentence.endswith("nobody else has moved it")

    def test_nobody_is_named_for_a_jump_that_no_mass_can_make(self) -> None:
        """A sensor jumps, or a driver has another unit: the others' energy has nothing to do with it."""
        incidents = self.incidents()
        incidents.receive("dy", self.told(100, let_go=1.0, quicker=1.0))
        (sentence,) = incidents.receive("environment", self.told(100, moved={"cx/cy": 3.0}))
        assert sentence.startswith("dy was beyond its limits")
        assert "it moved further in a tick than its stated mass and its hand's force allow: see its sensor" in sentence
        assert "cx" not in sentence
        incidents.forget("dy")  # its next process is another one
        late = 100 + round(QUIET / T)
        begun = Figures({"let_go": 1.0, f"began@{late - 50}": 1.0})
        incidents.receive("dy", Telemetry(late, begun, {}))
        (sentence,) = incidents.receive("environment", self.told(late, moved={"cx/cy": 6.0}))
        assert sentence.endswith("it was there when its process began: see its sensor, and the units of its driver")
        late += round(QUIET / T)
        incidents.receive("dy", self.told(late, let_go=2.0))
        (sentence,) = incidents.receive("environment", self.told(late, moved={"cx/cy": 9.0}))
        assert sentence.endswith("it had received 6 J from others, 6 J of it from cx (dx)")

    def test_nobody_is_named_for_such_a_jump_of_a_device_whose_process_ends(self) -> None:
        """The environment's word may come when the device has a new process already."""
        incidents = self.incidents()
        incidents.receive("dy", self.told(100, let_go=1.0, quicker=1.0))
        incidents.forget("dy")
        (sentence,) = incidents.receive("environment", self.told(100, moved={"cx/cy": 3.0}))
        assert "it moved further in a tick" in sentence
        assert "cx" not in sentence

    def test_a_party_beyond_its_budget_is_reported_not_too_often(self) -> None:
        incidents = self.incidents()
        (sentence,) = incidents.receive("environment", self.told(100, stops={"cx": 1.0}, given={"cx": 1.25}))
        assert sentence.startswith("cx (dx) was beyond its energy budget")
        assert sentence.endswith("it has put 1.25 J into the others so far")
        assert incidents.receive("environment", self.told(200, stops={"cx": 2.0})) == []
        later = 100 + round(QUIET / T)
        assert len(incidents.receive("environment", self.told(later, stops={"cx": 3.0}))) == 1
        assert incidents.receive("environment", self.told(2 * later, stops={"cx": 3.0})) == []

    def test_a_user_that_stays_frozen_is_reported_once(self) -> None:
        incidents, running = self.incidents(), ("cx", "cy", "cz")

        def receive(tick: int, event: str = "ledger", nodes: Sequence[str] = running) -> list[str]:
            return incidents.receive("environment", Telemetry(tick, Figures({event: 1.0}), {}), nodes)

        assert receive(600, "frozen:cx@500") == []
        assert receive(700, "returned:cx@650") == receive(1800) == []  # it was frozen for a moment
        assert receive(2000, "frozen:cx@1950") == receive(2900) == []
        assert receive(3000) == ["cx (dx) is frozen since 1.9 s: it takes no part, and the others go on"]
        assert receive(4000) == receive(5000, "returned:cx@4500") == []
        assert receive(6100, "frozen:cx@6000") == receive(9000, nodes=("cy",)) == []  # its loss is an incident already
        assert receive(9900) == []  # it is on its way back
        assert len(receive(10100)) == 1


class TestLine:
    def test_who_moved_whom_is_a_line_with_the_most_first(self) -> None:
        figures = Figures(
            {"ledger": 9.0}, {"moved": {"cx/cy": 1.25, "cz/cy": 3.0, "cy/cx": 1e-4}, "scaled": {"cz": 12.0}}
        )
        assert energy_line(figures) == "who moved whom [J]: cz → cy 3, cx → cy 1.25; held to an energy budget: cz"

    def test_of_many_the_first_are_shown(self) -> None:
        figures = Figures({}, {"moved": {f"a/b{i}": 1.0 + i for i in range(MOST_SHOWN + 2)}})
        assert energy_line(figures).endswith(" and 2 more")

    def test_nothing_is_no_line(self) -> None:
        assert energy_line(Figures({"ledger": 1.0})) == ""

    def test_it_is_printed_with_the_report(self) -> None:
        report = Report(
            7,
            Figures(
                {}, {"moved": {"cx/cy": 1.25}, "given": {"cx": 1.25}, "received": {"cy": 1.25}, "scaled": {"cx": 3.0}}
            ),
        )
        entry = node_entry(Role.ENVIRONMENT, report)
        assert entry["energy"] == {
            "given": {"cx": 1.25},
            "received": {"cy": 1.25},
            "moved": {"cx/cy": 1.25},
            "scaled": {"cx": 3},
        }
        out = io.StringIO()
        nodes = {"environment": entry}
        print_report(Console(file=out), {"session": "s", "duration": 1.0, "clock": "simulated", "nodes": nodes})
        assert "who moved whom [J]: cx → cy 1.25; held to an energy budget: cx" in out.getvalue()
