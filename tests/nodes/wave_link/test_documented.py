"""What docs/remote/law.md shows of the faces is what they do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "docs" / "remote" / "law.md"


def test_the_pages_python_prints_its_quoted_output(capsys: pytest.CaptureFixture[str]) -> None:
    section = PAGE.read_text(encoding="utf-8").split("## Both ends in a few lines\n")[1]
    code, quoted = re.findall(r"```(?:python)?\n(.*?)```", section, flags=re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == quoted
