"""What the world's own springs soften: the cut, the choice of parts, the certificate and its proof."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import fmpq_mat

from manyhands.design.certificate import (
    Certificate,
    content,
    differences,
    from_content,
    identity,
    load,
)
from manyhands.design.ladder import automatic_delays, design_ladder
from manyhands.design.models.coupling import Partition, SpringDamper, realisations
from manyhands.design.models.environment import (
    DelayedNetwork,
    NetworkBox,
    StateSpaceEnvironment,
    StiffenedEnvironment,
    TransferEnvironment,
)
from manyhands.design.models.network import GROUND, Method, Network, NetworkLink
from manyhands.design.models.statespace import Matrix, StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import (
    DeviceLevel,
    HapticLoop,
    LinearWanted,
    SpringDamperGiven,
    SpringDamperWanted,
    Wish,
)
from manyhands.design.proof import ProofInputError, prove
from manyhands.design.proof.claim import StiffenedData, read_environment
from manyhands.design.proof.environment import environment as environment_of_proof
from manyhands.design.proof.environment import split as split_of_proof
from manyhands.design.proof.exact import Item, exact_decimal
from manyhands.design.proof.ladder import prove_ladder
from manyhands.design.series import counted_parts
from manyhands.design.synthesis import design
from manyhands.launch.plan.loop import coupling_request, haptic_loop
from manyhands.launch.session.shipped import load_named
from tests.attack.hands import Hand
from tests.attack.loop import Repeating, Tick, growth
from tests.attack.oracle import CERTAIN, judge
from tests.attack.parties import precise

T = 1e-3
STIFFEST = SpringDamperWanted(Wish("stiffest"))
CONTACTS = np.array([3800.0, 3500.0, 3300.0])  # N/m, of Example 1


@pytest.fixture(scope="module")
def counted() -> HapticLoop:
    """Example 1, with as much counted as the design would."""
    return haptic_loop(load_named("example1", ["design.series=true"]))


@pytest.fixture(scope="module")
def stiff(counted: HapticLoop) -> Certificate:
    """Its stiffest coupling."""
    return design(counted, STIFFEST).certificate


def plain(certificate: Certificate) -> Any:
    return json.loads(json.dumps({"id": certificate.id, **content(certificate)}))


def sealed(data: Any) -> Any:
    return {**data, "id": identity(data)}


# --- which springs are in series


LINK = NetworkLink(("p", "m"), 500.0, 0.2)


@pytest.mark.parametrize(
    ("more", "found"),
    [
        ((), {"p": LINK}),
        ((NetworkLink(("m", "p"), 100.0, 0.0),), {"p": NetworkLink(("p", "m"), 600.0, 0.2)}),
        ((NetworkLink(("p", GROUND), 100.0, 0.0),), {}),
        ((NetworkLink(("p", "q"), 100.0, 0.0),), {}),
        ((NetworkLink(("q", GROUND), 50.0, 0.0),), {"p": LINK, "q": NetworkLink(("q", GROUND), 50.0, 0.0)}),
        ((NetworkLink(("q", "m"), 0.0, 0.3),), {"p": LINK}),
    ],
    ids=["one", "parallel", "two ends", "another port", "ground", "a damper alone"],
)
def test_a_port_has_a_contact_if_one_spring_joins_it_to_the_rest(
    more: tuple[NetworkLink, ...], found: dict[str, NetworkLink]
) -> None:
    assert Network(("p", "q"), (("m", 1.0),), (LINK, *more)).contacts() == found


def test_more_is_counted_up_to_what_the_coupling_itself_has_to_keep(counted: HapticLoop) -> None:
    assert counted_parts(counted) == (0.999,) * 3
    assert counted_parts(counted, 0.25) == (0.25,) * 3
    soft = replace(counted.environment, links=(NetworkLink(("dx", "hub"), 1000.0, 0.1), *counted.environment.links[1:]))  # type: ignore[type-var]
    part = counted_parts(replace(counted, environment=soft))[0]
    limit = T / 2.0 / 1.37
    assert part == pytest.approx(0.9 * 1000.0 * limit, abs=1e-3)
    assert part / 1000.0 <= 0.9 * limit


def test_a_longer_delay_leaves_more_to_count(counted: HapticLoop) -> None:
    soft = Network(("dx", "dy", "dz"), (), tuple(NetworkLink((p, GROUND), 800.0, 0.0) for p in ("dx", "dy", "dz")))
    at = [counted_parts(replace(counted, environment=soft, tau=tau))[0] for tau in (0.0, 1e-4, 3e-4)]
    assert at == sorted(at)
    assert at[0] < at[-1]


def test_without_a_contact_nothing_is_counted(counted: HapticLoop) -> None:
    joined = Network(("dx", "dy", "dz"), (), tuple(NetworkLink(e, 900.0, 0.0) for e in (("dx", "dy"), ("dy", "dz"))))
    assert counted_parts(replace(counted, environment=joined, series=())) == ()
    assert counted_parts(replace(counted, environment=DelayedNetwork(counted.environment, 1), series=())) == ()  # type: ignore[arg-type]


# --- the same loop, cut elsewhere


def drawn(rng: np.random.Generator) -> HapticLoop:
    """A network of which some ports have a contact, with any part of it counted."""
    m = int(rng.integers(1, 5))
    ports = tuple(f"p{i}" for i in range(m))
    ends = ["a", "b", GROUND]
    links = [NetworkLink((p, str(rng.choice(ends))), *(10.0 ** rng.uniform((1, -3), (5, 1)))) for p in ports]
    links += [NetworkLink(("a", "b"), 300.0, 0.3), NetworkLink(("b", GROUND), 900.0, 0.1)]
    if m > 2:
        links.append(NetworkLink((ports[0], ports[1]), 100.0, 0.0))
    world = Network(ports, (("a", 0.3), ("b", 2.0)), tuple(links))
    parts = tuple(float(rng.uniform(0.05, 0.99)) * (port in world.contacts()) for port in ports)
    devices = tuple(DeviceLevel(p, (i,), np.array([[1.0]])) for i, p in enumerate(ports))
    blocks = Partition(("c", "d")[: min(m, 2)], ((0,), tuple(range(1, m)))[: min(m, 2)])
    loop = HapticLoop("drawn", T, ports, devices, blocks, world)
    return replace(loop, series=parts) if any(parts) else loop


@pytest.mark.parametrize("seed", range(12))
def test_hands_feel_the_same_on_either_side_of_the_cut(seed: int) -> None:
    """(I + E V)^-1 E of the coupling and the world is that of the coupling with C and the stiffer world."""
    rng = np.random.default_rng(seed)
    loop = drawn(rng)
    m = len(loop.ports)
    blocks = tuple(SpringDamper(np.eye(len(b)) * 700.0, np.eye(len(b)) * 0.1) for b in loop.partition.blocks)
    run = loop.partition.join(realisations(blocks, T))
    own = loop.without_counted(run)
    assert own.order == run.order + len(loop.parts)
    for z in np.exp(1j * np.array([1e-3, 0.02, 0.3, 1.5, np.pi])):
        felt = []
        for V, E in ((own, loop.environment.environment(T)), (run, loop.cut.environment.environment(T))):
            E_z = E.response(z)
            felt.append(np.linalg.solve(np.eye(m) + E_z @ V.response(z), E_z))
        np.testing.assert_allclose(felt[0], felt[1], rtol=1e-6, atol=1e-7 * np.abs(felt[0]).max())


def test_devices_move_alike_on_either_side_of_the_cut(counted: HapticLoop) -> None:
    """In time, tick by tick, with the device's answer in the loop."""
    blocks = realisations((SpringDamper([[900.0]], [[0.2]]),) * 3, T)
    run = counted.partition.join(blocks)
    pairs = (
        (counted.without_counted(run), counted.environment.environment(T)),
        (run, counted.cut.environment.environment(T)),
    )
    moved = []
    for V, E in pairs:
        xi, eta, x, v = np.zeros(V.order), np.zeros(E.order), np.zeros(3), np.zeros(3)
        trace = []
        for k in range(400):
            p = x + V.C @ xi
            f = -np.linalg.solve(np.eye(3) + E.D @ V.D, E.C @ eta + E.D @ p)
            xi, eta = V.A @ xi + V.B @ f, E.A @ eta + E.B @ (p + V.D @ f)
            v = v + T / 0.3 * (f - 1.37 * v + np.array([2.0, -1.0, 0.5]) * (k < 100))
            x = x + T * v
            trace.append(x)
        moved.append(np.array(trace))
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-9 * np.abs(moved[0]).max())


