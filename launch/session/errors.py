"""The one error of session files, and how it words what was found and what would be right."""

import difflib
import re
from collections.abc import Iterable
from typing import Final

_SHOWN_CHARACTERS: Final = 60
_SHOWN_NAMES: Final = 16
_COMPARED_NAMES: Final = 512


class SessionError(Exception):
    """A session file or override cannot be used; the message is one line.

    ``example.yaml:12: devices.dx.mass: found -0.2; expected a mass in kg greater than 0``

    Attributes:
        source: the file, or the ``--set`` that brought the value.
        line: line in the file, from 1; ``None`` for an override, or where the whole file is wrong.
        key: path of the key, such as ``devices.dx.mass``; empty where the whole file is wrong.
        found: what the file has there.
        expected: what would be right.
        more: how many further problems the same file has.

    Example:
        >>> import manyhands as mh
        >>> try:
        ...     mh.load("example1", {"devices.dx.mass": -0.2})
        ... except mh.SessionError as error:
        ...     print(error)
        example-1: devices.dx.mass: found -0.2; expected a mass in kg greater than 0
    """

    def __init__(self, source: str, line: int | None, key: str, found: str, expected: str, more: int = 0) -> None:
        super().__init__(source, line, key, found, expected, more)
        self.source = source
        self.line = line
        self.key = key
        self.found = found
        self.expected = expected
        self.more = more

    def __str__(self) -> str:
        place = self.source if self.line is None else f"{self.source}:{self.line}"
        key = f"{self.key}: " if self.key else ""
        more = f" (and {self.more} more)" if self.more else ""
        return _one_line(f"{place}: {key}found {self.found}; expected {self.expected}{more}")


def _one_line(text: str) -> str:
    """The text with line ends, control characters and lone surrogates written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def show(value: object) -> str:
    """A value as messages show it: short, and in YAML's notation."""
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case float() if value != value:
            return ".nan"
        case float() if value in (float("inf"), float("-inf")):
            return ".inf" if value > 0 else "-.inf"
        case int() | float():
            return repr(value)
        case str():
            return repr(value if len(value) <= _SHOWN_CHARACTERS else value[: _SHOWN_CHARACTERS - 3] + "...")
        case list() | tuple():
            return "an empty list" if not value else f"a list of {len(value)}"
        case dict():
            return "an empty mapping" if not value else f"a mapping of {len(value)}"
        case _:
            return f"a {type(value).__name__}"


def listed(names: Iterable[str]) -> str:
    """Names separated by commas; of more than 16, the first 16 and the number of the others."""
    all_names = list(names)
    shown = ", ".join(all_names[:_SHOWN_NAMES])
    rest = len(all_names) - _SHOWN_NAMES
    return f"{shown} and {rest} more" if rest > 0 else shown or "none"


def one_of(names: Iterable[str], wrong: object) -> str:
    """The valid names, with a suggestion where one of them resembles the ``wrong`` value."""
    all_names = list(names)
    # difflib's time grows with the product of the lengths; no valid name is long
    quick = isinstance(wrong, str) and len(wrong) < 64 and len(all_names) <= _COMPARED_NAMES
    near = difflib.get_close_matches(str(wrong), all_names, n=1) if quick else []
    meant = f" (did you mean {near[0]!r}?)" if near else ""
    return f"one of {listed(all_names)}{meant}" if len(all_names) != 1 else all_names[0]


def key_text(path: Iterable[str | int]) -> str:
    """A path of keys and list positions in the notation of ``--set``: ``environment.links.0.stiffness``."""
    return ".".join(re.sub(r"\s", "_", str(step))[:_SHOWN_CHARACTERS] for step in path)
