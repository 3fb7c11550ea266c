"""What a proof says: findings, the verdicts that they are made of, and the one error."""

from __future__ import annotations

from dataclasses import dataclass


class ProofInputError(ValueError):
    """The data are no certificate: a key is missing, or is not of the type, shape or size that it must be."""


@dataclass(frozen=True)
class Finding:
    """One condition and how it came out.

    Attributes:
        condition: what was to be proved, with its number in the paper where it has one.
        holds: whether it is proved. False says no more than that it is not.
        value: the figure to read: in general an approximate least eigenvalue, that of a matrix scaled to a diagonal
            of 1 where no unit is named. The proof does not rest on it.
        bound: what ``value`` had to exceed.
        key: its name among the certificate's margins; empty when it is not a margin.
        argument: by which reasoning it holds, or why it is not proved.
        enforced: whether it holds because a controller keeps it at run time; then nothing is proved about it here.
    """

    condition: str
    holds: bool
    value: float
    bound: float
    key: str = ""
    argument: str = ""
    enforced: bool = False


@dataclass(frozen=True)
class Verdict:
    """Whether matrices are proved definite.

    Attributes:
        holds: whether they are.
        least: approximate least eigenvalue, for the reader; never below zero when ``holds``.
        argument: the arithmetic, or what failed.
    """

    holds: bool
    least: float
    argument: str

    @classmethod
    def of(cls, holds: bool, least: float, argument: str) -> Verdict:
        """A verdict whose figure does not contradict it by rounding."""
        return cls(holds, max(least, 0.0) if holds else least, argument)

    def finding(self, condition: str, because: str = "") -> Finding:
        """The finding about ``condition``; ``because`` is the reasoning that the arithmetic completes."""
        argument = f"{because}; {self.argument}" if because else self.argument
        return Finding(condition, self.holds, self.least, 0.0, argument=argument)


def weakest(parts: dict[str, Verdict]) -> Verdict:
    """All of ``parts`` by name: the first that fails, or the one nearest to failing.

    Args:
        parts: at least one.
    """
    for name, part in parts.items():
        if not part.holds:
            return Verdict(False, part.least, f"{name}: {part.argument}")
    name, part = min(parts.items(), key=lambda item: item[1].least)
    arguments = list(dict.fromkeys(p.argument for p in parts.values()))
    return Verdict(True, part.least, f"{'; '.join(arguments)}; nearest to failing: {name}")
