"""`colocate: true`: its effects on links, rights, keys, placement and processes, and on nothing else."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from manyhands.launch.audit.simulation import Simulation
from manyhands.launch.look.graph import show
from manyhands.launch.look.graph.parts import drawing_of_session, graph_object
from manyhands.launch.plan.plan import Plan
from manyhands.launch.plan.prepare import prepare
from manyhands.launch.plan.reach import reach
from manyhands.launch.plan.topology import placement, topology
from manyhands.launch.run.supervisor import Supervisor
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.launch.session.session import ENVIRONMENT

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
TICKS = 250


def session_of(file: str = "example1.yaml", colocate: bool = True) -> Session:
    return load_session(SESSIONS / file, [f"colocate={str(colocate).lower()}"])


def test_a_coupling_of_several_devices_is_in_the_process_of_none() -> None:
    with pytest.raises(SessionError) as caught:
        session_of("example1-centralised.yaml")
    assert "colocate: found true, with the coupling 'c' of the devices dx, dy, dz" in str(caught.value)
    assert "expected couplings of one device each, or false" in str(caught.value)


def test_colocation_adds_no_right_and_unsent_signals_have_no_reader() -> None:
    """Sample and force fall away between the two; everything else that one may read or write stays."""
    apart, together = (set(Plan(session_of(colocate=flag)).access) for flag in (False, True))
    assert together < apart
    assert {row.channel for row in apart - together} == {"sample", "force"}
    assert not {row for row in together if row.channel in ("sample", "force")}


def test_keys_are_shared_with_the_environment_and_the_supervisor_alone() -> None:
    known = Plan(session_of()).peers
    assert known["dx"] == {"supervisor"}
    assert known["cx"] == {ENVIRONMENT, "supervisor"}
    assert known[ENVIRONMENT] == {"cx", "cy", "cz", "supervisor"}


def test_what_is_carried_goes_where_its_device_goes() -> None:
    places = placement(topology(session_of()), [0, 1])
    assert places == placement(topology(session_of(colocate=False)), [0, 1])
    assert all(places[f"c{axis}"] == places[f"d{axis}"] for axis in "xyz")
    assert placement(topology(session_of("example1-operator.yaml")), [0, 1]) == {}  # one device carries all


def test_the_graph_shows_the_process_of_each_node() -> None:
    plain = graph_object(drawing_of_session(Plan(session_of())))
    assert plain["nodes"]["cx"] == {"role": "coupling", "ports": ["dx"], "process": "dx"}
    assert plain["nodes"]["dx"] == {"role": "device", "ports": ["dx"]}
    assert [link["between"] for link in plain["links"]] == [[ENVIRONMENT, name] for name in ("cx", "cy", "cz")]
    text = io.StringIO()
    show(drawing_of_session(Plan(session_of())), Console(file=text, width=120), "text", None)
    assert "coupling, in dx" in text.getvalue()
    assert "sample" not in text.getvalue()
    apart = graph_object(drawing_of_session(Plan(session_of(colocate=False))))
    assert not any("process" in node for node in apart["nodes"].values())


def test_processes_that_carry_couplings_give_the_simulations_numbers() -> None:
    prepared = prepare(session_of())
    outcome = Supervisor(prepared, clock="simulated", reach=reach(prepared, "ipc"), ticks=TICKS, record=True).run()
    assert (outcome.code, outcome.faults, outcome.lost) == (0, (), {})
    assert outcome.recording is not None
    expected = Simulation(prepared).run(TICKS)
    np.testing.assert_array_equal(outcome.recording.x, expected.x)
    np.testing.assert_array_equal(outcome.recording.f_v, expected.f_v)
    nodes = outcome.report["nodes"]
    assert set(nodes) == set(prepared.session.roles)
    assert all(node["ticks"] == TICKS for node in nodes.values())