# --- designs


def test_the_stiffest_couplings_of_example_1_reach_the_static_limits(stiff: Certificate) -> None:
    """1/K + 1/k > T/(2 Delta_D), of which 0.1 % of 1/k and the design's room are given up."""
    limits = 1.0 / (T / 2.0 / 1.37 - 1.0 / CONTACTS)
    assert limits == pytest.approx([9823.0, 12618.0, 16146.0], abs=1.0)
    own = np.diag(stiff.stiffness)
    assert np.all(own < limits)
    assert own == pytest.approx(limits, rel=0.01)
    assert stiff.version == 5
    assert all(finding.holds for finding in prove(plain(stiff)))


@pytest.mark.parametrize(("tau", "limits"), [(3e-4, (2323.0, 2452.0, 2561.0)), (1e-3, (836.0, 851.0, 864.0))])
def test_with_a_delay_too(counted: HapticLoop, tau: float, limits: tuple[float, ...]) -> None:
    found = design(replace(counted, tau=tau), STIFFEST).certificate
    plainly = design(replace(counted, tau=tau, series=()), STIFFEST).certificate
    own = np.diag(found.stiffness)
    assert np.all((own > np.diag(plainly.stiffness) * 1.2) & (own < limits))


def test_static_springs_of_example_2_are_below_three() -> None:
    session = load_named("example2", ["design.series=true"])
    found = design(haptic_loop(session), coupling_request(session)).certificate
    assert found.transparency is not None
    assert 2.9 < found.transparency.gamma < 3.0
    assert all(finding.holds for finding in prove(plain(found)))
    peak = _peak(found)
    assert peak < found.transparency.gamma < peak * 1.001


