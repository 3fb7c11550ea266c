"""When nobody was at the site of a wave link, as the environment recorded it: then its device owes no tick.

The two ends of a wave link count their ticks by their own clocks, and an end may report a little before or after the
other has heard of it. So each absence ends :data:`SLACK` later. It begins :data:`NOTICED` sooner, for a user who is
gone is missed only after a while; ticks that are there are not concerned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from manyhands.nodes.recorder.coverage import Gap
from manyhands.nodes.recorder.format import Recorded
from manyhands.nodes.rows.own_ticks import own_tick, own_tick_before
from manyhands.nodes.rows.tick_events import Kind, events_in

SLACK: Final = 0.25
"""By so much, s, the times differ in which the two ends of a wave link count an absence."""

NOTICED: Final = 5.0
"""Within so much time, s, the environment hears that a user is gone."""


class Away:
    """The absences of the users behind the wave links of one recording."""

    def __init__(self, recorded: Recorded) -> None:
        """No event yet.

        Args:
            recorded: the session of the recording.
        """
        self._recorded = recorded
        self._absences: dict[str, list[Gap]] = {name: [] for name in recorded.linked}
        self._since: dict[str, int] = {}

    def take(self, figures: Mapping[str, float]) -> None:
        """Take the events of one telemetry of the environment; a new process of it begins with nobody there."""
        events = sorted(events_in(figures), key=lambda event: (event.kind is not Kind.BEGAN, event.tick))
        for event in events:
            if event.kind is Kind.BEGAN and event.tick > 0:
                for name in self._absences:
                    self._since.setdefault(name, event.tick)
            elif event.peer not in self._absences:
                continue
            elif event.kind in (Kind.FREE, Kind.FROZEN):
                self._since.setdefault(event.peer, event.tick)
            elif event.kind is Kind.RETURNED and event.peer in self._since:
                self._absences[event.peer].append(Gap(self._since.pop(event.peer), event.tick))

    def of(self, devices: Mapping[str, range]) -> dict[str, Sequence[Gap]]:
        """The absences of each device behind a wave link, by its own ticks.

        Args:
            devices: by device, the span of its own ticks that are looked at.
        """
        before, slack = (round(time / self._recorded.period) for time in (NOTICED, SLACK))
        out: dict[str, Sequence[Gap]] = {}
        for name, found in self._absences.items():
            ports = {*self._recorded.ports[name]}
            for device in (one for one in devices if ports & {*self._recorded.ports[one]}):
                rate, end = self._recorded.rate_of(device), devices[device].stop
                own = [
                    Gap(max(0, own_tick(gap.begin - before, rate)), own_tick_before(gap.end + slack, rate))
                    for gap in found
                ]
                if name in self._since:
                    own.append(Gap(max(0, own_tick(self._since[name] - before, rate)), end))
                out[device] = own
        return out
