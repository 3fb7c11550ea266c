"""`manyhands design`, `verify` and `budget` of a session with wave links, and the commands that do not run one yet."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from manyhands.design.certificate import identity
from manyhands.launch.app.api import verify
from manyhands.launch.session.shipped import load_named

from ....support.commands import manyhands_command

pytestmark = pytest.mark.usefixtures("own_interrupt")

LINKED = [
    "--set", "couplings.cx={devices: [dx], wave_link: {mass: 0.05, round_trip: 0.004, period: 0.00025, tau: 0.00005}}",
    "--set", "couplings.cy={devices: [dy], wave_link: {b: 20, round_trip: 0.006}}",
    "--set", "design.objective=stiffest",
]  # fmt: skip


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """The world's file; those of the parts stand beside it."""
    result = manyhands_command("design", "example1", "-o", tmp_path / "one.cert.json", *LINKED)
    assert result.exit_code == 0, result.stderr
    return tmp_path / "one.cert.json"


def test_every_part_is_written_and_proved(written: Path, tmp_path: Path) -> None:
    names = ("one.cx.cert.json", "one.cy.cert.json", "one.in-tick.cert.json")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, "one.cert.json"])
    for name, words in zip(names, ("cx: proved, whatever", "cy: proved, whatever", "users in the tick"), strict=True):
        result = manyhands_command("verify", tmp_path / name)
        assert result.exit_code == 0, result.stderr
        assert words in result.stdout
        assert "assumed" in result.stdout
    together = [option for name in names for option in ("--with", tmp_path / name)]
    result = manyhands_command("verify", written, *together)
    assert result.exit_code == 0, result.stderr
    assert "example-1: the world is proved; " in result.stdout
    assert "its parties are cx, cy, in-tick; certificates that were proved together with it: 3" in result.stdout


@pytest.mark.parametrize(
    ("environment", "kept"),
    [
        ("{type: python, model: 'a:b', level: [-0.1, -0.1, 0]}", "is enforced at run time"),
        ("{type: python, model: 'a:b', stiffness: 900}", "is kept by the proxy test at every tick"),
        ("{type: scene, tools: {dx: {}, dy: {}, dz: {}}}", "is enforced at run time"),
    ],
)
def test_a_world_whose_level_is_not_proved_says_what_keeps_it(tmp_path: Path, environment: str, kept: str) -> None:
    file = tmp_path / "world.json"
    options = ["--part", "environment", "-o", file, *LINKED, "--set", f"environment={environment}"]
    assert manyhands_command("design", "example1", *options).exit_code == 0
    said = manyhands_command("verify", file).stdout
    assert f"example-1: the world is proved, where the level of the environment {kept}; " in said


def test_a_design_shows_what_is_felt(tmp_path: Path) -> None:
    result = manyhands_command("design", "example1", *LINKED)
    assert result.exit_code == 0, result.stderr
    assert "at least 4418.8 N/m and at most 50 g over a round trip of 4 ms" in result.stdout
    assert "margin of (A)" in result.stdout
    assert "0.4597 N·s/m" in result.stdout


def test_one_part_alone(written: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.json"
    result = manyhands_command("design", "example1", "--part", "cx", "-o", alone, *LINKED)
    assert result.exit_code == 0, result.stderr
    assert alone.read_bytes() == (tmp_path / "one.cx.cert.json").read_bytes()
    result = manyhands_command("design", "example1", "--part", "environment", "-o", alone, *LINKED)
    assert result.exit_code == 0, result.stderr
    assert alone.read_bytes() == written.read_bytes()


@pytest.mark.parametrize(
    ("session", "part", "expected"),
    [
        (LINKED, "cz", "expected one of cx, cy, in-tick, environment"),
        ([], "cx", "expected a session with wave links"),
    ],
)
def test_a_part_that_is_none(session: list[str], part: str, expected: str) -> None:
    result = manyhands_command("design", "example1", "--part", part, *session)
    assert result.exit_code == 2
    assert f"--part: found {part!r}; {expected}" in result.stderr


def test_the_object_of_a_design() -> None:
    result = manyhands_command("design", "example1", "--json", *LINKED)
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.stdout)
    assert list(said) == ["cx", "cy", "in-tick", "environment"]
    assert said["cx"]["margins"]["felt stiffness"] == pytest.approx(4418.785)
    assert said["environment"]["margin"] == pytest.approx(0.4597, abs=1e-4)
    assert set(said["environment"]["wave_links"]) == {"cx", "cy"}


