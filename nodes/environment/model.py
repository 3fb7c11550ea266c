"""A user's own model as the environment: how it is made, and how it is asked for forces.

A session names the model's factory (:mod:`manyhands.nodes.factory`). The environment's process calls it once, and asks
the model that it returns for forces once a tick.

**The model is trusted code.** It runs in the environment's process with that process's rights, and nothing here
confines it: to start a session that names a model is to run the model's code. It receives no key and no socket, and of
the session only the factory's arguments.

**The forces of the model are not trusted.** An exception ends the session with the model's name. So do forces of a
wrong shape, not finite, or beyond :data:`MOST_FORCE`, and no such force reaches a port. A model that does not return
holds up its ticks; devices then let go by themselves, as for every environment that is late.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.factory import FactoryError, FactoryName, in_one_line, made_by

Vector = NDArray[np.float64]

MOST_FORCE = 1e9
"""The greatest force of a model, N. Beyond it a force is a mistake; its square is still exact enough for a ledger."""


class EnvironmentModel(Protocol):
    """The interface of a model."""

    def react(self, x_e: Vector, k: int) -> Any:
        """The forces f_v(k) that the model wants to exert on the hands, N.

        Args:
            x_e: the predicted tool positions of this tick, p + D_V f_v(k-1), m, one entry for each port. The model may
                keep the array.
            k: the tick, counted from 0 since the model was made.

        Returns:
            One number for each port, in any form that numpy converts to m finite floats. A spring of stiffness c to
            the origin returns -c * x_e.
        """
        ...


class ModelFailure(Exception):
    """A model gave no usable answer; the message names it, the tick, what was found and what was expected."""


def make_model(name: FactoryName, ports: tuple[str, ...], T: float) -> EnvironmentModel:
    """Import a factory and call it for the model of these ports with the period T (s).

    Raises:
        FactoryError: the factory cannot be imported or fails, or its result has no method ``react``.
    """
    model = made_by(name, "model", ports, T)
    if not callable(getattr(model, "react", None)):
        raise FactoryError(
            f"the model {name.factory} cannot be asked: found {type(model).__name__}; expected an object with "
            "react(x_e, k)"
        )
    made: EnvironmentModel = model
    return made


class AskedModel:
    """A model and the checks on its answers.

    Attributes:
        failure: what was wrong with its first bad answer, after which it is not asked again; None before.
    """

    def __init__(self, name: str, model: EnvironmentModel, ports: tuple[str, ...]) -> None:
        """Ask ``model``, which messages call ``name``, for the forces at ``ports``."""
        self._name, self._ports = name, ports
        self._react: Callable[[Vector, int], Any] = model.react
        self._none = np.zeros(len(ports))
        self.failure: str | None = None

    def forces(self, x_e: Vector, k: int) -> Vector:
        """The model's forces at x_e, N; zero once it has failed. The model may keep the array ``x_e``, m."""
        if self.failure is not None:
            return self._none
        try:
            # a copy: the model may change the array that it has returned
            f = np.array(self._react(x_e, k), dtype=np.float64)
        except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code: no exception of its may end the loop unnamed
            return self._failed(k, in_one_line(error), "forces in N")
        m = len(self._ports)
        if f.shape != (m,):
            return self._failed(k, f"an answer of the shape {f.shape}", f"{m} forces, one a port")
        # written with not: a comparison with NaN is false, so NaN is refused as well
        if not np.abs(f).max() <= MOST_FORCE:
            port = int(np.argmin(np.abs(f) <= MOST_FORCE))
            found = f"a force of {f[port]:g} N at {self._ports[port]}"
            return self._failed(k, found, f"a finite number of at most {MOST_FORCE:g} N in size")
        return f

    def _failed(self, k: int, found: str, expected: str) -> Vector:
        self.failure = f"the model {self._name} failed at tick {k}: found {found}; expected {expected}; mend the model"
        return self._none
