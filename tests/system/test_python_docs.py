"""docs/python.md is executed: every block prints the output shown, and it introduces every name of the package."""

from __future__ import annotations

import doctest
import importlib.util
from pathlib import Path

import pytest

import manyhands as mh

from .test_design_docs import FLAGS, blocks

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_every_block_prints_its_quoted_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_pandas = importlib.util.find_spec("pandas") is not None
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
    names: dict[str, object] = {}
    wrong: list[str] = []
    found = list(blocks(PAGE.read_text(encoding="utf-8")))
    assert len(found) >= 10, "the page has lost its blocks"
    for block in found:
        where = f"docs/python.md:{block.line}"
        if "to_pandas" in block.text and not with_pandas:
            continue  # the only optional library of the page
        assert block.language == "python", f"{where}: nothing checks a block of {block.language!r}"
        examples = doctest.DocTestParser().get_doctest(block.text, names, where, str(PAGE), block.line)
        assert examples.examples, f"{where}: a block without an example"
        runner.run(examples, out=wrong.append, clear_globs=False)
        names = examples.globs
    assert not wrong, "\n".join(wrong)


def test_the_page_introduces_every_name() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [name for name in mh.__all__ if f"mh.{name}" not in text] == []
