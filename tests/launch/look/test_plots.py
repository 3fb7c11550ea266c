"""Pictures of recordings: the contents of each panel, every extreme kept, and the refusals."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.axes import Axes
from typer.testing import CliRunner

from manyhands.launch.app.cli import app
from manyhands.launch.audit.simulation import simulate
from manyhands.launch.files import TargetError
from manyhands.launch.look import figures
from manyhands.launch.look.figures import require_picture, save
from manyhands.launch.look.plots import (
    MOST_LINES,
    MOST_MARKS_LISTED,
    QUANTITIES,
    Mark,
    NotDrawable,
    Picture,
    between,
    figure_of,
    label,
    marks_of,
    picture_of_recording,
    picture_of_run,
    plain,
)
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.recordings.curves import COLUMNS, Curve, Panel, alone, backward_difference, band, gaps, thinned
from manyhands.launch.recordings.formats import SUFFIXES
from manyhands.launch.recordings.recording import Recording
from manyhands.launch.recordings.run import RecordedRun, RecordedTrace
from manyhands.launch.run.states import MOST_KEPT, Happenings, Incidents
from manyhands.nodes.recorder.core import RecorderCore
from manyhands.nodes.recorder.format import CERTIFICATE_FILE, Recorded
from manyhands.protocol.channels import TOPICS, links_at, topics_of
from manyhands.protocol.codec import encode
from manyhands.protocol.messages import Condition, Figures, Observation, Role
from tests.support.slot import session

PERIOD = 1e-3
Array = np.ndarray


def of_users(
    count: int,
    ticks: int,
    clock: str = "realtime",
    ledgers: bool = True,
    wall: bool = False,
    linked: bool = False,
    oriented: tuple[str, ...] = (),
    **more: object,
) -> RecordedRun:
    """A run of ``count`` users, every trace its own wave."""
    names = [f"u{i}" for i in range(count)]
    roles = {**{f"d-{n}": Role.DEVICE for n in names}, **{f"c-{n}": Role.COUPLING for n in names}}
    roles["environment"] = Role.ENVIRONMENT
    ports = {node: (node[2:],) if node != "environment" else tuple(names) for node in roles}
    couplings = tuple(f"c-{n}" for n in names) if linked else ()
    time = np.arange(ticks) * PERIOD
    traces = {}
    for number, (node, role) in enumerate(roles.items()):
        links = links_at(node, role, ports, couplings)
        for topic in topics_of(role, ("hub",), wall, bool(links), oriented=oriented):
            if (topic.name == "ledger" and not ledgers) or (topic.name == "tau" and clock != "realtime"):
                continue
            columns = topic.columns_of(ports[node], ("hub",), links, oriented)
            waves = [np.sin((1 + number + 0.1 * i) * time) for i in range(len(columns))]
            values = np.stack(waves, axis=1) if topic.name != "tau" else 300.0 + 10.0 * waves[0][:, None]
            traces[node, topic.name] = RecordedTrace(topic, columns, values)
    recorded = Recorded("study", "0123456789abcdef", PERIOD, clock, roles, ports, linked=couplings, oriented=oriented)
    return RecordedRun(recorded, traces, **more)  # type: ignore[arg-type]  # as each test wants it


def titles(axes: Sequence[Axes]) -> list[str]:
    return [one.get_title(loc="left") for one in axes]


def line(axes: Axes, name: str) -> tuple[Array, Array]:
    (found,) = [one for one in axes.get_lines() if one.get_label() == name]
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def legend(axes: Axes) -> list[str]:
    shown = axes.get_legend()
    assert shown is not None
    return [text.get_text() for text in shown.get_texts()]


class TestThinning:
    def test_few_ticks_are_all_drawn(self) -> None:
        values = np.sin(np.arange(4.0 * COLUMNS))
        np.testing.assert_array_equal(thinned(values), np.arange(4 * COLUMNS))

    @pytest.mark.parametrize("ticks", [5 * COLUMNS, 12_345, 100_003])
    @pytest.mark.parametrize("seed", range(3))
    def test_of_many_every_columns_extremes_ends_and_gaps_are_kept(self, ticks: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        values = rng.normal(size=ticks)
        values[rng.integers(ticks, size=20)] = np.nan
        values[3000:4500] = np.nan  # some columns know nothing
        shown = thinned(values)
        assert len(shown) <= 5 * COLUMNS
        assert np.all(np.diff(shown) > 0)
        size = -(-ticks // COLUMNS)
        for start in range(0, ticks, size):
            every = values[start : start + size]
            kept = values[shown[(shown >= start) & (shown < start + size)]]
            np.testing.assert_array_equal(kept[[0, -1]], every[[0, -1]])
            assert np.isnan(kept).any() == np.isnan(every).any()
            known, left = every[~np.isnan(every)], kept[~np.isnan(kept)]
            if len(known):
                assert (left.min(), left.max()) == (known.min(), known.max())

    @pytest.mark.parametrize("ticks", [3, 5000, 12_345])
    def test_a_band_reaches_every_curve(self, ticks: int) -> None:
        rng = np.random.default_rng(7)
        every = rng.normal(size=(5, ticks))
        every[:, 2] = np.nan if ticks > 3 else 0.0
        every[0, ticks // 2] = 30.0
        starts, least, greatest = band([Curve("", values) for values in every])
        assert len(starts) <= COLUMNS + 1
        for values in every:
            at = np.searchsorted(starts[:-1], np.arange(ticks), side="right") - 1
            known = ~np.isnan(values)
            assert np.all(values[known] <= greatest[at][known])
            assert np.all(values[known] >= least[at][known])
        assert np.nanmax(greatest) == 30.0
        assert (starts[-1], greatest[-1]) == (ticks - 1, greatest[-2])

    def test_gaps_of_any_curve_are_joined_where_no_pixel_lies_between(self) -> None:
        one, other = np.zeros(3 * COLUMNS), np.zeros(3 * COLUMNS)
        one[10:20], one[22:30], other[100:], other[0] = np.nan, np.nan, np.nan, np.nan
        assert gaps([Curve("", one), Curve("", other)]) == [(0, 1), (10, 30), (100, 3 * COLUMNS)]
        assert gaps([]) == []
        assert gaps([Curve("", np.zeros(3))]) == []

    def test_a_tick_between_gaps_is_seen_to_be_alone(self) -> None:
        nan = np.nan
        assert alone(np.array([1.0, nan, 2.0, nan, 3.0, 4.0])).tolist() == [True, False, True, False, False, False]

    def test_a_velocity_begins_at_rest_and_knows_nothing_beside_a_gap(self) -> None:
        found = backward_difference(np.array([[0.1], [0.3], [np.nan], [0.5], [0.4]]), 0.1)
        np.testing.assert_allclose(found, np.array([[1.0], [2.0], [np.nan], [np.nan], [-1.0]]))

    def test_a_velocity_in_wall_time_is_by_the_instants_of_the_samples(self) -> None:
        run, device = of_users(2, 40, wall=True), "d-u0"
        late = 1e9 * PERIOD * np.arange(40.0)
        late[20:] += 1e9 * PERIOD  # sample 20 came a period late
        run.traces[device, "instants"].values[:] = late[:, None]
        (panel,) = picture_of_run(run, ["velocity"]).panels
        of = {curve.label: curve.values for curve in panel.curves}
        expected = np.diff(run.traces[device, "sample"].values[:, 0], prepend=np.nan) / PERIOD
        expected[20] /= 2.0
        np.testing.assert_allclose(of["u0"], expected)


FOR_THE_AUDIT = {"instants", "applied", "work", "proposed", "heard", "told"}
OF_HANDS = ("orientation", "proxy", "angle", "torque", "account")


class TestPictures:
    def test_what_is_shown_where_nothing_is_asked_for(self) -> None:
        certificate = json.dumps({"tau": 0.00031}).encode()
        run = of_users(2, 500, attachments={CERTIFICATE_FILE: certificate})
        figure = figure_of(picture_of_run(run))
        x, v, f, ledgers, tau = figure.axes
        assert [one.get_ylabel() for one in figure.axes] == ["x [m]", "velocity [m/s]", "f_v [N]", "E [J]", "ticks"]
        assert "positions" in titles([x])[0]
        assert legend(x) == legend(v) == legend(f) == ["u0", "u1"]
        assert legend(ledgers) == ["d-u0", "d-u1", "c-u0", "c-u1", "environment"]
        time, values = line(x, "u1")
        np.testing.assert_array_equal(values, run.traces["d-u1", "sample"].values[:, 0])
        np.testing.assert_allclose(time, np.arange(500) * PERIOD)
        np.testing.assert_array_equal(line(v, "u1")[1][1:], np.diff(values) / PERIOD)
        assert x.get_shared_x_axes().joined(x, ledgers)
        assert not x.get_shared_x_axes().joined(x, tau)
        assert ledgers.get_xlabel() == "time [s]"
        assert x.get_xlabel() == ""
        assert figure.get_suptitle() == "study, realtime clock, certificate 0123456789ab, 500 ticks, 0.5 s"

    def test_the_delays_with_their_limits(self) -> None:
        run = of_users(2, 500, attachments={CERTIFICATE_FILE: b'{"tau": 0.000305}'})
        run.traces["d-u0", "tau"].values[7] = 1500.0
        run.traces["d-u1", "tau"].values[8] = np.nan
        tau = figure_of(picture_of_run(run)).axes[-1]
        every = np.concatenate([run.traces[f"d-u{i}", "tau"].values[:, 0] for i in range(2)])
        every = every[~np.isnan(every)]
        counts = sum(patch.get_data().values.sum() for patch in tau.patches)  # type: ignore[attr-defined]
        assert counts == len(every) == 999
        assert "greatest 1500" in tau.get_title(loc="left")
        certified, period = legend(tau)[-2:]
        assert certified == f"τ of the certificate, 305 µs:\n{np.mean(every > 305.0):.2%} above"
        assert period == "period T, 1000 µs:\n0.10% above"
        assert line(tau, certified)[0][0] == pytest.approx(305.0)
        assert line(tau, period)[0][0] == pytest.approx(1000.0)
        assert tau.get_xlim()[0] < every.min() <= every.max() < tau.get_xlim()[1]

    @pytest.mark.parametrize(
        ("attached", "words"),
        [
            ({CERTIFICATE_FILE: b'{"tau": 0.0}'}, "τ of the certificate, 0 µs:\nall above"),
            ({CERTIFICATE_FILE: b'{"tau": "short"}'}, None),
            ({CERTIFICATE_FILE: b"no JSON"}, None),
            ({CERTIFICATE_FILE: b"[" * 100_000}, None),
            ({}, None),
        ],
    )
    def test_a_certificate_without_a_tau_to_draw(self, attached: Mapping[str, bytes], words: str | None) -> None:
        found = legend(figure_of(picture_of_run(of_users(1, 50, attachments=attached))).axes[-1])
        assert (words in found) if words else not any("certificate" in text for text in found)

    def test_simulated_and_uncertified_runs_have_fewer_panels(self) -> None:
        run = of_users(1, 50, clock="simulated", ledgers=False)
        assert [panel.name for panel in picture_of_run(run).panels] == ["sample", "velocity", "force"]
        assert picture_of_run(run).delays is None

    def test_what_was_never_recorded_is_not_shown(self) -> None:
        run = of_users(1, 50)
        for (_, name), trace in run.traces.items():
            if name == "ledger":
                trace.values[:] = np.nan
        assert "ledger" not in [panel.name for panel in picture_of_run(run).panels]

    def test_every_topic_of_the_table_can_be_asked_for(self) -> None:
        names = {topic.name for topics in TOPICS.values() for topic in topics}
        assert {*QUANTITIES} == names - FOR_THE_AUDIT | {"velocity", "angle"}
        picture = picture_of_run(
            of_users(1, 50, wall=True, linked=True, oriented=("hub",)),
            [name for name in reversed(QUANTITIES) if name not in OF_HANDS],
        )
        assert [panel.name for panel in picture.panels] == [
            name for name in QUANTITIES if name != "tau" and name not in OF_HANDS
        ]
        assert picture.delays is not None
        labels = {panel.name: [curve.label for curve in panel.curves] for panel in picture.panels}
        assert labels["masses"] == ["hub"]
        assert labels["orientations"] == ["hub.qw", "hub.qx", "hub.qy", "hub.qz"]
        assert labels["tool"] == ["u0", "environment u0"]
        assert labels["tank"] == ["c-u0.L", "c-u0.G", "c-u0.H", *(f"environment c-u0.{figure}" for figure in "LGH")]

    def test_an_orientation_is_drawn_with_the_angle_to_its_tool(self) -> None:
        pytest.importorskip("mujoco")
        run = simulate(prepare(session(), None), 300)
        panels = {panel.name: panel for panel in picture_of_run(run, OF_HANDS).panels}
        assert [*panels] == [*OF_HANDS]
        assert [curve.label for curve in panels["torque"].curves] == ["pen.x", "pen.y", "pen.z"]
        (angle,) = panels["angle"].curves
        assert angle.label == "pen"
        torque = np.linalg.norm([curve.values for curve in panels["torque"].curves], axis=0)
        assert 0.3 * np.sin(angle.values) == pytest.approx(torque, abs=1e-12)

    @pytest.mark.parametrize(
        ("wanted", "words"),
        [
            (["speed"], "found 'speed'; expected some of sample, velocity"),
            (["ledger"], "found 'ledger', which is not recorded; expected some of sample, velocity, force"),
            (["tau"], "under the simulated clock; expected one in real time"),
        ],
    )
    def test_what_is_not_there_is_refused(self, wanted: list[str], words: str) -> None:
        with pytest.raises(NotDrawable, match=words):
            picture_of_run(of_users(1, 50, clock="simulated", ledgers=False), wanted)

    def test_a_recording_without_ticks_is_refused(self) -> None:
        with pytest.raises(NotDrawable, match="without a tick"):
            picture_of_run(of_users(1, 0))

    def test_a_part_of_the_time(self) -> None:
        run = of_users(1, 500, conditions=[(k, Condition("running", 0.0, {}, (), (f"at {k}",))) for k in (1, 200, 400)])
        picture = between(picture_of_run(run), 0.1, 0.3)
        figure = figure_of(picture)
        time, values = line(figure.axes[0], "u0")
        assert (time[0], time[-1], len(time)) == (pytest.approx(0.1), pytest.approx(0.3), 201)
        np.testing.assert_array_equal(values, run.traces["d-u0", "sample"].values[100:301, 0])
        whole, part = picture_of_run(run).panels[1].curves[0].values, picture.panels[1].curves[0].values
        np.testing.assert_array_equal(part, whole[100:301])  # a velocity does not begin anew
        assert [mark.text for mark in picture.marks] == ["at 200"]
        assert picture.delays is not None
        assert len(picture.delays.curves[0].values) == 201

    @pytest.mark.parametrize(
        ("start", "end", "words"),
        [
            (0.5, None, "--from: found 0.5 s; expected at most 0.499 s"),
            (0.3, 0.2, "--until: found 0.2 s; expected more than --from, 0.3 s"),
            (-1.0, None, "--from: found -1 s; expected 0 or more"),
            (None, float("nan"), "--until: found nan s; expected 0 or more"),
        ],
    )
    def test_times_that_are_none(self, start: float | None, end: float | None, words: str) -> None:
        with pytest.raises(NotDrawable, match=words):
            between(picture_of_run(of_users(1, 500)), start, end)

    def test_what_is_new_in_each_condition_is_a_mark(self) -> None:
        def told(notices: tuple[str, ...], incidents: tuple[str, ...], faults: tuple[str, ...] = ()) -> Condition:
            return Condition("running", 0.0, {}, (), notices, incidents, faults)

        conditions = [
            (0, told((), ())),
            (100, told(("clipped",), ("lost",))),
            (200, told(("clipped",), ("lost", "lost"))),  # the same once more
            (300, told(("clipped",), ("2 earlier incidents", "back"), ("broken",))),
        ]
        assert marks_of(conditions, PERIOD) == (
            Mark(0.1, "clipped"),
            Mark(0.1, "lost"),
            Mark(0.2, "lost"),
            Mark(0.3, "back"),
            Mark(0.3, "broken"),
        )

    @pytest.mark.parametrize("happened", [Incidents(), Happenings("visits")], ids=["incidents", "visits"])
    def test_a_summary_of_what_happened_has_no_mark(self, happened: Happenings) -> None:
        for number in range(MOST_KEPT + 3):
            happened.add(f"number {number}")
        field = {happened.what: happened.sentences}
        condition = replace(Condition("running", 0.0, {}), **field)
        assert len(marks_of([(0, condition)], PERIOD)) == MOST_KEPT


class TestFigures:
    def test_a_spike_of_one_tick_in_a_long_run_is_drawn(self) -> None:
        run = of_users(1, 200_000)
        run.traces["d-u0", "force"].values[123_457] = 30.0
        time, values = line(figure_of(picture_of_run(run)).axes[2], "u0")
        assert len(values) <= 5 * COLUMNS
        assert values.max() == 30.0
        assert time[values.argmax()] == pytest.approx(123.457)

    def test_a_gap_is_drawn_and_reported(self) -> None:
        run = of_users(1, 50_000)
        run.traces["d-u0", "sample"].values[20_000:20_400] = np.nan
        axes = figure_of(picture_of_run(run)).axes[0]
        time, values = line(axes, "u0")
        assert not np.any((time > 20.0) & (time < 20.4) & ~np.isnan(values))
        assert np.isnan(values).any()
        assert "not recorded" in legend(axes)
        (shade,) = axes.collections
        (box,) = [path.get_extents() for path in shade.get_paths()]
        assert (box.x0, box.x1) == (pytest.approx(20.0), pytest.approx(20.4))

    def test_a_tick_alone_is_a_dot(self) -> None:
        run = of_users(1, 50)
        values = run.traces["d-u0", "sample"].values
        values[10:20] = np.nan
        values[15] = 0.7
        axes = figure_of(picture_of_run(run)).axes[0]
        (dots,) = [one for one in axes.get_lines() if one.get_marker() == "."]
        assert np.asarray(dots.get_ydata()).tolist() == [0.7]

    def test_many_ports_are_a_band_and_the_farthest(self) -> None:
        run = of_users(MOST_LINES + 1, 3000)
        run.traces["d-u5", "force"].values[1234] = -9.0
        x, _, force, _, tau = figure_of(picture_of_run(run)).axes
        assert legend(force) == [f"all {MOST_LINES + 1}, from the\nleast to the greatest", "u5, the farthest"]
        assert line(force, "u5, the farthest")[1].min() == -9.0
        assert force.collections[0].get_paths()[0].get_extents().y0 == -9.0
        assert legend(tau)[0] == f"all {MOST_LINES + 1} devices"
        few = figure_of(picture_of_run(of_users(MOST_LINES, 300))).axes[0]
        assert legend(few) == [f"u{i}" for i in range(MOST_LINES)]
        looks = {(one.get_color(), one.get_linestyle()) for one in few.get_lines()}
        assert len(looks) == MOST_LINES
        assert len(x.get_lines()) == 1

    def test_marks_are_lines_with_numbers_and_a_list(self) -> None:
        marks = (Mark(0.1, "first"), Mark(0.4, "second"), Mark(0.401, "third costs $5, not $6"))
        picture = picture_of_run(of_users(1, 500))
        figure = figure_of(Picture(picture.title, PERIOD, 0, 500, picture.panels, marks=marks))
        top, *_, told = figure.axes
        assert [text.get_text() for text in top.texts] == ["1", "2–3"]
        for axes in figure.axes[:-1]:
            at = [one.get_xdata()[0] for one in axes.get_lines() if one.get_linestyle() == "--"]
            assert at == [0.1, 0.4, 0.401]
        assert told.texts[0].get_text().splitlines() == [
            "1 0.100 s first",
            "2 0.400 s second",
            r"3 0.401 s third costs \$5, not \$6",
        ]

    def test_a_long_list_ends(self) -> None:
        picture = picture_of_run(of_users(1, 500))
        marks = tuple(Mark(0.001 * k, f"no. {k}") for k in range(MOST_MARKS_LISTED + 4))
        figure = figure_of(Picture(picture.title, PERIOD, 0, 500, picture.panels, marks=marks))
        lines = figure.axes[-1].texts[0].get_text().splitlines()
        assert len(lines) == MOST_MARKS_LISTED + 1
        assert lines[-1] == "and 4 more"

    def test_a_cut_file_is_reported(self) -> None:
        figure = figure_of(picture_of_run(of_users(1, 50, cut="it ends at byte 5")))
        assert figure.get_supxlabel() == "This recording is cut: it ends at byte 5"
        assert figure.get_suptitle().endswith(", cut")
        assert figure_of(picture_of_run(of_users(1, 50))).get_supxlabel() == ""

    def test_texts_of_anywhere(self) -> None:
        assert plain("a\nb\x1b[31m $x$", 40) == "a b\ufffd[31m \\$x\\$"
        assert plain("x" * 50, 10) == "x" * 9 + "…"
        assert label("_hidden") == " _hidden"


class TestFiles:
    def small(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(figures, "DPI", 30)  # the same, sooner

    def test_png_and_svg(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.small(monkeypatch)
        run = of_users(1, 50)
        marks = (Mark(0.01, "a <tag> & $1 \u4e2d"),)  # the last has no glyph in our fonts
        picture = Picture("a <b> $2$", PERIOD, 0, 50, picture_of_run(run).panels, marks=marks)
        for name in ("a.png", "a.svg", "b.svg", "a.pdf", "b.pdf"):
            save(figure_of(picture), tmp_path / name)
        assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
        assert (tmp_path / "a.pdf").read_bytes()[:4] == b"%PDF"
        assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
        texts = {
            "".join(text.itertext()) for text in ElementTree.parse(tmp_path / "a.svg").iter() if "text" in text.tag
        }
        assert {"a <b> $2$", "1 0.010 s a <tag> & $1 \u4e2d", "u0", "x [m]", "time [s]"} <= texts
        assert len([*tmp_path.iterdir()]) == 5

    @pytest.mark.parametrize("name", ["a.gif", "a", "none/a.png"])
    def test_names_of_no_picture(self, name: str, tmp_path: Path) -> None:
        with pytest.raises(TargetError, match=r"expected one of \.png, \.svg, \.pdf|found no folder"):
            require_picture(tmp_path / name)

    def test_whole_or_not_at_all(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = tmp_path / "a.png"
        path.write_bytes(b"older")
        picture = picture_of_run(of_users(1, 50))

        def broken(*_arguments: object, **_options: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("matplotlib.figure.Figure.savefig", broken)
        with pytest.raises(OSError, match="No space"):
            save(figure_of(picture), path)
        assert path.read_bytes() == b"older"
        assert [*tmp_path.iterdir()] == [path]


def recorded_file(path: Path, ticks: int) -> Recorded:
    """A recording of one device, written by the recorder itself."""
    recorded = Recorded("study", "0123456789abcdef", PERIOD, "realtime", {"d": Role.DEVICE}, {"d": ("p",)})
    core = RecorderCore(recorded, {CERTIFICATE_FILE: b'{"tau": 0.0004}'})
    x = np.sin(0.01 * np.arange(ticks))[:, None]
    traces = {"x": x, "f_v": -2.0 * x, "ledger": np.abs(x), "tau_us": 300.0 + x}
    core.take(encode(Observation("d", ticks, Figures(), traces)), 0)
    path.write_bytes(core.end())
    return recorded


class TestCommand:
    @pytest.fixture(autouse=True)
    def small(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(figures, "DPI", 30)

    def call(self, *arguments: str | Path) -> tuple[int, str, str]:
        found = CliRunner().invoke(app, ["plot", *map(str, arguments)])
        return found.exit_code, found.stdout, found.stderr

    def test_beside_the_file_by_default(self, tmp_path: Path) -> None:
        recorded_file(tmp_path / "run.mcap", 400)
        assert self.call(tmp_path / "run.mcap") == (0, f"{tmp_path / 'run.png'}\n", "")
        assert self.call(tmp_path / "run.mcap", "--format", "svg", "--show", "velocity, tau", "--from", "0.1")[0] == 0
        text = (tmp_path / "run.svg").read_text()
        assert "velocity [m/s]" in text
        assert "delays inside the tick" in text
        assert "τ of the certificate, 400 µs" in text
        assert "energy ledgers" not in text
        assert {path.name for path in tmp_path.iterdir()} == {"run.mcap", "run.png", "run.svg"}

    @pytest.mark.parametrize("suffix", SUFFIXES)
    def test_what_simulate_keeps(self, suffix: str, tmp_path: Path) -> None:
        x = np.cumsum(np.random.default_rng(0).normal(size=(300, 2)), axis=0)
        x[40:50, 1] = np.nan
        kept = Recording("study", "id", PERIOD, ("a", "b[0],"), x, -x)
        kept.save(tmp_path / f"run{suffix}")
        assert self.call(tmp_path / f"run{suffix}", "-o", tmp_path / "out.svg")[0] == 0
        text = (tmp_path / "out.svg").read_text()
        for words in ("positions", "velocities", "forces", "b[0],", "not recorded"):
            assert words in text
        code, _, said = self.call(tmp_path / f"run{suffix}", "--show", "tau")
        assert (code, "expected some of sample, velocity, force" in said) == (2, True)
        figure = figure_of(picture_of_recording(kept))
        np.testing.assert_array_equal(line(figure.axes[0], "b[0],")[1], x[:, 1])

    @pytest.mark.parametrize(
        ("arguments", "words"),
        [
            (["run.mcap", "-o", "out.gif"], "found the suffix '.gif'; expected one of .png, .svg, .pdf"),
            (["run.mcap", "-o", "none/out.png"], "found no folder"),
            (["run.mcap", "-o", "out.png", "--format", "svg"], "give either --format or -o FILE"),
            (["run.mcap", "--format", "pdf"], "--format: found 'pdf'; expected png or svg"),
            (["run.mcap", "--show", "speed"], "found 'speed'"),
            (["run.mcap", "--from", "9"], "--from: found 9 s; expected at most 0.049 s"),
            (["absent.mcap"], "cannot be read"),
            (["absent.npz"], "cannot be read"),
            (["bad.mcap"], "expected an .mcap recording"),
            (["bad.npz"], "found no recording"),
            (["bad.csv"], "found no recording"),
            (["bad.parquet"], "found no recording"),
            (["run.txt"], "found the suffix '.txt'"),
        ],
    )
    def test_bad_input_ends_with_2_and_leaves_nothing(
        self, arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        recorded_file(tmp_path / "run.mcap", 50)
        for name in ("bad.mcap", "bad.npz", "bad.csv", "bad.parquet"):
            (tmp_path / name).write_bytes(b"tick,time_s,x[a]_m,f_v[a]_N\n0,0.0,1.0\n")
        before = {*tmp_path.iterdir()}
        code, said, told = self.call(*arguments)
        assert (code, said) == (2, "")
        assert words in told
        assert {*tmp_path.iterdir()} == before


def test_a_panel_of_one_tick() -> None:
    """Nothing to join, and no time between: still a picture."""
    figure = figure_of(Picture("one", PERIOD, 0, 1, (Panel("a", "t", "a [m]", (Curve("p", np.ones(1)),)),)))
    (axes,) = figure.axes
    assert [list(one.get_ydata()) for one in axes.get_lines()] == [[1.0], [1.0]]
