"""The unit of a trace: a topic states that of translating axes, and its columns may turn."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from manyhands.design.models.axis import units_by_port, units_of
from manyhands.protocol.channels import Columns, Topic

_OF_AXES = (Columns.PORTS, Columns.MASSES, Columns.LINKED)


def units_of_columns(topic: Topic, columns: Sequence[str], turning: Collection[str]) -> tuple[str, ...]:
    """The unit of each column.

    Args:
        topic: the topic.
        columns: their names.
        turning: the session's ports and bodies that turn.
    """
    if topic.columns not in _OF_AXES:
        return (topic.unit,) * len(columns)
    return tuple(units(topic.unit) for units in units_by_port(columns, turning).values())


def unit_of_all(topic: Topic, columns: Sequence[str], turning: Collection[str]) -> str:
    """The unit of all columns together; arguments are those of :func:`units_of_columns`."""
    if topic.columns not in _OF_AXES:
        return topic.unit
    return units_of(columns, turning)(topic.unit)
