"""What a session promises; :data:`manyhands.nodes.monitor.health.PROMISES` states each in words."""

from __future__ import annotations

from enum import StrEnum


class Promise(StrEnum):
    """What is promised."""

    CERTIFICATE = "certificate"
    RECORD = "record"
    PASSIVITY = "passivity"
    DRIVER = "driver's word"
    ORIENTATION = "orientation account"
    DELAY = "delay"
    PERIOD = "period"
    LATENESS = "lateness energy"
    INERTIA = "stated inertia"
    SPEED = "proved speed"
    GIVEN = "force given"
    FORCE = "force limits"
    LEVEL = "declared level"
    LINK = "wave link"
    MOTION = "motion limits"
    BUDGET = "energy budget"
    PRESENCE = "presence"
    PUNCTUALITY = "punctuality"
    PACE = "pace"
