"""What a suite finds: one sentence for each thing that a driver or a model has to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from rich.console import Console

from manyhands.protocol.messages import presentable


class Conformance(StrEnum):
    """What is known of one thing that has to be done."""

    KEPT = "ok"
    BROKEN = "broken"
    OPEN = "not judged"


@dataclass(frozen=True)
class Judgement:
    """One check.

    Attributes:
        check: its name; for a broken one, what is wrong, such as "stale sample".
        verdict: the answer.
        text: what was measured; where it is broken, "found …; expected …".
    """

    check: str
    verdict: Conformance
    text: str

    def as_plain(self) -> dict[str, Any]:
        """As a JSON object."""
        return {"check": self.check, "verdict": self.verdict.value, "text": self.text}


def broken(findings: Iterable[Judgement]) -> list[str]:
    """The names of the checks that are broken, in their order."""
    return [finding.check for finding in findings if finding.verdict is Conformance.BROKEN]


def print_judgements(console: Console, findings: Iterable[Judgement]) -> None:
    """Print one line for each finding."""
    for finding in findings:
        # a text may quote what foreign code has raised
        what = "" if finding.verdict is Conformance.KEPT else f"{finding.check}: "
        line = presentable(f"{finding.verdict.value:>10}  {what}{finding.text}")
        console.print(line, markup=False, highlight=False, soft_wrap=True)
