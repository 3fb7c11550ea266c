"""The functions of `import manyhands as mh` do what the commands do, for objects, and refuse what makes no sense."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from matplotlib.figure import Figure

import manyhands as mh
from manyhands.design.models.coupling import spring_damper_of
from manyhands.design.models.statespace import StateSpace
from manyhands.extras import MissingExtra
from manyhands.launch.doctor import probe
from manyhands.launch.doctor.profile import Lateness, Profile
from manyhands.launch.plan.plan import Plan
from manyhands.launch.recordings.recording import RecordingError

from ...support.commands import manyhands_command

SHORT = {"design.ladder": []}  # a ladder takes most of the time of a run that does not use it


@pytest.fixture(scope="module")
def certificate() -> mh.Certificate:
    return mh.certify("example1")


@pytest.fixture(scope="module")
def linked() -> mh.Session:
    """Example 1 with one user behind a wave link."""
    far = {"devices": ["dx"], "wave_link": {"mass": 0.5, "round_trip": 0.02}}
    return mh.load("example1", {"couplings.cx": far, "design.objective": "stiffest"})


def test_load_takes_every_form_of_a_session(tmp_path: Path) -> None:
    session = mh.load("example1")
    file = Path(__file__).parents[3] / "launch" / "sessions" / "example1.yaml"
    assert mh.load(file) == mh.load(str(file)) == mh.load(session.to_dict()) == mh.load(session) == session
    assert mh.load(session) is session
    assert mh.load(file, {"period": 5e-4}).period == 5e-4
    with pytest.raises(mh.SessionError, match="a session file that can be read"):
        mh.load(tmp_path / "none.yaml")


MODEL = """
class Wall:
    def __init__(self, ports, period, parameters): self.m = len(ports)
    def react(self, x, k): return [-100.0 * at for at in x]
    def close(self): pass
"""


def test_a_model_beside_a_script_is_found_and_a_change_does_not_lose_it(tmp_path: Path) -> None:
    """A dict has no file of its own: the script that states it has."""
    (tmp_path / "my_wall.py").write_text(MODEL, encoding="utf-8")
    (tmp_path / "study.py").write_text(
        """
import manyhands as mh
session = mh.load({
    "session": "beside", "period": 0.001,
    "devices": {"pen": {"dof": 1, "osp": 1.0, "driver": "simulated", "mass": 0.1,
                        "hand": {"force": ["0.5"]}}},
    "couplings": {"c": {"devices": ["pen"]}},
    "environment": {"type": "python", "model": "my_wall:Wall", "level": 0.1},
    "design": {"coupling": "spring-damper", "tau": 0.0},
}, {"devices.pen.osp": 2.0})
if __name__ == "__main__":
    with mh.run(session, 0.05, clock="simulated", record="run.mcap") as run:
        run.wait()
    print(abs(mh.read("run.mcap").f_v).max() > 0.0)
