"""Session files: the one place where the structure of a session is written, read and checked.

``source`` turns YAML into plain data with positions; ``model`` and the parts it is made of turn that into a
:class:`Session` or a :class:`SessionError`. docs/session-file.md is the reference of the format.
"""

from manyhands.launch.session.black_box import PythonEnvironment
from manyhands.launch.session.design import Design, Pole
from manyhands.launch.session.device import Device
from manyhands.launch.session.environment import (
    GROUND,
    Environment,
    Link,
    NetworkEnvironment,
    StateSpaceEnvironment,
    TransferFunctionEnvironment,
)
from manyhands.launch.session.error import SessionError
from manyhands.launch.session.faults import Faults
from manyhands.launch.session.given import BlockMatrices
from manyhands.launch.session.hand import BROWSER_HAND, DEFAULT_HAND, Hand
from manyhands.launch.session.interval import Interval, LevelInterval
from manyhands.launch.session.model import Session, load_session
from manyhands.launch.session.motion import Motion
from manyhands.launch.session.observers import Observer
from manyhands.launch.session.port_limits import PortLimits
from manyhands.launch.session.rational import Rational
from manyhands.launch.session.structure import ENVIRONMENT, RESERVED, SUPERVISOR, CouplingBlock
from manyhands.launch.session.trace import TraceData
from manyhands.launch.session.weights import Weight, Weights

__all__ = [
    "BROWSER_HAND",
    "DEFAULT_HAND",
    "ENVIRONMENT",
    "GROUND",
    "RESERVED",
    "SUPERVISOR",
    "BlockMatrices",
    "CouplingBlock",
    "Design",
    "Device",
    "Environment",
    "Faults",
    "Hand",
    "Interval",
    "LevelInterval",
    "Link",
    "Motion",
    "NetworkEnvironment",
    "Observer",
    "Pole",
    "PortLimits",
    "PythonEnvironment",
    "Rational",
    "Session",
    "SessionError",
    "StateSpaceEnvironment",
    "TraceData",
    "TransferFunctionEnvironment",
    "Weight",
    "Weights",
    "load_session",
]
