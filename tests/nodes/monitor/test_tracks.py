"""Tracks: the last seconds of every trace in bounded memory, gaps kept as gaps, velocity from every tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from manyhands.nodes.monitor.tracks import Decimated, Floats, Track, TrackKey, Tracks
from manyhands.protocol.messages import Figures, Observation

from ...support.observed_session import ABOUT, UNCERTIFIED


def piece(first: int, *values: float) -> Decimated:
    return Decimated(first, np.array([[[v], [v]] for v in values]))


def drawn(track: Track, since: int = 0) -> tuple[int, list[float]]:
    new = track.since(since)
    return new.first, new.values[:, 0, 0].tolist()


def track_of(tracks: Tracks, name: str) -> Track:
    return next(track for key, track in tracks.items() if key.name == name)


def of_left(tick: int, x: Floats) -> Observation:
    return Observation("left", tick, Figures(), {"x": x[:, None]})


def test_a_ring_keeps_the_latest_and_no_more() -> None:
    track = Track(1, capacity=4)
    for index in range(10):
        track.add(piece(index, float(index)))
    assert drawn(track) == (6, [6.0, 7.0, 8.0, 9.0])
    assert drawn(track, since=8) == (8, [8.0, 9.0])
    assert drawn(track, since=10) == (10, [])


def test_a_piece_longer_than_the_ring_leaves_its_end() -> None:
    track = Track(1, capacity=3)
    track.add(piece(0, *map(float, range(8))))
    assert drawn(track) == (5, [5.0, 6.0, 7.0])


def test_a_gap_is_a_gap() -> None:
    track = Track(1, capacity=6)
    track.add(piece(0, 1.0))
    track.add(piece(3, 4.0))
    first, values = drawn(track)
    assert (first, values[0], values[3]) == (0, 1.0, 4.0)
    assert np.isnan(values[1:3]).all()


def test_a_gap_is_one_where_something_was_before() -> None:
    track = Track(1, capacity=4)
    track.add(piece(0, *map(float, range(6))))
    track.add(piece(8, 8.0))
    first, values = drawn(track)
    assert (first, values[0], values[3]) == (5, 5.0, 8.0)
    assert np.isnan(values[1:3]).all()


@pytest.mark.parametrize("far", [10, 2**62])
def test_a_gap_longer_than_the_ring_begins_it_anew(far: int) -> None:
    track = Track(1, capacity=4)
    track.add(piece(0, 1.0, 2.0))
    track.add(piece(far, 3.0))
    assert drawn(track) == (far, [3.0])


def test_two_parts_of_a_bucket_are_one() -> None:
    track = Track(1, capacity=4)
    track.add(Decimated(2, np.array([[[1.0], [5.0]]])))
    track.add(Decimated(2, np.array([[[9.0], [3.0]], [[7.0], [7.0]]])))
    assert track.since(0).values[:, :, 0].tolist() == [[1.0, 9.0], [7.0, 7.0]]


def test_velocity_is_of_every_tick() -> None:
    tracks = Tracks(ABOUT, window=0.02, buckets=2)  # ten ticks a bucket
    x = np.zeros(20)
    x[13] = 0.001  # one tick: 1 m/s, and back
    tracks.take(of_left(20, x))
    assert track_of(tracks, "left/velocity").since(0).values[1, :, 0].tolist() == pytest.approx([1.0, -1.0])


def test_velocity_continues_across_pieces_but_not_across_a_gap() -> None:
    tracks = Tracks(ABOUT, window=0.01, buckets=10)  # a tick a bucket
    tracks.take(of_left(2, np.array([0.0, 0.001])))
    tracks.take(of_left(4, np.array([0.003, 0.003])))
    tracks.take(of_left(8, np.array([0.1, 0.101])))
    values = track_of(tracks, "left/velocity").since(0).values[:, 0, 0]
    assert values[1:4].tolist() == pytest.approx([1.0, 2.0, 0.0])
    assert np.isnan(values[[0, 4, 5, 6]]).all()
    assert values[7] == pytest.approx(1.0)


def test_velocity_of_a_device_in_wall_time_is_by_the_instants_of_its_samples() -> None:
    tracks = Tracks(ABOUT, window=0.01, buckets=10)  # a tick a bucket
    x = np.array([[0.0], [0.001], [0.002], [0.002]])
    s = np.array([0.2, 1.2, 3.2, 3.2])[:, None] * 1e6  # the third sample came a period late
    for tick, rows in ((2, slice(0, 2)), (4, slice(2, 4))):
        tracks.take(Observation("left", tick, Figures(), {"x": x[rows], "instants": s[rows].repeat(3, axis=1)}))
    values = track_of(tracks, "left/velocity").since(0).values[:, 0, 0]
    assert values[1:3].tolist() == pytest.approx([1.0, 0.5])
    assert np.isnan(values[[0, 3]]).all()


TURNED = replace(ABOUT, hands=("left",))


def test_the_angle_between_a_device_and_its_tool_is_that_of_the_turn() -> None:
    """Of either sign of a quaternion, to the last digits where it is small, and a gap where one is none."""
    tracks = Tracks(TURNED, window=0.01, buckets=10)  # a tick a bucket
    by = [0.0, 1e-9, 0.3, 3.0]
    Q = np.array([[0.5, -0.5, 0.5, 0.5]] * 5)
    R = np.empty((5, 4))
    for row, angle in enumerate([*by, 0.0]):
        c, s = np.cos(angle / 2), np.sin(angle / 2)
        R[row] = [c * 0.5 + s * 0.5, c * -0.5 + s * 0.5, c * 0.5 - s * 0.5, c * 0.5 + s * 0.5]  # turned about x
    R[1::2] *= -1.0
    R[4, 0] = np.inf
    tracks.take(Observation("left", 5, Figures(), {"R": R, "Q": Q}))
    values = track_of(tracks, "left/angle").since(0).values[:, 0, 0]
    assert values[:4].tolist() == pytest.approx(by, rel=1e-6, abs=1e-15)
    assert np.isnan(values[4])
    tracks.take(Observation("left", 10, Figures(), {"Q": Q}))
    assert track_of(tracks, "left/angle").end == 5


def test_of_a_hand_that_turns_what_is_drawn_has_tracks() -> None:
    names = {key.name for key in Tracks(TURNED).columns} - {key.name for key in Tracks(ABOUT).columns}
    told = "environment/told"
    assert names == {told, *(f"left/{topic}" for topic in ("orientation", "proxy", "torque", "account", "angle"))}
    names = {key.name for key in Tracks(replace(TURNED, sensed=("left",))).columns}
    assert names - {key.name for key in Tracks(ABOUT).columns} == {told, "left/orientation"}


def test_a_trace_of_another_shape_is_counted_and_left_out() -> None:
    tracks = Tracks(ABOUT)
    tracks.take(Observation("left", 100, Figures(), {"x": np.zeros((100, 3))}))
    tracks.take(Observation("left", 3, Figures(), {"x": np.zeros((100, 1))}))  # of ticks before the first
    assert tracks.unfit == 2
    assert all(track.end == 0 for _, track in tracks.items())


def test_every_row_of_the_table_and_every_velocity_has_a_track() -> None:
    names = {key.name for key in Tracks(ABOUT).columns}
    assert {"left/sample", "left/velocity", "vl/tool", "environment/tools", "environment/masses"} <= names
    assert "left/ledger" in names
    assert not any("ledger" in key.name for key in Tracks(UNCERTIFIED).columns)
    columns = {key.name: columns for key, columns in Tracks(ABOUT).columns.items()}
    assert columns["right/velocity"] == ("right.x", "right.y")
    assert columns["environment/masses"] == ("ball",)
    assert isinstance(next(iter(Tracks(ABOUT).columns)), TrackKey)


def test_a_node_with_a_period_of_its_own_has_as_many_buckets_a_second() -> None:
    """Four ticks of the left device are one of the session's, and its velocity is by its own period."""
    left = replace(ABOUT.nodes["left"], period=ABOUT.period / 4.0)
    tracks = Tracks(replace(ABOUT, nodes=ABOUT.nodes | {"left": left}))
    plain = Tracks(ABOUT)
    ticks = 10 * plain.size
    tracks.take(of_left(4 * ticks, np.arange(4.0 * ticks)))
    plain.take(of_left(ticks, np.arange(float(ticks))))
    assert (tracks.size, tracks.sizes["left"], tracks.sizes["right"]) == (plain.size, 4 * plain.size, plain.size)
    first, values = drawn(track_of(tracks, "left/sample"))
    assert (first, len(values)) == (0, 10)
    assert values == [4.0 * value for value in drawn(track_of(plain, "left/sample"))[1]]
    velocity = drawn(track_of(tracks, "left/velocity"))[1][1:]
    assert velocity == pytest.approx([4.0 / ABOUT.period] * 9)
