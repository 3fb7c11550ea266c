"""Two different devices in one session: one at home in the tick, one of a guest's across a WAN, who allows its driver.

The home device is a row of :data:`HOME`. The guest's is a fake serial board. Real processes, in two network namespaces.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from ..fakes.board import FakeBoard, fake_board
from ..fakes.haply import fake_haply
from ..support.wan import Wire, wan
from .device_rows import HELD, SERIAL_BOARD
from .test_seats import PORT, PROMISE, Host, Said, command, require_unaccused

DRIVER: Final = "manyhands.devices.serial_board:SerialBoard"
WIRE: Final = Wire(delay=0.02, jitter=0.002, loss=0.01)
DEADLINE: Final = 60.0  # s, for anything that is awaited


@contextmanager
def simulated(_folder: Path, _within: Sequence[str]) -> Iterator[Mapping[str, Any]]:
    """A device at home that moves by itself, 1 N to and fro."""
    yield {
        "dof": 1,
        "osp": 1.37,
        "driver": "simulated",
        "mass": 0.2,
        "limits": {"force": 8, "displacement": 0.2, "speed": 2},
        "hand": {"stiffness": 60, "damping": 2, "force": "1.0*sin(2*pi*0.5*t)"},
    }


@contextmanager
def haply(_folder: Path, within: Sequence[str]) -> Iterator[Mapping[str, Any]]:
    """An Inverse3 behind a service on the host's machine; somebody holds it, and moves."""
    hand = {"mass": 0.15, "damping": 1.0, "step": 0.001, "hand": 100.0, "amplitude": 0.015}
    with fake_haply(within, **hand) as one:
        yield {
            "dof": 3,
            "axes": ["x", "y", "z"],
            "osp": 1.0,
            "driver": "haply-inverse3",
            "parameters": {"port": one.port, "events": one.events, "silence": 0.9, "force": 5, **HAPLY_TIMES},
            **HAPLY_TIMES,
            "held": "torque",
            "linkage": {"kappa": 8},
            "limits": {"force": 5, "displacement": 0.15, "speed": 1},
        }
        end = one.asked()
        assert end["most"] > 0.1  # N, what its motors have really done
        assert end["f"] == [0.0, 0.0, 0.0]
        assert end["enabled"] == {"gravity_compensation": True, "torque_scaling": True}  # as it was before


HAPLY_TIMES: Final = {"sample_age": 0.002, "actuation_delay": 0.001}  # s

HOME: Final[Mapping[str, Callable[[Path, Sequence[str]], AbstractContextManager[Mapping[str, Any]]]]] = {
    "simulated": simulated,
    "haply-inverse3": haply,
}
"""By name, the device at home: opens its fake, if it has one, and gives its keys of a session.

A fake that listens to the network stands on the host's machine: the second argument is what to put before its command.
"""


def session_of(home: Mapping[str, Any], port: str) -> dict[str, Any]:
    """A ball between the two, at the board's period."""
    first, *others = (f"home.{axis}" for axis in home.get("axes", ["0"]))
    tau = SERIAL_BOARD.design["tau"]
    return {
        "session": "two-devices",
        "period": SERIAL_BOARD.period,
        "colocate": True,
        "devices": {
            "home": dict(home),
            "far": {**SERIAL_BOARD.keys, "parameters": {**SERIAL_BOARD.parameters, "port": port}},
        },
        "couplings": {
            "chome": {"devices": ["home"]},
            "far_seat": {"devices": ["far"], "wave_link": {"b": 10, "tau": tau}},
        },
        "environment": {
            "type": "network",
            "masses": {"ball": 0.5},
            "links": [
                {"between": [first, "ball"], "stiffness": 60, "damping": 0.2},
                {"between": ["far.0", "ball"], "stiffness": 60, "damping": 0.2},
                {"between": ["ball", "ground"], "stiffness": 30, "damping": 1.0},
                *({"between": [axis, "ground"], "stiffness": 60} for axis in others),
            ],
        },
        "design": {**SERIAL_BOARD.design, "objective": "feasible"},
    }


def until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + DEADLINE
    while not true():
        assert time.monotonic() < end, "it never came"
        time.sleep(0.01)


def felt(one: FakeBoard) -> None:
    """Wait until the guest's hand feels the ball."""
    until(lambda: abs(one.asked()[1][0]) > 0.02)


@pytest.mark.long
@pytest.mark.parametrize("device", HOME)
def test_two_devices_hold_one_ball_one_across_a_wan(device: str, tmp_path: Path) -> None:
    """The guest comes by an invitation, is refused without its word for the driver's code, and comes after faults."""
    home, far = tmp_path / "home", tmp_path / "far"
    for machine in (home, far):
        machine.mkdir()
    with (
        wan(WIRE) as net,
        HOME[device](tmp_path, net.within("near")) as keys,
        fake_board(HELD, period_us=500) as one,
        ExitStack() as stack,
    ):
        port = tmp_path / "port"
        one.order(f"plug {port}")
        one.asked()
        (home / "two.yaml").write_text(json.dumps(session_of(keys, str(port))))
        address = f"{net.address('near')}:{PORT}"
        options = ("--listen", address, "-o", "two", "--record", "run.mcap", "--report", "run.json")
        host = Host(stack.enter_context(command("host", "two.yaml", *options, cwd=home, within=net.within("near"))))
        host.until(": running")
        invitation = far / "far_seat.invitation"
        invitation.touch(mode=0o600)
        invitation.write_bytes((home / "two" / invitation.name).read_bytes())
        join = ("join", invitation.name, "--yes")
        with command(*join, cwd=far, within=net.within("far")) as process:
            refused = Said(process)
            assert refused.end() != 0
        assert any(f"--allow-code {DRIVER}" in line for line in refused.lines)
        for fault, said in (("", ""), ("brake", "found the board braked by its own protection"), ("unplug", str(port))):
            with command(*join, "--allow-code", DRIVER, cwd=far, within=net.within("far")) as process:
                guest = Said(process)
                guest.until("far_seat: in, ")
                felt(one)
                if not fault:
                    assert guest.end(signal.SIGINT) == 130
                else:
                    one.order(fault)
                    assert guest.end() != 0
                    assert any(said in line for line in guest.lines), guest.lines
            until(lambda: one.asked()[1] == [0.0])
            one.order(f"free\nplug {port}")
        host.go_on(200)
        assert host.end(signal.SIGINT) == 130
    report = json.loads((home / "run.json").read_text())
    nodes = report["nodes"]
    for node in nodes.values():
        assert node.get("ledger", {"margin": 0.0})["margin"] >= PROMISE or node["role"] == "device"
        assert node.get("interface", {"margin": 0.0})["margin"] >= PROMISE
    judged = "ledger" if keys["driver"] == "simulated" else "interface"  # what another hand intends nobody knows
    assert nodes["home"][judged]["margin"] >= PROMISE
    assert nodes["home"]["peak_force"] > 0.1
    assert nodes["home"].get("incidents", {}).get("restarts", 0) == 0
    assert [text for text in report.get("incidents", []) if "home" in text] == []
    require_unaccused(home / "run.mcap")
