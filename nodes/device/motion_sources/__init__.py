"""Devices without motors by which a person moves a goal: each kind is a file here, and a line in a table.

A kind is a :class:`manyhands.nodes.device.motion_sources.source.MotionSource`. Its name is a session's ``driver``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from manyhands.nodes.device.motion_sources.gamepad import Gamepad
from manyhands.nodes.device.motion_sources.source import MotionSource
from manyhands.nodes.device.motion_sources.spacemouse import SpaceMouse

MOTION_SOURCES: Final[Mapping[str, type[MotionSource]]] = {"spacemouse": SpaceMouse, "gamepad": Gamepad}
"""The kinds by their names."""