def _peak(certificate: Certificate) -> float:
    """||W1 E V|| on a grid, of the coupling itself and the world as it is, by responses alone."""
    assert certificate.transparency is not None
    W1 = certificate.transparency.aim.W1
    E, V = (StateSpace(*system[:4]) for system in (certificate.E, certificate.V))
    z = np.exp(1j * T * np.concatenate([np.linspace(66.0, 66.8, 200), np.geomspace(1.0, np.pi / T, 200)]))
    return max(float(np.linalg.norm(E.response(s) @ V.response(s) * W1.response(np.array([s]))[0], 2)) for s in z)


def test_two_poles_buy_more_than_without_the_contacts() -> None:
    session = load_named("example2-linear", ["design.series=true", "design.order=2"])
    request = coupling_request(session)
    assert isinstance(request, LinearWanted)
    found = design(haptic_loop(session), request).certificate
    assert found.transparency is not None
    assert found.transparency.gamma < 1.2  # 4.453 without
    assert all(finding.holds for finding in prove(plain(found)))


def test_intervals_are_cut_at_both_ends(counted: HapticLoop) -> None:
    low = counted.environment
    assert isinstance(low, Network)
    high = replace(low, links=tuple(replace(link, stiffness=2.0 * link.stiffness) for link in low.links))
    box = replace(counted, environment=NetworkBox(low, high))
    found = design(box, STIFFEST).certificate
    assert found.levels.P_E == "energy"
    assert all(finding.holds for finding in prove(plain(found)))
    assert isinstance(box.cut.environment, NetworkBox)
    np.testing.assert_allclose(
        [link.stiffness for link in box.cut.environment.high.links],
        [(1.0 if "ground" in link.ends else 1000.0) * link.stiffness for link in high.links],
    )


def test_a_ladder_counts_the_same_parts_at_every_rung(stiff: Certificate) -> None:
    found = design_ladder(stiff, STIFFEST, automatic_delays(stiff.loop)).ladder
    assert found is not None
    assert found.independent
    assert {rung.loop.series for rung in found.rungs} == {stiff.loop.series}
    assert all(finding.holds for rung in found.rungs for finding in prove(plain(rung)))
    rungs = [plain(rung) for rung in found.rungs]
    other = sealed({**rungs[1], "series": {**rungs[1]["series"], "dx": 0.5}})
    assert prove_ladder(rungs, 0).one_loop.holds
    assert not prove_ladder([rungs[0], other, *rungs[2:]], 0).one_loop.holds


# --- the file


def test_the_file_is_read_back_as_it_was_written(stiff: Certificate, tmp_path: Path) -> None:
    stiff.save(tmp_path / "c.json")
    again, data = load(tmp_path / "c.json")
    assert data["series"] == {"dx": 0.999, "dy": 0.999, "dz": 0.999}
    assert content(again) == content(stiff)
    assert again.id == stiff.id == identity(data)


def test_a_certificate_that_counts_is_not_one_of_a_session_that_does_not(stiff: Certificate) -> None:
    assert differences(stiff, stiff.loop, STIFFEST) == []
    assert differences(stiff, replace(stiff.loop, series=()), STIFFEST) == [
        "the compliance of the world that is counted in series differs"
    ]
    assert differences(stiff, replace(stiff.loop, series=(0.999, 0.999, 0.5)), STIFFEST)


def test_with_a_tolerance_both_stand_in_one_file(counted: HapticLoop) -> None:
    found = design(replace(counted, period_tolerance=0.1), STIFFEST).certificate
    data = plain(found)
    assert (data["version"], data["period_tolerance"]) == (5, 0.1)
    assert all(finding.holds for finding in prove(data))
    none = sealed({**data, "period_tolerance": 0.0})
    assert not all(finding.holds for finding in prove(none))


