"""`manyhands design`, `verify` and `budget`: pictures, the output for other programs, and Ctrl-C meanwhile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from manyhands.design import synthesis
from manyhands.design.certificate import identity, load
from manyhands.design.proof import prove
from manyhands.launch.app import cli
from manyhands.launch.look import figures

from ....support.commands import manyhands_command

KEYS = {"status", "id", "version", "asked", "margin", "gamma", "coupling", "levels", "margins", "period", "tau"}
KEYS |= {"period_tolerance", "structure", "enforced", "series", "encoder", "speed", "mechanism"}
GIVEN = ["--set", "design.coupling=given", "--set", "design.stiffness=704.9", "--set", "design.damping=0.0372"]
SHAPED = [*GIVEN, "--set", "design.objective=loop-shaping"]
COMPLEMENTARITY = ["--set", "design.algorithm=complementarity"]

pytestmark = pytest.mark.usefixtures("own_interrupt")


def one_object(result: Result) -> dict[str, Any]:
    """All of standard output is one JSON object."""
    said = json.loads(result.stdout)
    assert isinstance(said, dict)
    return said


def proved(path: Path) -> bool:
    return all(finding.holds for finding in prove(load(path)[1]))


def test_design_draws_into_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(figures, "DPI", 30)  # the same, sooner
    folder = tmp_path / "pictures" / "of example 1"
    result = manyhands_command("design", "example1.yaml", "--plot", folder, "-o", tmp_path / "c.json")
    assert result.exit_code == 0, result.stderr
    names = {path.stem for path in folder.iterdir()}
    assert {"structure", "passivity"} <= names
    assert not any("convergence" in name for name in names)  # a method without iterations converges to nothing
    for path in folder.iterdir():
        assert path.name in result.stderr
        assert path.read_bytes().startswith(b"\x89PNG")
    assert f"manyhands verify {tmp_path / 'c.json'}" in result.stderr
    more = manyhands_command("design", "example1.yaml", "--plot", folder, *COMPLEMENTARITY)
    assert more.exit_code == 0, more.stderr
    assert any("convergence" in path.stem for path in folder.iterdir())


def test_the_object_of_a_design(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    result = manyhands_command("design", "example2.yaml", "-o", file, "--json", *SHAPED)
    assert result.exit_code == 0, result.stderr
    said = one_object(result)
    assert set(said) == KEYS
    assert (said["status"], said["tau"], said["period"]) == ("certified", 0.0, 1e-3)
    assert said["gamma"] == pytest.approx(49.02, abs=0.01)
    assert said["structure"] == [["dx"], ["dy"], ["dz"]]
    assert set(said["levels"]) >= {"Delta_D", "Delta_V", "Phi_E"}
    again = one_object(manyhands_command("verify", file, "--json"))
    assert {key: again[key] for key in KEYS} == said
    assert again["failing"] == []
    assert str(said["gamma"])[:5] in manyhands_command("design", "example2.yaml", *SHAPED).stdout


def test_the_object_of_a_design_with_a_delay() -> None:
    result = manyhands_command("design", "example1.yaml", "--json", "--set", "design.tau=0.00025")
    assert result.exit_code == 0, result.stderr
    said = one_object(result)
    assert (said["tau"], said["gamma"]) == (2.5e-4, None)
    assert said["levels"]["kappa"] > 0.5
    assert 0.0 < said["levels"]["share"] < 1.0
    assert "0.00025 s" in manyhands_command("design", "example1.yaml", "--set", "design.tau=0.00025").stdout


def test_a_design_for_longer_periods(tmp_path: Path) -> None:
    file = str(tmp_path / "c.json")
    wanted = ("--set", "design.objective=stiffest", "--set", "design.period_tolerance=0.25")
    result = manyhands_command("design", "example1.yaml", "-o", file, "--json", *wanted)
    assert result.exit_code == 0, result.stderr
    said = one_object(result)
    assert (said["tau"], said["period_tolerance"], said["version"]) == (0.0, 0.25, 4)
    assert said["levels"]["share"] == pytest.approx(0.8)
    assert max(map(max, said["coupling"]["stiffness"])) < 2740.0 / 1.25
    assert (
        "T = 0.001 s, tau = 0 s, periods up to 1.25 T" in manyhands_command("design", "example1.yaml", *wanted).stdout
    )
    assert "periods up to (1 + rho) T" in manyhands_command("verify", file).stdout
    simulate = ("simulate", "example1.yaml", "--certificate", file, "--duration", "0.01")
    assert manyhands_command(*simulate, *wanted).exit_code == 0
    other = manyhands_command(*simulate, *wanted[:2], "--set", "design.tau=0")
    assert other.exit_code != 0
    assert "the period tolerance differs: the certificate has 0.25, the session 0.0" in other.stderr
    assert manyhands_command(*simulate, *wanted[:2]).exit_code == 0  # a session that leaves its delay open


def test_the_object_of_linear_blocks() -> None:
    """Matrices of the whole V, when it has no K and B."""
    matrices = {name: {"A": [[0.2]], "B": [[1e-3]], "C": [[0.5]], "D": [[1e-3]]} for name in ("cx", "cy", "cz")}
    text = json.dumps(matrices)
    result = manyhands_command(
        "design", "example1.yaml", "--json", "--set", "design.coupling=given", "--set", f"design.matrices={text}"
    )
    assert result.exit_code == 0, result.stderr
    coupling = one_object(result)["coupling"]
    assert set(coupling) == {"A", "B", "C", "D"}
    assert coupling["A"] == [[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]]


def test_a_forged_file_is_exit_3_with_what_fails(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    assert manyhands_command("design", "example1.yaml", "-o", file, *GIVEN).exit_code == 0
    data = json.loads(file.read_text())
    data["levels"]["Delta_V"]["cy"] = [[5.0]]
    data["margins"] = {}
    data["id"] = identity(data)
    file.write_text(json.dumps(data))
    result = manyhands_command("verify", file)
    assert result.exit_code == 3
    assert "not proved: V_hat of cy is Delta_V-OSP" in result.stderr
    said = one_object(manyhands_command("verify", file, "--json"))
    assert said["status"] == "infeasible"
    assert any("V_hat of cy" in condition for condition in said["failing"])


def test_a_file_that_the_proof_cannot_read_is_exit_2(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    assert manyhands_command("design", "example1.yaml", "-o", file, *GIVEN).exit_code == 0
    data = json.loads(file.read_text())
    data["margins"]["(10)"] = True
    file.write_text(json.dumps(data))
    for more in ([], ["--json"]):
        result = manyhands_command("verify", file, *more)
        assert result.exit_code == 2
        assert f"error: {file}: margins.(10)" in result.stderr
        assert result.stdout == ""


def test_another_aim_is_another_session(tmp_path: Path) -> None:
    file = tmp_path / "c.json"
    assert manyhands_command("design", "example2.yaml", "-o", file, *GIVEN[:2], *SHAPED).exit_code == 0
    result = manyhands_command("verify", file, "--session", "example2.yaml")
    assert result.exit_code == 3
    words = "design.coupling differs: the certificate has given, the session asks for spring-damper"
    assert [line for line in result.stderr.splitlines() if words in line] == result.stderr.splitlines()
    other = manyhands_command("verify", file, "--session", "example2-closed-loop.yaml", "--json")
    assert other.exit_code == 3
    assert any("the transparency problem differs" in text for text in one_object(other)["failing"])


def test_infeasible_is_one_object_too() -> None:
    result = manyhands_command("design", "example1.yaml", "--json", *GIVEN, "--set", "design.tau=0.001")
    assert result.exit_code == 3
    said = one_object(result)
    assert set(said) == KEYS | {"reason", "relax", "changes"}
    assert (said["status"], said["id"], said["coupling"]) == ("infeasible", None, None)
    assert "its stiffness plus 2/T times its damping, 779.3 N/m, is not below" in said["reason"]
    assert any(way.startswith("a delay inside the tick below") for way in said["relax"])


def test_budget_prints_and_draws(tmp_path: Path) -> None:
    picture = tmp_path / "budget.png"
    result = manyhands_command("budget", "example1.yaml", "--plot", picture)
    assert result.exit_code == 0, result.stderr
    assert "2740" in result.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    said = one_object(manyhands_command("budget", "example1.yaml", "--json"))
    assert "2740" in json.dumps(said)
    doubled = one_object(manyhands_command("budget", "example1.yaml", "--json", "--set", "period=0.0005"))
    assert said != doubled


def own(*options: str) -> dict[str, Any]:
    return one_object(manyhands_command("budget", "--json", "--osp", "0.05", *options))


def certified(of: dict[str, Any], tau: float) -> float:
    (row,) = [row for row in of["devices"]["device"]["against_tau"] if row["tau"] == pytest.approx(tau, abs=1e-12)]
    return float(row["certified"])


def test_a_device_without_a_session_gets_what_the_laws_say() -> None:
    """b/(T/2 + 3 tau/2) of [Bianchini2010]_'s condition; what a linkage takes of b, as docs/mechanisms.md has it."""
    plain, fast = own(), own("--rate", "4000", "--delay", "0.0001")
    assert certified(plain, 0.0) == pytest.approx(100.0)
    assert certified(plain, 1e-3) == pytest.approx(25.0)
    assert certified(fast, 1e-4) == pytest.approx(0.05 / (0.125e-3 + 1.5e-4))
    varying = own("--jitter", "0.5ms")  # of docs/drivers.md: b/(1.5 T/2 + 3 tau/2), for periods up to 1.5 T
    assert certified(varying, 1e-3) == pytest.approx(0.05 / (0.75e-3 + 1.5e-3))
    geared = own("--kappa", "10", "--force", "3", "--fastest", "0.5")
    assert 30.0 < 100.0 - certified(geared, 0.0) < 40.0  # K_geo = kappa F_max is 30 N/m, and a little for the way


