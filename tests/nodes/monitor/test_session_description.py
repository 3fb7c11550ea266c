"""A session's description in its directory is read back as it was written, or gives one error."""

from __future__ import annotations

import json
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from manyhands.design.models.scene import Body, ContactScene, Obstacle, ToolSphere
from manyhands.nodes.monitor import session_state as about_file
from manyhands.nodes.monitor.session_state import (
    ABOUT,
    About,
    AboutError,
    CertificateAbout,
    LinkAbout,
    NodeAbout,
    SpringAbout,
)
from manyhands.protocol.messages import Role

WHOLE = About(
    session="example-é", id="i", pid=17, clock="realtime", transport="ipc", period=0.001, ticks=5, started=1.5e9,
    nodes={"dx": NodeAbout(Role.DEVICE, ("dx.x", "dx.y")), "cx": NodeAbout(Role.COUPLING, ("dx.x", "dx.y"), "dx"),
           "environment": NodeAbout(Role.ENVIRONMENT, ("dx.x", "dx.y"))},
    links=(LinkAbout(("cx", "environment"), ("dx.x", "dx.y")),),
    masses={"hub": 3.0}, springs=(SpringAbout(("dx.x", "hub"), 3800.0, 0.1),), grips=("dx",), reach={"dx.x": 0.1},
    certificate=CertificateAbout(
        0.0001, {"(10)": 0.2}, None, {"dx": 1.37}, (0.0002, 0.0005), ("environment",), 0.005, True
    ),
    environment="network", observers={"watch": ("telemetry", "dx/sample")},
)  # fmt: skip


IN_SPACE = replace(
    WHOLE,
    masses=dict.fromkeys(("ball.x", "ball.y", "ball.z"), 0.1),
    scene=ContactScene(
        ("dx.x", "dx.y"),
        (ToolSphere("dx", (0, 1), (0, 1), (0.0, 0.1, 0.2), 0.01),),
        (Body("ball", 0.1, (0.0, 0.2, 0.0), 0.03),),
        (Obstacle("floor", "wall", ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))),),
    ),
)


@pytest.mark.parametrize(
    "about",
    [
        WHOLE,
        replace(WHOLE, certificate=None, observers={}, masses={}, springs=()),
        replace(WHOLE, seats={"cx": "dx"}),
        replace(WHOLE, nodes=WHOLE.nodes | {"dx": replace(WHOLE.nodes["dx"], wall=True, torques=True)}),
        IN_SPACE,
        replace(WHOLE, hands=("dx",), sensed=("dx",)),
    ],
)
def test_round_trip(about: About, tmp_path: Path) -> None:
    about.save(tmp_path)
    assert About.load(tmp_path) == about
    assert [path.name for path in tmp_path.iterdir()] == [ABOUT]
    assert stat.S_IMODE((tmp_path / ABOUT).stat().st_mode) == 0o600


def test_what_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    WHOLE.save(tmp_path)
    with pytest.raises(ValueError, match="JSON"):
        replace(WHOLE, period=float("nan")).save(tmp_path)
    assert About.load(tmp_path) == WHOLE


def changed(**entries: Any) -> str:
    return json.dumps({**WHOLE.as_plain(), **entries})


def without(key: str) -> str:
    plain = WHOLE.as_plain()
    del plain[key]
    return json.dumps(plain)


LATER = ("force", "drawing", "turning", "oriented", "hands", "sensed")
"""What descriptions have had later than others."""

DAMAGED = {
    "a seat of no node": changed(seats={"cy": "dx"}),
    "a seat without a device": changed(seats={"cx": "dy"}),
    "seats in a list": changed(seats=["cx"]),
    "empty": "",
    "cut": changed()[:100],
    "no object": "[]",
    "null": "null",
    "deep": "[" * 100_000,
    "another version's": json.dumps({"session": "s"}),
    "more than there is": changed(more=1),
    **{f"no {key}": without(key) for key in WHOLE.as_plain() if key not in LATER},
    "forces in words": changed(force={"dx": "strong"}),
    "a role that there is not": changed(nodes={"dx": {"role": "king", "ports": [], "process": None}}),
    "ports that are no list": changed(nodes={"dx": {"role": "device", "ports": "dx", "process": None}}, links=[]),
    "a process of nobody": changed(nodes={"dx": {"role": "device", "ports": [], "process": "dz"}}, links=[]),
    "a link to nobody": changed(links=[{"ends": ["cx", "cz"], "ports": []}]),
    "a link of one end": changed(links=[{"ends": ["cx"], "ports": []}]),
    "a scene that is none": changed(scene={"tools": {}}),
    "a scene of other bodies": json.dumps({**IN_SPACE.as_plain(), "masses": {"ball.x": 0.1}}),
    "a scene of other ports": json.dumps(
        {
            **WHOLE.as_plain(),
            "scene": ContactScene(("dx",), (ToolSphere("dx", (0,), (0,), (0.0, 0.0, 0.0)),)).geometry_terms(),
        }
    ),
    "a scene beyond all doubles": changed(
        scene={**ContactScene(()).geometry_terms(), "bodies": {"ball": {"mass": 10**400, "at": [0, 0, 0], "radius": 0}}}
    ),
    "a name that is none": changed(session=3),
    "a process id in words": changed(pid="17"),
    "a process id that is a truth": changed(pid=True),
    "a process id that is none": changed(pid=0),
    "an instant in words": changed(started="today"),
    "an instant beyond all calendars": changed(started=1e300),
    "no period": changed(period=0),
    "a period that is no number": changed(period=float("nan")),
    "ticks that are none": changed(ticks=-1),
    "masses in words": changed(masses={"hub": "heavy"}),
    "a mass that is no number": changed(masses={"hub": float("inf")}),
    "a spring in words": changed(springs=[{"ends": ["a", "b"], "stiffness": "s", "damping": 0.0}]),
    "a certificate of another kind": changed(certificate={"tau": 1.0}),
    "a drawing that is none": changed(drawing={"up": "x", "frames": {}, "shapes": []}),
    "a bound in words": changed(certificate={**WHOLE.as_plain()["certificate"], "bounded": "yes"}),
}


@pytest.mark.parametrize("text", DAMAGED.values(), ids=DAMAGED)
def test_damaged(text: str, tmp_path: Path) -> None:
    (tmp_path / ABOUT).write_text(text)
    with pytest.raises(AboutError, match=r"about\.json: found no session's description"):
        About.load(tmp_path)


def test_a_description_from_before_it_had_limits_of_forces_or_a_drawing(tmp_path: Path) -> None:
    (tmp_path / ABOUT).write_text(without("force"))
    assert About.load(tmp_path).force == {}
    (tmp_path / ABOUT).write_text(without("drawing"))
    assert About.load(tmp_path).drawing is None


def test_not_there_not_a_file_not_text_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(AboutError, match="cannot be read: No such file"):
        About.load(tmp_path)
    (tmp_path / ABOUT).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(AboutError, match="found no session's description"):
        About.load(tmp_path)
    WHOLE.save(tmp_path)
    monkeypatch.setattr(about_file, "MAX_ABOUT_BYTES", 100)
    with pytest.raises(AboutError, match=r"cannot be read: Is longer than 100 bytes"):
        About.load(tmp_path)
    (tmp_path / ABOUT).unlink()
    (tmp_path / ABOUT).mkdir()
    with pytest.raises(AboutError, match=r"about\.json"):
        About.load(tmp_path)
