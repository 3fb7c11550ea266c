"""Whether a session's engine takes its model: tried before anything is started, with this package's engines alone.

The environment's process makes the engine when its peers shake hands. A model that is refused there would end a session
that has begun. Engines of other packages are their authors' code, which no command runs outside that process.
"""

from __future__ import annotations

from manyhands.launch.session import Session
from manyhands.nodes.environment.model import PROXY, make_model


def require_engine(session: Session) -> None:
    """Refuse a session whose model the engine does not take; every other session passes.

    Raises:
        FactoryError: the model is refused, or the engine is not installed.
    """
    if session.environment.tried_first:
        make_model(session.foreign_code["environment.model"], session.ports, session.period, PROXY)
