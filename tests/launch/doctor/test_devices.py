"""What is plugged in, read from a folder that looks like sysfs and /dev; nothing of this machine is looked at."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from http.server import BaseHTTPRequestHandler, HTTPServer
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from manyhands.launch.app.cli import devices as command
from manyhands.launch.doctor import devices
from manyhands.launch.doctor.devices import PluggedIn, Survey, version_at
from manyhands.launch.session import load_session
from manyhands.launch.session.device_file import catalogue, catalogue_file
from manyhands.nodes.kernel.factory import DRIVERS, published

from ...support.commands import manyhands_command

FORCES = "1 7f0000 0"  # of capabilities/ff: the bit of FF_CONSTANT is in the second word of 64
RUMBLES = "107030000 0"


@dataclass
class Desk:
    """A folder with sys and dev, into which devices are plugged."""

    root: Path
    closed: tuple[str, ...] = ()

    def plug(self, place: str, ids: str, name: str = "", kind: str = "00", nodes: Mapping[str, str] = {}) -> None:
        """A USB device; ``nodes`` are folders below it in sysfs, and with an event device what forces it has."""
        folder = self.root / "sys/bus/usb/devices" / place
        vendor, product = ids.split(":")
        number = str(len(list(folder.parent.glob("*"))) + 1)
        files = {"idVendor": vendor, "idProduct": product, "bDeviceClass": kind, "busnum": "1", "devnum": number}
        for file, text in {**files, "manufacturer": "", "product": name}.items():
            self.file(folder / file, text + "\n")
        self.file(self.root / f"dev/bus/usb/001/{number.zfill(3)}")
        for node, forces in nodes.items():
            (folder / node).mkdir(parents=True)
            last = Path(node).name
            self.file(self.root / ("dev/input" if last.startswith("event") else "dev") / last)
            if forces:
                self.file((folder / node).parent / "capabilities/ff", forces)

    def file(self, path: Path, text: str = "") -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def look(self, answer: str | None = None) -> Survey:
        def may(path: Path) -> bool:
            return path.resolve().name not in self.closed

        return devices.survey(self.root, may, lambda _address: answer, ())

    def only(self) -> PluggedIn:
        [found] = self.look().devices
        return found


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def test_an_empty_desk(desk: Desk) -> None:
    assert desk.look() == Survey((), 0, {"inverse3": "http://127.0.0.1:10001/version"})


def test_keyboards_and_hubs_are_no_device(desk: Desk) -> None:
    desk.plug("usb1", "1d6b:0002", "root hub", kind="09")
    desk.plug("1-1", "046d:c31c", "Keyboard", nodes={"1-1:1.0/0003:046D:C31C.0001/input/input3/event3": "0"})
    desk.plug("1-2", "045e:028e", "Gamepad", nodes={"1-2:1.0/input/input4/event4": RUMBLES})
    desk.file(desk.root / "sys/bus/usb/devices/1-1:1.0/bInterfaceClass", "03")
    assert (desk.look().devices, desk.look().others) == ((), 2)


class TestForceDimension:
    def test_without_its_library_and_the_right_to_open_it(self, desk: Desk) -> None:
        desk.plug("1-4", "1451:0402", "omega.x haptic device")
        desk.closed = ("001",)
        found = desk.only()
        assert (found.known, found.usb, found.nodes) == (("omega.7",), "1451:0402", ("/dev/bus/usb/001/001",))
        assert any(one.startswith("found no libdrd.so; expected the maker's library") for one in found.missing)
        assert found.missing[-1].startswith(
            "/dev/bus/usb/001/001 may not be opened: write the rule into /etc/udev/rules"
        )
        assert found.rule == ('SUBSYSTEM=="usb", ATTR{idVendor}=="1451", ATTR{idProduct}=="0402", TAG+="uaccess"')

    @pytest.mark.parametrize("folder", ["usr/local/lib", "usr/lib/x86_64-linux-gnu", "opt/sdk/lib"])
    def test_with_both(self, desk: Desk, folder: str) -> None:
        desk.plug("1-4", "1451:0402")
        desk.file(desk.root / folder / "libdrd.so.3")
        assert not [one for one in desk.only().missing if "driver" not in one]
        assert desk.only().rule == ""

    def test_of_a_vendor_alone_all_that_it_may_be(self, desk: Desk) -> None:
        desk.plug("1-4", "1451:0301")
        assert desk.only().known == ("delta.3", "lambda.7", "omega.3", "omega.6")


class TestSerialBoard:
    NODE = "1-2:1.0/tty/ttyACM0"

    def test_the_next_line_has_the_name_that_lasts(self, desk: Desk) -> None:
        desk.plug("1-2", "2341:003d", "Arduino Due", nodes={self.NODE: ""})
        link = desk.root / "dev/serial/by-id/usb-Arduino_Due-if00"
        link.parent.mkdir(parents=True)
        link.symlink_to("../../ttyACM0")
        found = desk.only()
        assert (found.known, found.missing) == (("serial-board",), ())
        assert found.next == (
            "manyhands check-driver serial-board --dof 1 "
            "--parameters '{port: /dev/serial/by-id/usb-Arduino_Due-if00}' --no-push"
        )

    def test_whoever_may_not_open_it_is_told_the_group(self, desk: Desk) -> None:
        desk.plug("1-2", "0403:6001", "FT232R", nodes={"1-2:1.0/ttyUSB0/tty/ttyUSB0": ""})
        desk.closed = ("ttyUSB0",)
        assert desk.only().missing == (
            "/dev/ttyUSB0 may not be opened: sudo usermod -aG dialout $USER, and log in again",
        )

    def test_a_container_that_was_not_given_it(self, desk: Desk) -> None:
        desk.plug("1-2", "0403:6001", nodes={self.NODE: ""})
        (desk.root / "dev/ttyACM0").unlink()
        assert desk.only().missing == (
            "found no /dev/ttyACM0; expected that node: a container has to be given the device",
        )

    def test_a_port_of_ids_that_many_share_is_known_by_its_name(self, desk: Desk) -> None:
        desk.plug("1-2", "0483:5740", "mjbots fdcanusb", nodes={self.NODE: ""})
        desk.plug("1-3", "0483:5740", "STM32 Virtual ComPort", nodes={"1-3:1.0/tty/ttyACM1": ""})
        assert [found.known for found in desk.look().devices] == [("moteus",), ("serial-board",)]

    def test_what_is_behind_a_hub_is_not_the_hubs(self, desk: Desk) -> None:
        desk.plug("1-3", "1a86:8092", "no hub by its class", nodes={"1-3.1/1-3.1:1.0/tty/ttyACM0": ""})
        desk.file(desk.root / "sys/bus/usb/devices/1-3/1-3.1/idVendor", "2341")
        assert (desk.look().devices, desk.look().others) == ((), 1)


class TestWheel:
    def test_by_its_forces_whoever_made_it(self, desk: Desk) -> None:
        desk.plug("1-5", "ffff:0001", "A wheel", nodes={"1-5:1.0/0003:F.1/input/input7/event7": FORCES})
        desk.closed = ("event7",)
        found = desk.only()
        assert (found.known, found.nodes) == (("wheel",), ("/dev/bus/usb/001/001", "/dev/input/event7"))
        assert found.rule.startswith('SUBSYSTEM=="input", ATTRS{idVendor}=="ffff"')

    def test_one_without_forces_says_what_it_lacks(self, desk: Desk) -> None:
        desk.plug("1-5", "046d:c24f", "G29", nodes={"1-5:1.0/0003:F.1/input/input7/event7": RUMBLES})
        assert any(one.startswith("found no event device with constant forces") for one in desk.only().missing)


def test_a_device_without_a_driver_of_ours(desk: Desk) -> None:
    desk.plug("1-6", "2988:0302", "Touch", nodes={"1-6:1.0/0003:2988:0302.0002/hidraw/hidraw2": ""})
    desk.closed = ("hidraw2",)
    found = desk.only()
    assert found.known == ("touch",)
    assert found.missing[0].startswith("this package has no driver of it")
    assert found.rule.startswith('SUBSYSTEM=="hidraw", ATTRS{idVendor}=="2988"')
    assert found.next == "manyhands devices touch"


class TestService:
    def test_one_that_answers_is_a_device(self, desk: Desk) -> None:
        found = desk.look('{"version":"3.5.0"}')
        assert found.silent == {}
        [service] = found.devices
        assert (service.place, service.known) == ("http://127.0.0.1:10001/version", ("inverse3",))
        assert service.name == 'its service answers: {"version":"3.5.0"}'

    def test_a_library_that_its_driver_needs_is_missing(self, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
        assert desk.look('{"version":"3.5.0"}').devices[0].missing == ()
        monkeypatch.setitem(sys.modules, "websockets", None)
        assert desk.look('{"version":"3.5.0"}').devices[0].missing == (
            "found no websockets; expected the extra haply: pip install 'manyhands[haply]'",
        )

    @pytest.mark.parametrize(("status", "said"), [(200, "a b"), (404, "status 404")])
    def test_it_is_asked_once(self, status: int, said: str) -> None:
        class Service(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                asked.append(self.path)
                self.send_response(status)
                self.end_headers()
                self.wfile.write(b"a\n b")

            def log_message(self, *_: object) -> None:
                pass

        asked: list[str] = []
        with HTTPServer(("127.0.0.1", 0), Service) as server:
            thread = threading.Thread(target=server.handle_request)
            thread.start()
            try:
                assert version_at(f"http://127.0.0.1:{server.server_port}/version") == said
            finally:
                thread.join()
            free = server.server_port
        assert asked == ["/version"]
        assert version_at(f"http://127.0.0.1:{free}/version") is None

    def test_nobody_elsewhere_is_asked(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object, **__: object) -> None:
            pytest.fail("a connection was made")

        monkeypatch.setattr(devices.http.client, "HTTPConnection", refuse)
        assert version_at("http://192.0.2.1:10001/version") is None


class TestCommand:
    def test_it_prints_what_is_missing_and_the_next_line(self, desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
        desk.plug("1-2", "2341:003d", "Arduino\x1b[31m Due", nodes={TestSerialBoard.NODE: ""})
        desk.plug("1-6", "2988:0302", "Touch")
        desk.plug("1-7", "046d:c31c", "Keyboard")
        monkeypatch.setattr(command, "survey", partial(desk.look, None))
        done = manyhands_command("devices")
        assert done.exit_code == 0
        lines = done.stdout.splitlines()
        assert lines[0] == "serial-board: USB 2341:003d, 'Arduino\\x1b[31m Due' at 1-2"
        assert lines[1].startswith(
            "  next: manyhands check-driver serial-board --dof 1 --parameters '{port: /dev/ttyACM0}'"
        )
        assert lines[2] == "touch: USB 2988:0302, 'Touch' at 1-6"
        assert lines[3].startswith("  missing: this package has no driver of it")
        assert lines[-2].startswith("inverse3: no service answers at http://127.0.0.1:10001/version")
        assert lines[-1].startswith("1 other USB device;")
        plain = json.loads(manyhands_command("devices", "--json").stdout)
        assert [device["known"] for device in plain["devices"]] == [["serial-board"], ["touch"]]
        assert (plain["others"], list(plain["silent"])) == (1, ["inverse3"])

    def test_the_catalogue_and_a_file_of_it(self) -> None:
        listed = manyhands_command("devices", "--catalogue").stdout
        assert "omega.3              Force Dimension omega.3\n" in listed
        assert json.loads(manyhands_command("devices", "--catalogue", "--json").stdout)["touch"] == "3D Systems Touch"
        shown = manyhands_command("devices", "omega.3").stdout
        assert "  limits: {force: 6.9, displacement: 0.043}\n      CHAI3D 3.3.0, https://github.com/chai3d" in shown
        assert "    #   manyhands identify force-dimension --dof 3 -o stick.device.yaml\n" in shown
        assert json.loads(manyhands_command("devices", "omega.3", "--json").stdout)["keys"]["dof"] == 3

    def test_a_file_of_ones_own(self, tmp_path: Path) -> None:
        (tmp_path / "mine.yaml").write_text(
            "device: mine\nkeys: {osp: 0.5, step: 1.0e-05}\nsources: {osp: identified, step: its encoder}\n"
            "by_itself: [gates forces]\nidentification: {ways: 200}\nnotes: [It squeaks.]\n"
        )
        shown = manyhands_command("devices", tmp_path / "mine.yaml").stdout.splitlines()
        assert shown[1:] == [
            "  osp: 0.5", "      identified", "  step: 1e-05", "      its encoder",
            "  by itself, outside every certificate: gates forces", "  identification ways: 200", "  It squeaks.",
            "in a session, where each line with # is yours:", "devices:", "  stick:", f"    from: {tmp_path}/mine.yaml",
            '    # driver: "my_driver:make"  # yours, for this package has none of it (docs/drivers.md)',
            "    # dof: 1  # how many axes yours has",
            "    # what your driver states, such as limits, sample_age and actuation_delay; to print it, run",
            "    #   manyhands check-driver my_driver:make --dof 1 --no-push",
        ]  # fmt: skip

    @pytest.mark.parametrize("name", catalogue())
    def test_what_is_printed_is_a_session_once_its_comments_are_filled_in(self, name: str, tmp_path: Path) -> None:
        """As it is printed it lacks what nobody knows of it, and the first error is about that."""
        printed = manyhands_command("devices", name).stdout.partition("where each line with # is yours:\n")[2]
        own = printed.replace("# driver:", "driver:").replace("# dof:", "dof:")
        keys = catalogue_file(name).keys
        axes, unit = keys.get("axes", ""), "N·m·s/rad" if "rotation" in str(keys.get("axes")) else "N·s/m"
        axes = [*map(str, range(keys.get("dof", 1)))] if isinstance(axes, str) else axes
        rest = yaml.safe_dump(
            {
                "session": "mine",
                "period": 0.006,
                "couplings": {"c": {"devices": ["stick"]}},
                "environment": {
                    "type": "network",
                    "links": [{"between": [f"stick.{axis}", "ground"], "stiffness": 0.5} for axis in axes],
                },
                "design": {"coupling": "spring-damper"},
            }
        )
        (file := tmp_path / "mine.yaml").write_text(rest + own)
        done = manyhands_command("design", file)
        assert done.exit_code == 2
        lacks = f"osp in {unit}: the damping that your device surely has; measure it with manyhands identify"
        assert lacks in done.stderr
        file.write_text(rest + own.replace("# osp: OSP", "osp: 0.5"))
        done = manyhands_command("design", file)
        assert done.exit_code == 0, done.output
        driver = load_session(file).devices["stick"].driver
        (warned,) = [
            line for line in done.stderr.splitlines() if line.startswith("warning: stick: found no sample_age")
        ]
        assert f"of its driver {driver}; expected those that manyhands check-driver prints" in warned
        file.write_text(rest + own.replace("# osp: OSP", "sample_age: 0.0\n    osp: 0.5"))
        assert "warning: stick" not in manyhands_command("design", file).stderr

    @pytest.mark.parametrize("name", [name for name in catalogue() if catalogue_file(name).needs])
    def test_a_driver_refuses_to_go_without_each_parameter_that_it_is_said_to_need(self, name: str) -> None:
        file = catalogue_file(name)
        module, _, factory = published(DRIVERS)[file.driver or ""].partition(":")
        given = {key: 1.0 if key not in ("device", "port") else "/dev/none" for key in file.needs}
        make = getattr(import_module(module), factory)
        for lacking in file.needs:
            rest = {key: value for key, value in given.items() if key != lacking}
            with pytest.raises(ValueError, match=rf"parameters\.{lacking}: found"):
                make(("d.0",), 0.01, rest)
        with pytest.raises((OSError, RuntimeError)):  # it has all, and there is no such device
            make(("d.0",), 0.01, given)

    def test_what_is_none(self) -> None:
        for arguments in (("omega.33",), ("no.yaml",), ("omega.3", "--catalogue")):
            done = manyhands_command("devices", *arguments)
            assert done.exit_code == 2
            assert done.stderr.startswith("error: ")
