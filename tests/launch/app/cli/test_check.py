"""check-driver and check-model as commands: what they print, their exit codes, and when hardware is pushed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from manyhands.design.models.axis import TRANSLATING
from manyhands.launch.app.cli.check import _agreed
from manyhands.launch.conformance.driver import Bench, SuiteStopped, check_driver, checked_apart
from manyhands.launch.conformance.judgement import Judgement
from manyhands.nodes.device.plugin import PluginDriver
from manyhands.nodes.device.specification import AxisMap, DeviceSpecification
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
        "sample_age: 0.002, age_jitter: 0.001, actuation_delay: 0.003, mass: [0.2, 0.2]; its period is at least "
        "0.005 s, the age and delay together"
    )


def test_times_that_a_driver_measures_at_each_start_have_room_for_the_next_one(tmp_path: Path) -> None:
    (starts := tmp_path / "starts").write_text("6e-4 2e-4 3e-4")
    given = json.dumps({"starts": str(starts)})
    done = manyhands_command(
        *("check-driver", "tests.support.identified_plants:slide_of_starts", "--parameters", given, "--no-push")
    )
    last = done.stdout.splitlines()[-1]
    assert "sample_age: 0.0009, actuation_delay: 0.00045, step: " in last, done.output
    assert "its period is at least 0.00135 s, the age and delay together; its times are those of one start" in last
    assert "age_jitter" not in last


@pytest.mark.parametrize(
    ("given", "key"),
    [("{}", "orientation: {limits: {torque: 0.2, speed: 60}}"), ("{sensed: true}", "orientation: {sensed: true}"),
     ("{holds: tool}", "orientation: {sensed: true}")],
)  # fmt: skip
def test_the_keys_of_a_device_that_turns_in_space_are_told(given: str, key: str) -> None:
    own = ("tests.support.turning_drivers:Pen", "--dof", 3, "--parameters", given, "--no-push")
    done = manyhands_command("check-driver", *own)
    assert f", {key}" in done.stdout.splitlines()[-1], done.output


def test_a_torque_is_asked_about_beside_a_force(capsys: pytest.CaptureFixture[str]) -> None:
    assert not _agreed(0.5, 0.01, TRANSLATING, 0.005)  # nobody is at a terminal
    found = " ".join(capsys.readouterr().err.split())
    assert "0.5 N, up to 10 mm at a time, and turns it with 0.005 N·m; nobody may hold it" in found


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
    assert (done.exit_code, done.stdout) == (2, "")
    assert "found real hardware to push, and no terminal to ask at; expected --yes, or --no-push" in done.stderr
    read = manyhands_command("check-driver", f"{MADE}Raising", "--parameters", "{hardware: true}", "--no-push")
    assert "not judged  wrong sign: nothing was pushed" in read.stdout
    assert "exception" not in read.stdout
    assert "5 of 10 checks were judged" in read.stdout


@pytest.mark.alone  # likewise
def test_nothing_is_asked_about_hardware_that_no_force_moves() -> None:
    done = manyhands_command("check-driver", f"{MADE}MovesByItself", "--parameters", "{hardware: true}", "--dof", 1)
    assert (done.exit_code, "this pushes real hardware" in done.stderr) == (0, False), done.output
    assert "not judged  wrong sign: skipped: the driver states that no force moves its device" in done.stdout
    nothing = "moves whatever force acts on it, as no hand does, so a run shows nothing about stability with a hand"
    assert f"the device does by itself, outside the certificate: {nothing}" in done.stdout
    assert done.stdout.splitlines()[-1].endswith(f'by_itself: ["{nothing}"]')


@pytest.mark.alone  # likewise
def test_what_a_device_does_by_itself_is_said() -> None:
    done = manyhands_command("check-driver", f"{__name__}:Braking", "--no-push")
    assert "the device does by itself, outside the certificate: brakes above 1 m/s" in done.stdout
    assert json.loads(manyhands_command("check-driver", f"{__name__}:Braking", "--no-push", "--json").stdout)[
        "by_itself"
    ] == ["brakes above 1 m/s"]


class Braking(Counterpart):
    def specification(self) -> DeviceSpecification:
        return replace(super().specification(), by_itself=("brakes above 1 m/s",))


class TestProbe:
    def test_a_counterpart_answers(self) -> None:
        done = manyhands_command("probe", f"{__name__}:Braking", "--seconds", "0.1")
        assert done.exit_code == 0, done.output
        read, answered, deed = done.stdout.splitlines()
        assert read == "axis 0 stayed at 0.000 mm until it was pushed"
        assert answered.startswith("axis 0 answered +0.5 N by moving +3.")
        assert deed == "the device does by itself, outside the certificate: brakes above 1 m/s"

    def test_one_that_is_wrong_ends_with_1(self) -> None:
        done = manyhands_command("probe", f"{MADE}SwappedAxes", "--dof", "2", "--seconds", "0.1")
        assert done.exit_code == 1
        assert done.stdout.splitlines()[-1] == "the axes after it were not pushed"
        plain = json.loads(manyhands_command("probe", f"{MADE}WrongSign", "--seconds", "0.1", "--json").stdout)
        assert [(answer["axis"], answer["right"]) for answer in plain["answers"]] == [("axis 0", False)]
        assert plain["reads"] == [{"axis": "axis 0", "low": 0.0, "high": 0.0}]

    def test_nothing_is_pushed_where_that_is_not_wanted_or_moves_nothing(self) -> None:
        done = manyhands_command("probe", f"{MADE}Raising", "--no-push", "--seconds", "0.1")  # raises at a force
        assert (done.exit_code, done.stdout.splitlines()[-1]) == (0, "no force was exerted")
        done = manyhands_command("probe", f"{MADE}MovesByItself", "--seconds", "0.1")
        assert done.exit_code == 0
        assert "the driver states that no force moves its device" in done.stdout

    def test_a_driver_that_fails_ends_with_1_and_is_named(self) -> None:
        done = manyhands_command("probe", f"{MADE}Raising", "--seconds", "0.1")
        assert done.exit_code == 1
        assert "failed in apply: found OSError: no such device" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "found"),
    [
        (["probe", f"{MADE}Counterpart", "--seconds", "0"], "--seconds: found 0; expected a number greater than 0"),
        (["probe", f"{MADE}Counterpart", "--dof", "33"], "found 33 axes or ports; expected 1 to 32"),
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
