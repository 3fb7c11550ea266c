"""Session files: the one place where the structure of a session is written, read and checked.

``source`` turns YAML into plain data with positions; ``model`` and the parts it is made of turn that into a
:class:`Session` or a :class:`SessionError`. docs/session-file.md is the reference of the format.
"""

from manyhands.launch.session.design import BlockMatrices, Design
from manyhands.launch.session.device import Device
from manyhands.launch.session.error import SessionError
from manyhands.launch.session.hand import DEFAULT_HAND, Hand, Rational
from manyhands.launch.session.model import Session, load_session
from manyhands.launch.session.structure import GROUND, RESERVED, CouplingBlock, Link, NetworkEnvironment
from manyhands.launch.session.trace import TraceData

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
