"""The command line: exit codes, standard output and error, and messages that name the remedy."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manyhands
from manyhands.launch.app import cli
from manyhands.launch.plan.sites import SessionPart

from ....support.broken_sessions import BROKEN
from ....support.commands import manyhands_command

SESSIONS = Path(__file__).parents[4] / "launch" / "sessions"

STIFFNESS_26 = "[704.9058, 704.9336, 704.8754]"
MATRICES_27 = (
    "[[660.4367,-0.2614,-0.3282],[-0.2614,660.4181,-0.3429],[-0.3282,-0.3429,660.4602]]",
    "[[0.1674,-0.0003,-0.0005],[-0.0003,0.1685,-0.0006],[-0.0005,-0.0006,0.1675]]",
)

pytestmark = pytest.mark.usefixtures("own_interrupt")


def given(K: str, B: str) -> list[str]:
    return ["--set", "design.coupling=given", "--set", f"design.stiffness={K}", "--set", f"design.damping={B}"]


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_session_is_exit_2_and_one_message(name: str, tmp_path: Path) -> None:
    path = BROKEN[name].write(name, tmp_path)
    for command in (["design"], ["launch", "--duration", "1"]):
        result = manyhands_command(*command, path)
        assert result.exit_code == 2
        assert result.stdout == ""
        lines = result.stderr.splitlines()
        assert lines[0].startswith(f"error: {path}")
        assert "expected" in result.stderr
        assert "Traceback" not in result.stderr
        assert result.stderr.count("error:") == 1


LINK = "couplings.cx.wave_link={mass: 0.5, round_trip: 0.1}"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["design", "absent.yaml"], "absent.yaml"),
        (["design", "example1.yaml", "--set", "devices.dx.mass=heavy"], "--set devices.dx.mass"),
        (["design", "example1.yaml", "--set", "devices.dx.maas=1"], "did you mean 'mass'"),
        (["design", "example1.yaml", "-o", "no/such/folder/c.json"], "expected one that exists"),
        (["simulate", "example1.yaml", "--duration", "0"], "--duration: found 0 s"),
        (["simulate", "example1.yaml", "--duration", "nan"], "--duration: found nan s"),
        (["simulate", "example1.yaml", "--duration", "1e8"], "expected at most"),
        (["simulate", "example1.yaml", "--record", "run.xls"], "expected one of .csv, .npz, .parquet\n"),
        (["launch", "example1.yaml", "--clock", "sundial"], "--clock: found 'sundial'"),
        (["launch", "example1.yaml", "--transport", "udp"], "--transport: found 'udp'"),
        (["launch", "example1.yaml", "--record", "run"], "expected one of .csv, .npz, .parquet, .mcap\n"),
        (["launch", "example1.yaml", "--report", "no/such/folder/r.json"], "expected one that exists"),
        (["verify", "absent.json"], "absent.json"),
        (["demo", "--clock", "sundial"], "--clock: found 'sundial'"),
        (["design", "example1.yaml", "-o", "/tmp"], "/tmp: found a folder; expected the name of a file"),
        (["launch", "example1.yaml", "--report", "/tmp"], "/tmp: found a folder"),
        (["demo", "--duration", "0"], "--duration: found 0 s"),
        (["demo", "--duration", "1e8"], "expected at most"),
        (["demo", "-o", "/dev/null"], "/dev/null: found a file; expected the name of a folder"),
        (["design", "example1.yaml", "--plot", "/dev/null"], "/dev/null: found a file; expected the name of a folder"),
        (["budget", "absent.yaml"], "absent.yaml"),
        (["budget", "example1.yaml", "--plot", "picture.xls"], "picture.xls"),
        (["budget", "example1.yaml", "--plot", "no/such/folder/b.png"], "no/such/folder"),
        (["budget"], "found neither SESSION nor --osp"),
        (["budget", "example1", "--osp", "1"], "found --osp beside a session"),
        (["budget", "example1", "--friction", "1"], "found an option of --osp without it; expected a session file, or"),
        (["budget", "--osp", "1", "--set", "period=0.1"], "found --osp beside a session or --set"),
        (["budget", "--osp", "-1"], "--osp: found -1; expected a number greater than 0"),
        (["budget", "--osp", "nan"], "--osp: found nan"),
        (["budget", "--osp", "1", "--friction", "-1"], "--friction: found -1; expected a number of 0 or more"),
        (["budget", "--osp", "1", "--delay", "0.002"], "--delay: found 0.002 s; expected at most a period, 0.001 s"),
        (["budget", "--osp", "1", "--speed", "1"], "--speed: found a device without dry friction"),
        (["budget", "--osp", "1", "--kappa", "9", "--force", "3"], "--fastest: found 0; expected a number greater"),
        (["simulate", "example1", "--delay", "40ms"], "found a session without a wave link"),
        (["simulate", "example1", "--set", LINK, "--delay", "4o"], "--delay: found '4o'; expected a time, such as"),
        (["simulate", "example1", "--set", LINK, "--loss", "95%"], "--loss: found '95%'; expected a part of the waves"),
        (
            ["simulate", "ball", "--delay", "80"],
            "--delay: found '80'; expected a time under way in s from 0 to 10, such",
        ),
        (["launch", "example1", "--set", LINK, "--jitter", "1ms"], "expected --clock simulated"),
        (["design"], "Missing argument"),
        (["dance"], "No such command"),
    ],
)
def test_usage_errors_are_exit_2(arguments: list[str], words: str) -> None:
    result = manyhands_command(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stdout == ""


@pytest.mark.parametrize(
    ("session", "arguments", "margin"),
    [
        ("example1.yaml", [], None),
        ("example1-centralised.yaml", [], None),
        ("example1-operator.yaml", [], None),
        ("example1.yaml", given(STIFFNESS_26, "0.0372"), 0.7979),
        ("example1-centralised.yaml", given(*MATRICES_27), 0.9455),
    ],
)
def test_design_certifies_and_verify_proves_again(
    session: str, arguments: list[str], margin: float | None, tmp_path: Path
) -> None:
    file = tmp_path / "c.json"
    result = manyhands_command("design", session, "-o", file, "--json", *arguments)
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    assert said["status"] == "certified"
    assert said["gamma"] is None
    levels = {name: np.array(value) for name, value in said["levels"].items()}
    D, V, E = levels["Delta_D"], levels["Delta_V"], levels["Phi_E"]
    least = np.linalg.eigvalsh(np.block([[D - E, -E], [-E, V - E]]))[0]
    assert least > 0.0
    assert said["margin"] == pytest.approx(least, rel=1e-12)
    if margin is not None:
        assert said["margin"] == pytest.approx(margin, abs=1e-3)
    mask = np.zeros_like(D, dtype=bool)
    ports = [port for block in said["structure"] for port in block]
    for block in said["structure"]:
        rows = [ports.index(port) for port in block]
        mask[np.ix_(rows, rows)] = True
    assert np.all(np.array(said["coupling"]["stiffness"])[~mask] == 0.0)
    assert np.all(np.array(said["coupling"]["damping"])[~mask] == 0.0)

    proof = manyhands_command("verify", file, "--json")
    assert proof.exit_code == 0, proof.stderr
    assert json.loads(proof.stdout)["id"] == said["id"]
    shown = manyhands_command("verify", file)
    assert shown.exit_code == 0
    assert said["id"] in shown.stdout


def test_the_session_a_certificate_belongs_to_is_checked(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    assert manyhands_command("design", "example1.yaml", "-o", file).exit_code == 0
    assert manyhands_command("verify", file, "--session", "example1.yaml").exit_code == 0
    other = manyhands_command("verify", file, "--session", "example1-centralised.yaml")
    assert other.exit_code == 3
    assert "it is the session's: the session's name differs" in other.stderr


def test_too_stiff_a_coupling_exits_3_and_names_possible_relaxations() -> None:
    result = manyhands_command("design", "example1.yaml", "--json", *given("3000", "0"))
    assert result.exit_code == 3
    said = json.loads(result.stdout)
    assert said["status"] == "infeasible"
    assert said["id"] is None
    assert "2740 N/m" in said["reason"]
    assert any("a stiffness below 2740 N/m" in way for way in said["relax"])
    assert any("osp above 1.5" in way for way in said["relax"])
    assert len(said["changes"]) == len(said["relax"])
    assert said["changes"][0] == {"design.stiffness": 2737.1}
    assert "not certified" in result.stderr


@pytest.mark.parametrize("command", [["design"], ["launch", "--duration", "1"]])
def test_without_coupling_a_session_is_refused(command: list[str]) -> None:
    result = manyhands_command(*command, "example1-uncoupled.yaml")
    assert result.exit_code == 3
    assert "there is no coupling" in result.stderr
    assert "\n  could help: a coupling that is designed: --set 'design={coupling: spring-damper}' is" in result.stderr


def test_the_printed_operator_is_refused_as_not_passive() -> None:
    printed = "[[&h {num: [0.02,1.2,20], den: [1,10.3,100]},0.1,0.1],[0.1,*h,0.1],[0.1,0.1,*h]]"
    result = manyhands_command("design", "example1-operator.yaml", "--set", f"devices.d.hand.operator={printed}")
    assert result.exit_code == 2
    assert "operator not passive at 20.9 rad/s" in result.stderr


def test_simulate_writes_what_launch_records(tmp_path: Path) -> None:
    one, other = tmp_path / "simulate.npz", tmp_path / "launch.npz"
    assert manyhands_command("simulate", "example1.yaml", "--duration", "0.4", "--record", one).exit_code == 0
    report = tmp_path / "report.json"
    result = manyhands_command(
        "launch", "example1", "--duration", "0.4", "--clock", "simulated", "--record", other, "--report", report
    )
    assert result.exit_code == 0, result.stderr
    with np.load(one) as a, np.load(other) as b:
        assert a["x"].shape == (400, 3)
        for signal in ("x", "f_v", "ports", "certificate"):
            np.testing.assert_array_equal(a[signal], b[signal])
    assert json.loads(report.read_text())["nodes"]["dx"]["ticks"] == 400


def test_an_uncertified_simulation_warns(tmp_path: Path) -> None:
    result = manyhands_command("simulate", "example1-uncoupled.yaml", "--duration", "0.1")
    assert result.exit_code == 0
    assert "not certified" in result.stderr
    quiet = manyhands_command("simulate", "example1-uncoupled.yaml", "--duration", "0.1", "--uncertified")
    assert "not certified" not in quiet.stderr


@pytest.mark.parametrize("command", [["design"], ["launch", "--duration", "1"], ["simulate", "--duration", "1"]])
@pytest.mark.parametrize("becomes", [ImportError("half an import"), SystemError("half a module"), None])
def test_ctrl_c_is_130_even_when_an_import_catches_it(
    command: list[str], becomes: Exception | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Extension modules may turn what is raised while they load into an error of theirs, or swallow it."""
    honest = SessionPart.design

    def importing(*arguments: Any) -> Any:
        try:
            signal.raise_signal(signal.SIGINT)
        except (KeyboardInterrupt, SystemExit):
            if becomes is not None:
                raise becomes from None
        return honest(*arguments)

    monkeypatch.setattr(SessionPart, "design", importing)
    monkeypatch.setattr(cli.common, "ctrl_c", [])
    result = manyhands_command(*command, "example1.yaml", "--set", "design.tau=0")
    assert result.exit_code == 130
    assert "Traceback" not in result.output


