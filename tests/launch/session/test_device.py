"""The drivers of a session's devices: the keys that each needs, and the motions that are read."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

from manyhands.design.models.device import held_device
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared
from manyhands.launch.recordings import tables
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.run.broadcast import describe
from manyhands.launch.session import BROWSER_HAND, PERSONS, Session, SessionError, limits, load_session
from manyhands.launch.session.shipped import load_named, shipped_sessions
from manyhands.nodes.kernel.bundle import DeviceBundle, PersonHand, RateMotion, RecordedMotion, load, save
from tests.support.exponential import errors

SESSION = """
session: played
period: 0.001
devices:
  dx: {dof: 1, osp: 1.37, driver: trace, trace: {times: [0, 0.5], values: [0, 0.02]}}
  dy: {dof: 2, osp: [1, 2], driver: simulated, mass: 0.2}
couplings: {cx: {devices: [dx]}, cy: {devices: [dy]}}
environment:
  type: network
  links: [{between: [dx, dy.0], stiffness: 100}, {between: [dy.1, ground], stiffness: 100}]
design: {coupling: none}
"""
POSITIONS = np.arange(24.0).reshape(6, 4) * 1e-3 - [0.0, 0.001, 0.002, 0.003]
RUN = Recording("before", "id", 0.002, ("dx", "dz", "dy.0", "dy.1"), POSITIONS, np.zeros((6, 4)))
TRACED = "devices.dx={{dof: 1, osp: 1.37, driver: trace, trace: {}}}"
LIMITED = "devices.dx={{dof: 1, osp: 1, driver: trace, limits: {{{}}}, trace: {}}}"
TWO_AXES = "devices.dy={{dof: 2, osp: 1, driver: trace, limits: {{speed: 1000}}, trace: {}}}"
HELD = "devices.dy={{dof: 2, osp: 1, driver: browser, mass: 1, hand: {}}}"

MOVED = "devices.dy={{dof: 2, osp: 1, mass: 1, driver: {}}}"


def loaded(folder: Path, *overrides: str) -> Session:
    path = folder / "s.yaml"
    path.write_text(SESSION)
    return load_session(path, overrides)


def refused(folder: Path, *overrides: str) -> SessionError:
    with pytest.raises(SessionError) as caught:
        loaded(folder, *overrides)
    return caught.value


def test_a_traced_device_has_a_motion_and_no_mechanism(tmp_path: Path) -> None:
    device = loaded(tmp_path).devices["dx"]
    assert device.trace is not None
    assert (device.trace.times, device.trace.values) == ((0.0, 0.5), ((0.0, 0.02),))
    assert (device.mass, device.damping, device.hand) == (None, None, None)


@pytest.mark.parametrize(
    ("override", "key", "found", "expected"),
    [
        ("devices.dx.mass=0.2", "devices.dx.mass", "mass with 'driver: trace'", "no mass"),
        ("devices.dx.damping=2", "devices.dx.damping", "damping with 'driver: trace'", "no damping"),
        ("devices.dx.hand={}", "devices.dx.hand", "hand with 'driver: trace'", "no hand"),
        ("devices.dx={dof: 1, osp: 1, driver: trace}", "devices.dx", "no key 'trace'", "{file: run.mcap}"),
        ("devices.dx.driver=simulated", "devices.dx.trace", "trace with 'driver: simulated'", "or no trace"),
        ("devices.dx.driver=browsr", "devices.dx.driver", "'browsr'", "did you mean 'browser'?"),
        ("devices.dy.driver=trace", "devices.dy", "no key 'trace'", "the recorded motion"),
        ("devices.dx={dof: 1, osp: 1, driver: browser}", "devices.dx", "no key 'mass'", "the least moving mass in kg"),
        (HELD.format("{motion: sin(t)}"), "devices.dy", "motion", "person"),
        (HELD.format("{force: [0, 1]}"), "devices.dy", "force", "person"),
        (HELD.format("{stiffness: [0, 9]}"), "devices.dy", "0", "pointer"),
        (MOVED.format("spacemouse, step: 0.1"), "devices.dy.step", "step with 'driver: spacemouse'", "no step"),
        (MOVED.format("spacemouse, scale: 2"), "devices.dy.scale", "scale with 'driver: spacemouse'", "no scale"),
        (MOVED.format("spacemouse, trace: 3"), "devices.dy.trace", "3", "{times"),
        (MOVED.format("gamepad, parameters: {speed: 0}"), "devices.dy.parameters.speed", "0", "greater than 0"),
        (MOVED.format("gamepad, parameters: {speed: 0.6}"), "devices.dy.parameters.speed", "0.6", "at most 0.5"),
        (MOVED.format("gamepad, parameters: {dead_zone: 1}"), "devices.dy.parameters.dead_zone", "1", "from 0 to 0.9"),
        (MOVED.format("gamepad, parameters: {device: js0}"), "devices.dy.parameters.device", "'js0'", "/dev/hidraw3"),
        (MOVED.format("gamepad, parameters: {sped: 1}"), "devices.dy.parameters.sped", "'sped'", "device, speed, dead"),
        (MOVED.format("gamepad, parameters: 3"), "devices.dy.parameters", "3", "a mapping"),
        (MOVED.format("gamepad, axis_map: [x, ry]"), "devices.dy.axis_map", "a list of 2", "2 of x, y, z, rx"),
        (MOVED.format("gamepad, axis_map: [x, -x]"), "devices.dy.axis_map", "a list of 2", "each once"),
        (MOVED.format("gamepad, axis_map: [x]"), "devices.dy.axis_map", "a list of 1", "2 of x, y"),
        ("devices.dy={dof: 6, osp: 1, driver: gamepad, mass: 1}", "devices.dy.dof", "6", "at most 5, the axes of"),
        (MOVED.format("spacemouse, hand: {motion: 1}"), "devices.dy", "motion", "person"),
        (MOVED.format("browser, parameters: {speed: 1}"), "devices.dy.parameters", "with 'driver: browser'", "no para"),
        (TRACED.format("3"), "devices.dx", "3", "{times: [...], values: [...]}"),
        (TRACED.format("{fil: a.csv}"), "devices.dx.trace", "fil", "{file: FILE, device: NAME}"),
        (TRACED.format("{file: run.txt}"), "devices.dx.trace.file", "'run.txt'", ".mcap, .npz, .csv"),
        (TRACED.format("{file: none.csv}"), "devices.dx.trace.file", "no such file", "a recording"),
        (TRACED.format("{times: 3, values: [1]}"), "devices.dx.trace.times", "3", "a list of times"),
        (TRACED.format("{times: [0, x], values: [1, 2]}"), "devices.dx.trace.times.1", "'x'", "a time in s"),
        (TRACED.format("{times: [0, 1], values: [0, .nan]}"), "devices.dx.trace.values.1", ".nan", "finite"),
        (TRACED.format("{times: [0, 1], values: [0]}"), "devices.dx.trace.values", "a list of 1", "2 positions"),
        (TRACED.format("{times: [0], values: [[0], [0]]}"), "devices.dx.trace.values", "a list of 2", "a list of pos"),
        (TWO_AXES.format("{times: [0], values: [0]}"), "devices.dy.trace.values", "a list of 1", "2 lists"),
        (TRACED.format("{times: [0, 0], values: [0, 1]}"), "devices.dx.trace", "after 0 s", "increasing from 0"),
        (TRACED.format("{times: [1], values: [1]}"), "devices.dx.trace", "first time is 1 s", "increasing from 0"),
        (TRACED.format("{times: [0, 1001], values: [0, 1]}"), "devices.dx.trace", "1001 s", "1000000 ticks"),
    ],
)  # fmt: skip
def test_what_a_driver_needs_and_has_no_use_for(
    tmp_path: Path, override: str, key: str, found: str, expected: str
) -> None:
    error = refused(tmp_path, override)
    assert error.key.startswith(key)
    assert found in error.found
    assert expected in error.expected


@pytest.mark.parametrize(
    ("limit", "values", "found"),
    [
        ("displacement: 0.01", "[0, 0.005, 0.011, 0]", "a displacement of 0.011 m at tick 4"),
        ("speed: 2", "[0, 0.002, 0.008, 0.008]", "a speed of 3 m/s at tick 3"),
        ("speed: 2", "[0.003, 0.003, 0.003, 0.003]", "a speed of 3 m/s at tick 0"),
    ],
)
def test_a_motion_beyond_the_limits_is_refused_with_its_tick(
    tmp_path: Path, limit: str, values: str, found: str
) -> None:
    motion = f"{{times: [0, 0.002, 0.004, 0.006], values: {values}}}"
    error = refused(tmp_path, LIMITED.format(limit, motion))
    assert (error.key, error.found) == ("devices.dx.trace", found)
    assert "the device's limit" in error.expected


def test_a_motion_at_its_limits_is_not(tmp_path: Path) -> None:
    at_them = LIMITED.format("displacement: 0.02, speed: 0.041", "{times: [0, 0.5], values: [0, 0.02]}")
    assert loaded(tmp_path, at_them).devices["dx"].trace is not None


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_recording_is_read_by_its_devices(tmp_path: Path, suffix: str) -> None:
    RUN.save(tmp_path / f"run{suffix}")
    session = loaded(
        tmp_path, TRACED.format(f"{{file: run{suffix}}}"), TWO_AXES.format(f"{{file: run{suffix}, device: dy}}")
    )
    one, two = session.devices["dx"].trace, session.devices["dy"].trace
    assert one is not None
    assert two is not None
    np.testing.assert_allclose(one.times, RUN.time, rtol=1e-15)
    np.testing.assert_array_equal(one.values, RUN.x[:, :1].T)
    np.testing.assert_array_equal(two.values, RUN.x[:, 2:].T)
    assert loaded(tmp_path, TRACED.format(f"{{file: run{suffix}, device: dz}}")).devices["dx"].trace is not None
    for asked, found in (("dq", "without a device 'dq'"), ("dy", "whose 'dy' has 2 axes")):
        error = refused(tmp_path, TRACED.format(f"{{file: run{suffix}, device: {asked}}}"))
        assert error.key == "devices.dx.trace.device"
        assert found in error.found
    renamed = SESSION.replace("dx", "dw")
    (tmp_path / "w.yaml").write_text(renamed)
    with pytest.raises(SessionError, match="without a device 'dw', the device's own name"):
        load_session(tmp_path / "w.yaml", [TRACED.format(f"{{file: run{suffix}}}").replace("dx", "dw")])


def test_a_streamed_recording_is_read_as_the_others_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []

    def read(path: Path) -> Recording:
        asked.append(path)
        return RUN

    monkeypatch.setattr(tables, "read_recording", read)
    motion = loaded(tmp_path, TRACED.format("{file: run.mcap, device: dz}")).devices["dx"].trace
    assert asked == [tmp_path / "run.mcap"]
    assert motion is not None
    np.testing.assert_array_equal(motion.values, RUN.x[:, 1:2].T)
    np.testing.assert_array_equal(motion.times, RUN.time)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_table_of_another_program_is_read_by_its_columns(tmp_path: Path, suffix: str) -> None:
    if suffix == ".csv":
        (tmp_path / "m.csv").write_text("t, a, b\n0,0,0\n0.25,0.01,-0.01\n\n0.5,0,-0.02\n")
    else:
        np.savez(tmp_path / "m.npz", t=[0.0, 0.25, 0.5], x=[[0.0, 0.0], [0.01, -0.01], [0.0, -0.02]])
    motion = loaded(tmp_path, TWO_AXES.format(f"{{file: m{suffix}}}")).devices["dy"].trace
    assert motion is not None
    assert motion.times == (0.0, 0.25, 0.5)
    assert motion.values == ((0.0, 0.01, 0.0), (0.0, -0.01, -0.02))
    assert "2 columns" in refused(tmp_path, TRACED.format(f"{{file: m{suffix}}}")).found
    assert "names no devices" in refused(tmp_path, TWO_AXES.format(f"{{file: m{suffix}, device: dy}}")).found


def test_an_early_ended_device_rests_and_a_gap_is_refused(tmp_path: Path) -> None:
    for hole, read in ((slice(4, 6), 4), (slice(2, 3), None)):
        x = RUN.x.copy()
        x[hole, 0] = np.nan
        Recording("before", "id", 0.002, RUN.ports, x, RUN.f_v).save(tmp_path / "run.npz")
        if read is None:
            assert "without a position at tick 2" in refused(tmp_path, TRACED.format("{file: run.npz}")).found
        else:
            motion = loaded(tmp_path, TRACED.format("{file: run.npz}")).devices["dx"].trace
            assert motion is not None
            assert len(motion.times) == read


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("m.csv", b"", "0 columns"),
        ("m.csv", b"t,x\n", "0 samples"),
        ("m.csv", b"0,1\n0.1\n", "row 2"),
        ("m.csv", b"0,1\n0.1,one\n", "row 2"),
        ("m.csv", b"\xff\xfe", "not UTF-8"),
        ("m.csv", b"0,1\n0.1,inf\n", "without a position at sample 1"),
        ("m.csv", b"0,\n0.1,0\n", "without a position at sample 0"),
        ("m.npz", b"junk", "not a zip file"),
        ("m.mcap", b"junk", "no recording"),
    ],
)
def test_files_that_hold_no_motion(tmp_path: Path, name: str, content: bytes, found: str) -> None:
    (tmp_path / name).write_bytes(content)
    assert found in refused(tmp_path, TRACED.format(f"{{file: {name}}}")).found


def test_an_archive_of_something_else_or_of_too_much_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", y=[1.0])
    assert "which does not hold x, ports, period, or x, t" in refused(tmp_path, TRACED.format("{file: a.npz}")).found
    np.savez(tmp_path / "b.npz", t=[0.0], x=np.array(["a"]))
    assert "something else than numbers" in refused(tmp_path, TRACED.format("{file: b.npz}")).found
    np.savez(tmp_path / "c.npz", t=np.array([None]), x=[0.0])
    assert "which holds Python's objects" in refused(tmp_path, TRACED.format("{file: c.npz}")).found
    with (
        zipfile.ZipFile(tmp_path / "d.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("x.npy", "w") as member,
    ):
        for _ in range(65):
            member.write(bytes(1 << 20))
    with zipfile.ZipFile(tmp_path / "d.npz", "a") as archive:
        archive.writestr("t.npy", b"")
    assert "when unpacked" in refused(tmp_path, TRACED.format("{file: d.npz}")).found


def test_motions_are_bounded_together(tmp_path: Path) -> None:
    rows = limits.MAX_MOTION_NUMBERS // 4
    np.savez(tmp_path / "m.npz", t=np.arange(rows) * 1e-3, x=np.zeros(rows))
    np.savez(tmp_path / "n.npz", t=np.arange(rows) * 1e-3, x=np.zeros((rows, 2)))
    loaded(tmp_path, TRACED.format("{file: m.npz}"))
    error = refused(tmp_path, TRACED.format("{file: m.npz}"), TWO_AXES.format("{file: n.npz}"))
    assert error.found == f"recorded motions of {5 * rows} numbers in all"


def test_a_kept_session_needs_no_other_file_and_reads_back_equal(tmp_path: Path) -> None:
    RUN.save(tmp_path / "run.npz")
    session = loaded(tmp_path, TRACED.format("{file: run.npz}"), TWO_AXES.format("{file: run.npz}"))
    assert Session.model_validate(session.as_plain()) == session
    kept = tmp_path / "elsewhere" / "kept.yaml"
    kept.parent.mkdir()
    kept.write_text(yaml.safe_dump(session.as_plain()))
    assert load_session(kept) == session
    held = loaded(tmp_path, "devices.dy={dof: 2, osp: 1, driver: browser, mass: 1}")
    assert Session.model_validate(held.as_plain()) == held


def test_the_hand_at_a_browser_has_its_own_defaults(tmp_path: Path) -> None:
    hand = loaded(tmp_path, "devices.dy={dof: 2, osp: 1, driver: browser, mass: 1}").devices["dy"].hand
    assert hand is not None
    assert (hand.stiffness, hand.damping) == ((BROWSER_HAND["stiffness"],) * 2, (BROWSER_HAND["damping"],) * 2)
    own = loaded(tmp_path, HELD.format("{stiffness: 50}")).devices["dy"].hand
    assert own is not None
    assert (own.stiffness, own.damping) == ((50.0,) * 2, (BROWSER_HAND["damping"],) * 2)


@pytest.mark.parametrize("driver", PERSONS)
def test_every_person_has_the_same_hand_and_no_stated_inertia(driver: str, tmp_path: Path) -> None:
    device = loaded(tmp_path, MOVED.format(driver)).devices["dy"]
    assert device.hand is not None
    assert device.hand.stiffness == (BROWSER_HAND["stiffness"],) * 2
    assert device.inertia is None
    assert device.word is None  # its hand is known, and its ledger is judged


def test_a_spacemouse_moves_the_goal_of_a_hand(tmp_path: Path) -> None:
    plain = loaded(tmp_path, MOVED.format("spacemouse"))
    assert plain.devices["dy"].rate == RateMotion("spacemouse", "", ("x", "y"), 0.1, 0.05)
    override = MOVED.format(
        "gamepad, parameters: {device: /dev/input/js1, speed: 0.3, dead_zone: 0}, axis_map: [-z, x]"
    )
    own = loaded(tmp_path, override)
    assert own.devices["dy"].rate == RateMotion("gamepad", "/dev/input/js1", ("-z", "x"), 0.3, 0.0)
    assert Session.model_validate(own.as_plain()) == own
    from manyhands.launch.plan.prepare import prepare

    source = cut(prepare(own, uncertified=True), RunPlan("realtime", tmp_path, ""))["dy"]
    assert isinstance(source, DeviceBundle)
    assert isinstance(source.source, PersonHand)
    assert source.source.rate == own.devices["dy"].rate
    assert describe(prepare(own, uncertified=True), "realtime", "ipc", 0, ()).grips == ()  # no page holds it


@pytest.fixture
def prepared(tmp_path: Path) -> Prepared:
    from manyhands.launch.plan.prepare import prepare

    session = loaded(tmp_path, "devices.dy={dof: 2, osp: 1, driver: browser, mass: 1}")
    return prepare(session, uncertified=True)


def test_a_bundle_names_its_devices_driver(prepared: Prepared, tmp_path: Path) -> None:
    bundles = cut(prepared, RunPlan("realtime", tmp_path, ""))
    for name, kind in (("dx", RecordedMotion), ("dy", PersonHand)):
        bundle = bundles[name]
        assert isinstance(bundle, DeviceBundle)
        save(bundle, tmp_path / name)
        read = load(tmp_path / name, DeviceBundle)
        assert isinstance(read.source, kind)
        save(read, tmp_path / f"{name}.again")
        assert (tmp_path / f"{name}.again").read_bytes() == (tmp_path / name).read_bytes()
    moved = load(tmp_path / "dx", DeviceBundle).source
    assert isinstance(moved, RecordedMotion)
    np.testing.assert_array_equal(moved.damping, [[1.37]])


@pytest.mark.parametrize(
    ("clock", "remote", "grips"), [("realtime", (), ("dy",)), ("realtime", ("dy",), ()), ("simulated", (), ())]
)
def test_a_session_names_what_can_be_held(
    prepared: Prepared, clock: str, remote: tuple[str, ...], grips: tuple[str, ...]
) -> None:
    assert describe(prepared, clock, "ipc", 0, remote).grips == grips


@pytest.mark.parametrize("name", shipped_sessions())
def test_the_sampling_of_shipped_devices_is_as_exact_as_scipys(name: str) -> None:
    shipped = load_named(name)
    for device in shipped.devices.values():
        hand, mass, damping = device.hand, device.mass, device.damping
        held = held_device(
            list(np.add(mass, hand.mass)),
            list(damping),
            hand.rational.realisation(),
            list(hand.damping),
            list(hand.stiffness),
        ).continuous()
        below = np.zeros((held.inputs, held.order + held.inputs))
        found = errors(np.vstack([np.hstack([held.A, held.B]), below]) * shipped.period)
        assert found.ours <= max(found.scipys, np.finfo(float).eps)