""",
        encoding="utf-8",
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-P", str(tmp_path / "study.py")],
        cwd=elsewhere, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.strip() == "True", done.stderr
    shutil.rmtree(elsewhere)


@pytest.mark.usefixtures("own_interrupt")
def test_design_writes_the_file_of_the_command(certificate: mh.Certificate, tmp_path: Path) -> None:
    done = manyhands_command("design", "example1.yaml", "-o", tmp_path / "command.json")
    assert done.exit_code == 0, done.stderr
    certificate.save(tmp_path / "function.json")
    assert (tmp_path / "function.json").read_bytes() == (tmp_path / "command.json").read_bytes()


def test_a_certificate_shows_itself_in_a_line(certificate: mh.Certificate) -> None:
    assert repr(certificate) == (
        "Certificate(example-1: blocks cx, cy, cz, K = 1110.21 I (3 x 3) N/m, T = 0.001 s, tau = 0 s, "
        f"margin 1.495 N·s/m, id {certificate.id[:16]})"
    )
    for part in (
        certificate.loop,
        certificate.levels,
        certificate.loop.environment,
        certificate.V,
        certificate.blocks[0],
    ):
        assert len(repr(part)) < 700
        assert "\n" not in repr(part)


def test_stiffness_and_damping_are_those_of_the_springs(certificate: mh.Certificate) -> None:
    springs = certificate.spring_damper
    assert springs is not None
    assert np.array_equal(certificate.stiffness, springs.stiffness)
    assert np.array_equal(certificate.damping, springs.damping)
    found = spring_damper_of(StateSpace.of(certificate.V), 1e-3)
    np.testing.assert_allclose(found.stiffness, springs.stiffness, rtol=1e-9)
    np.testing.assert_allclose(found.damping, springs.damping, rtol=1e-6, atol=1e-9)


def test_stiffness_and_damping_of_a_linear_coupling_are_its_slow_motion() -> None:
    linear = mh.certify(mh.load("example2-linear", {"design.order": 1}))
    assert linear.spring_damper is None
    omega = 1e-3  # rad/s, where the next term of the expansion is 1e-9 of the first
    V = linear.frequency_responses([omega]).V[0]
    z = np.exp(1j * omega * 1e-3)
    expected = linear.stiffness + linear.damping * (1.0 - 1.0 / z) / 1e-3
    np.testing.assert_allclose(np.linalg.inv(V).real, expected.real, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.inv(V).imag, expected.imag, rtol=1e-3, atol=1e-6)


def test_a_coupling_without_static_stiffness_is_refused() -> None:
    integrator = StateSpace([[1.0]], [[1.0]], [[1.0]], [[1.0]])
    with pytest.raises(ValueError, match="expected a static stiffness"):
        spring_damper_of(integrator, 1e-3)


def test_the_systems_are_those_of_control(certificate: mh.Certificate) -> None:
    omega = np.array([1.0, 66.0, 1000.0])
    V, E = control.ss(*certificate.V), control.ss(*certificate.E)
    found = certificate.frequency_responses(omega)
    z = np.exp(1j * omega * 1e-3)
    np.testing.assert_allclose(found.V, np.moveaxis(V(z), 2, 0), rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(found.E, np.moveaxis(E(z), 2, 0), rtol=1e-9, atol=1e-9)
    F = control.feedback(E, V)
    np.testing.assert_allclose(found.F, np.moveaxis(F(z), 2, 0), rtol=1e-6, atol=1e-6)
    assert V.dt == 1e-3


def test_frequencies_beyond_the_sampling_are_refused(certificate: mh.Certificate) -> None:
    with pytest.raises(ValueError, match=r"expected frequencies from 0 to pi/T = 3141\.59 rad/s"):
        certificate.frequency_responses([4000.0])


def test_a_declared_environment_has_no_matrices() -> None:
    puck = {
        "session": "puck",
        "period": 1e-3,
        "devices": {"d": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2}},
        "couplings": {"c": {"devices": ["d"]}},
        "environment": {"type": "python", "model": "nowhere:Puck", "level": 0.1},
        "design": {"coupling": "spring-damper"},
    }
    found = mh.certify(puck)
    with pytest.raises(ValueError, match="declared by its level"):
        found.frequency_responses()


def test_verify_takes_objects_and_files(certificate: mh.Certificate, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    certificate.save(path)
    assert mh.verify(path, "example1")
    data = json.loads(path.read_text())
    data["coupling"]["blocks"]["cx"]["stiffness"] = [[3000.0]]
    path.write_text(json.dumps(data))
    proof = mh.verify(path)
    assert not proof
    assert proof.failing[0].condition == "the id is the SHA-256 of the content"
    assert repr(proof).startswith("Proof(example-1: not proved, the id is the SHA-256 of the content")


def test_verify_compares_with_the_session(certificate: mh.Certificate) -> None:
    proof = mh.verify(certificate, mh.load("example1", {"period": 5e-4}))
    assert next(finding.condition[:32] for finding in proof.failing) == "it is the session's: the period "


def test_the_parts_of_a_session_with_wave_links_are_designed_and_meet(linked: mh.Session) -> None:
    with pytest.raises(ValueError, match="part: found None; expected one of cx, in-tick, environment"):
        mh.certify(linked)
    site, in_tick, world = (mh.certify(linked, part) for part in ("cx", "in-tick", "environment"))
    assert mh.verify(site, linked)
    proof = mh.verify(world, linked, [site, in_tick])
    assert proof
    assert any("in-tick" in finding.condition or "certificate" in finding.condition for finding in proof.findings)
    with pytest.raises(ValueError, match="which is no world; expected none"):
        mh.verify(site, parts=[in_tick])
    with pytest.raises(ValueError, match="expected none, since example-1 has no wave links"):
        mh.certify("example1", "cx")


def test_a_measured_delay_is_designed_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # the profile is kept

    def measured(plan: Plan, way: probe.Way) -> Profile:
        return Profile(way.profile_key(plan), Lateness(100.0, 190.0, 300.0, 400.0), 1000.0, 0.0, 2.0, time.time())

    monkeypatch.setattr(probe, "measure_profile", measured)
    certificate = mh.certify(mh.load("example1", {"design.tau": "auto"}))
    assert certificate.tau == pytest.approx(0.00025)  # 190 us, on the grid of T/20, and a step of reserve


def test_the_budget_has_wave_links_and_any_delay(linked: mh.Session) -> None:
    found = mh.budget(linked)
    assert [link.name for link in found.wave_links] == ["cx"]
    assert found.at(0.5e-3)["dx"].certified == pytest.approx(1.37 / (0.5e-3 + 0.75e-3), rel=1e-6)
    assert found.at(0.0, 0.5e-3)["dx"].certified == pytest.approx(5480.0, rel=1e-6)
    assert {len(column) for column in found.columns().values()} == {18}
    with pytest.raises(ValueError, match="expected a finite positive period"):
        found.at(0.0, -1.0)
    with pytest.raises(ValueError, match=r"expected 0 \.\.\. T"):
        found.at(2e-3)


def test_simulate_runs_under_a_certificate(certificate: mh.Certificate, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    certificate.save(path)
    runs = [mh.simulate("example1", 0.3, certificate=one) for one in (None, certificate, path, str(path))]
    assert {run.certificate for run in runs} == {certificate.id}
    assert all(np.array_equal(run.x, runs[0].x) for run in runs)
    with pytest.raises(mh.NotCertified, match="a certificate of another session"):
        mh.simulate(mh.load("example1", {"devices.dx.osp": 1.2}), 0.3, certificate=certificate)


def test_a_simulation_is_a_recording(certificate: mh.Certificate, tmp_path: Path) -> None:
    run = mh.simulate("example1", 0.3, certificate=certificate)
    assert (run.session, run.period, run.ports, run.ticks) == ("example-1", 1e-3, ("dx", "dy", "dz"), 300)
    np.testing.assert_array_equal(run.velocity, np.diff(run.x, axis=0, prepend=np.zeros((1, 3))) / 1e-3)
    ledgers = run.columns("*/ledger")
    assert len(ledgers) == 2 + 7
    run.save(tmp_path / "run.npz")
    assert np.array_equal(mh.read(tmp_path / "run.npz").x, run.x)
    run.save(tmp_path / "run.csv", "dx/sample")
    assert (tmp_path / "run.csv").read_text().splitlines()[0] == "tick,time_s,dx.sample[dx]_m"
    with pytest.raises(RecordingError, match=r"found the suffix '\.txt'; expected one of \.csv, \.npz, \.parquet"):
        run.save(tmp_path / "run.txt")
    with pytest.raises(RecordingError, match="found 'nothing', which matches no topic here"):
        run.columns("nothing")


def test_a_data_frame_has_the_table(certificate: mh.Certificate) -> None:
    pytest.importorskip("pandas")
    run = mh.simulate("example1", 0.05, certificate=certificate)
    frame = run.to_pandas("dx/*")
    assert frame.index.name == "time_s"
    assert np.array_equal(frame["dx.sample[dx]_m"].to_numpy(), run.x[:, 0])
    assert mh.budget("example1").to_pandas()["certified_N/m"].max() == pytest.approx(2740.0)
    assert list(frame.columns) == [name for name in run.columns("dx/*") if name != "time_s"]


def test_a_data_frame_without_pandas_says_what_to_install(
    certificate: mh.Certificate, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    run = mh.simulate("example1", 0.05, certificate=certificate)
    with pytest.raises(MissingExtra, match=r"pip install 'manyhands\[pandas\]'"):
        run.to_pandas()


def test_an_uncertified_simulation_warns() -> None:
    with pytest.warns(UserWarning, match="example-1-uncoupled is not certified"):
        mh.simulate("example1-uncoupled", 0.05)
    assert mh.simulate("example1-uncoupled", 0.05, uncertified=True).certificate.startswith("uncertified-")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mh.simulate("example1", 0.0), "duration: found 0 s; expected from one period, 0.001 s, to 1e9 s"),
        (
            lambda: mh.simulate("example1", 1e7),
            "duration: found 1e+07 s, 10000000000 ticks of 3 ports; expected at most",
        ),
        (lambda: mh.run("example1", 0.0), "duration: found 0 s; expected from one period"),
        (lambda: mh.run("example1", clock="sundial"), "clock: found 'sundial'; expected realtime or simulated"),
        (lambda: mh.run("example1", transport="udp"), "transport: found 'udp'; expected ipc or tcp"),
        (
            lambda: mh.simulate(mh.load("example1", SHORT), 0.1, silences=[mh.Silence("cq", 1)]),
            "found a silence of 'cq'; expected one of cx, cy, cz",
        ),
    ],
)
def test_senseless_arguments_are_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  # its text is compared
        call()
    assert str(caught.value).startswith(message)


def test_read_refuses_other_files(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"expected one of \.csv, \.npz, \.parquet, \.mcap"):
        mh.read(tmp_path / "run.txt")


def test_everything_is_drawn_into_given_axes(certificate: mh.Certificate, linked: mh.Session, tmp_path: Path) -> None:
    run = mh.simulate("example1", 0.3, certificate=certificate)
    run.save(tmp_path / "run.npz")
    drawn = [
        (run, None),
        (run, "ledger"),
        (mh.read(tmp_path / "run.npz"), "force"),
        (certificate, None),
        (certificate, "structure"),
        (mh.budget("example1"), None),
        (mh.budget(linked), "cx"),
    ]
    figure = Figure(figsize=(8.0, 30.0))
    for axes, (what, quantity) in zip(figure.subplots(len(drawn), 1), drawn, strict=True):
        assert mh.plot(what, quantity, ax=axes) is axes
        assert axes.has_data()
        assert axes.get_title(loc="left")
    figure.savefig(tmp_path / "all.png", dpi=20)


def test_the_axes_have_the_units(certificate: mh.Certificate) -> None:
    run = mh.simulate("example1", 0.05, certificate=certificate)
    labels = [mh.plot(what, ax=Figure().subplots()).get_ylabel() for what in (run, certificate, mh.budget("example1"))]
    assert labels == ["velocity [m/s]", "singular values [N/m]", "stiffness [N/m]"]


def test_without_axes_a_new_figure_of_pyplot_is_made(certificate: mh.Certificate) -> None:
    from matplotlib import pyplot

    pyplot.switch_backend("agg")
    before = pyplot.get_fignums()
    axes = mh.plot(certificate)
    assert axes.figure is pyplot.gcf()
    assert len(pyplot.get_fignums()) == len(before) + 1
    pyplot.close()


def test_what_cannot_be_drawn_is_refused(certificate: mh.Certificate) -> None:
    axes = Figure().subplots()
    with pytest.raises(ValueError, match="quantity: found 'speed'; expected impedance or structure"):
        mh.plot(certificate, "speed", ax=axes)
    with pytest.raises(ValueError, match="quantity: found 'dq'; expected one of dx, dy, dz"):
        mh.plot(mh.budget("example1"), "dq", ax=axes)
    with pytest.raises(RecordingError, match="found 'wave', which is not recorded"):
        mh.plot(mh.simulate("example1", 0.05, certificate=certificate), "wave", ax=axes)
