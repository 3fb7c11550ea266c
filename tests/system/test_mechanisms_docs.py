"""docs/mechanisms.md is executed: commands print what it quotes, tables are computed anew, numbers are theirs."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from textwrap import indent
from typing import Any

import pytest

import manyhands as mh

from ..support.commands import manyhands_command
from .test_design_docs import blocks, commands, missing, unfounded

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "mechanisms.md").read_text(encoding="utf-8")
TABLE = re.compile(r"<!-- (\w+): begin -->\n(.*?)\n<!-- \1: end -->", re.DOTALL)
QUICK = ("held", "boxes", "steps", "devices", "options")  # tables that are computed in seconds


@pytest.fixture
def mechanisms(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The benchmark, which is run from the repository's root."""
    monkeypatch.syspath_prepend(ROOT)
    return import_module("benchmarks.mechanisms")


@pytest.mark.long
@pytest.mark.usefixtures("own_interrupt")
def test_its_commands_print_what_it_quotes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mechanisms: Any) -> None:
    """In the page's order, in one folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.yaml").write_text(mechanisms.arm_yaml())
    consoles = [block for block in blocks(PAGE) if block.language == "console"]
    typed = [one for block in consoles for one in commands(block.text)]
    assert len(typed) == PAGE.count("\n$ manyhands ") == 7
    for arguments, code, quoted in typed:
        done = manyhands_command(*arguments)
        assert done.exit_code == code, (arguments, done.output)
        assert missing(quoted, done.output) == [], (arguments, done.output)


def test_its_kinematics_are_those_of_a_session(mechanisms: Any, tmp_path: Path) -> None:
    """In place of the lines of arm.yaml that say how a force is held."""
    whole, kinematics = (block.text for block in blocks(PAGE) if block.language == "yaml")
    assert whole == mechanisms.arm_yaml()
    text = mechanisms.arm_yaml(force_held=True)
    assert len(whole.splitlines()) == len(text.splitlines()) + 2
    stated = text.replace("    step:", indent(kinematics, "    ") + "    step:")
    (tmp_path / "chain.yaml").write_text(stated)
    [device] = mh.certify(mh.load(tmp_path / "chain.yaml")).loop.devices
    assert device.held is not None
    assert device.held.linkage is not None
    assert device.held.kappa == pytest.approx(9.15, abs=0.01)


@pytest.mark.long
def test_its_tables_are_those_of_the_program(mechanisms: Any) -> None:
    """Of the slower ones the rows of one device; the rest are other values of the same."""
    tables = dict(TABLE.findall(PAGE))
    assert tables.keys() == mechanisms.TABLES.keys()
    assert {mark: tables[mark] for mark in QUICK} == {mark: mechanisms.TABLES[mark]() for mark in QUICK}
    head, rule, *rows = mechanisms.examples(mechanisms.EXAMPLES[-1:]).splitlines()
    assert tables["examples"].splitlines()[:2] == [head, rule]
    assert tables["examples"].splitlines()[-2:] == rows


def test_every_number_in_its_text_is_one_of_a_block_or_table() -> None:
    computed = TABLE.sub(lambda found: f"<!-- computed by: python -m benchmarks.mechanisms -->\n{found[2]}\n", PAGE)
    computed = re.sub(r"decision \d+", "decision", computed)
    assert unfounded(computed) == []
