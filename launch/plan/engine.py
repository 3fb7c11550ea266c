"""What a session's engine says of its model before anything is started, with this package's engines alone: whether it
takes it, and what it looks like.

The environment's process makes the engine when its peers shake hands. A model that is refused there would end a session
that has begun. Engines of other packages are their authors' code, which no command runs outside that process.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Any

from manyhands.launch.session import Session
from manyhands.nodes.environment.drawing import WorldDrawing
from manyhands.nodes.environment.model import PROXY, make_model
from manyhands.nodes.kernel.factory import FactoryName


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
    if not session.environment.tried_first:
        return None
    code = session.foreign_code["environment.model"]
    return _drawing(code.factory, json.dumps(code.parameters), code.folder, session.ports, session.period)


@lru_cache(maxsize=1)  # a start asks twice, and an engine of a large model takes long to make
def _drawing(factory: str, parameters: str, folder: str, ports: tuple[str, ...], period: float) -> WorldDrawing | None:
    engine: Any = make_model(FactoryName(factory, json.loads(parameters), folder), ports, period, PROXY)
    drawing: WorldDrawing | None = engine.drawing() if hasattr(engine, "drawing") else None
    return drawing
