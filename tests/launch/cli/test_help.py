"""The help of every command shows its usage and ends with an example that parses."""

from __future__ import annotations

import shlex

import click
import pytest
import typer
from typer.testing import CliRunner

from manyhands.launch.cli import app

pytestmark = pytest.mark.usefixtures("own_interrupt")


def commands() -> dict[str, typer.core.TyperCommand]:
    """Every command of the program, by its words."""
    found = {}
    open_ = {"": typer.main.get_command(app)}
    while open_:
        words, command = open_.popitem()
        inner = getattr(command, "commands", None)
        if inner is None:
            found[words] = command
        else:
            open_ |= {f"{words} {name}".strip(): one for name, one in inner.items()}
    return found


def test_there_are_those_that_are_known() -> None:
    assert {"design", "verify", "launch", "graph", "list", "echo", "hz", "top"} <= commands().keys()


@pytest.mark.parametrize("words", sorted(commands()))
def test_help_ends_with_an_example(words: str) -> None:
    done = CliRunner().invoke(app, [*words.split(), "--help"], terminal_width=400)
    assert done.exit_code == 0
    last = done.stdout.rstrip().rsplit("\n\n", 1)[-1]
    example = " ".join(last.split())
    assert example.startswith(f"Example: manyhands {words}"), example
    first = " ".join(done.stdout.split()).split("[OPTIONS]")[-1]
    assert len(first) > 20


@pytest.mark.parametrize("words", sorted(commands()))
def test_the_example_has_no_option_or_argument_that_there_is_not(words: str) -> None:
    command = commands()[words]
    (example,) = [line for line in (command.epilog or "").splitlines() if line.startswith("Example: ")]
    arguments = shlex.split(example.removeprefix("Example: manyhands "), comments=True)[len(words.split()) :]
    try:
        command.make_context(words, arguments)
    except click.exceptions.UsageError as error:
        pytest.fail(f"{example}: {error.format_message()}")
