"""Session files: the one place where the structure of a session is written, read and checked.

``yaml`` turns YAML into plain data with positions. ``session`` and its parts (``device``, ``environment``, ``design``)
turn these data into a :class:`Session`, or raise a :class:`SessionError`. docs/session-file.md is the reference of the
format.
"""

from manyhands.launch.session.design import BlockMatrices, Design, Pole, Weight, Weights
from manyhands.launch.session.device import BROWSER_HAND, DEFAULT_HAND, PERSONS, SCRIPTED, Device, Hand
from manyhands.launch.session.environment import (
    EngineEnvironment,
    Environment,
    MeshEnvironment,
    ModelEnvironment,
    NetworkEnvironment,
    PythonEnvironment,
    SessionLink,
    StateSpaceEnvironment,
    TransferFunctionEnvironment,
)
from manyhands.launch.session.errors import SessionError
from manyhands.launch.session.fields import Interval, LevelInterval, PortLimits
from manyhands.launch.session.matrices import Rational
from manyhands.launch.session.motion import Motion, TraceData
from manyhands.launch.session.scene import SceneEnvironment
from manyhands.launch.session.session import (
    ENVIRONMENT,
    RESERVED,
    SUPERVISOR,
    CouplingBlock,
    Faults,
    Observer,
    Session,
    load_session,
)
from manyhands.launch.session.wave_link import WaveLink

__all__ = [
    "BROWSER_HAND",
    "DEFAULT_HAND",
    "ENVIRONMENT",
    "PERSONS",
    "RESERVED",
    "SCRIPTED",
    "SUPERVISOR",
    "BlockMatrices",
    "CouplingBlock",
    "Design",
    "Device",
    "EngineEnvironment",
    "Environment",
    "Faults",
    "Hand",
    "Interval",
    "LevelInterval",
    "MeshEnvironment",
    "ModelEnvironment",
    "Motion",
    "NetworkEnvironment",
    "Observer",
    "Pole",
    "PortLimits",
    "PythonEnvironment",
    "Rational",
    "SceneEnvironment",
    "Session",
    "SessionError",
    "SessionLink",
    "StateSpaceEnvironment",
    "TraceData",
    "TransferFunctionEnvironment",
    "WaveLink",
    "Weight",
    "Weights",
    "load_session",
]
