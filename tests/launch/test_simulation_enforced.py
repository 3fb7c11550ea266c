"""Sessions whose environment is a model, or whose environment's level is enforced: from the file to a run."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from manyhands.design.models.environment import DeclaredEnvironment
from manyhands.launch.cli import app
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import NotCertified, haptic_loop, prepare, read_certificate
from manyhands.launch.session import PythonEnvironment, Session, SessionError, load_session
from manyhands.launch.simulation import Silence, Simulation
from manyhands.nodes.bundle import SIMULATED, BundleError, EnvironmentBundle, load, save
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.factory import FactoryError

MODULE = "models_of_these_tests"
MODELS = """
import numpy as np

class Active:
    '''A damper with the wrong sign, and a spring.'''
    def __init__(self, ports, period, parameters):
        self.last, self.period, self.damping = np.zeros(len(ports)), period, parameters["damping"]
    def react(self, x_e, k):
        v, self.last = (x_e - self.last) / self.period, x_e
        return np.clip(self.damping * v - 500.0 * x_e, -1e4, 1e4)

class Fails:
    def __init__(self, ports, period, parameters):
        self.m = len(ports)
    def react(self, x_e, k):
        return [0.0] * self.m if k < 20 else 1 / 0
"""
SESSION = f"""
session: black-box
period: 0.001
devices:
  dx: {{dof: 1, osp: 1.37, driver: simulated, mass: 0.2}}
  dy: {{dof: 1, osp: 1.37, driver: simulated, mass: 0.2}}
couplings:
  cx: {{devices: [dx]}}
  cy: {{devices: [dy]}}
environment:
  type: python
  model: "{MODULE}:Active"
  level: 0.1
  parameters: {{damping: 3.0, scene: [1, {{name: wall, hard: true}}]}}
design: {{coupling: given, stiffness: 800, damping: 0.1, ladder: []}}
"""
SHIPPED = Path(__file__).parents[2] / "launch" / "sessions"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The session's file; its model is *not* importable."""
    path = tmp_path / "black-box.yaml"
    path.write_text(SESSION, encoding="utf-8")
    return path


