"""`design.series`: which sessions may have it, and that what is run is the session's own coupling and world."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import manyhands as mh
from manyhands.design.certificate import Certificate
from manyhands.design.models.network import Network
from manyhands.design.models.statespace import StateSpace
from manyhands.launch.app.design_report import series_rows
from manyhands.launch.plan.loop import NotCertified
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import SessionError
from manyhands.launch.session.shipped import load_named

SERIES = {"design.series": True, "design.objective": "stiffest"}


@pytest.fixture(scope="module")
def counted() -> Prepared:
    return prepare(load_named("example1", [f"{key}={json.dumps(value)}" for key, value in SERIES.items()]))


REFUSED: dict[str, tuple[str, list[str], str]] = {
    "too much": ("example1", ["design.series=1"], "design.series: found 1; expected a part greater than 0"),
    "a text": ("example1", ["design.series=all"], "or true or false"),
    "none": ("example1-uncoupled", ["design.series=true"], "design.series: found true with 'coupling: none'"),
    "given": (
        "example1",
        ["design.coupling=given", "design.stiffness=700", "design.series=true"],
        "design.series: found true with 'coupling: given'",
    ),
    "late": (
        "example1",
        ["environment.delay=1", "design.series=true"],
        "found true with an environment of type network with a delay",
    ),
    "scene": (
        "carry",
        ["design.series=true"],
        "expected an environment of type network, state-space or transfer-function without delay",
    ),
    "wave link": (
        "ball",
        ["design.series=true"],
        "found true with the wave link of 'left_seat'; expected no wave link",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_sessions_that_have_nothing_to_count_are_refused(name: str) -> None:
    session, changes, text = REFUSED[name]
    with pytest.raises(SessionError) as error:
        load_named(session, changes)
    assert text in str(error.value)


def test_nothing_is_counted_unless_it_is_asked_for() -> None:
    assert load_named("example1").design.counted is None
    assert load_named("example1", ["design.series=false"]).design.counted is None
    assert load_named("example1", ["design.series=0.5"]).design.counted == 0.5
    assert mh.certify("example1").version == 3


def test_processes_run_the_loop_as_it_is_cut(counted: Prepared) -> None:
    certificate, world = counted.certificate, counted.loop.environment
    assert certificate is not None
    assert isinstance(world, Network)
    assert [round(link.stiffness) for link in world.links] == [3_800_000, 3_500_000, 3_300_000, 2600]
    assert [block.order for block in counted.blocks] == [1, 1, 1]
    assert 1.0 / counted.blocks[0].response(1.0).real == pytest.approx(2739.7, abs=0.1)
    assert certificate.stiffness[0, 0] == pytest.approx(9794.0, abs=1.0)


def test_a_certificate_is_for_the_session_that_counts(counted: Prepared, tmp_path: Path) -> None:
    assert counted.certificate is not None
    counted.certificate.save(tmp_path / "c.json")
    again = prepare(counted.session, tmp_path / "c.json")
    assert again.loop.environment == counted.loop.environment
    with pytest.raises(NotCertified, match="the compliance of the world that is counted in series differs"):
        prepare(load_named("example1", ["design.objective=stiffest"]), tmp_path / "c.json")


def test_hands_move_as_with_the_coupling_itself_and_the_world_as_it_is(counted: Prepared) -> None:
    """A run of the certified session, and one of its coupling less C with the session's own network, uncertified."""
    certificate = counted.certificate
    assert certificate is not None
    session = mh.load("example1", SERIES)
    run = mh.simulate(session, 0.5, certificate=certificate)
    matrices = {name: _matrices(certificate, i) for i, name in enumerate(certificate.loop.partition.names)}
    own = mh.load("example1", {"design": {"coupling": "given", "matrices": matrices}})
    other = mh.simulate(own, 0.5, uncertified=True)
    assert np.abs(run.x).max() > 1e-3
    np.testing.assert_allclose(run.x, other.x, atol=1e-9 * np.abs(run.x).max())
    np.testing.assert_allclose(run.f_v, other.f_v, atol=1e-7 * np.abs(run.f_v).max())


def _matrices(certificate: Certificate, port: int) -> Any:
    """V of one port, without what is counted."""
    V = StateSpace(*certificate.V[:4])
    mine = [i for i in range(V.order) if V.B[i, port]]
    A, B, C = V.A[np.ix_(mine, mine)], V.B[mine][:, [port]], V.C[[port]][:, mine]
    return {"A": A.tolist(), "B": B.tolist(), "C": C.tolist(), "D": V.D[[port]][:, [port]].tolist()}


WORLD = {"num": [0.3, 3300.0], "den": [1.0]}
NOTHING = {"num": [0.0], "den": [1.0]}


def functions(**design: object) -> mh.Session:
    """Example 1 with a spring and damper of rational functions behind each tool, and nothing between them."""
    entries = [[WORLD if i == j else NOTHING for j in range(3)] for i in range(3)]
    return mh.load(
        "example1",
        {
            "environment": {"type": "transfer-function", "entries": entries},
            "design": {"coupling": "spring-damper", **design},
        },
    )


def test_a_late_world_of_functions_is_refused() -> None:
    entries = [[WORLD if i == j else NOTHING for j in range(3)] for i in range(3)]
    environment = {"type": "transfer-function", "entries": entries, "delay": 1}
    with pytest.raises(SessionError, match="found true with an environment of type transfer-function with a delay"):
        mh.load("example1", {"environment": environment, "design.series": True})


def test_a_world_of_functions_gives_up_plain_springs(tmp_path: Path) -> None:
    """The coupling contains them, the world runs without them, and the report names them."""
    session = functions(series=True, objective="stiffest")
    counted = prepare(session)
    certificate = counted.certificate
    assert certificate is not None
    assert certificate.loop.series == pytest.approx((0.999 / 3900.0,) * 3, rel=1e-3)
    assert np.diag(certificate.stiffness) == pytest.approx([9183.0] * 3, abs=10.0)
    left = counted.loop.environment.environment(session.period).response(-1.0).real
    assert left[0, 0] > 100.0 * 3900.0  # a tenth of a per cent of its compliance is left at the Nyquist frequency
    rows = series_rows(certificate)
    assert rows["dx"]["compliance"] == certificate.loop.series[0]
    assert rows["dx"]["coupling"] == pytest.approx(certificate.stiffness[0, 0])
    certificate.save(tmp_path / "c.json")
    assert prepare(session, tmp_path / "c.json").id == certificate.id
    with pytest.raises(NotCertified, match="the compliance of the world that is counted in series differs"):
        prepare(functions(series=0.5, objective="stiffest"), tmp_path / "c.json")


def test_hands_move_as_with_the_world_of_functions_as_it_is() -> None:
    session = functions(series=True, objective="stiffest")
    certificate = prepare(session).certificate
    assert certificate is not None
    run = mh.simulate(session, 0.3, certificate=certificate)
    matrices = {name: _matrices(certificate, i) for i, name in enumerate(certificate.loop.partition.names)}
    other = mh.simulate(functions(coupling="given", matrices=matrices), 0.3, uncertified=True)
    assert np.abs(run.x).max() > 1e-3
    np.testing.assert_allclose(run.x, other.x, atol=1e-9 * np.abs(run.x).max())
    np.testing.assert_allclose(run.f_v, other.f_v, atol=1e-7 * np.abs(run.f_v).max())
