"""An event between two ticks of a node appears once, with its tick, in its telemetry's figures."""

from __future__ import annotations

import math

from manyhands.nodes.rows.tick_events import MOST_EVENTS, Kind, TickEvent, TickEvents, events_in


def test_a_process_reports_the_ticks_of_its_start_and_jumps() -> None:
    events = TickEvents()
    assert [*events_in(events.take(20, 30))] == [TickEvent(Kind.BEGAN, 20, 1)]
    assert events.take(30, 40) == {}  # rows that follow each other
    assert [*events_in(events.take(55, 60))] == [TickEvent(Kind.JUMPED, 55, 40)]


def test_periods_without_force_are_counted_by_the_tick_awaited() -> None:
    events = TickEvents()
    events.take(0, 10)
    for tick in (12, 12, 15):
        events.release(tick)
    assert [*events_in(events.take(10, 20))] == [TickEvent(Kind.RELEASED, 12, 2), TickEvent(Kind.RELEASED, 15, 1)]
    assert events.take(20, 30) == {}  # they are reported once


def test_rungs_and_frozen_couplings_are_reported() -> None:
    events = TickEvents()
    events.take(0, 10)
    events.change_rung(11, 2)
    events.freeze(12, "c.x")
    events.activate(14, "c.x")
    events.begin_free(15, "c.y")
    expected = [
        TickEvent(Kind.RUNG, 11, 2),
        TickEvent(Kind.FROZEN, 12, 1, "c.x"),
        TickEvent(Kind.RETURNED, 14, 1, "c.x"),
        TickEvent(Kind.FREE, 15, 1, "c.y"),
    ]
    assert [*events_in(events.take(10, 20))] == expected


def test_a_device_that_leaves_reports_the_tick_of_the_sample_with_which_it_begins_to() -> None:
    events = TickEvents()
    events.take(0, 10)
    events.leave(14)
    assert [*events_in(events.take(10, 20))] == [TickEvent(Kind.LEAVING, 14, 1)]
    assert [*events_in(events.take(20, 30))] == []


def test_an_environment_that_raises_all_forces_in_every_tick_fits_a_telemetry() -> None:
    events = TickEvents()
    events.take(0, 10)
    for tick in range(10, 10 + 3 * MOST_EVENTS):
        events.raise_again(tick)
    told = events.take(10, 20)
    assert len(told) == MOST_EVENTS
    assert next(events_in(told)) == TickEvent(Kind.RAISED, 10, 1)


def test_releases_of_one_telemetry_are_bounded() -> None:
    events = TickEvents()
    for tick in range(2 * MOST_EVENTS):
        events.release(tick)
    events.release(0)
    released = [event for event in events_in(events.take(0, 1)) if event.kind is Kind.RELEASED]
    assert (len(released), released[0].value) == (MOST_EVENTS, 2)


def test_figures_that_are_no_events_are_passed_over() -> None:
    values = {"released@1": math.nan, "rung@2": math.inf, "rung@3": -1.0, "rung@4": 0.5, "jumped@-5": 1.0}
    assert [*events_in({**values, "released": 3.0, "rung_cx": 1.0, "began@": 1.0, "frozen:@3": 1.0})] == []