def test_friction_of_a_device_without_a_session_counts_below_speeds() -> None:
    below = {row["speed"]: row["certified"] for row in own("--friction", "0.1", "--speed", "0.2")["below_speeds"]}
    assert list(below) == [0.03, 0.1, 0.2, 0.3, 1.0]
    assert below[0.1] == pytest.approx(2.0 * (0.05 + 0.1 / 0.1) / 1e-3)  # 2 (b + c/v)/T
    assert sorted(below.values(), reverse=True) == list(below.values())
    assert "below_speeds" not in own()


def test_the_answer_for_a_device_without_a_session_is_a_sentence(tmp_path: Path) -> None:
    picture = tmp_path / "own.png"
    result = manyhands_command("budget", "--osp", "0.05", "--plot", picture)
    assert "a coupling below 100 N/m if nothing is late, and a coupling below 25 N/m" in result.stdout
    assert "(session)" not in result.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    none = manyhands_command("budget", "--osp", "0.05", "--kappa", "100", "--force", "10", "--fastest", "1")
    assert "none if nothing is late, and none if forces may be a period late" in none.stdout


def test_a_pipe_has_the_width_that_its_user_states() -> None:
    for columns, width in (("60", 60), ("", 140), ("none", 140)):
        code = "from manyhands.launch.app.cli.common import out; print(out.width)"
        done = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, "COLUMNS": columns}, capture_output=True, text=True,
            check=True,
        )  # fmt: skip
        assert int(done.stdout) == width


