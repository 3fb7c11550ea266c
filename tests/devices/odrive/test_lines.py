"""Lines of ODrive's ASCII protocol, by the maker's manual."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from manyhands.devices.odrive.lines import Answer, Error, Form, answer, command, said


def test_the_checksum_is_that_of_the_manual() -> None:
    """Its example of a valid checksum: ``r vbus_voltage *93``."""
    assert command("r vbus_voltage") == b"r vbus_voltage *93\n"


def sealed(text: str) -> bytes:
    found = 0
    for byte in text.encode():
        found ^= byte
    return f"{text}*{found}".encode()


def test_answers_by_their_form() -> None:
    assert answer(sealed("0.250000 -1.5")) == Answer(Form.PAIR, (0.25, -1.5), "0.250000 -1.5")
    assert answer(sealed("0.25")) == Answer(Form.FRACTION, (0.25,), "0.25")
    assert answer(sealed("inf")) == Answer(Form.FRACTION, (float("inf"),), "inf")
    assert answer(sealed("16777216")) == Answer(Form.WHOLE, (16777216.0,), "16777216")
    assert answer(sealed("invalid property")) == Answer(Form.TEXT, (), "invalid property")


def test_a_line_whose_checksum_is_wrong_or_missing_is_none() -> None:
    assert answer(b"0.25 1.5") is None
    assert answer(sealed("0.25 1.5").replace(b"2", b"3")) is None
    assert answer(b"0.25*zz") is None


def test_errors_have_the_makers_names() -> None:
    assert said(0x200) == "DC_BUS_UNDER_VOLTAGE"
    assert said(0x1000000 | 0x4000) == "INVERTER_OVER_TEMP | WATCHDOG_TIMER_EXPIRED"
    assert said(0x80) == "0x80"
    assert said(0) == "none"
    assert Error.WATCHDOG_TIMER_EXPIRED == 0x01000000


@given(st.binary(max_size=80))
def test_any_line_is_an_answer_or_none(line: bytes) -> None:
    found = answer(line)
    assert found is None or found.form in Form
