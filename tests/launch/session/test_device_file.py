"""Device files: their keys are a device's defaults, what is wrong has its place, and the catalogue keeps its rules."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from manyhands.launch.session import Session, SessionError, load_session
from manyhands.launch.session import device_file as files
from manyhands.launch.session.device_file import catalogue, catalogue_file, device_file
from manyhands.launch.session.yaml import parse_tree
from manyhands.nodes.kernel.factory import DRIVERS, published

STICK = """\
device: a stick of the lab
keys:
  driver: "my_stick:make"
  dof: 2
  axes: [x, y]
  osp: {between: [0.3, 0.5]}
  parameters: {port: /dev/ttyACM0, baud: 1000000}
  sample_age: 0.0002
  step: 0.00001
  limits: {force: 5, displacement: 0.05}
sources:
  driver: ours
  dof: two motors
  axes: as it stands on the desk
  osp: "identified 2026-11-20, free decay, 200 ways"
  parameters: its cable
  sample_age: measured
  step: 2048 lines, 0.02 m a turn
  limits: data sheet of the motors
by_itself: [compensates gravity by a force of its own]
identification: {damping: {value: 0.4, low: 0.3}, ways: 200}
notes: [It squeaks.]
"""

SESSION = """\
session: s
period: 0.001
devices:
  stick: {KEYS}
couplings:
  c: {devices: [stick]}
environment:
  type: network
  links:
    - {between: [stick.x, ground], stiffness: 100}
    - {between: [stick.y, ground], stiffness: 100}