def test_help_of_every_command_ends_with_an_example() -> None:
    for command in ("design", "verify", "budget", "simulate", "launch", "demo"):
        text = manyhands_command(command, "--help").stdout
        assert f"Example: manyhands {command}" in text.split("Options")[-1]
    assert manyhands.__version__ in manyhands_command("--version").stdout


def test_a_short_demo_draws_and_reports(tmp_path: Path) -> None:
    out = tmp_path / "demo"
    result = manyhands_command("demo", "-o", out, "--duration", "8", "--clock", "simulated")
    assert result.exit_code == 0, result.stderr
    names = {path.name for path in out.iterdir()}
    assert {"report.json", "certificate.json", "velocities.png", "fig6-decentralised.png"} <= names
    assert json.loads((out / "certificate.json").read_text())["id"] in result.stdout
    for path in out.glob("*.png"):
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 10_000
    assert manyhands_command("verify", out / "certificate.json").exit_code == 0


def test_a_demo_that_does_not_come_to_rest_reports_it(tmp_path: Path) -> None:
    result = manyhands_command("demo", "-o", tmp_path / "demo", "--duration", "0.5", "--clock", "simulated")
    assert result.exit_code == 1
    assert "not every device came to rest" in result.stdout


def test_the_command_line_starts_without_what_only_some_commands_need() -> None:
    """Help, completion and a mistyped option should not wait for solvers, exact arithmetic or plots to be imported."""
    code = (
        "import sys, manyhands.launch.app.cli\n"
        "heavy = {'scipy', 'cvxpy', 'clarabel', 'flint', 'matplotlib'}\n"
        "print(sorted({name.split('.')[0] for name in sys.modules} & heavy))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert out.stdout.strip() == "[]"


def test_a_delay_can_be_tried_and_a_stated_one_is_not_ignored() -> None:
    """Two ways of 40 ms, and both play-outs: 10 ms of jitter are ten ticks, and two for a lost wave, each."""
    asked = ("simulate", "example1", "--duration", "0.5", "--set", "design.tau=0", "--set", LINK)
    tried = manyhands_command(*asked, "--delay", "40ms", "--jitter", "10ms", "--loss", "2%")
    assert tried.exit_code == 0, tried.stderr
    R = float(tried.stdout.partition("wave link of cx: a round trip of ")[2].partition(" ms")[0])
    assert 100.0 <= R <= 2 * (40.0 + 10.0 + 2.0 + 8.0)  # at most so; and the smoothing of a deeper play-out
    assert "no network is simulated" not in tried.stderr
    none = manyhands_command(*asked)
    assert "a round trip of 1 ms is felt" in none.stdout
    assert "cx: a round trip of 100 ms is stated, and no network is simulated" in none.stderr
    assert "--delay 50ms simulates one" in none.stderr
