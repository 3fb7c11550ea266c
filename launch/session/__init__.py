"""Session files: the one place where the structure of a session is written, read and checked.

``source`` turns YAML into plain data with positions; ``model`` and the parts it is made of turn that into a
:class:`Session` or a :class:`SessionError`. docs/session-file.md is the reference of the format.
"""

from manyhands.launch.session.error import SessionError
from manyhands.launch.session.model import (
    DEFAULT_HAND,
    GROUND,
    RESERVED,
    BlockMatrices,
    CouplingBlock,
    Design,
    Device,
    Hand,
    Link,
    NetworkEnvironment,
    Rational,
    Session,
    TraceData,
    load_session,
)

__all__ = [
    "DEFAULT_HAND",
    "GROUND",
    "RESERVED",
    "BlockMatrices",
    "CouplingBlock",
    "Design",
    "Device",
    "Hand",
    "Link",
    "NetworkEnvironment",
    "Rational",
    "Session",
    "SessionError",
    "TraceData",
    "load_session",
]
