"""The results of a proof: findings, the verdicts that they consist of, and the proof's one error."""

from __future__ import annotations

from dataclasses import dataclass, replace


class ProofInputError(ValueError):
    """The data are no certificate: a key is missing, or its value has the wrong type, shape or size."""


@dataclass(frozen=True)
class Finding:
    """One condition and the result of its proof.

    Attributes:
        condition: the condition, with its number in the paper if it has one.
        holds: whether it is proved. False only means that it is not proved; it may be true nevertheless.
        value: a figure for the reader, in general an approximate least eigenvalue; without a unit, that of the matrix
            scaled to a diagonal of 1. The proof does not rely on it.
        bound: the number that ``value`` had to exceed.
        key: its name among the certificate's margins; empty if it is not a margin.
        argument: why it holds, or why it is not proved.
        enforced: whether it holds because a controller or the proxy test keeps it at run time; then it is not proved
            here.
        assumed: whether another certificate proves it, or the rules of a wave link's face keep it.
    """

    condition: str
    holds: bool
    value: float
    bound: float
    key: str = ""
    argument: str = ""
    enforced: bool = False
    assumed: bool = False

    def about(self, prefix: str) -> Finding:
        """The same finding, with ``prefix`` before its condition."""
        return replace(self, condition=prefix + self.condition)


@dataclass(frozen=True)
class Proof:
    """The findings about one certificate; true if all of them hold.

    Attributes:
        subject: what was proved, for the reader.
        findings: in the order of the proof.
    """

    subject: str
    findings: tuple[Finding, ...]

    @property
    def failing(self) -> tuple[Finding, ...]:
        """The findings that do not hold."""
        return tuple(finding for finding in self.findings if not finding.holds)

    def __bool__(self) -> bool:
        return not self.failing

    def __repr__(self) -> str:
        if not self.failing:
            return f"Proof({self.subject}: proved, {len(self.findings)} findings)"
        first = self.failing[0]
        because = f" ({first.argument})" if first.argument else ""
        return f"Proof({self.subject}: not proved, {first.condition}: found {first.value:.6g}{because})"


@dataclass(frozen=True)
class Verdict:
    """Whether matrices are proved definite.

    Attributes:
        holds: whether they are proved definite.
        least: approximate least eigenvalue, for the reader; never below zero if ``holds``.
        argument: the arithmetic, or the reason of the failure.
    """

    holds: bool
    least: float
    argument: str

    @classmethod
    def of(cls, holds: bool, least: float, argument: str) -> Verdict:
        """A verdict whose figure is rounded so that it does not contradict ``holds``."""
        return cls(holds, max(least, 0.0) if holds else least, argument)

    def finding(self, condition: str, because: str = "") -> Finding:
        """The finding about ``condition``; ``because`` is the reasoning that the arithmetic completes."""
        argument = f"{because}; {self.argument}" if because else self.argument
        return Finding(condition, self.holds, self.least, 0.0, argument=argument)


def weakest(parts: dict[str, Verdict]) -> Verdict:
    """The verdict on all of ``parts``: the first that fails, or else the part nearest to failing.

    Args:
        parts: verdicts by name, at least one.
    """
    for name, part in parts.items():
        if not part.holds:
            return Verdict(False, part.least, f"{name}: {part.argument}")
    name, part = min(parts.items(), key=lambda item: item[1].least)
    arguments = list(dict.fromkeys(p.argument for p in parts.values()))
    return Verdict(True, part.least, f"{'; '.join(arguments)}; nearest to failing: {name}")
