"""What `design` and `verify` say of encoder steps, and of mechanisms as a whole."""

from __future__ import annotations

import json
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


TORQUES = ["devices.dx.held=torque", "devices.dx.linkage={kappa: 8.2}", "devices.dx.limits={force: 10, speed: 1}"]
RUBBING = [f"devices.{name}.friction={{least: 0.1}}" for name in ("dx", "dy", "dz")]
PLAIN = "about forces held as forces, exact samples (no encoder steps) and no dry friction"
NOTHING: dict[str, list[str]] = {"held": [], "step": [], "friction": []}


@pytest.mark.parametrize(
    ("overrides", "line", "mechanism"),
    [
        ([], f"format 3, {PLAIN}", NOTHING),
        (["design.period_tolerance=0.1"], f"format 4, {PLAIN}", NOTHING),
        (["design.series=true"], f"format 5, {PLAIN}", NOTHING),
        (
            TORQUES,
            "format 6, about forces held as torques by dx, and as forces by the others; exact samples (no encoder "
            "steps) and no dry friction",
            NOTHING | {"held": ["dx"]},
        ),
        (
            [STEP],
            "format 6, about forces held as forces, samples in encoder steps of dx (not covered) and no dry friction",
            NOTHING | {"step": ["dx"]},
        ),
        (
            [STEP, *RUBBING],
            "format 6, about forces held as forces, samples in encoder steps of dx (covered by dry friction) and dry "
            "friction of dx, dy, dz (for encoder steps alone)",
            NOTHING | {"step": ["dx"], "friction": ["dx", "dy", "dz"]},
        ),
        (
            RUBBING[:1],
            "format 6, about forces held as forces, exact samples (no encoder steps) and dry friction of dx (not "
            "counted)",
            NOTHING | {"friction": ["dx"]},
        ),
        (
            [*RUBBING[:1], "design.speed=0.05"],
            "format 6, about forces held as forces, exact samples (no encoder steps) and dry friction of dx (as "
            "damping below 0.05 m/s)",
            NOTHING | {"friction": ["dx"]},
        ),
    ],
)
def test_verify_says_what_mechanisms_a_certificate_is_about(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], overrides: list[str], line: str, mechanism: dict[str, list[str]]
) -> None:
    """In one line of its own, which is no alarm: those of formats 3 to 5 say nothing of mechanisms."""
    certificate = prepare(load_named("example1", overrides)).certificate
    assert certificate is not None
    file = tmp_path / "c.json"
    certificate.save(file)
    out, err = Console(width=200), Console(width=200, stderr=True)
    with out.capture() as printed, err.capture() as warned:
        assert run_verify(file, None, out, err, as_json=False) == 0
    assert printed.get().splitlines().count(f"{file}: {line}") == 1
    assert warned.get() == ""
    run_verify(file, None, out, err, as_json=True)
    assert json.loads(capsys.readouterr().out)["mechanism"] == mechanism
