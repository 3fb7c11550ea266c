"""A model of somebody else's making as the environment: how it is named, made, and asked.

A session names a factory, "package.module:function", that is importable where the environment runs. It is called once
with the ports, the period and the session's parameters, and what it returns is asked for forces once a tick.

**It is trusted code.** It runs in the environment's process with that process's rights, and nothing here confines it:
whoever starts a session that names a model runs its code. It is handed no key, no socket and nothing of the session but
what stands in the factory's arguments. What is not trusted is what it computes: an exception, or forces of a wrong
shape, not finite or beyond :data:`MOST_FORCE`, end the session with the model's name, and no such force reaches a port.
A model that does not return holds up its ticks; devices then let go by themselves, as for every environment that is
late.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from manyhands.nodes.lifetime import Stopped

Vector = NDArray[np.float64]

MOST_FORCE = 1e9
"""N; a model's force beyond it is a mistake, and squares of it are still exact enough for a ledger."""

FACTORY = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
"""What the name of a factory looks like: package.module:function."""


class EnvironmentModel(Protocol):
    """What the environment's process asks of a model."""

    def react(self, x_e: Vector, k: int) -> Any:
        """The forces f_v(k) that the model wants to exert on the hands, N.

        Args:
            x_e: where the tools are going to be at this tick, m, one entry a port: p + D_V f_v(k-1). The
                model's to keep.
            k: the tick, counted from 0 since the model was made.

        Returns:
            One number a port, anything that numpy makes m finite floats of. A spring of stiffness c to the origin
            returns -c * x_e.
        """
        ...


class ModelError(ValueError):
    """A model cannot be made; names it and says what is wrong."""


class ModelFailure(Exception):
    """A model gave no usable answer; names it and says at which tick, what was found, and what would be right."""


@dataclass(frozen=True)
class ModelName:
    """Which model a session wants.

    Attributes:
        factory: "package.module:function".
        parameters: handed to it, plain data.

    Raises:
        ValueError: the factory's name does not have that form.
    """

    factory: str
    parameters: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not FACTORY.fullmatch(self.factory):
            raise ValueError(f"found the model {self.factory!r:.80}; expected package.module:factory")


def make_model(name: ModelName, ports: tuple[str, ...], T: float) -> EnvironmentModel:
    """Import a factory and have it make the model of these ports with the period T (s).

    Raises:
        ModelError: it cannot be imported, it fails, or what it makes cannot be asked.
    """
    module, _, function = name.factory.partition(":")
    try:
        factory = getattr(importlib.import_module(module), function)
        model = factory(ports, T, dict(name.parameters))
    except Stopped:
        raise  # somebody ends the process meanwhile
    except (Exception, SystemExit) as error:  # foreign code: whatever it raises is told, with its name
        raise ModelError(
            f"the model {name.factory} cannot be made: found {_told(error)}; expected a factory of (ports, period, "
            "parameters) on Python's import path"
        ) from error
    if not callable(getattr(model, "react", None)):
        raise ModelError(
            f"the model {name.factory} cannot be asked: found {type(model).__name__}; expected an object with "
            "react(x_e, k)"
        )
    made: EnvironmentModel = model
    return made


class AskedModel:
    """A model and the checks on what it answers.

    Attributes:
        failure: what was wrong with its first bad answer; it is not asked again.
    """

    def __init__(self, name: str, model: EnvironmentModel, ports: tuple[str, ...]) -> None:
        """Ask ``model``, called ``name``."""
        self._name, self._ports = name, ports
        self._react: Callable[[Vector, int], Any] = model.react
        self._none = np.zeros(len(ports))
        self.failure: str | None = None

    def forces(self, x_e: Vector, k: int) -> Vector:
        """The model's forces at x_e, m, which is the model's from now on; N, zero once it has failed."""
        if self.failure is not None:
            return self._none
        try:
            # a copy of m numbers: the model may change what it has returned
            f = np.array(self._react(x_e, k), dtype=np.float64)
        except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code: no exception of its may end the loop unnamed
            return self._failed(k, _told(error), "forces in N")
        m = len(self._ports)
        if f.shape != (m,):
            return self._failed(k, f"an answer of the shape {f.shape}", f"{m} forces, one a port")
        # also refuses what is not a number
        if not np.abs(f).max() <= MOST_FORCE:
            port = int(np.argmin(np.abs(f) <= MOST_FORCE))
            found = f"a force of {f[port]:g} N at {self._ports[port]}"
            return self._failed(k, found, f"a finite number of at most {MOST_FORCE:g} N in size")
        return f

    def _failed(self, k: int, found: str, expected: str) -> Vector:
        self.failure = f"the model {self._name} failed at tick {k}: found {found}; expected {expected}; mend the model"
        return self._none


def _told(error: BaseException) -> str:
    """An exception in a line of bounded length; its text is the model's, and may be anything."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 -- a text that cannot be made must not hide that there was an error
        text = "without a text"
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__
