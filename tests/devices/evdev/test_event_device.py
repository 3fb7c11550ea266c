"""The numbers and layouts of the kernel's header, and what the calls do to a fake that keeps them."""

from __future__ import annotations

import errno
import subprocess
from contextlib import closing

import pytest

from manyhands.devices.evdev import event_device as ev
from manyhands.devices.evdev.event_device import EventDevice

from ...fakes.compiled import FAKES, built
from ...fakes.wheel import STRICT, FakeCalls, Turn, fake_wheel


def test_numbers_and_layouts_are_those_of_the_systems_header() -> None:
    program = built("evdev_layout", (FAKES / "evdev_layout.c",), STRICT)
    said = subprocess.run([program], check=True, capture_output=True, text=True).stdout.split()
    found = dict(zip(said[::2], map(int, said[1::2]), strict=True))
    effect = ev.EFFECT.pack(0x52, 3, 0x4000, 0, 0, 24, 0, -5, 0, 0, 0, 0)
    assert found == {
        "event": ev.EVENT.size,
        "effect": ev.EFFECT.size,
        "absinfo": ev.ABSINFO.size,
        "id": effect.index((3).to_bytes(2, "little")),
        "direction": 4,
        "length": effect.index((24).to_bytes(2, "little")),
        "level": effect.index((-5).to_bytes(2, "little", signed=True)),
        "sff": ev.EVIOCSFF,
        "rmff": ev.EVIOCRMFF,
        "grab": ev.EVIOCGRAB,
        "clock": ev.EVIOCSCLOCKID,
        "types": ev.EVIOCGBIT(0),
        "forces": ev.EVIOCGBIT(ev.EV_FF),
        "get": ev.EVIOCGABS(ev.ABS_WHEEL),
        "set": ev.EVIOCSABS(ev.ABS_WHEEL),
        "constant": ev.FF_CONSTANT,
        "gain": ev.FF_GAIN,
        "autocenter": ev.FF_AUTOCENTER,
        "rumble": ev.FF_RUMBLE,
        "dropped": ev.SYN_DROPPED,
    }


def test_codes_and_axes_are_read() -> None:
    with fake_wheel(Turn(), Turn()) as one, closing(EventDevice(one.path, FakeCalls())) as device:
        assert device.codes() == {ev.EV_SYN, ev.EV_ABS, ev.EV_FF}
        assert device.codes(ev.EV_ABS) == {ev.ABS_X, ev.ABS_Y}
        assert device.codes(ev.EV_FF) == {ev.FF_RUMBLE, ev.FF_CONSTANT, ev.FF_GAIN, ev.FF_AUTOCENTER}
        axis = device.axis(ev.ABS_Y)
        assert (axis.minimum, axis.value, axis.maximum, axis.fuzz) == (0, 32768, 65535, 255)
        device.filter(ev.ABS_X, 3)
        assert device.axis(ev.ABS_X).fuzz == 3


def test_effects_belong_to_one_file_and_end_with_it() -> None:
    with fake_wheel() as one, closing(EventDevice(one.path, FakeCalls())) as device:
        other = EventDevice(one.path, FakeCalls())
        number = other.upload(-1, 0x4000, 1000, 0)
        other.play([(number, 1)])
        assert one.asked()[2]["playing"] == 1
        with pytest.raises(OSError, match="Permission") as caught:
            device.upload(number, 0x4000, 0, 0)
        assert caught.value.errno == errno.EACCES
        other.close()
        other.close()  # a second call does nothing
        while one.asked()[2]["playing"]:
            pass  # the fake hears of the end of a connection in its own turn


def test_events_of_another_file_go_to_whoever_has_grabbed_it() -> None:
    with fake_wheel(Turn(c=0.0)) as one, closing(EventDevice(one.path, FakeCalls())) as device:
        one.order("manual")
        with closing(EventDevice(one.path, FakeCalls())) as other:
            other.grab()
            with pytest.raises(OSError, match="busy"):
                device.grab()
            number = other.upload(-1, 0x4000, -ev.FULL, 0)
            other.play([(number, 1)])
            one.advance(0.1)
            assert list(device.events()) == []
            heard = list(other.events())
            assert {event.kind for event in heard} == {ev.EV_ABS, ev.EV_SYN}
            assert heard[-2].value > 32768


def test_the_end_of_a_fake_is_an_unplugged_device() -> None:
    with fake_wheel() as one, closing(EventDevice(one.path, FakeCalls())) as device:
        one.process.kill()
        one.process.wait()
        with pytest.raises(OSError, match="No such device"):
            list(device.events())


class Chunks(FakeCalls):
    """A device whose queue is longer than one read: what reads return is given."""

    given: tuple[int, ...] = ()

    def read(self, fd: int, size: int) -> bytes:
        """As many events as the next number says."""
        count, self.given = self.given[0], self.given[1:]
        return ev.EVENT.pack(1, 2, ev.EV_ABS, 0, 7) * count


def test_a_long_queue_is_read_to_its_end() -> None:
    calls = Chunks()
    calls.given = (64, 64, 3)
    with fake_wheel() as one, closing(EventDevice(one.path, calls)) as device:
        assert len(list(device.events())) == 131
    assert not calls.given
