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

from manyhands.design.certificate import content, from_content, identity
from manyhands.design.errors import Infeasible
from manyhands.design.models.declared import DeclaredEnvironment, ProxyEnvironment
from manyhands.design.proof.prove import prove
from manyhands.launch.app.cli import app
from manyhands.launch.audit.simulation import Silence, Simulation
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.certificates import read_certificate
from manyhands.launch.plan.loop import NotCertified, haptic_loop
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import PythonEnvironment, Session, SessionError, load_session
from manyhands.launch.session.design import full_matrix
from manyhands.nodes.environment.enforced import EnforcedCore
from manyhands.nodes.environment.model import ModelFailure
from manyhands.nodes.kernel.bundle import SIMULATED, BundleError, EnvironmentBundle, load, save
from manyhands.nodes.kernel.factory import FactoryError

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

class Wall:
    '''One-sided walls at 2 mm: asked for forces, or for proxies.'''
    def __init__(self, ports, period, parameters):
        self.stiffness = parameters.get("stiffness", 0.0)
    def react(self, x_e, k):
        return -self.stiffness * np.maximum(x_e - 0.002, 0.0)
    def proxy(self, x, k):
        return np.minimum(x, 0.002)

class Ahead:
    '''A proxy that runs ahead of its tool, and pulls it along.'''
    def __init__(self, ports, period, parameters):
        pass
    def proxy(self, x, k):
        return x + 0.01 * (-1.0) ** k

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
PROXIES = ["environment.stiffness=5000", f"environment.model={MODULE}:Wall", "environment.level=0"]
"""The same session with springs to proxies."""
SHIPPED = Path(__file__).parents[3] / "launch" / "sessions"


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
    np.testing.assert_array_equal(full_matrix(given.level, 2), 0.1 * np.eye(2))
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
    with pytest.raises(BundleError, match=r"a EnvironmentBundle: (enforce: )?found"):
        load(path, EnvironmentBundle)


def test_without_enforcement_there_is_no_certificate(file: Path, tmp_path: Path) -> None:
    enforced, session = load_session(file), load_session(file, ["environment.enforce=false"])
    with pytest.raises(NotCertified, match="its level is not enforced") as refused:
        prepare(session)
    assert isinstance(refused.value.__cause__, Infeasible)
    assert [remedy.changes for remedy in refused.value.__cause__.remedies] == [{"environment.enforce": True}]
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


def test_springs_to_proxies_are_certified_without_a_controller(file: Path, tmp_path: Path) -> None:
    """The certificate rests on the proxy test, with or without the controller beneath, and not on another stiffness."""
    for net in ("true", "false"):
        session = load_session(file, [*PROXIES, f"environment.enforce={net}"])
        prepared = prepare(session)
        assert prepared.certificate is not None
        assert prepared.loop.environment == ProxyEnvironment(("dx", "dy"), np.zeros((2, 2)), 5000.0 * np.eye(2))
        assert prepared.loop.enforced == ()
        bundle = environment_bundle(session)
        assert bundle.enforce == (net == "true")
        np.testing.assert_array_equal(bundle.stiffness, 5000.0 * np.eye(2))
        save(bundle, tmp_path / net)
        np.testing.assert_array_equal(load(tmp_path / net, EnvironmentBundle).stiffness, bundle.stiffness)
    runner, certificate = CliRunner(), tmp_path / "c.json"
    overrides = [word for override in PROXIES for word in ("--set", override)]
    designed = runner.invoke(app, ["design", str(file), "-o", str(certificate), *overrides])
    assert "springs to proxies: their level is kept by the proxy test at every tick" in designed.stdout
    shown = runner.invoke(app, ["verify", str(certificate)])
    assert shown.exit_code == 0
    assert "black-box: proved, where the level of the environment is kept by the proxy test" in shown.stdout
    for other in ("environment.stiffness=5001", "environment.stiffness=[[5000, 1], [1, 5000]]"):
        with pytest.raises(NotCertified, match="the environment differs"):
            read_certificate(certificate, load_session(file, [*PROXIES, other]))


