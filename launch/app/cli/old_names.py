"""Names of commands and options that have become others: the old ones work until version 0.8, and say the new one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

UNTIL: Final = "0.8"
"""The version in which the old names are gone."""

COMMANDS: Final[Mapping[str, tuple[str, ...]]] = {
    "list": ("top", "--all"),
    "keys": ("invite",),
}
"""By the old name of a command, the words that it is called by now."""

_RUNNING: Final = {"--session": "--running"}

OPTIONS: Final[Mapping[str, Mapping[str, str]]] = {
    "doctor": {"--seconds": "--duration"},
    "echo": _RUNNING,
    "export": {"--to": "--format"},
    "graph": _RUNNING,
    "hz": _RUNNING,
    "keys": {"-o": "--keys"},
    "node": {"--session": "--bundle", "--host": "--address"},
    "plot": {"--to": "--format", "--topics": "--show"},
    "record": _RUNNING,
    "simulate": {"-o": "--record"},
    "top": _RUNNING,
    "view": _RUNNING,
}
"""By the name with which a command was called, the options that have another name now."""


def renewed(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments of the program by their present names, and a sentence for each that has changed.

    Args:
        arguments: a command's name, and what follows.
    """
    name, *rest = arguments
    new = list(COMMANDS.get(name, (name,)))
    said = [_sentence(f"manyhands {name}", f"manyhands {' '.join(new)}")] if name in COMMANDS else []
    options = OPTIONS.get(name, {})
    for at, word in enumerate(rest):
        if word == "--":
            return new + rest[at:], said
        option, sign, value = _split(word)
        if option in options:
            said.append(_sentence(f"{name} {option}", options[option]))
            new += (
                [options[option], value] if sign and not option.startswith("--") else [options[option] + sign + value]
            )
        else:
            new.append(word)
    return new, said


def _split(word: str) -> tuple[str, str, str]:
    """An option, what stands between it and its value, and the value, as far as these are in one word."""
    if word.startswith("--"):
        return word.partition("=")
    if word.startswith("-") and len(word) > 2:
        return word[:2], "=", word[2:]
    return word, "", ""


def _sentence(old: str, new: str) -> str:
    return f"{old} is now {new}; the old name works until version {UNTIL}"