design: {coupling: spring-damper}
"""


def read(folder: Path, keys: str, *overrides: str, stick: str = STICK) -> Session:
    (folder / "my-stick.yaml").write_text(stick)
    (folder / "s.yaml").write_text(SESSION.replace("KEYS", keys))
    return load_session(folder / "s.yaml", overrides)


def refusal(folder: Path, keys: str = "from: ./my-stick.yaml", stick: str = STICK) -> str:
    with pytest.raises(SessionError) as caught:
        read(folder, keys, stick=stick)
    return str(caught.value).replace(f"{folder}/", "")


class TestDefaults:
    def test_the_keys_of_the_file_are_those_of_the_device(self, tmp_path: Path) -> None:
        device = read(tmp_path, "from: ./my-stick.yaml").devices["stick"]
        assert (device.driver, device.axes, device.sample_age) == ("my_stick:make", ("x", "y"), 0.0002)
        assert device.osp_low == ((0.3, 0.0), (0.0, 0.3))
        assert device.limits.force == (5.0, 5.0)
        assert device.by_itself == ("compensates gravity by a force of its own",)
        assert device.word is not None
        assert device.word.by_itself == device.by_itself

    def test_those_of_the_session_win(self, tmp_path: Path) -> None:
        keys = "from: my-stick.yaml, osp: 0.2, step: 0.001, limits: {force: 3}, parameters: {port: /dev/ttyACM7}"
        device = read(tmp_path, keys).devices["stick"]
        assert device.osp_low[0][0] == 0.2
        assert device.step == (0.001, 0.001)
        assert (device.limits.force, device.limits.displacement) == ((3.0, 3.0), (0.05, 0.05))
        assert device.parameters == {"port": "/dev/ttyACM7", "baud": 1000000}

    def test_so_do_those_of_an_override_though_their_part_is_in_the_file(self, tmp_path: Path) -> None:
        overrides = ("devices.stick.limits.force=2", "devices.stick.parameters.port=/dev/x", "devices.stick.osp=0.1")
        device = read(tmp_path, "from: ./my-stick.yaml", *overrides).devices["stick"]
        assert (device.limits.force, device.limits.displacement) == ((2.0, 2.0), (0.05, 0.05))
        assert (device.parameters or {})["port"] == "/dev/x"
        assert device.osp_low[0][0] == 0.1

    def test_another_driver_takes_nothing_that_is_true_of_this_one_alone(self, tmp_path: Path) -> None:
        keys = "from: ./my-stick.yaml, driver: simulated, mass: 0.1, damping: 0.6"
        device = read(tmp_path, keys).devices["stick"]
        assert (device.parameters, device.sample_age, device.by_itself) == (None, None, None)
        assert (device.step, device.limits.displacement) == ((0.00001, 0.00001), (0.05, 0.05))

    def test_what_the_session_says_of_it_is_added(self, tmp_path: Path) -> None:
        device = read(tmp_path, "from: ./my-stick.yaml, by_itself: [gates small forces]").devices["stick"]
        assert device.by_itself == ("compensates gravity by a force of its own", "gates small forces")

    def test_what_is_kept_of_a_session_needs_no_file(self, tmp_path: Path) -> None:
        session = read(tmp_path, "from: ./my-stick.yaml")
        (tmp_path / "my-stick.yaml").unlink()
        plain = session.as_plain()
        assert "from" not in plain["devices"]["stick"]
        assert Session.from_dict(plain) == session
        assert session.replace({"devices.stick.osp": 0.2}).devices["stick"].sample_age == 0.0002

    def test_python_names_it_too(self) -> None:
        data = parse_tree(SESSION.replace("KEYS", "x: 1"), "s").data
        data["devices"] = {"stick": {"from": "omega.3", "osp": 0.5, "driver": "simulated", "mass": 0.2}}
        data["environment"] = {
            "type": "network",
            "links": [{"between": [f"stick.{axis}", "ground"], "stiffness": 100} for axis in "xyz"],
        }
        assert Session.from_dict(data).devices["stick"].limits.force == (6.9,) * 3


class TestWhatIsWrong:
    def test_an_unknown_name_is_answered_with_the_nearest(self, tmp_path: Path) -> None:
        said = refusal(tmp_path, "from: omega.33, osp: 0.5")
        assert said.startswith("s.yaml:4: devices.stick.from: found 'omega.33'; expected one of ")
        assert "(did you mean 'omega.3'?)" in said
        assert said.endswith("or the path of a device file, such as ./my-stick.yaml")

    def test_a_path_without_a_file(self, tmp_path: Path) -> None:
        said = refusal(tmp_path, "from: ./mine.yaml")
        assert said.startswith("s.yaml:4: devices.stick.from: found './mine.yaml', which is no file")

    def test_without_osp_it_says_what_to_do(self, tmp_path: Path) -> None:
        said = refusal(tmp_path, "from: omega.3")
        assert said.startswith("s.yaml:4: devices.stick: found no osp, and none in omega.3; expected osp in N·s/m: ")
        assert said.endswith("measure it with manyhands identify, or state it")

    def test_a_value_of_the_file_is_refused_where_it_stands(self, tmp_path: Path) -> None:
        said = refusal(tmp_path, stick=STICK.replace("force: 5", "force: -5"))
        assert said.startswith("my-stick.yaml:10: devices.stick.limits.force: found -5; expected ")

    def test_and_one_of_the_session_in_the_session(self, tmp_path: Path) -> None:
        said = refusal(tmp_path, "from: ./my-stick.yaml, limits: {force: -5}")
        assert said.startswith("s.yaml:4: devices.stick.limits.force: found -5; expected ")

    def test_though_the_file_has_a_number_for_each_axis(self, tmp_path: Path) -> None:
        listed = STICK.replace("step: 0.00001", "step: [0.00001, 0.00002]")
        assert refusal(tmp_path, "from: ./my-stick.yaml, step: -1", listed).startswith("s.yaml:4: devices.stick.step")

    @pytest.mark.parametrize(
        ("before", "after", "said"),
        [
            ("device: a stick of the lab\n", "", "1: found no key 'device'; expected the keys device, keys, sources"),
            ("device: a stick of the lab", "device: [a]", "1: device: found a list of 1; expected what it is, in one"),
            ("  osp: \"ident", "  # \"ident", "6: keys.osp: found osp without a source; expected sources: {osp: where"),
            ("  step: 2048", "  mass: 2048", "9: keys.step: found step without a source"),
            ("  step: 2048 lines, 0.02 m a turn", "  step: 2048", "18: sources.step: found 2048; expected a text"),
            ("  step: 0.00001\n", "", "17: sources.step: found a source of 'step', which is no key of this file"),
            ("  step: 0.0", "  stepp: 0.0", "9: keys.stepp: found the key 'stepp'; expected one of dof, "),
            ("  step: 0.0", "  from: 0.0", "9: keys.from: found the key 'from'; expected one of dof, "),
            ("notes: [It", "remarks: [It", "22: remarks: found the unknown key 'remarks'; expected one of device, "),
            ("notes: [It squeaks.]", "notes: it", "22: notes: found 'it'; expected a list"),
            ("[compensates gravity by a force of its own]", "[1]", "20: by_itself.0: found 1; expected a sentence"),
            ("by_itself: [", "by_itself: [a, a, a, a, a, a, a, a, ", "20: by_itself: found a list of 9"),
            ("{damping: {value: 0.4, low: 0.3}, ways: 200}", "3", "21: identification"),
            ("notes: [It squeaks.]", "found_by: {usb: [1451]}", "22: found_by"),
            ("notes: [It squeaks.]", 'found_by: {usb: ["0x1451"], source: x}', "22: found_by.usb: found a list of 1"),
            ("notes: [It squeaks.]", 'found_by: {usb: ["1451"]}', "22: found_by: found no source"),
            ("  dof: 2\n", "  dof:\n", "4: keys.dof: found nothing; expected a value"),
            (STICK, "", "1: found an empty file; expected keys and values, beginning with 'device: NAME'"),
        ],
    )  # fmt: skip
    def test_each_part_of_a_file_in_its_line(self, tmp_path: Path, before: str, after: str, said: str) -> None:
        assert before in STICK
        assert refusal(tmp_path, stick=STICK.replace(before, after)).startswith(f"my-stick.yaml:{said}")

    def test_osp_of_the_catalogue_needs_a_citation(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "guess.yaml"
        monkeypatch.setattr(files, "catalogue", lambda: {"guess": path})
        for source, allowed in (("a feeling", False), ("doi:10.1109/TRO.2005.862487, table 2", True)):
            path.write_text(f"device: d\nkeys: {{osp: 0.5}}\nsources: {{osp: {source!r}}}\n")
            assert device_file(path).keys == {"osp": 0.5}  # in a file of one's own any source is one
            if allowed:
                assert catalogue_file("guess").keys == {"osp": 0.5}
            else:
                with pytest.raises(SessionError, match=r"sources.osp: found 'a feeling'; expected a citation"):
                    catalogue_file("guess")


class TestCatalogue:
    @pytest.mark.parametrize("name", catalogue())
    def test_a_file_is_sound_and_its_keys_are_a_devices(self, name: str) -> None:
        file = catalogue_file(name)
        assert file.driver is None or file.driver in published(DRIVERS)
        given: dict[str, Any] = {"from": name, "osp": 0.5, "driver": "my_driver:make", "dof": file.keys.get("dof", 1)}
        axes = file.keys.get("axes", [])
        axes = [str(i) for i in range(given["dof"])] if not axes or isinstance(axes, str) else axes
        session = {
            "session": "s", "period": 0.001, "devices": {"d": given}, "couplings": {"c": {"devices": ["d"]}},
            "environment": {
                "type": "network",
                "links": [{"between": [f"d.{axis}", "ground"], "stiffness": 100.0} for axis in axes],
            },
            "design": {"coupling": "spring-damper"},
        }  # fmt: skip
        device = Session.from_dict(session).devices["d"]
        for key, value in file.keys.get("limits", {}).items():
            assert getattr(device.limits, key) == (float(value),) * device.dof

    def test_it_has_every_device_that_is_known(self) -> None:
        known = {
            "delta.3", "omega.3", "omega.6", "omega.7", "sigma.7", "lambda.7", "falcon", "touch", "phantom-omni",
            "phantom-desktop", "phantom-premium-1.5", "phantom-premium-3.0", "inverse3", "serial-board", "moteus",
            "odrive", "wheel",
        }  # fmt: skip
        assert set(catalogue()) == known

    def test_it_gives_no_stiffness_for_a_bound(self) -> None:
        """What CHAI3D recommends is advice, and no passivity bound."""
        for path in catalogue().values():
            assert not {"osp", "stiffness"} & set(yaml.safe_load(path.read_text())["keys"])