@pytest.fixture
def importable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From here on the model is."""
    (tmp_path / f"{MODULE}.py").write_text(MODELS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.delitem(sys.modules, MODULE, raising=False)


def environment_bundle(session: Session, uncertified: bool = False) -> EnvironmentBundle:
    bundle = cut(prepare(session, uncertified=uncertified), RunPlan(SIMULATED, None, ""))["environment"]
    assert isinstance(bundle, EnvironmentBundle)
    return bundle


def test_a_session_is_read_and_written_back(file: Path) -> None:
    session = load_session(file)
    given = session.environment
    assert isinstance(given, PythonEnvironment)
    assert (given.model, given.enforce) == (f"{MODULE}:Active", True)
    assert given.parameters == {"damping": 3.0, "scene": [1, {"name": "wall", "hard": True}]}
    np.testing.assert_array_equal(given.level_matrix(2), 0.1 * np.eye(2))
    assert Session.model_validate(session.as_plain(), context={"folder": file.parent}) == session


@pytest.mark.parametrize(
    ("level", "matrix"), [("[0.1, 0.2]", [[0.1, 0.0], [0.0, 0.2]]), ("[[0, 1], [1, -2]]", [[0.0, 1.0], [1.0, -2.0]])]
)
def test_a_level_by_port_or_as_a_matrix(file: Path, level: str, matrix: list[list[float]]) -> None:
    environment = haptic_loop(load_session(file, [f"environment.level={level}"])).environment
    assert environment == DeclaredEnvironment(("dx", "dy"), np.array(matrix))


@pytest.mark.parametrize(
    ("override", "error"),
    [
        ("environment.model=wall", r"environment\.model: found 'wall'; expected package\.module:factory"),
        ("environment.model='os:system(1)'", r"expected package\.module:factory"),
        (f"environment.model=m:{'f' * 200}", r"at most 200 characters"),
        (
            "environment.level='0.1 N·s/m'",
            r"environment\.level: found .*; expected a number in N·s/m, without the unit",
        ),
        ("environment.level=[0.1]", r"environment\.level: found a list of 1; expected a number, 2 numbers, or 2 rows"),
        ("environment.level=[[0, 1], [2, 0]]", r"environment\.level\.1\.0: found .*; expected a symmetric matrix"),
        ("environment.level=.inf", r"finite"),
        ("environment.enforce='yes'", r"environment\.enforce: found 'yes'; expected true or false"),
        ("environment.parameters=[1]", r"environment\.parameters: found a list of 1; expected a mapping"),
        ("environment.parameters={a: [0, .nan]}", r"environment\.parameters\.a\.1: found \.nan; expected a finite"),
        ("environment.parameters={a: {b: }}", r"environment\.parameters\.a\.b: found nothing"),
        ("environment.delay=1", r"unknown key 'delay'"),
    ],
)
def test_errors_are_reported_at_their_place(file: Path, override: str, error: str) -> None:
    with pytest.raises(SessionError, match=error):
        load_session(file, [override])


@pytest.mark.parametrize("value", ["1", "'true'", "[]"])
def test_enforce_is_true_or_false_on_every_type(value: str) -> None:
    with pytest.raises(SessionError, match=r"environment\.enforce: found .*; expected true or false"):
        load_session(SHIPPED / "example1.yaml", [f"environment.enforce={value}"])


def test_nothing_is_imported_before_the_environment_runs(file: Path) -> None:
    """Reading, designing, proving and cutting bundles do without the model; making the core does not."""
    prepared = prepare(load_session(file))
    assert prepared.certificate is not None
    assert prepared.certificate.loop.enforced == ("environment",)
    bundles = cut(prepared, RunPlan(SIMULATED, None, ""))
    assert MODULE not in sys.modules
    for name, bundle in bundles.items():
        assert (MODULE in repr(bundle)) == (name == "environment")
    with pytest.raises(FactoryError, match=f"the model {MODULE}:Active cannot be made: found ModuleNotFoundError"):
        Simulation(prepared)


def test_the_bundle_carries_the_model_and_its_controller(file: Path, tmp_path: Path) -> None:
    bundle = environment_bundle(load_session(file))
    assert bundle.E is None
    assert bundle.enforce
    save(bundle, tmp_path / "bundle.json")
    again = load(tmp_path / "bundle.json", EnvironmentBundle)
    assert again.model == bundle.model
    assert again.enforce
    np.testing.assert_array_equal(again.Phi_E, 0.1 * np.eye(2))


@pytest.mark.parametrize(
    ("key", "value"),
    [("enforce", False), ("enforce", 1), ("enforce", None), ("Phi_E", None), ("model", None)],
)
def test_a_promise_is_not_run_without_its_controller(file: Path, tmp_path: Path, key: str, value: Any) -> None:
    path = tmp_path / "bundle.json"
    save(environment_bundle(load_session(file)), path)
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {key: value}))
    with pytest.raises(BundleError, match="ValueError: found"):
        load(path, EnvironmentBundle)


def test_without_enforcement_there_is_no_certificate(file: Path, tmp_path: Path) -> None:
    enforced, session = load_session(file), load_session(file, ["environment.enforce=false"])
    with pytest.raises(NotCertified, match=r"its level is not enforced.*set 'enforce: true' in environment"):
        prepare(session)
    bundle = environment_bundle(session, uncertified=True)
    assert (bundle.Phi_E, bundle.enforce) == (None, False)
    certificate = tmp_path / "c.json"
    out = CliRunner().invoke(app, ["design", str(file), "-o", str(certificate)])
    assert out.exit_code == 0
    assert read_certificate(certificate, enforced).loop.enforced == ("environment",)
    with pytest.raises(NotCertified, match="the environment differs"):
        read_certificate(certificate, session)


def test_a_level_beyond_the_devices_is_enforced_but_certifies_nothing(file: Path) -> None:
    session = load_session(file, ["environment.level=1.4"])
    with pytest.raises(NotCertified, match="declared level"):
        prepare(session)
    bundle = environment_bundle(session, uncertified=True)
    assert bundle.enforce
    np.testing.assert_array_equal(bundle.Phi_E, 1.4 * np.eye(2))


@pytest.mark.usefixtures("importable")
def test_a_run_keeps_the_ledgers_whatever_the_model_does(file: Path) -> None:
    """Also while a user is away; the same model without its controller throws the hands about."""
    simulation = Simulation(prepare(load_session(file)))
    enforced = simulation.run(1500, faults=[Silence("cy", 400, 700)])
    core = simulation.environment
    assert isinstance(core, EnforcedCore)
    assert core.controller is not None
    assert core.controller.ticks > 100
    assert core.controller.energy > 0.0
    assert simulation.ledgers["environment"] is core.ledger
    assert all(ledger.minimum >= -1e-9 for ledger in simulation.ledgers.values())
    raw = Simulation(prepare(load_session(file, ["environment.enforce=false"]), uncertified=True)).run(1500)
    assert np.abs(raw.velocity[-500:]).max() > 10.0 * np.abs(enforced.velocity[-500:]).max()


@pytest.mark.usefixtures("importable")
def test_a_model_that_fails_ends_the_simulation_with_its_name(file: Path) -> None:
    session = load_session(file, [f"environment.model={MODULE}:Fails"])
    with pytest.raises(ModelFailure, match=f"the model {MODULE}:Fails failed at tick 20: found ZeroDivisionError"):
        Simulation(prepare(session)).run(100)


@pytest.mark.parametrize("environment", ["network", "matrices"])
def test_what_is_proved_is_not_touched_by_the_net(environment: str) -> None:
    """Example 1, and a wall given by its matrices: the controller never acts, and the numbers stay as they are."""
    matrices = "environment={type: state-space, A: [[-5]], B: [[1, 0, 0]], C: [[-100], [0], [0]], "
    matrices += "D: [[900, 0, 0], [0, 900, 0], [0, 0, 900]]}"
    overrides = ["design.ladder=[]", *([matrices] if environment == "matrices" else [])]
    plain, netted = (
        load_session(SHIPPED / "example1.yaml", [*overrides, f"environment.enforce={on}"]) for on in ("false", "true")
    )
    assert haptic_loop(netted).enforced == ()
    assert haptic_loop(netted).environment == haptic_loop(plain).environment
    simulation = Simulation(prepare(netted))
    found, expected = simulation.run(1500), Simulation(prepare(plain)).run(1500)
    core = simulation.environment
    assert isinstance(core, EnforcedCore)
    assert core.controller is not None
    assert (core.controller.ticks, core.controller.energy) == (0, 0.0)
    # the same equations, summed in another order over 1500 ticks
    np.testing.assert_allclose(found.f_v, expected.f_v, rtol=0, atol=1e-9 * np.abs(expected.f_v).max())
    bundle = environment_bundle(netted)
    assert bundle.enforce
    assert not environment_bundle(plain).enforce
    with pytest.raises(ValueError, match="enforce True without a level"):
        dataclasses.replace(bundle, Phi_E=None)


def test_a_proved_type_without_a_certificate_has_nothing_to_enforce() -> None:
    session = load_session(SHIPPED / "example1-uncoupled.yaml", ["environment.enforce=true"])
    assert not environment_bundle(session, uncertified=True).enforce


def test_design_and_verify_tell_what_is_enforced(file: Path, tmp_path: Path) -> None:
    runner, certificate = CliRunner(), str(tmp_path / "c.json")
    designed = runner.invoke(app, ["design", str(file), "-o", certificate, "--json"])
    assert json.loads(designed.stdout)["enforced"] == ["environment"]
    verified = runner.invoke(app, ["verify", certificate, "--json"])
    assert json.loads(verified.stdout)["enforced"] == ["environment"]
    shown = runner.invoke(app, ["verify", certificate])
    assert shown.exit_code == 0
    assert "black-box: proved, where the level of the environment is enforced at run time" in shown.stdout
    assert "not proved: enforced" in " ".join(shown.stdout.replace("│", " ").split())
    proved = runner.invoke(app, ["design", str(SHIPPED / "example1.yaml"), "--json"])
    assert json.loads(proved.stdout)["enforced"] == []


@pytest.mark.usefixtures("importable")
def test_a_run_names_the_model_whose_code_it_runs(file: Path) -> None:
    runner = CliRunner()
    done = runner.invoke(app, ["simulate", str(file), "--duration", "0.05"])
    assert done.exit_code == 0
    assert f"black-box: runs the code of the model {MODULE}:Active, which is not confined" in done.stderr
    failed = runner.invoke(
        app, ["simulate", str(file), "--duration", "0.05", "--set", f"environment.model={MODULE}:Fails"]
    )
    assert failed.exit_code == 1
    assert "failed at tick 20" in failed.stderr
    missing = runner.invoke(
        app, ["simulate", str(file), "--duration", "0.05", "--set", f"environment.model={MODULE}:No"]
    )
    assert missing.exit_code == 2
    assert "cannot be made" in missing.stderr


def test_pictures_are_left_out_with_a_reason(file: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["design", str(file), "--plot", str(tmp_path / "pictures")])
    assert done.exit_code == 0
    assert "no pictures:" in done.stderr
    assert not list((tmp_path / "pictures").glob("*"))