# --- the proof


def changed(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    out = copy.deepcopy(data)
    inner = out
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return sealed({**out, "margins": {}})


FALSE: dict[str, tuple[tuple[Any, ...], Any, str]] = {
    "all of a link": (("series", "dx"), 1.0, "not between 0 and 1"),
    "more than a link": (("series", "dx"), 1.5, "not between 0 and 1"),
    "less than nothing": (("series", "dx"), -0.5, "not between 0 and 1"),
    "nothing": (("series", "dx"), 0.0, "not between 0 and 1"),
    "two ends": (("environment", "links", 3, "between"), ["dx", "ground"], "lead to 2 ends"),
    "no end": (("environment", "links", 0, "between"), ["hub", "ground"], "lead to 0 ends"),
    "another port": (("environment", "links", 0, "between"), ["dx", "dy"], "leads to another port"),
    "a damper alone": (("environment", "links", 0, "stiffness"), 0.0, "has no stiffness"),
    "a late world": (("environment", "delay"), 1, "without delay"),
}


@pytest.mark.parametrize("name", FALSE)
def test_a_part_that_is_not_the_worlds_own_is_not_proved(stiff: Certificate, name: str) -> None:
    path, value, text = FALSE[name]
    data = {**plain(stiff), "series": {"dx": 0.999}}
    failing = [finding for finding in prove(changed(data, path, value)) if not finding.holds]
    assert failing[0].condition == "what is counted in series is the world's own"
    assert text in failing[0].argument


def test_the_coupling_that_is_run_keeps_its_own_limit(stiff: Certificate) -> None:
    data = changed(plain(stiff), ("coupling", "blocks", "cx", "stiffness"), [[2741.0]])
    failing = [finding.condition for finding in prove(data) if not finding.holds]
    assert failing[0] == "V_hat of cx is Delta_V-OSP, Lemma 1"


def test_another_part_is_another_world(stiff: Certificate) -> None:
    """The storage matrix and Phi_E prove the world that is left; a part more or less leaves a different one."""
    data = plain(stiff)
    assert data["storage"]["E_hat"] != "energy"
    failing = [f.condition for f in prove(changed(data, ("series", "dx"), 0.2)) if not f.holds]
    assert failing == ["E_hat is (-Phi_E)-ISP, (14)", "the loop is well posed: I + D_E D_V is regular"]


def test_another_part_is_another_transparency() -> None:
    session = load_named("example2", ["design.series=true"])
    found = design(haptic_loop(session), coupling_request(session)).certificate
    data = changed(plain(found), ("series", "dx"), 0.9989)
    assert any("transparency" in finding.condition and not finding.holds for finding in prove(data))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"series": {}}, "series: found"),
        ({"series": {"nobody": 0.5}}, "series: found"),
        ({"series": {"dx": "all"}}, "series.dx: found"),
        ({"version": 3}, "series: expected it in version 5"),
        ({"version": 4}, "period_tolerance: expected it in version 4"),
    ],
)
def test_hostile_series_are_refused(stiff: Certificate, change: dict[str, Any], text: str) -> None:
    with pytest.raises(ProofInputError, match=text):
        prove(sealed({**plain(stiff), **change}))


def test_a_version_without_its_key_is_refused(stiff: Certificate) -> None:
    data = plain(stiff)
    del data["series"]
    with pytest.raises(ProofInputError, match="series: expected it in version 5"):
        prove(sealed(data))


# --- hands


def stiffened(certificate: Certificate, factor: float) -> Any:
    """The certificate with couplings whose own stiffness is ``factor`` times the static limit, B = 0."""
    data = plain(certificate)
    for name, k, part in zip(data["coupling"]["blocks"], CONTACTS, certificate.loop.series, strict=True):
        limit = 1.0 / (T / 2.0 / 1.37 - part / k)
        run = 1.0 / (1.0 / (factor * limit) + part / k)
        data["coupling"]["blocks"][name] = {"stiffness": [[float(run)]], "damping": [[0.0]]}
    return sealed({**data, "margins": {}})


def test_no_hand_shakes_the_certified_coupling(stiff: Certificate) -> None:
    assert judge(plain(stiff), np.random.default_rng(5), draws=60, steps=40).findings == []


def test_hands_shake_a_coupling_of_one_and_a_half_times_the_limit(stiff: Certificate) -> None:
    found = judge(stiffened(stiff, 1.5), np.random.default_rng(5), draws=20, steps=40)
    assert any(finding.startswith("shaken") for finding in found.findings)
    assert "any passive hand" in {finding.split(", ")[0] for finding in found.findings}


