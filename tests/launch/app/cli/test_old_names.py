"""Names that commands and options had before: they work, and say the present one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer

from manyhands import __version__
from manyhands.launch.app.cli import GROUPS, app
from manyhands.launch.app.cli.old_names import COMMANDS, OPTIONS, UNTIL, renewed

from ....support.commands import manyhands_command

pytestmark = pytest.mark.usefixtures("own_interrupt")


def numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".")[:2]]


def test_they_are_gone_when_it_was_promised() -> None:
    assert numbers(__version__) < numbers(UNTIL), "remove the old names, and this test's cases"


def test_each_leads_to_what_there_is_and_none_hides_anything() -> None:
    group = typer.main.get_group(app)
    listed = {name for entries in GROUPS.values() for name in entries}
    assert not COMMANDS.keys() & listed
    for name, options in OPTIONS.items():
        command = group.get_command(None, COMMANDS.get(name, (name,))[0])  # type: ignore[arg-type]
        known = {word for parameter in command.params for word in parameter.opts}
        assert set(options.values()) <= known
        assert not options.keys() & known or name in COMMANDS


@pytest.mark.parametrize(
    ("given", "means"),
    [
        ("list --json", "top --all --json"),
        ("keys s.yaml -o k --renew dx", "invite s.yaml --keys k --renew dx"),
        ("keys s.yaml -ok", "invite s.yaml --keys k"),
        ("top --session=s --once", "top --running=s --once"),
        ("echo dx/sample --session s -n 3", "echo dx/sample --running s -n 3"),
        ("node dx --session b --host h --connect c", "node dx --bundle b --address h --connect c"),
        ("plot r.mcap --topics force --to svg", "plot r.mcap --show force --format svg"),
        ("simulate s -o r.npz", "simulate s --record r.npz"),
        ("doctor --seconds 2", "doctor --duration 2"),
        ("export r.mcap --to csv -- --to", "export r.mcap --format csv -- --to"),
    ],
)
def test_an_old_call_becomes_the_present_one(given: str, means: str) -> None:
    new, said = renewed(given.split())
    assert new == means.split()
    assert all(line.endswith(f"; the old name works until version {UNTIL}") for line in said)
    assert renewed(new) == (new, [])


def test_what_is_asked_under_an_old_name_is_done_and_said(tmp_path: Path) -> None:
    done = manyhands_command("keys", "example1.yaml", "-o", tmp_path / "keys", "--json")
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["session"] == "example-1"
    assert done.stderr.splitlines()[:2] == [
        f"note: manyhands keys is now manyhands invite; the old name works until version {UNTIL}",
        f"note: keys -o is now --keys; the old name works until version {UNTIL}",
    ]
    shown = manyhands_command("list", "--json")
    assert (shown.exit_code, shown.stdout) == (0, "[]\n")
