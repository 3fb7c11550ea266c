"""What `design` and `verify` say of encoder steps."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

from manyhands.launch.app.design_report import certificate_object, encoder_lines, print_certificate, run_verify
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session.shipped import load_named

STEP = "devices.dx.step=1e-5"


def said(tmp_path: Path, session: str, *overrides: str) -> tuple[list[str], str]:
    """The lines about steps, and the last line of verify."""
    certificate = prepare(load_named(session, overrides)).certificate
    assert certificate is not None
    certificate.save(tmp_path / "c.json")
    console = Console(width=200)
    with console.capture() as capture:
        print_certificate(console, certificate)
        assert run_verify(tmp_path / "c.json", None, console, console, as_json=False) == 0
    text = capture.get()
    lines = encoder_lines(certificate)
    assert all(line in text for line in lines)
    assert (certificate_object(certificate)["encoder"] is None) == (not lines)
    return lines, text.splitlines()[-1]


def test_every_port_has_the_force_in_millinewtons_and_its_own_in_steps(tmp_path: Path) -> None:
    friction = [f"devices.{name}.friction={{least: 0.1}}" for name in ("dx", "dy", "dz")]
    lines, last = said(tmp_path, "example1", STEP, *friction)
    assert lines == [
        "dx at most 24.4 mN, 2.2 steps",
        "dy at most 18.2 mN",
        "dz at most 18 mN",
        "covered by dry friction",
    ]
    assert last.startswith("example-1: proved; certificate")


@pytest.mark.parametrize(
    ("session", "line"),
    [
        ("example1", "not covered: no dry friction of that force is stated"),
        ("example1-uncertain", "not covered: the world is known up to intervals"),
    ],
)
def test_what_is_not_covered_is_named(tmp_path: Path, session: str, line: str) -> None:
    lines, last = said(tmp_path, session, STEP)
    assert lines[-1] == line
    assert "of devices that measure exactly; certificate" in last


def test_nothing_is_said_without_steps(tmp_path: Path) -> None:
    lines, last = said(tmp_path, "example1")
    assert not lines
    assert "exactly" not in last


def test_a_claim_below_a_speed_says_so_in_its_first_lines_and_its_verdict(tmp_path: Path) -> None:
    session = load_named("example1", ["devices.dx.friction={least: 0.1}", "design.speed=0.05"])
    certificate = prepare(session).certificate
    assert certificate is not None
    certificate.save(tmp_path / "c.json")
    console = Console(width=200)
    for printed in (lambda: print_certificate(console, certificate), lambda: verified(tmp_path, console)):
        with console.capture() as capture:
            printed()
        first, *_, last = capture.get().splitlines()
        assert "below 0.05 m/s on every axis, and not beyond" in first
    assert last.startswith("example-1: proved below 0.05 m/s on every axis, and not beyond; certificate")
    assert certificate_object(certificate)["speed"] == 0.05


def verified(folder: Path, console: Console) -> None:
    run_verify(folder / "c.json", None, console, console, as_json=False)