@pytest.mark.parametrize(
    ("stiffness", "level", "at"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]], "the stiffness K of the proxies' springs"),
        ([[1.0, 1.0], [1.0, 1.0]], [[0.0, 0.0], [0.0, 0.0]], "the stiffness K of the proxies' springs"),
        ([[5.0, 0.0], [0.0, 5.0]], [[-0.1, 0.0], [0.0, 0.0]], "the declared level of the proxies"),
    ],
)
def test_the_exact_proof_refuses_other_springs(file: Path, stiffness: Any, level: Any, at: str) -> None:
    certificate = prepare(load_session(file, PROXIES)).certificate
    assert certificate is not None
    data = json.loads(json.dumps(content(certificate)))
    assert data["environment"] == {"type": "proxy", "level": [[0.0] * 2] * 2, "stiffness": [[5e3, 0.0], [0.0, 5e3]]}
    for given in (data["environment"], {"type": "proxy", "level": level, "stiffness": stiffness}):
        data["environment"] = given
        data["id"] = identity(data)
        findings = prove(data)
        refused = [finding for finding in findings if not finding.holds]
        kept = [finding.argument for finding in findings if finding.enforced]
        if given["stiffness"] == stiffness:
            assert refused[0].condition.startswith(at)
            assert not kept
        else:
            assert not refused
            assert kept == ["kept by the proxy test at every tick, whatever positions are proposed"]


@pytest.mark.usefixtures("importable")
def test_a_tank_is_in_the_certificate_the_proof_the_bundle_and_the_ledger(file: Path, tmp_path: Path) -> None:
    tank = [*PROXIES, "environment.tank=0.25"]
    session = load_session(file, tank)
    assert type(session).model_validate(session.as_plain()) == session
    prepared = prepare(session)
    assert prepared.certificate is not None
    data = content(prepared.certificate)
    assert data["environment"]["tank"] == 0.25
    assert "tank" not in content(prepare(load_session(file, PROXIES)).certificate)["environment"]  # type: ignore[arg-type]
    assert from_content(data | {"id": identity(data)}).loop.environment == prepared.loop.environment
    findings = prove(data | {"id": identity(data)})
    assert all(finding.holds for finding in findings)
    (kept,) = [finding.argument for finding in findings if finding.enforced]
    assert kept.endswith("gives out at most the 0.25 J of its tank, which counts as stored")
    forged = data | {"environment": data["environment"] | {"tank": -1e-9}}
    failing = [finding.condition for finding in prove(forged | {"id": identity(forged)}) if not finding.holds]
    assert failing[0] == "the tank of the world is not negative"
    bundle = environment_bundle(session)
    save(bundle, tmp_path / "b")
    assert load(tmp_path / "b", EnvironmentBundle).energy_at_start == 0.25
    older = json.loads((tmp_path / "b").read_text())
    del older["tank"]
    (tmp_path / "older").write_text(json.dumps(older))
    assert load(tmp_path / "older", EnvironmentBundle).energy_at_start == 0.0
    ledger = Simulation(prepared).ledgers["environment"]
    assert ledger.total == 0.25
    shown = CliRunner().invoke(app, ["design", str(file), "-o", str(tmp_path / "c.json"), "--set", tank[0], "--set",
                                     tank[1], "--set", tank[2], "--set", tank[3]])  # fmt: skip
    assert "give out at most the 0.25 J of their tank" in " ".join(shown.stdout.split())
    verified = CliRunner().invoke(app, ["verify", str(tmp_path / "c.json")])
    assert "the world gives out at most the 0.25 J of its tank" in verified.stdout
    with pytest.raises(NotCertified, match="the environment differs"):
        read_certificate(tmp_path / "c.json", load_session(file, PROXIES))
    with pytest.raises(SessionError, match=r"environment\.tank: found .*; expected 0 for a model that returns forces"):
        load_session(file, ["environment.tank=0.25"])