def test_the_damper_of_a_contact_lowers_the_limit_of_a_plain_spring(counted: HapticLoop) -> None:
    """At the static limit a spring without damping is too stiff at the Nyquist frequency: 1/K + 1/(k + 2 b/T) decides.

    A light hand that only burns 1.37 N*s/m shakes it; the certified coupling, less damped there, it does not.
    """
    own = (SpringDamper([[16146.0]], [[0.0]]),)
    world = Network(("dz",), (("hub", 3.0),), (NetworkLink(("dz", "hub"), 3300.0, 0.3),))
    loop = HapticLoop(
        "one", T, ("dz",), (DeviceLevel("dz", (0,), np.array([[1.37]])),), Partition(("cz",), ((0,),)), world
    )
    light = Repeating((Hand([[1e-6]], [[0.0]], [[0.0]]),), (Tick((0.0,), (1.0,)),))
    some = design(replace(loop, series=counted_parts(loop)), STIFFEST).certificate
    assert float(some.stiffness[0, 0]) == pytest.approx(16146.0, rel=0.01)
    assert growth([precise(plain(some))], light) <= CERTAIN
    bare = plain(some) | {"series": {}}
    bare["coupling"]["blocks"]["cz"] = {"stiffness": own[0].stiffness.tolist(), "damping": own[0].damping.tolist()}
    assert growth([precise(bare)], light) > 0.05


# --- worlds without links: plain springs


def given(E: StateSpace, ports: tuple[str, ...]) -> StateSpaceEnvironment:
    """E as matrices, with a static gain that is symmetric to the last digit."""
    gain = E.response(1.0).real
    return StateSpaceEnvironment(ports, StateSpace.with_static_gain(E.A, E.B, E.C, (gain + gain.T) / 2.0))


def springs(K: Matrix, B: Matrix) -> TransferEnvironment:
    """K + B s as rational functions."""
    m = len(K)
    rows = [[((float(B[i, j]), float(K[i, j])), (1.0,)) for j in range(m)] for i in range(m)]
    return TransferEnvironment(tuple(f"p{i}" for i in range(m)), tuple(map(tuple, rows)))


def of_world(world: StateSpaceEnvironment | TransferEnvironment) -> HapticLoop:
    devices = tuple(DeviceLevel(p, (i,), np.array([[1.37]])) for i, p in enumerate(world.ports))
    blocks = Partition(world.ports, tuple((i,) for i in range(len(world.ports))))
    return HapticLoop("given", T, world.ports, devices, blocks, world)


ANGLES = np.concatenate([np.geomspace(1e-4, np.pi, 2000), np.linspace(0.01, np.pi, 2000)])  # rad a tick


def least_part(E: StateSpace, angles: Matrix = ANGLES) -> float:
    """The least eigenvalue of He E_hat over ``angles``, N*s/m."""
    z = np.exp(1j * angles)
    hats = [E.response(point) * (T * point / (point - 1.0)) for point in z]
    return min(float(np.linalg.eigvalsh((hat + hat.conj().T) / 2.0)[0]) for hat in hats)


@pytest.fixture(scope="module")
def matrices(counted: HapticLoop) -> HapticLoop:
    """Example 1 with its world as matrices, with as much counted as the design would."""
    loop = replace(counted, environment=given(counted.environment.environment(T), counted.ports), series=())
    return replace(loop, series=counted_parts(loop))


@pytest.fixture(scope="module")
def stiff_matrices(matrices: HapticLoop) -> Certificate:
    """Its stiffest coupling."""
    return design(matrices, STIFFEST).certificate


@pytest.mark.parametrize(("k", "b"), [(3300.0, 0.3), (3300.0, 0.0), (9000.0, 2.0), (1000.0, 20.0)])
def test_a_spring_gives_up_what_its_stiffness_at_the_nyquist_frequency_leaves(k: float, b: float) -> None:
    (found,) = counted_parts(of_world(springs(np.array([[k]]), np.array([[b]]))))
    assert found == pytest.approx(0.999 / (k + 2.0 * b / T), rel=1e-3)
    assert found <= 0.999 / (k + 2.0 * b / T)
    assert f"{found:.3e}" == f"{found:.8e}".replace("00000e", "e")  # four figures, on every machine


