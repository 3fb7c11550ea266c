"""Code of other packages that a session names: the factory of a driver or a model, and the parameters it is given.

A short name stands for the factory that an installed package publishes under it. It is replaced by that factory when
the session file is read, so that a recording, an invitation or a certificate never depends on what is installed where
it is read. Only metadata of packages is read here; no code of theirs runs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from manyhands.launch.session.errors import one_of, show
from manyhands.launch.session.fields import Described, Problem, ValueCheck, refusal, refuse
from manyhands.launch.session.forms import JsonSchema, either
from manyhands.launch.session.limits import MAX_FACTORY_NAME
from manyhands.launch.session.yaml import KeyPath
from manyhands.nodes.kernel.factory import FACTORY, published

_SHORT: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def factory_of(value: object, group: str, words: tuple[str, ...] = ()) -> str:
    """A factory's name, or one of ``words``; a short name becomes the factory that is published under it.

    Args:
        value: as the session has it.
        group: of the entry points, :data:`manyhands.nodes.kernel.factory.DRIVERS` or ``MODELS``.
        words: that stand for no code of another package.
    """
    if isinstance(value, str) and (value in words or (len(value) <= MAX_FACTORY_NAME and FACTORY.fullmatch(value))):
        return value
    form = f"package.module:factory, at most {MAX_FACTORY_NAME} characters"
    if not isinstance(value, str) or not _SHORT.fullmatch(value) or len(value) > MAX_FACTORY_NAME:
        raise refuse(show(value), f"{one_of(words, value)}, or {form}" if words else form)
    short = published(group)
    if value in short:
        return short[value]
    known = (*words, *short)
    installed = f"{one_of(known, value)}, or " if known else ""
    raise refuse(show(value), f"{installed}{form}; an installed package may publish a short name ({group})")


@dataclass(frozen=True, slots=True)
class Factory(ValueCheck):
    """The check of a factory's name by :func:`factory_of`, with the same attributes."""

    group: str
    words: tuple[str, ...] = ()

    @property
    def json_schema(self) -> JsonSchema:
        """A word, a short name that is published here, or a factory's name."""
        name = {"type": "string", "pattern": f"^({FACTORY.pattern})$", "maxLength": MAX_FACTORY_NAME}
        words = [*self.words, *published(self.group)]
        return either({"type": "string", "enum": words}, name) if words else name

    def __call__(self, value: object) -> str:
        """The factory's name, or the word."""
        return factory_of(value, self.group, self.words)


def plain_parameters(value: object) -> dict[str, object]:
    """Plain data for a factory: a mapping from names to numbers, text, booleans, lists and mappings."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise refuse(show(value), "a mapping from names to values")
    if problems := list(_plain_problems(value)):
        raise refusal(*problems)
    return dict(value)


def _plain_problems(value: object, at: KeyPath = ()) -> Iterator[Problem]:
    """A problem for each part of a value that is not plain data."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _plain_problems(item, (*at, str(key)))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _plain_problems(item, (*at, index))
    elif isinstance(value, float) and not math.isfinite(value):
        yield Problem(at, show(value), "a finite number")
    elif not isinstance(value, str | bool | int | float | None):  # nulls_in reports None
        yield Problem(at, show(value), "a number, a text, true, false, or a list or mapping of them")


PARAMETERS: Final = Described(
    plain_parameters,
    {"type": "object", "additionalProperties": {"type": ["number", "string", "boolean", "array", "object"]}},
)
"""The check of parameters, :func:`plain_parameters`."""
