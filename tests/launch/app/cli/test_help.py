"""The help of every command shows its usage and ends with an example that parses."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
import typer
from typer.testing import CliRunner

import manyhands.launch.app.cli
from manyhands.launch.app.cli import GROUPS, app

from ....support.rooms import ROOMS

ROOT = Path(__file__).parents[4]

pytestmark = pytest.mark.usefixtures("own_interrupt")


def commands() -> dict[str, typer.core.TyperCommand]:
    """Every command of the program, by its words."""
    group = typer.main.get_group(app)
    return {name: group.get_command(None, name) for name in group.list_commands(None)}


def told() -> list[tuple[str, int, str]]:
    """Every command line of this program in a text of the product: its file, line and words."""
    found = []
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    for line in re.findall(r"\bmanyhands ([a-z][a-z-]+(?: --[a-z-]+)*)", node.value):
                        found.append((str(path.relative_to(ROOT)), node.lineno, line))
    return found


def test_every_command_and_option_that_a_text_names_exists() -> None:
    """Advice of a command that is not there cannot be followed. A word after "manyhands" may be prose, too."""
    known, wrong, followed = commands(), [], set()
    for file, line, text in told():
        name, *options = text.split()
        command = known.get(name)
        if command is None:
            wrong += [(file, line, text)] if "-" in name or options else []
            continue
        have = {one for parameter in command.params for one in (*parameter.opts, *parameter.secondary_opts)}
        wrong += [] if set(options) <= have | {"--help"} else [(file, line, text)]
        followed.add(name)
    assert wrong == []
    assert {"check-driver", "identify", "doctor", "design", "devices"} <= followed


def test_there_are_those_that_are_known() -> None:
    assert {"design", "verify", "launch", "graph", "echo", "hz", "top"} <= commands().keys()


def test_every_command_of_a_module_is_in_the_list() -> None:
    """The list names modules, which it does not import; a command that is not in it could not be called."""
    folder = Path(manyhands.launch.app.cli.__file__).parent
    for file in folder.glob("*.py"):
        module = importlib.import_module(f"manyhands.launch.app.cli.{file.stem}")
        if file.stem != "__init__" and hasattr(module, "commands"):
            listed = {name for group in GROUPS.values() for name, entry in group.items() if entry.module == file.stem}
            assert typer.main.get_group(module.commands).commands.keys() == listed


def test_the_list_fits_80_columns_and_needs_nothing_of_the_commands() -> None:
    code = (
        "import sys; from manyhands.__main__ import main; sys.argv[1:] = ['--help']\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'pydantic', 'yaml', 'zmq', 'manyhands.launch.session'} & sys.modules.keys()\n"
        "sys.exit(f'found {heavy}; expected none of them' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    for title, group in GROUPS.items():
        at = lines.index(f"{title}:")
        shown = [line.split(maxsplit=1) for line in lines[at + 1 : at + 1 + len(group)]]
        assert shown == [[name, entry.summary] for name, entry in group.items()]


@pytest.mark.parametrize(("word", "meant"), [("lanch", "did you mean 'launch'?"), ("xyzzy", "see manyhands --help")])
def test_an_unknown_command_is_a_usage_error_that_names_the_nearest(word: str, meant: str) -> None:
    done = CliRunner().invoke(app, [word, "example1"])
    assert done.exit_code == 2
    assert done.stderr.splitlines()[-1] == f"Error: No such command {word!r}; {meant}"


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


FREE = {
    *("S", "N", "M", "COUNT", "PORT", "N/m", "N·m", "N·s/m", "HZ", "M/S", "1/M", "TIME", "PART"),  # numbers
    *("HOST", "HOST:PORT", "HOST[:PORT]", "tcp://HOST:PORT", "COMMAND"),  # of the user's own network
    *("YAML", "N|NAMES", "NAME", "DRIVER", "MODEL", "PACKAGE.MODULE:FACTORY"),  # texts of the user's own
    *(
        "FILE",
        "DIR",
        "CERT",
        "OUT",
        "PATH",
        "BUNDLE",
        "LAYOUT",
        "[DIR]",
        "[INVITATION]",
    ),  # files: the shell completes those
}
"""What stands in the help for a value that is not one of some."""


@pytest.mark.parametrize("words", sorted(commands()))
def test_every_value_that_is_one_of_some_can_be_completed(words: str) -> None:
    for parameter in commands()[words].params:
        if not getattr(parameter, "is_flag", False) and parameter._custom_shell_complete is None:
            assert parameter.metavar in FREE, parameter.opts


def test_one_name_of_an_option_has_one_form_of_value() -> None:
    """Except for what is written: each command says what its -o is."""
    forms: dict[str, set[str]] = {}
    for command in commands().values():
        for parameter in command.params:
            if parameter.param_type_name == "option" and not parameter.is_flag:
                forms.setdefault(parameter.opts[0], set()).add(str(parameter.metavar))
    several = {name: sorted(found) for name, found in forms.items() if len(found) > 1}
    assert several.pop("-o")
    assert several.pop("--format")
    assert several.pop("--plot") == ["DIR", "FILE"]  # several pictures, or one
    assert several.pop("--from") == ["S", "TEMPLATE"]  # what a new session is made from, and where a plot begins
    # guests name the host's address in one form, a node's operator in that of ZeroMQ
    assert several == {"--address": ["HOST", "HOST[:PORT]"], "--connect": ["HOST:PORT", "tcp://HOST:PORT"]}
