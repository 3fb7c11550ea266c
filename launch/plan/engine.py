"""What a session's engine says of its model before anything is started, with this package's engines alone: whether it
takes it, what it looks like, and what would be better.

The environment's process makes the engine when its peers shake hands. A model that is refused there would end a session
that has begun. Engines of other packages are their authors' code, which no command runs outside that process.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from manyhands.launch.session import Session
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.environment.model import PROXY, make_model
from manyhands.nodes.kernel.factory import FactoryError, FactoryName


def require_engine(session: Session) -> None:
    """Refuse a session whose model the engine does not take; every other session passes.

    Raises:
        FactoryError: the model is refused, or the engine is not installed.
    """
    drawing_of(session)


def drawing_of(session: Session) -> WorldDrawing | None:
    """What the world of a session's engine looks like at its start; None where no engine of this package says it.

    Raises:
        FactoryError: the model is refused, or the engine is not installed.
    """
    return None if (engine := _engine_of(session)) is None else engine.drawing


def engine_lines(session: Session) -> list[str]:
    """One line for each tool that a hand turns and that the engine's model would let swing by itself.

    A model that is refused says nothing here: whoever starts the session is told why.
    """
    try:
        # to make an engine takes a second, and no other model has anything to say
        engine = _engine_of(session) if session.environment.turned else None
    except FactoryError:
        return []
    return [] if engine is None else [f"{session.name}: environment.model: {line}" for line in engine.advice]


@dataclass(frozen=True)
class _Tried:
    """What an engine said when it was made."""

    drawing: WorldDrawing | None
    advice: tuple[str, ...]


def _engine_of(session: Session) -> _Tried | None:
    if not session.environment.tried_first:
        return None
    code = session.foreign_code["environment.model"]
    return _tried(code.factory, json.dumps(code.parameters), code.folder, session.ports, session.period)


@lru_cache(maxsize=1)  # a start asks several times, and an engine of a large model takes long to make
def _tried(factory: str, parameters: str, folder: str, ports: tuple[str, ...], period: float) -> _Tried:
    engine: Any = make_model(FactoryName(factory, json.loads(parameters), folder), ports, period, PROXY)
    drawing: WorldDrawing | None = engine.drawing() if hasattr(engine, "drawing") else None
    return _Tried(drawing, tuple(getattr(engine, "advice", ())))
