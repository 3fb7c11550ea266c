"""Buttons in a session file: who has some, what uses them, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from manyhands.launch.audit.simulation import Simulation, simulate
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.session import Session, SessionError
from manyhands.launch.session.session import ENVIRONMENT

from ...support.buttons import handover, held_down


def test_each_node_knows_the_buttons_behind_it() -> None:
    session = Session.from_dict(handover())
    own = ("anna.grip", "anna.menu")
    assert session.buttons_at["anna"] == session.buttons_at["to_anna"] == own
    assert session.buttons_at[ENVIRONMENT] == (*own, "ben.grip", "ben.menu")


def test_a_device_of_two_couplings_has_its_buttons_in_the_first_alone() -> None:
    couplings = {"c1": {"ports": ["anna.x"]}, "c2": {"ports": ["anna.y", "anna.z"]}, "to_ben": {"devices": ["ben"]}}
    session = Session.from_dict(handover(couplings=couplings))
    assert [session.buttons_at[name] for name in ("c1", "c2")] == [("anna.grip", "anna.menu"), ()]


def test_the_environment_learns_a_press_in_its_tick_and_the_spring_then_carries() -> None:
    prepared = prepare(Session.from_dict(handover()))
    run = simulate(prepared, 400)
    expected = {"anna.grip": [range(50, 300)], "ben.grip": [range(200, 380)]}
    assert held_down(run.figures[ENVIRONMENT], 400) == expected
    assert held_down(run.figures["anna"], 400) == {"anna.grip": [range(50, 300)]}
    masses = run.traces[ENVIRONMENT, "masses"].values[:, 1]
    assert masses[299] > 0.015, "anna has lifted it"
    assert masses[370] > 0.012, "and ben holds it, lower by what his spring gives way"
    assert masses[395] < masses[379] - 5e-4, "until he lets it go"
    assert run.traces[ENVIRONMENT, "ledger"].values.min() >= 0.0


def test_over_a_wave_link_the_environment_learns_it_with_a_wave() -> None:
    wave: dict[str, Any] = {"devices": ["ben"], "wave_link": {"b": 5, "network": {"delay": 0.01}}}
    prepared = prepare(Session.from_dict(handover(couplings__to_ben=wave)))
    run = simulate(prepared, 400)
    (held,) = held_down(run.figures[ENVIRONMENT], 400)["ben.grip"]
    assert 205 <= held.start <= 220
    assert held.stop - held.start == 180


def test_a_session_without_buttons_has_none_in_its_bundles() -> None:
    data = handover(environment__holds=[])
    for device in data["devices"].values():
        del device["buttons"]
    simulation = Simulation(prepare(Session.from_dict(data)))
    assert simulation.buttons.names == ()
    assert simulation.events == {}


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("devices__anna__buttons", {"grip": [[1.0, 0.5]]}, "each after the one before"),
        ("devices__anna__buttons", {"grip": [[1.0, 2.0], [1.5, 3.0]]}, "each after the one before"),
        ("devices__anna__buttons", {"grip": [1.0, 2.0]}, r"\[from, until\] in s"),
        ("devices__anna__buttons", {"grip": [["a", 2.0]]}, "a time in s"),
        ("devices__anna__buttons", ["grip", "grip"], "each name once"),
        ("devices__anna__buttons", ["Grip!"], "a button"),
        ("devices__anna__buttons", [f"b{i}" for i in range(17)], "16"),
        ("devices__anna__buttons", ["menu"], "the button 'grip' of anna"),
        ("devices__anna__driver", "browser", "no buttons"),
        ("devices__anna__driver", "spacemouse", "their names alone"),
        ("environment__holds__0__button", "gripe", "the button 'gripe' of anna; expected .*grip"),
        ("environment__holds__0__tool", "anne", "the name 'anne'"),
        ("environment__holds__0__stiffness", 0, "a stiffness in N/m"),
        ("environment__holds__0__within", -1, "a radius in m"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence(where: str, value: object, said: str) -> None:
    with pytest.raises(SessionError, match=said):
        Session.from_dict(handover(**{where: value}))


def test_more_buttons_than_a_signal_carries_are_refused() -> None:
    data = handover(couplings={"all": {"devices": ["anna", "ben"]}})
    data["environment"]["holds"] = []
    for device in data["devices"].values():
        device["buttons"] = [f"b{i}" for i in range(16)]
    Session.from_dict(data)
    data["devices"]["cleo"] = data["devices"]["ben"]
    data["environment"]["tools"]["cleo"] = {"at": [0, 0.2, 0]}
    data["couplings"]["all"]["devices"].append("cleo")
    with pytest.raises(SessionError, match="devices with 48 buttons"):
        Session.from_dict(data)
