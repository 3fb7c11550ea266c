"""check-driver and check-model as commands: what they print, their exit codes, and when hardware is pushed."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from manyhands.launch.conformance.driver import Bench, SuiteStopped, check_driver, checked_apart
from manyhands.launch.conformance.judgement import Judgement
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap
from manyhands.protocol.clock import SimulatedClock

from ....support.commands import manyhands_command
from ....support.plugin_drivers import Counterpart

MADE = "tests.support.plugin_drivers:"

pytestmark = pytest.mark.usefixtures("own_interrupt")


@pytest.mark.alone  # how long calls take is judged, by the clock
def test_a_good_driver_ends_with_the_keys_for_the_session_file() -> None:
    timing = "{timing: {sample_age: 0.002, age_jitter: 0.001, actuation_delay: 0.003}, age: 0.002, delay: 0.003}"
    done = manyhands_command("check-driver", f"{MADE}Counterpart", "--dof", 2, "--parameters", timing)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines()[-1] == (
        "for the session file: dof: 2, limits: {force: [8, 8], displacement: [0.2, 0.2], speed: [2, 2]}, "
        "sample_age: 0.002, age_jitter: 0.001, actuation_delay: 0.003"
    )


@pytest.mark.alone  # likewise
def test_a_broken_driver_ends_with_1_and_is_named() -> None:
    done = manyhands_command("check-driver", f"{MADE}WrongSign", "--json")
    assert done.exit_code == 1
    found = json.loads(done.stdout)
    assert found["driver"] == f"{MADE}WrongSign"
    assert [one["check"] for one in found["findings"] if one["verdict"] == "broken"] == ["wrong sign"]
    printed = manyhands_command("check-driver", f"{MADE}WrongSign")
    assert "broken  wrong sign: found a push of +0.5 N" in printed.stdout
    assert "for the session file" not in printed.stdout


def test_hardware_is_not_pushed_without_an_answer() -> None:
    """Here nobody is at a terminal."""
    done = manyhands_command("check-driver", f"{MADE}Raising", "--parameters", "{hardware: true}")  # raises at a force
    assert "this pushes real hardware with 0.5 N, up to 10 mm at a time; nobody may hold it" in done.stderr
    assert "no force is exerted" in done.stderr
    assert "not judged  wrong sign: nothing was pushed" in done.stdout
    assert "exception" not in done.stdout


@pytest.mark.alone  # likewise
def test_nothing_is_asked_about_hardware_that_no_force_moves() -> None:
    done = manyhands_command("check-driver", f"{MADE}MovesByItself", "--parameters", "{hardware: true}", "--dof", 1)
    assert (done.exit_code, "this pushes real hardware" in done.stderr) == (0, False), done.output
    assert "not judged  wrong sign: skipped: the driver states that no force moves its device" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["check-driver", "nowhere.at_all:f"], "the driver nowhere.at_all:f cannot be made"),
        (["check-driver", "no name"], "DRIVER: found 'no name'; expected package.module:factory"),
        (["check-driver", f"{MADE}Counterpart", "--parameters", "[1]"], "--parameters: found a list of 1; expected a"),
        (["check-driver", f"{MADE}Counterpart", "--parameters", "{a: "], "found text that is not YAML"),
        (["check-driver", f"{MADE}Counterpart", "--dof", "0"], "found 0 axes or ports; expected 1 to 32"),
        (["check-driver", f"{MADE}Counterpart", "--force", "0"], "--force: found 0; expected a number greater than 0"),
        (["check-model", "builtins:dict"], "the model builtins:dict cannot be made"),
        (["check-model", "wall"], "MODEL: found 'wall'; expected package.module:factory"),
        (["check-model", "a:b", "--reach", "-1"], "--reach: found -1; expected"),
        (["check-model", "a:b", "--ports", "0"], "found 0 axes or ports"),
    ],
)
def test_bad_input_ends_with_2_and_is_named(arguments: list[str], found: str) -> None:
    done = manyhands_command(*arguments)
    assert done.exit_code == 2, done.output
    assert found in done.stderr


class Spring:
    def __init__(self, ports: tuple[str, ...], period: float, parameters: dict[str, float]) -> None:
        self.ports, self.stiffness = ports, parameters.get("stiffness", 100.0)

    def react(self, x_e, k):  # type: ignore[no-untyped-def]
        assert len(x_e) == len(self.ports)
        return -self.stiffness * x_e


def test_a_model_is_tried_with_named_ports_and_named_where_it_is_broken() -> None:
    name = f"{__name__}:Spring"
    done = manyhands_command("check-model", name, "--ports", "left,right", "--level", "0")
    assert done.exit_code == 0, done.output
    wrong = manyhands_command("check-model", name, "--parameters", "{stiffness: -20}", "--json")
    assert wrong.exit_code == 1
    findings = json.loads(wrong.stdout)["findings"]
    assert [one["check"] for one in findings if one["verdict"] == "broken"] == ["wrong sign"]


def test_a_suite_that_is_interrupted_closes_its_driver() -> None:
    driver = Counterpart(("d",), 1e-3, {})
    plugin = PluginDriver("some:driver", driver, AxisMap((0,), (1.0,)), driver.specification(), 1e-3)
    bench = Bench(plugin, 1e-3, SimulatedClock())
    bench.stopping = True

    def suite() -> Iterator[Judgement]:
        return check_driver(bench, driver.specification(), None)

    with pytest.raises(SuiteStopped):
        checked_apart(bench, lambda: list(suite()))
    assert driver.closed
