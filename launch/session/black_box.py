"""An environment that is a model of somebody else's making, and the key by which a session has a level enforced.

The session file only names the model. It is imported by the process that runs as the environment, never by reading,
designing or proving a session.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal, TypeAlias

from pydantic import BeforeValidator, Field

from manyhands.launch.session.error import listed, show
from manyhands.launch.session.fields import Choice, Flag, Problem, Quantity, SessionModel, refusal, refuse, unsymmetric
from manyhands.launch.session.given import OneOrMany, full_matrix, one_or_many
from manyhands.launch.session.limits import MAX_MODEL_NAME
from manyhands.launch.session.matrices import Array
from manyhands.launch.session.source import KeyPath
from manyhands.nodes.environment.model import FACTORY

_LEVEL: Final = Quantity("a level", "N·s/m")


Enforce: TypeAlias = Flag
"""Whether a passivity controller keeps the environment's level at run time."""

ENFORCE_MEANING: Final = "whether a passivity controller keeps its level at run time"


def _factory(value: object) -> str:
    if not isinstance(value, str) or len(value) > MAX_MODEL_NAME or not FACTORY.fullmatch(value):
        raise refuse(show(value), f"package.module:factory, at most {MAX_MODEL_NAME} characters")
    return value


def _plain_problems(value: object, at: KeyPath = ()) -> Iterator[Problem]:
    """What of a value is not plain data: numbers, text, true and false, lists and mappings of them."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _plain_problems(item, (*at, str(key)))
    elif isinstance(value, list | tuple):
        for index, item in enumerate(value):
            yield from _plain_problems(item, (*at, index))
    elif isinstance(value, float) and not math.isfinite(value):
        yield Problem(at, show(value), "a finite number")
    elif not isinstance(value, str | bool | int | float | None):  # nothing at all is told of elsewhere
        yield Problem(at, show(value), "a number, a text, true, false, or a list or mapping of them")


def _parameters(value: object) -> object:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise refuse(show(value), "a mapping from names to values")
    if problems := list(_plain_problems(value)):
        raise refusal(*problems)
    return dict(value)


class PythonEnvironment(SessionModel):
    """A model in Python that says its forces tick by tick; nothing but its declared level is known to the design."""

    type: Annotated[Literal["python"], BeforeValidator(Choice(("python",)))] = Field(
        description="the kind of environment: python"
    )
    model: Annotated[str, BeforeValidator(_factory)] = Field(description="the model's factory, package.module:factory")
    level: Annotated[OneOrMany, one_or_many(_LEVEL)] = Field(
        description="the declared level Phi_E in N·s/m: a number, one for each port, or a matrix"
    )
    enforce: Enforce = Field(default=True, description=ENFORCE_MEANING)
    parameters: Annotated[dict[str, Any], BeforeValidator(_parameters)] = Field(
        default={}, description="plain data, handed to the factory"
    )

    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """Whether the level does not fit a session with these ports."""
        m, level = len(ports), self.level
        rows = level if isinstance(level, tuple) else (level,) * m
        if len(rows) != m or any(isinstance(row, tuple) and len(row) != m for row in rows):
            expected = f"a number, {m} numbers, or {m} rows of {m}, for the ports {listed(ports)}"
            yield Problem(("level",), show(level), expected)
        elif isinstance(rows[0], tuple):
            matrix: Any = rows
            if problem := unsymmetric(matrix):
                yield problem._replace(at=("level", *problem.at))

    def level_matrix(self, ports: int) -> Array:
        """Phi_E, ``ports`` x ``ports``, N·s/m."""
        return full_matrix(self.level, ports)
