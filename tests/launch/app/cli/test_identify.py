"""identify as a command: what it prints and writes, its exit codes, and when hardware is moved."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from manyhands.design.budget import stiffest
from manyhands.launch.session import Session

from ....support.commands import manyhands_command

SLIDE = "tests.support.identified_plants:slide"

pytestmark = pytest.mark.usefixtures("own_interrupt")


def test_it_ends_with_the_osp_and_the_stiffness_that_follows_and_writes_both(tmp_path: Path) -> None:
    file = tmp_path / "slide.device.yaml"
    folder = tmp_path / "new" / "pictures"
    options = ("--period", 0.002, "--travel", 0.02, "-o", file, "--plot", folder, "--name", "slide")
    done = manyhands_command("identify", SLIDE, *options)
    assert done.exit_code == 0, done.output
    assert "damping N·s/m" in done.stdout
    read = yaml.safe_load(file.read_text())
    osp = read["keys"]["osp"]
    assert 0.4 < osp <= 0.5
    assert read["device"] == "slide"
    assert done.stdout.splitlines()[-1].startswith(f"for the session file: osp: {osp:g}, friction: {{least: [")
    # K = b/(T/2), with no delay
    assert f"up to {osp / 0.001:.4g} N/m follows" in done.stdout
    assert (folder / "identify-1.png").stat().st_size > 1000
    device = Session.from_dict(
        {
            "session": "found",
            "period": 0.002,
            "devices": {"stick": {"from": str(file)}},
            "couplings": {"c": {"devices": ["stick"]}},
            "environment": {"type": "network", "links": [{"between": ["stick.0", "ground"], "stiffness": 100}]},
            "design": {"coupling": "spring-damper"},
        }
    ).devices["stick"]
    assert device.osp == ((osp,),)
    assert device.friction is not None
    refused = manyhands_command("identify", SLIDE, "--plot", file)  # before anything moves
    assert (refused.exit_code, refused.stdout) == (2, "")
    assert f"{file}: found a file; expected the name of a folder" in refused.stderr
    again = manyhands_command("identify", SLIDE, "-o", file)
    assert again.exit_code == 2
    assert "--overwrite" in again.output


def test_a_session_with_the_file_runs_at_a_start_that_measures_more_up_to_what_the_file_states(tmp_path: Path) -> None:
    """The file has half as much again as the greatest of three starts, and no jitter: then that is all of the age."""
    starts, file, session = tmp_path / "starts", tmp_path / "slide.yaml", tmp_path / "wall.yaml"
    starts.write_text("4e-4 1e-4 2e-4\n6e-4 2e-4 3e-4\n5e-4 1e-4 2e-4")
    driver, given = "tests.support.identified_plants:slide_of_starts", json.dumps({"starts": str(starts)})
    options = ("--period", 0.004, "--travel", 0.02, "--parameters", given, "-o", file)
    done = manyhands_command("identify", driver, *options)
    assert done.exit_code == 0, done.output
    keys, sources = (yaml.safe_load(file.read_text())[part] for part in ("keys", "sources"))
    assert ({"age_jitter"} & keys.keys(), keys["sample_age"], keys["actuation_delay"]) == (set(), 9e-4, 4.5e-4)
    assert sources["sample_age"].startswith("1.5 times the greatest that the driver measured at 3 starts, ")
    assert "its times are those of 3 starts, with half as much again for the next ones" in done.stdout
    # with all of the age as jitter, so for the session that has the file
    limit = stiffest(np.eye(1) * keys["osp"], 0.004, 9e-4 + 4.5e-4, period_tolerance=9e-4 / 0.004)
    assert f"up to {limit.certified:.4g} N/m follows, at a period of 4 ms and a delay of 1.35 ms" in done.stdout
    world = {"type": "network", "links": [{"between": ["stick.0", "ground"], "stiffness": 20}]}
    content = {"session": "wall", "period": 0.004, "devices": {"stick": {"from": "./slide.yaml"}}}
    content |= {"couplings": {"c": {"devices": ["stick"]}}, "environment": world}
    session.write_text(yaml.safe_dump({**content, "design": {"coupling": "spring-damper"}}))

    def launched(at_this_start: str) -> tuple[int, str]:
        starts.write_text(at_this_start)
        ran = manyhands_command("simulate", session, "--duration", 0.1)
        return ran.exit_code, ran.output

    assert launched("9e-4 9e-4 4e-4")[0] == 0  # nine times the jitter of the first start
    code, output = launched("0.0012 1e-4 4e-4")
    assert code != 0
    assert (
        "sample_age: found 0.0009 s; expected at least 0.0012 s, which the driver measured at this start: end other "
        "programs, or state as much and design the session anew" in output
    )


def test_json_has_the_device_file() -> None:
    options = ("--period", 0.002, "--travel", 0.02, "--parameters", "{c: 0.3}", "--json")
    done = manyhands_command("identify", SLIDE, *options)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["keys"]["driver"] == SLIDE


def test_hardware_is_not_moved_without_a_terminal_to_ask_at() -> None:
    done = manyhands_command("identify", SLIDE, "--parameters", "{hardware: true}")
    assert done.exit_code == 1
    assert "no terminal to ask at: give --yes" in done.output


def test_something_that_gives_energy_is_refused() -> None:
    options = ("--period", 0.002, "--travel", 0.02, "--parameters", "{b: -0.05, c: 0.0}")
    done = manyhands_command("identify", SLIDE, *options)
    assert done.exit_code == 1, done.output
    assert "osp:" not in done.stdout


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--travel", 0), "--travel: found 0; expected a number greater than 0"),
        (("--dof", 4), "--dof: found 4; expected 1 to 3"),
        (("--poses", 10), "--poses: found 10"),
        (("--dof", 2), "found 1 axes; expected --dof 2"),
    ],
)
def test_bad_options_are_refused(options: tuple[object, ...], said: str) -> None:
    done = manyhands_command("identify", SLIDE, *options)
    assert done.exit_code == 2
    assert said in done.output