def test_what_cannot_be_certified_is_reported_by_part() -> None:
    stiff = [*LINKED, "--set", "design.objective=feasible", "--set", "design.coupling=given"]
    result = manyhands_command("design", "example1", "--json", *stiff, "--set", "design.stiffness=3000")
    assert result.exit_code == 3
    assert "example-1: cy: not certified: coupling cy: its stiffness, 3000 N/m, is not below" in result.stderr
    said = json.loads(result.stdout)
    assert (said["cx"]["status"], said["cy"]["status"]) == ("certified", "infeasible")
    assert said["cy"]["relax"]
    late = manyhands_command("design", "example1", *LINKED, "--set", "environment.delay=1")
    assert late.exit_code == 3
    assert "environment: not certified: condition (A) fails: the environment needs 1.999 N·s/m" in late.stderr
    assert "could help: a world without delay: --set environment.delay=0 is certified with a margin of" in late.stderr


def test_a_forged_world_or_part_is_not_proved(written: Path, tmp_path: Path) -> None:
    data = json.loads(written.read_text())
    data["levels"]["Phi_E"]["cx"] = [[-1.0]]
    data["id"] = identity(data)
    forged = tmp_path / "forged.json"
    forged.write_text(json.dumps(data))
    result = manyhands_command("verify", forged)
    assert result.exit_code == 3
    assert "forged.json: not proved: E_hat is (-Phi_E)-ISP" in result.stderr
    part = json.loads((tmp_path / "one.cx.cert.json").read_text())
    part["margins"]["felt stiffness"] = 5000.0
    part["id"] = identity(part)
    forged.write_text(json.dumps(part))
    result = manyhands_command("verify", written, "--with", forged, "--json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["failing"] == ["the margin felt stiffness is not overstated"]
    assert "forged.json: not proved: the margin felt stiffness" in result.stderr


def test_only_a_world_has_parts(written: Path, tmp_path: Path) -> None:
    part = tmp_path / "one.cx.cert.json"
    result = manyhands_command("verify", part, "--with", written)
    assert result.exit_code == 2
    assert f"--with: found {part}, which is no world's certificate; expected that of a world" in result.stderr
    result = manyhands_command("verify", written, "--with", written)
    assert result.exit_code == 2


def test_a_world_and_a_part_are_compared_with_a_session(written: Path, tmp_path: Path) -> None:
    session = tmp_path / "one.yaml"
    plain = Path(__file__).parents[4] / "launch" / "sessions" / "example1.yaml"
    text = plain.read_text().replace("cx: {devices: [dx]}", LINKED[1].removeprefix("couplings.").replace("=", ": ", 1))
    text = text.replace("cy: {devices: [dy]}", LINKED[3].removeprefix("couplings.").replace("=", ": ", 1))
    session.write_text(text.replace("objective: feasible", "objective: stiffest"))
    for name in ("one.cert.json", "one.cx.cert.json", "one.in-tick.cert.json"):
        assert manyhands_command("verify", tmp_path / name, "--session", session).exit_code == 0
    session.write_text(session.read_text().replace("stiffness: 3800", "stiffness: 3900").replace("b: 20", "b: 21"))
    result = manyhands_command("verify", written, "--session", session)
    assert result.exit_code == 3
    assert "it is the session's: the environment differs from the session's" in result.stderr
    assert "the wave_links differs from the session's" in result.stderr
    assert manyhands_command("verify", tmp_path / "one.cx.cert.json", "--session", session).exit_code == 0
    result = manyhands_command("verify", tmp_path / "one.cy.cert.json", "--session", session)
    assert "it is the session's: the environment differs" in result.stderr
    result = manyhands_command("verify", tmp_path / "one.cy.cert.json", "--session", "example1")
    assert result.exit_code == 3


def test_every_part_is_compared_with_the_session(written: Path, tmp_path: Path) -> None:
    """The world of a session may be proved together with sites of another wish, period or hand: each is compared."""
    session = load_named("example1", [item for item in LINKED if item != "--set"])
    names = ("one.cx.cert.json", "one.cy.cert.json", "one.in-tick.cert.json")
    path = tmp_path / "session.yaml"
    path.write_text(yaml.safe_dump(session.as_plain(), sort_keys=False))
    together = [option for name in names for option in ("--with", tmp_path / name)]
    done = manyhands_command("verify", written, *together, "--session", path)
    assert done.exit_code == 0, done.stderr

    softer = manyhands_command(
        "design", "example1", "-o", tmp_path / "soft.cert.json", *LINKED[:-1], "design.objective=feasible"
    )
    assert softer.exit_code == 0, softer.stderr
    for name, words in (
        ("soft.cx.cert.json", "design.objective differs: the certificate has feasible, the session asks for stiffest"),
        ("soft.in-tick.cert.json", "design.objective differs: the certificate has feasible"),
    ):
        assert manyhands_command("verify", written, "--with", tmp_path / name).exit_code == 0  # of no session
        done = manyhands_command("verify", written, "--with", tmp_path / name, "--session", path)
        assert done.exit_code == 3
        assert f"{tmp_path / name}: not proved: it is the session's: {words}" in done.stderr
        assert not verify(written, path, [tmp_path / name])

    data = json.loads((tmp_path / "soft.cx.cert.json").read_text())
    data["asked"] = {}
    data["id"] = identity(data)
    forged = tmp_path / "unsaid.json"
    forged.write_text(json.dumps(data))
    done = manyhands_command("verify", written, "--with", forged, "--session", path)
    assert done.exit_code == 3
    assert "design.objective differs: the certificate has nothing, the session asks for stiffest" in done.stderr

    forged.write_text(json.dumps(data | {"version": 2}))
    done = manyhands_command("verify", written, "--with", forged, "--session", path)
    assert done.exit_code == 2
    assert f"{forged}: found a certificate of format version 2, which manyhands 0.6.0 is" in done.stderr


def test_a_simulation_in_one_process_has_one_period() -> None:
    result = manyhands_command("simulate", "example1", "--duration", "1", *LINKED)
    assert result.exit_code == 2
    assert "couplings.cx.wave_link.period: found 0.00025 s; expected the session's 0.001 s" in result.stderr


def test_a_session_runs_under_the_certificates_of_its_parts(tmp_path: Path) -> None:
    options = ("--duration", "0.2", "--clock", "simulated", *LINKED)
    folder = tmp_path / "run"
    result = manyhands_command("launch", "example1", *options, "--directory", folder)
    assert result.exit_code == 0, result.stderr
    kept = {path.name for path in folder.glob("certificate*")}
    assert kept == {"certificate.json", "certificate.cx.json", "certificate.cy.json", "certificate.in-tick.json"}
    again = manyhands_command("launch", "example1", *options, "--certificate", folder / "certificate.json")
    assert again.exit_code == 0, again.stderr


def test_the_budget_of_a_session_with_wave_links(tmp_path: Path) -> None:
    picture = tmp_path / "links.svg"
    result = manyhands_command("budget", "example1", "--plot", picture, *LINKED)
    assert result.exit_code == 0, result.stderr
    assert "cx: over a wave link" in result.stdout
    assert picture.exists()
    said = json.loads(manyhands_command("budget", "example1", "--json", *LINKED).stdout)
    assert set(said["wave_links"]) == {"cx", "cy"}
    assert "wave_links" not in json.loads(manyhands_command("budget", "example1", "--json").stdout)