@pytest.mark.parametrize(
    ("overrides", "error"),
    [
        (["environment.stiffness=0"], r"environment\.stiffness: found .*; expected a positive definite matrix"),
        (["environment.stiffness=[5000, -1]"], r"environment\.stiffness: found .*; expected a positive definite"),
        (["environment.stiffness=[[1, 2], [3, 4]]"], r"environment\.stiffness\.1\.0: found .*; expected a symmetric"),
        (["environment.stiffness=1e9"], r"environment\.stiffness: found .*1e\+08"),
        (["environment.stiffness=10", "environment.level=-0.1"], r"environment\.level: .*no negative eigenvalue"),
    ],
)
def test_errors_of_springs_are_reported_at_their_place(file: Path, overrides: list[str], error: str) -> None:
    with pytest.raises(SessionError, match=error):
        load_session(file, overrides)


def test_a_model_needs_a_level_or_a_stiffness(file: Path) -> None:
    file.write_text(SESSION.replace("  level: 0.1\n", ""), encoding="utf-8")
    with pytest.raises(SessionError, match="found neither level nor stiffness; expected level"):
        load_session(file)
    environment = load_session(file, ["environment.stiffness=10"]).environment
    assert isinstance(environment, PythonEnvironment)
    np.testing.assert_array_equal(full_matrix(environment.level, 2), np.zeros((2, 2)))


@pytest.mark.usefixtures("importable")
def test_a_stiff_wall_does_not_chatter_through_a_proxy(file: Path) -> None:
    """The same wall of 5000 N/m: asked explicitly its force turns back and forth, through a proxy it does not."""
    turned, runner = {}, CliRunner()
    for kind, overrides in (("proxy", PROXIES), ("react", ["environment.parameters={stiffness: 5000}"])):
        words = [f"environment.model={MODULE}:Wall", *overrides, *PRESS]
        simulation = Simulation(prepare(load_session(file, words)))
        assert simulation.run(800).f_v[:, 0].min() < -1.0
        core = simulation.environment
        assert isinstance(core, EnforcedCore)
        turned[kind] = core.chatter.reversals[0]
        assert core.controller is not None
        if kind == "proxy":
            assert list(core.held) == [0, 0]
            assert core.controller.ticks == 0
        shown = runner.invoke(
            app, ["simulate", str(file), "--duration", "0.8", *(w for word in words for w in ("--set", word))]
        )
        assert ("the model's force chatters: cx up to" in shown.stdout) == (kind == "react")
        assert (
            ("what a proxy does about it" in shown.stdout)
            == ("the controller kept back" in shown.stdout)
            == (kind == "react")
        )
    assert turned["proxy"] <= 2
    assert turned["react"] > 20


PRESS = ["devices.dx.hand={force: '3*step(t - 0.1)'}"]


@pytest.mark.usefixtures("importable")
def test_hostile_proxies_are_held_and_replayed_to_the_last_bit(file: Path) -> None:
    """The ledgers stay above zero while a user is away, and a second run has the same numbers."""
    session = load_session(file, [*PROXIES, f"environment.model={MODULE}:Ahead", *PRESS])
    prepared = prepare(session)
    runs = []
    for _ in range(2):
        simulation = Simulation(prepared)
        runs.append(simulation.run(600, faults=[Silence("cy", 200, 400)]).f_v)
        assert simulation.environment.held[0] > 100
        assert all(ledger.minimum >= -1e-12 for ledger in simulation.ledgers.values())
    np.testing.assert_array_equal(*runs)


@pytest.mark.usefixtures("importable")
def test_a_model_without_the_method_is_named_with_the_remedy(file: Path) -> None:
    with pytest.raises(FactoryError, match=r"found Active with react alone; expected an object with proxy\(x, k\)"):
        Simulation(prepare(load_session(file, ["environment.stiffness=10"])))
    with pytest.raises(
        FactoryError, match=r"found Ahead with proxy alone; .* state stiffness in the session.*--stiffness"
    ):
        Simulation(prepare(load_session(file, [f"environment.model={MODULE}:Ahead"])))