def test_no_more_is_counted_than_the_coupling_keeps_and_no_more_than_is_asked() -> None:
    soft = of_world(springs(np.array([[100.0]]), np.array([[0.0]])))
    assert counted_parts(soft)[0] == pytest.approx(0.999 * 0.9 * T / 2.0 / 1.37, rel=1e-3)
    world = of_world(springs(np.array([[3300.0]]), np.array([[0.3]])))
    assert counted_parts(world, 0.5)[0] == pytest.approx(0.5 / 0.999 * counted_parts(world)[0], rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_greatest_springs_leave_a_passive_world_and_none_can_grow_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 4))
    X = rng.normal(size=(m, m))
    network = Network(
        tuple(f"p{i}" for i in range(m)),
        (("a", 0.05),),
        (
            *(NetworkLink((f"p{i}", "a"), *(10.0 ** rng.uniform((3, -2), (4, 0)))) for i in range(m)),
            NetworkLink(("a", GROUND), 2000.0, 0.5),
        ),
    )
    K = X @ X.T * 3000.0 + 500.0 * np.eye(m)
    world = springs((K + K.T) / 2.0, 0.2 * np.eye(m)) if seed % 2 else given(network.environment(T), network.ports)
    loop = of_world(world)
    found = np.array(counted_parts(loop)) / 0.999
    assert np.all(found > 0.0)
    size = float(np.abs(world.environment(T).response(-1.0)).max()) * T
    assert least_part(StiffenedEnvironment(world, tuple(0.999 * found)).discrete(T)) >= -1e-9 * size
    at_limit = 0.9 * T / 2.0 / 1.37
    for i in range(m):
        more = found.copy()
        more[i] *= 1.005
        if more[i] < at_limit:
            assert least_part(StiffenedEnvironment(world, tuple(more)).discrete(T)) < 0.0


@pytest.mark.parametrize("seed", range(3))
def test_hands_feel_the_same_where_plain_springs_are_counted(matrices: HapticLoop, seed: int) -> None:
    rng = np.random.default_rng(seed)
    loop = replace(matrices, series=tuple(float(c) for c in rng.random(3) * matrices.series))
    run = loop.partition.join(realisations((SpringDamper([[900.0]], [[0.2]]),) * 3, T))
    own = loop.without_counted(run)
    assert own.order == run.order
    left = loop.cut.environment.environment(T)
    assert left.order == loop.environment.environment(T).order
    for z in np.exp(1j * np.array([1e-3, 0.02, 0.3, 1.5, np.pi])):
        felt = []
        for V, E in ((own, loop.environment.environment(T)), (run, left)):
            E_z = E.response(z)
            felt.append(np.linalg.solve(np.eye(3) + E_z @ V.response(z), E_z))
        np.testing.assert_allclose(felt[0], felt[1], rtol=1e-6, atol=1e-7 * np.abs(felt[0]).max())


def test_static_worlds_give_up_what_their_stiffness_leaves() -> None:
    """Without states E' = K (I - C K)^-1, for a singular K and a port that touches nothing too."""
    K = np.array([[3000.0, -3000.0, 0.0], [-3000.0, 3000.0, 0.0], [0.0, 0.0, 0.0]])
    world = of_world(StateSpaceEnvironment(("a", "b", "c"), StateSpace.static(K)))
    a, b, c = counted_parts(world)
    assert a + b == pytest.approx(0.999 / 3000.0, rel=1e-3)  # two ports share a spring, and each gives up half of it
    assert a == pytest.approx(b, rel=1e-3)
    assert c == pytest.approx(0.999 * 0.9 * T / 2.0 / 1.37, rel=1e-3)
    found = design(replace(world, series=(a, b, c)), STIFFEST).certificate
    assert all(finding.holds for finding in prove(plain(found)))


def test_worlds_that_lack_passivity_or_are_late_count_nothing() -> None:
    active = StateSpaceEnvironment(("p",), StateSpace([[-3000.0]], [[3000.0]], [[900.0]], [[100.0]]), "zoh")
    late = replace(springs(np.array([[3300.0]]), np.array([[0.3]])), delay=1)
    unstable = StateSpaceEnvironment(("p",), StateSpace([[1.1]], [[1.0]], [[-1.0]], [[100.0]]))
    for world in (active, late, unstable):
        assert counted_parts(of_world(world)) == ()
    with pytest.raises(ValueError, match="an environment without delay"):
        replace(of_world(late), series=(1e-4,))
    with pytest.raises(ValueError, match="a compliance of 0 or more"):
        replace(of_world(springs(np.array([[3300.0]]), np.array([[0.3]]))), series=(-1e-4,))


def test_matrices_of_example_1_become_nearly_as_stiff_as_its_network(stiff_matrices: Certificate) -> None:
    """c = 0.999/(k + 2 b/T), and 1/K + c > T/(2 Delta_D)."""
    b = np.array([0.1, 0.2, 0.3])
    limits = 1.0 / (T / 2.0 / 1.37 - 0.999 / (CONTACTS + 2.0 * b / T))
    assert np.diag(stiff_matrices.stiffness) == pytest.approx(limits, rel=0.01)
    assert all(finding.holds for finding in prove(plain(stiff_matrices)))
    assert judge(plain(stiff_matrices), np.random.default_rng(5), draws=20, steps=20).findings == []