# --- Ctrl-C


def interrupting(after: int, calls: list[str], how: Callable[[], None]) -> Callable[..., Any]:
    """A design that is interrupted at the ``after``-th report of the search."""
    honest = synthesis.design

    def design(loop: Any, wanted: Any, progress: Callable[[str], None]) -> Any:
        def telling(text: str) -> None:
            calls.append(text)
            progress(text)
            if len(calls) == after:
                how()

        return honest(loop, wanted, telling)

    return design


def ctrl_c() -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.solver
def test_ctrl_c_keeps_the_best_so_far_and_writes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, calls = tmp_path / "c.json", []
    monkeypatch.setattr(synthesis, "design", interrupting(6, calls, ctrl_c))
    result = manyhands_command("design", "example1.yaml", "-o", file, "--json", *COMPLEMENTARITY)
    assert result.exit_code == 130
    assert "interrupted; this is the best coupling so far, and it is certified" in result.stderr
    assert proved(file)
    said = one_object(result)
    assert said["status"] == "certified"
    assert said["id"] == load(file)[0].id
    assert "not converged" in load(file)[0].method["algorithm"]


@pytest.mark.solver
@pytest.mark.parametrize("arguments", [[], GIVEN], ids=["search", "given"])
def test_ctrl_c_before_anything_is_found_writes_nothing(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, calls = tmp_path / "c.json", []
    monkeypatch.setattr(synthesis, "design", interrupting(1, calls, ctrl_c))
    result = manyhands_command("design", "example1.yaml", "-o", file, "--json", *arguments)
    assert result.exit_code == 130
    assert (result.stdout, list(tmp_path.iterdir())) == ("", [])
    assert "interrupted before a coupling was found" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.solver
def test_a_second_ctrl_c_ends_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, calls = tmp_path / "c.json", []

    def twice() -> None:
        try:
            ctrl_c()
        except KeyboardInterrupt:
            ctrl_c()

    monkeypatch.setattr(synthesis, "design", interrupting(6, calls, twice))
    result = manyhands_command("design", "example1.yaml", "-o", file, *COMPLEMENTARITY)
    assert result.exit_code == 130
    assert (result.stdout, list(tmp_path.iterdir())) == ("", [])
    assert len(calls) == 6


@pytest.mark.solver
def test_an_interrupt_answered_with_the_best_result_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the method: the flag of what was found is what decides, not the signal alone."""
    honest = synthesis._springs

    def interrupted(*arguments: Any, **options: Any) -> synthesis.Found:
        found = honest(*arguments, **options)
        return synthesis.Found(found.coupling, found.method, interrupted=True)

    monkeypatch.setattr(synthesis, "_springs", interrupted)
    result = manyhands_command("design", "example1.yaml", "--json")
    assert result.exit_code == 130
    assert one_object(result)["status"] == "certified"


def test_the_handler_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a design Ctrl-C means again what it means to the command line."""
    seen: list[Any] = []
    honest = cli.common.end

    def ending(code: int) -> None:
        seen.append(signal.getsignal(signal.SIGINT))
        honest(code)

    monkeypatch.setattr(cli.design, "end", ending)
    assert manyhands_command("design", "example1.yaml", *GIVEN).exit_code == 0
    assert seen == [cli.common.unwind]
