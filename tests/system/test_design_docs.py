"""docs/design.md is executed: every block prints the output shown, and every number in the text is one of a block."""

from __future__ import annotations

import doctest
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.testing import CliRunner

from manyhands import passivity
from manyhands.launch.app import cli

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "design.md"
SESSIONS = ROOT / "launch" / "sessions"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
COMPUTED = re.compile(r"<!-- computed by: (.+?) -->\n((?:\|.*\n)+)")
FRAME = re.compile(r"[\u2500-\u257f]")  # what tables are drawn with
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w])")
SMALL = 10  # whole numbers up to here are counts, sections and figures


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and its first line in the page."""

    language: str
    text: str
    line: int


def blocks(text: str) -> Iterator[Block]:
    for match in BLOCK.finditer(text):
        yield Block(match[1], match[2], text.count("\n", 0, match.start(2)) + 1)


def commands(block: str) -> Iterator[tuple[list[str], int, list[str]]]:
    """Arguments, expected exit code and quoted output lines of each ``$ manyhands`` of a console block."""
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        command, *quoted = part.strip().splitlines()
        command, _, comment = command.partition(" #")
        program, *arguments = shlex.split(command)
        assert program == "manyhands", f"the page may only run manyhands, found {command!r}"
        stated = re.search(r"exit (\d+)", comment)
        yield arguments, int(stated[1]) if stated else 0, quoted


def plain(line: str) -> str:
    """A line without the frame of a table, and with single spaces."""
    return " ".join(FRAME.sub(" ", line).split())


def missing(quoted: list[str], output: str) -> list[str]:
    """The quoted lines that do not occur in ``output``; ``...`` stands for anything within a line."""
    lines = [plain(line) for line in output.splitlines()]

    def occurs(line: str) -> bool:
        parts = [re.escape(part) for part in plain(line).split("...")]
        return any(re.fullmatch(".*".join(parts), found) for found in lines)

    return [line for line in quoted if not occurs(line)]


def without_blocks(text: str) -> str:
    """The running text: no blocks, no computed tables, no code, no targets of links."""
    text = COMPUTED.sub("", BLOCK.sub("", text))
    text = re.sub(r"`[^`]*`", "", text)
    return re.sub(r"\]\([^)]*\)", "]", text)


def unfounded(text: str) -> list[str]:
    """Numbers of the running text that begin no number of a block or of a computed table."""
    shown = "\n".join([*(block.text for block in blocks(text)), *(table for _, table in COMPUTED.findall(text))])
    found = []
    for number in NUMBER.findall(re.sub(r"\((\d+)\)", "", without_blocks(text))):  # (10) is an equation
        if (number.isdigit() and int(number) <= SMALL) or re.search(rf"(?<![\d.]){re.escape(number)}", shown):
            continue
        found.append(number)
    return found


@pytest.mark.long
@pytest.mark.usefixtures("own_interrupt")
def test_every_block_prints_its_quoted_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the page's order, in one folder: commands leave files that the code reads, and the other way round."""
    monkeypatch.chdir(tmp_path)
    # as to a file, even where the tests themselves write to a terminal
    runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
    names: dict[str, object] = {}
    wrong: list[str] = []
    ran = 0
    for block in blocks(PAGE.read_text(encoding="utf-8")):
        where = f"docs/design.md:{block.line}"
        if block.language == "python":
            examples = doctest.DocTestParser().get_doctest(block.text, names, where, str(PAGE), block.line)
            assert examples.examples, f"{where}: a python block without an example"
            report: list[str] = []
            runner.run(examples, out=report.append, clear_globs=False)
            names = examples.globs
            wrong += report
            ran += 1
        elif block.language == "console":
            for arguments, code, quoted in commands(block.text):
                done = CliRunner().invoke(cli.app, arguments)  # in this process: the page has a dozen of them
                if done.exit_code != code:
                    wrong.append(f"{where}: {arguments}: exit {done.exit_code}, expected {code}\n{done.output}")
                wrong += [
                    f"{where}: {arguments} did not say: {line}\n{done.output}" for line in missing(quoted, done.output)
                ]
                ran += 1
        else:
            assert block.language == "yaml", f"{where}: nothing checks a block of {block.language!r}"
    assert ran >= 25, "the page has lost its blocks"
    assert not wrong, "\n".join(wrong)


def test_excerpts_of_sessions_are_the_shipped_ones() -> None:
    shipped = [path.read_text(encoding="utf-8") for path in SESSIONS.glob("*.yaml")]
    excerpts = [block for block in blocks(PAGE.read_text(encoding="utf-8")) if block.language == "yaml"]
    assert excerpts
    for block in excerpts:
        assert any(block.text in text for text in shipped), f"docs/design.md:{block.line}: no shipped session has this"


def test_every_number_in_the_text_is_one_of_a_block() -> None:
    assert unfounded(PAGE.read_text(encoding="utf-8")) == []


def test_examples_too_slow_for_a_test_name_their_program() -> None:
    found = COMPUTED.findall(PAGE.read_text(encoding="utf-8"))
    assert found
    for command, _ in found:
        program, script, *_ = shlex.split(command)
        assert program == "python"
        assert (ROOT / script).is_file()


def test_the_check_sees_what_is_wrong() -> None:
    """The rules of the page, each broken once."""
    output = "│ margin of (10)  │ 1.4955 N·s/m │\nexample-1: certified   \n"
    assert missing(["margin of (10) 1.4... N·s/m", "example-1: certified"], output) == []
    assert missing(["margin of (10) 1.5... N·s/m", "certified"], output) == ["margin of (10) 1.5... N·s/m", "certified"]
    page = "The limit (24) is 2740 N/m, not 2750, in 3 steps, `x = 7.5`.\n```console\n$ manyhands x\n2740\n```\n"
    assert unfounded(page) == ["2750"]
    assert unfounded(page + "<!-- computed by: python a.py -->\n| 2750.5 |\n") == []


def test_the_page_describes_every_name_of_the_passivity_library() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in passivity.__all__ if f"`{name}`" not in text] == []