def test_with_a_delay_and_rungs_too(matrices: HapticLoop, stiff_matrices: Certificate) -> None:
    found = design_ladder(stiff_matrices, STIFFEST, automatic_delays(matrices)).ladder
    assert found is not None
    assert all(finding.holds for rung in found.rungs for finding in prove(plain(rung)))
    plainly = design(replace(matrices, tau=3e-4, series=()), STIFFEST).certificate
    late = design(replace(matrices, tau=3e-4), STIFFEST).certificate
    assert np.all(np.diag(late.stiffness) > 1.5 * np.diag(plainly.stiffness))
    assert all(finding.holds for finding in prove(plain(late)))


def test_plain_springs_stand_in_the_file_in_metres_by_newton(stiff_matrices: Certificate, tmp_path: Path) -> None:
    stiff_matrices.save(tmp_path / "c.json")
    again, data = load(tmp_path / "c.json")
    loop = stiff_matrices.loop
    assert data["series"] == {p: {"compliance": c} for p, c in zip(loop.ports, loop.series, strict=True)}
    assert (data["version"], again.id) == (5, stiff_matrices.id)
    assert content(again) == content(stiff_matrices)
    assert differences(again, loop, STIFFEST) == []
    assert differences(again, replace(loop, series=(1e-4, *loop.series[1:])), STIFFEST) == [
        "the compliance of the world that is counted in series differs"
    ]


@pytest.mark.parametrize("kind", ["matrices", "functions"])
def test_transparency_is_about_the_coupling_less_the_springs(matrices: HapticLoop, kind: str) -> None:
    loop = matrices
    if kind == "functions":
        loop = of_world(springs(np.array([[3300.0]]), np.array([[0.3]])))
        loop = replace(loop, series=counted_parts(loop))
    aim = Transparency("closed-loop", Filter((0.1,), (1.0, -0.9)), Filter((1.0,), (1.0,)))
    m = len(loop.ports)
    coupling = SpringDamper(1000.0 * np.eye(m), 0.1 * np.eye(m))
    found = design(loop, SpringDamperGiven(coupling, aim)).certificate
    data, claim = plain(found), found.transparency
    assert claim is not None
    assert all(finding.holds for finding in prove(data))
    E, V = (StateSpace(*system[:4]) for system in (found.E, found.V))
    peak = 0.0
    for z in np.exp(1j * np.concatenate([[1e-6], np.geomspace(1e-3, np.pi, 3000)])):
        E_z, W = E.response(z), claim.aim.W1.response(np.array([z]))[0]
        error = np.linalg.solve(np.eye(m) + E_z @ V.response(z), E_z) - E_z
        peak = max(peak, float(np.linalg.norm(W * error, 2)))
    assert peak < claim.gamma < peak * 1.01
    port = loop.ports[0]
    other = changed(data, ("series", port, "compliance"), 0.9 * data["series"][port]["compliance"])
    assert any("transparency" in finding.condition and not finding.holds for finding in prove(other))


FALSE_SPRINGS: dict[str, tuple[tuple[Any, ...], Any, str, str]] = {
    "none": (("series", "dx", "compliance"), 0, "the world's own", "not greater than 0"),
    "negative": (("series", "dx", "compliance"), -1e-4, "the world's own", "not greater than 0"),
    "a late world": (("environment", "delay"), 1, "the world's own", "without delay"),
    "more": (("series", "dx", "compliance"), 2.75e-4, "(14)", ""),
    "less": (("series", "dx", "compliance"), 1.2e-4, "(14)", ""),
    "all": (("series", "dx", "compliance"), 1e-2, "E(1) is symmetric and >= 0", ""),
    "another world": (("environment", "C", 0, 0), 17.0, "(14)", ""),
}


@pytest.mark.parametrize("name", FALSE_SPRINGS)
def test_other_springs_are_not_proved(stiff_matrices: Certificate, name: str) -> None:
    path, value, condition, text = FALSE_SPRINGS[name]
    failing = [finding for finding in prove(changed(plain(stiff_matrices), path, value)) if not finding.holds]
    assert condition in failing[0].condition
    assert text in failing[0].argument


def test_a_spring_that_takes_the_whole_stiffness_leaves_no_world() -> None:
    """I - E(1) C is singular at c = 1/k, and just above it E'(1) is negative."""
    world = of_world(springs(np.array([[4096.0]]), np.array([[0.0]])))
    data = plain(design(replace(world, series=counted_parts(world)), STIFFEST).certificate)
    for compliance, text in ((1.0 / 4096.0, "eigenvalue 1"), (1.0 / 4095.0, "")):
        failing = [f for f in prove(changed(data, ("series", "p0", "compliance"), compliance)) if not f.holds]
        assert failing[0].condition == "the static stiffness E1 = E(1) is symmetric and >= 0"
        assert text in failing[0].argument


