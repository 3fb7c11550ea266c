"""What a design says where floating point ends: one refusal, with the numbers that are too far apart."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from manyhands.design.errors import SolverFailure
from manyhands.design.models.kind import Environment


@contextmanager
def within_floats(environment: Environment) -> Iterator[None]:
    """Turn errors of arithmetic into one refusal.

    Args:
        environment: of the loop; the message names the span of its numbers.

    Raises:
        SolverFailure: in place of a matrix that is singular in floats, an overflow, or a division by zero.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            yield
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        raise SolverFailure(
            f"the numbers are too far apart for floating point ({error}){_spans(environment)}"
        ) from error


def _spans(environment: Environment) -> str:
    """The least and the greatest stiffness of an environment's springs, in words; empty without any."""
    found = sorted(filter(None, environment.stiffnesses))
    return f": the stiffnesses of the environment run from {found[0]:.3g} to {found[-1]:.3g} N/m" if found else ""