@pytest.mark.parametrize("value", [2e-4, {}, {"part": 0.5}, {"compliance": "all"}, {"compliance": 1e-4, "part": 0.5}])
def test_hostile_springs_are_refused(stiff_matrices: Certificate, stiff: Certificate, value: Any) -> None:
    with pytest.raises(ProofInputError, match="series"):
        prove(changed(plain(stiff_matrices), ("series", "dx"), value))
    if isinstance(value, dict):
        with pytest.raises(ProofInputError, match="series"):
            prove(changed(plain(stiff), ("series", "dx"), value))
    with pytest.raises((ValueError, TypeError)):
        from_content(changed(plain(stiff_matrices), ("series", "dx"), value))


def test_hands_shake_a_coupling_beyond_the_plain_springs(stiff_matrices: Certificate) -> None:
    """The oracle knows E': with V at 1.5 times its limit it finds hands that shake the loop."""
    data = plain(stiff_matrices)
    for name in data["coupling"]["blocks"]:
        data["coupling"]["blocks"][name] = {"stiffness": [[1.5 * 2740.0]], "damping": [[0.0]]}
    found = judge(sealed({**data, "margins": {}}), np.random.default_rng(5), draws=20, steps=40)
    assert any(finding.startswith("shaken") for finding in found.findings)


@pytest.mark.parametrize(
    ("A", "gain", "D", "method"),
    [
        ([[0.0, 1.0], [-1.5e6, -40.0]], 6.4e3, 3000.0, "zoh"),
        ([[0.0, 1.0], [-5.38e6, -151.5]], 1.1197e4, 3023.3, "tustin"),
    ],
    ids=["E' unstable at first", "E' not passive at first"],
)
def test_a_resonance_between_the_angles_of_the_program_is_found(
    A: list[list[float]], gain: float, D: float, method: Method
) -> None:
    """A mass on a spring, sampled: its own angle is in the program from the start; the one that decides is not."""
    world = StateSpaceEnvironment(("p",), StateSpace(A, [[0.0], [-gain]], [[gain, 0.0]], [[D]]), method)
    (found,) = counted_parts(of_world(world))
    left, more = (StiffenedEnvironment(world, (c,)).discrete(T) for c in (found, 1.005 * found))
    assert np.max(np.abs(np.linalg.eigvals(left.A))) < 1.0
    angles = np.linspace(0.5, np.pi, 20_000)
    assert least_part(left, angles) >= 0.0
    assert least_part(more, angles) < 0.0 or np.max(np.abs(np.linalg.eigvals(more.A))) >= 1.0


@pytest.mark.parametrize("kind", ["matrices", "functions"])
def test_the_proof_rebuilds_the_world_that_is_left(matrices: HapticLoop, kind: str) -> None:
    """The prover's E', in balls, has the response E (I - C E)^-1, and E'(1) exactly."""
    loop = matrices
    if kind == "functions":
        K = np.array([[3300.0, -700.0], [-700.0, 2500.0]])
        loop = replace(of_world(springs(K, 0.3 * np.eye(2))), series=(2e-4, 1e-4))
    m = len(loop.ports)
    data = StiffenedData(
        read_environment(Item(loop.environment.terms(), "environment"), loop.ports),  # type: ignore[arg-type]
        fmpq_mat(m, m, [exact_decimal(c) if i == j else 0 for i, c in enumerate(loop.series) for j in range(m)]),
    )
    rest = split_of_proof(data, exact_decimal(T))
    A, B, C, D = (
        np.array([[float(entry) for entry in row] for row in M.tolist()]).reshape(M.nrows(), M.ncols())
        for M in environment_of_proof(rest, exact_decimal(T))
    )
    E = loop.environment.environment(T)
    for z in np.exp(1j * np.array([1e-4, 0.02, 0.3, 1.5, np.pi])):
        expected = E.response(z) @ np.linalg.inv(np.eye(m) - np.diag(loop.series) @ E.response(z))
        np.testing.assert_allclose(StateSpace(A, B, C, D).response(z), expected, rtol=1e-6, atol=1e-6)
    steady = E.response(1.0).real
    left = steady @ np.linalg.inv(np.eye(m) - np.diag(loop.series) @ steady)
    found = [[float(entry) for entry in row] for row in rest.stiffness.tolist()]
    np.testing.assert_allclose(found, left, rtol=1e-9, atol=1e-9)
