"""Certificates of sites and worlds with changed data and recomputed ids: whatever numpy refutes is not proved."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import json
import random
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from manyhands.design.certificate import content
from manyhands.design.models.coupling import Partition
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.problem import DeviceLevel, HapticLoop, SpringDamperWanted, Wish
from manyhands.design.proof import ProofInputError, prove, prove_together, prove_world
from manyhands.design.synthesis import design
from manyhands.design.wave_link import WaveLinkFace, WorldPromise, in_tick_id, wave_link_id
from manyhands.design.world import world_content, world_terms
from manyhands.design.world_synthesis import design_world

from ...support.cases import cases
from .test_hostile_json import VALUES, paths

Data = dict[str, Any]
Path = tuple[Any, ...]
T = 1e-3
PORTS = ("a", "b", "c")
B = np.array([[20.0, 3.0], [3.0, 10.0]])
TANK, R, HARVEST = 0.01, 0.006, (0.25, 0.2)
MASS = np.array([[0.06, 0.009], [0.009, 0.03]])  # exactly b R/2
CLEARLY = 1e-5  # relative


def name_of(terms: Data) -> str:
    return hashlib.sha256(json.dumps(terms, separators=(",", ":")).encode()).hexdigest()


def renamed(data: Data) -> Data:
    """With the names of its contracts made again from its own terms, as a careful forger would have them."""
    out = copy.deepcopy(data)
    if out["format"] == "manyhands-world":
        for name, link in out["wave_links"].items():
            terms = {"session": out["session"], "coupling": name, "ports": out["structure"][name]}
            link["id"] = name_of({"contract": "wave-link", **terms, "b": link["b"], "tank": link["tank"]})
        if (own := out["in_tick"]) is not None:
            terms = {"session": out["session"], "period": out["period"], "ports": own["ports"]}
            own["id"] = name_of({"contract": "in-tick", **terms, "level": own["level"]})
        return out
    environment = out["environment"]
    if environment["type"] == "wave-link":
        terms = {"session": out["session"], "coupling": next(iter(out["structure"])), "ports": out["ports"]}
        terms |= {"b": environment["b"], "tank": environment["tank"]}
        environment["id"] = name_of({"contract": "wave-link", **terms})
    else:
        terms = {"session": out["session"], "period": out["period"], "ports": out["ports"]}
        environment["id"] = name_of({"contract": "in-tick", **terms, "level": environment["level"]})
    return out


@pytest.fixture(scope="module")
def site() -> Data:
    """Two devices in one coupling, with a matrix b, a felt mass allowed, and a harvest."""
    ports = PORTS[:2]
    face = WaveLinkFace(
        ports,
        id=wave_link_id("test", "cab", ports, B, TANK),
        b=B,
        tank=TANK,
        harvest=HARVEST,
        round_trip=R,
        mass=MASS,
    )
    devices = (DeviceLevel("da", (0,), [[1.37]]), DeviceLevel("db", (1,), [[1.0]]))
    loop = HapticLoop("test", T, ports, devices, Partition(("cab",), ((0, 1),)), face, tau=1e-4)
    made = design(loop, SpringDamperWanted(Wish("feasible"))).certificate
    return {"id": made.id, **content(made)}


@pytest.fixture(scope="module")
def in_tick() -> Data:
    level = np.array([[0.2]])
    promise = WorldPromise(("c",), level, id=in_tick_id("test", T, ("c",), level))
    loop = HapticLoop("test", T, ("c",), (DeviceLevel("dc", (0,), [[1.37]]),), Partition(("cc",), ((0,),)), promise)
    made = design(loop, SpringDamperWanted()).certificate
    return {"id": made.id, **content(made)}


@pytest.fixture(scope="module")
def world() -> Data:
    links = [NetworkLink((port, "hub"), 3000.0, 0.2) for port in PORTS] + [NetworkLink(("hub", GROUND), 2600.0, 0.5)]
    network = Network(PORTS, (("hub", 3.0),), tuple(links))
    made = design_world(world_terms("test", T, network, Partition(("cab", "cc"), ((0, 1), (2,))), {"cab": (B, TANK)}))
    return {"id": made.id, **world_content(made)}


def proved(data: Data) -> bool:
    try:
        found = prove_world(data) if data["format"] == "manyhands-world" else prove(data)
    except ProofInputError:
        return False
    return all(finding.holds for finding in found)


def failing(data: Data) -> str:
    found = prove_world(data) if data["format"] == "manyhands-world" else prove(data)
    return next(finding.condition for finding in found if not finding.holds)


def changed(data: Data, path: Path, value: Any) -> Data:
    out = copy.deepcopy(data)
    at = out
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return out


def test_what_is_designed_is_proved(site: Data, in_tick: Data, world: Data, certificates) -> None:
    for data in (site, in_tick, world):
        assert proved(data)
        assert certificates.seal(renamed(data)) == data  # the names and ids, computed a second time
    assert all(finding.assumed for finding in prove(site) if finding.condition.startswith("E_hat is"))
    assert not any(finding.enforced for finding in prove(site))


SITE_CHANGES: list[tuple[Path, Callable[[Any], Any], str]] = [
    (("environment", "b"), lambda b: [[20.0, 3.0], [3.0, 10.1]], "felt mass"),  # by 0.3 g
    (("environment", "b"), lambda b: [[20.0, 25.0], [25.0, 20.0]], "wave impedance"),
    (("environment", "b"), lambda b: [[19.0, 3.0], [3.0, 9.0]], "margin felt stiffness"),
    (("environment", "tank"), lambda tank: -tank, "tank"),
    (("environment", "harvest"), lambda theta: [theta[0], theta[1] + 1e-9], "E_hat is (-Phi_E)-ISP"),
    (("environment", "harvest"), lambda theta: [theta[0], -0.1], "harvest"),
    (("environment", "round_trip"), lambda R: 1.01 * R, "felt mass"),
    (("environment", "round_trip"), lambda R: -R, "round trip"),
    (("environment", "mass"), lambda M: [[0.06, 0.009], [0.009, 0.0299]], "felt mass"),
    (("margins", "felt stiffness"), lambda K: 1.00001 * K, "margin felt stiffness"),
    (("structure",), lambda s: {"ca": ["a"], "cb": ["b"]}, ""),
    (("structure",), lambda s: {"cab": ["b", "a"]}, ""),
]


@pytest.mark.parametrize(("path", "change", "reason"), SITE_CHANGES)
def test_each_number_of_a_site_is_held_to(site: Data, certificates, path: Path, change: Any, reason: str) -> None:
    value = site
    for key in path:
        value = value[key]
    data = changed(site, path, change(copy.deepcopy(value)))
    if path[-1] in ("b", "tank"):
        assert "id of the wave link" in failing(certificates.seal(data))  # by the name, unless that is forged, too
    data = certificates.seal(renamed(data))
    if reason:
        assert reason in failing(data)
    assert not proved(data)


WORLD_CHANGES: list[tuple[Path, Any, str]] = [
    (("wave_links", "cab", "b"), [[20.0, 25.0], [25.0, 20.0]], "wave impedance"),
    (("wave_links", "cab", "tank"), -1e-9, "tank"),
    (("wave_links",), {}, "every port has one coupling"),
    (("in_tick",), None, "every port has one coupling"),
    (("in_tick", "ports"), ["a"], "every port has one coupling"),
    (("in_tick", "level"), [[-0.5]], "condition (A)"),
    (("levels", "Phi_E", "cab"), [[0.1, 0.0], [0.0, -0.4]], "condition (A)"),
    (("levels", "Phi_E", "cab"), [[-0.8, 0.0], [0.0, -0.4]], "E_hat is (-Phi_E)-ISP"),
    (("environment", "links", 0, "stiffness"), 300.0, "E_hat is (-Phi_E)-ISP"),
    (("environment", "links", 0, "stiffness"), -3000.0, "no stiffness and no damping is negative"),
    (("period",), 1e-4, "E_hat is (-Phi_E)-ISP"),
    (("period",), 0.0, "0 < T"),
    (("margins", "(A)"), 0.5, "margin (A)"),
    (("margins", "(10)"), 0.1, "margin (10)"),
]


@pytest.mark.parametrize(("path", "value", "reason"), WORLD_CHANGES)
def test_each_number_of_a_world_is_held_to(world: Data, certificates, path: Path, value: Any, reason: str) -> None:
    assert reason in failing(certificates.seal(renamed(changed(world, path, value))))


def test_the_names_of_contracts_are_held_to(world: Data, in_tick: Data, certificates) -> None:
    for data, path, what in (
        (world, ("wave_links", "cab", "tank"), "wave link of cab"),
        (world, ("in_tick", "level"), "users in the tick"),
        (in_tick, ("environment", "level"), "promise"),
    ):
        value = [[0.1]] if path[-1] == "level" else 0.02
        assert what in failing(certificates.seal(changed(data, path, value)))
    assert failing(changed(world, ("session",), "other")) == "the id is the SHA-256 of the content"


MALFORMED: list[tuple[Path, Any, str]] = [
    (("version",), 2, "version"),
    (("format",), "manyhands-certificate", "format"),
    (("ports",), ["a", "a", "c"], "one distinct name"),
    (("wave_links",), {"cx": {"id": "", "b": [[1.0]], "tank": 0.0}}, "one of structure"),
    (("wave_links", "cab", "b"), [[20.0, 3.0], [2.0, 10.0]], "symmetric"),
    (("wave_links", "cab", "b"), [[20.0]], "rows"),
    (("in_tick", "ports"), ["d"], "one of the certificate's ports"),
    (("environment",), {"type": "world", "id": "", "level": [[0.0] * 3] * 3}, "an environment, or a declared level"),
    (("storage", "E_hat"), "enforced", "energy"),
    (("method",), {"algorithm": 1.5}, "whole number"),
    (("more",), 1, "unknown keys"),
]


@pytest.mark.parametrize(("path", "value", "expected"), MALFORMED)
def test_a_malformed_world_is_refused_with_its_place(world: Data, path: Path, value: Any, expected: str) -> None:
    with pytest.raises(ProofInputError, match=expected):
        prove_world(changed(world, path, value))


def test_a_felt_mass_needs_a_round_trip(site: Data) -> None:
    with pytest.raises(ProofInputError, match=r"environment.round_trip: found None"):
        prove(changed(site, ("environment", "round_trip"), None))
    with pytest.raises(ProofInputError, match="missing keys"):
        prove({**site, "environment": {k: v for k, v in site["environment"].items() if k != "harvest"}})


def test_only_certificates_of_one_contract_belong_together(
    site: Data, in_tick: Data, world: Data, certificates
) -> None:
    promised = certificates.seal(renamed(changed(world, ("in_tick", "level"), [[0.2]])))
    assert proved(promised)
    assert [finding.holds for finding in prove_together(promised, [site, in_tick])] == [True, True]
    assert [finding.holds for finding in prove_together(world, [site, in_tick])] == [True, False]  # 0 is promised there
    softer = certificates.seal(renamed(changed(promised, ("wave_links", "cab", "b"), (0.9 * B).tolist())))
    assert proved(softer)
    assert [finding.holds for finding in prove_together(softer, [site, in_tick])] == [False, True]
    ordinary = changed(in_tick, ("environment",), {"type": "declared", "level": [[0.2]]})
    assert [finding.holds for finding in prove_together(promised, [ordinary])] == [False]


@given(data=st.data())
@settings(max_examples=cases(60, 400), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_for_any_value_a_proof_ends_with_findings_or_one_error(
    site: Data, in_tick: Data, world: Data, data: st.DataObject
) -> None:
    base = data.draw(st.sampled_from([site, in_tick, world]))
    path = data.draw(st.sampled_from([path for path in paths(base) if path[0] != "asked"]))
    hostile = json.loads(json.dumps(changed(base, path, data.draw(VALUES))))
    try:
        found = prove_world(hostile) if base is world else prove(hostile)
    except ProofInputError:
        return
    assert found
    assert all(isinstance(finding.holds, bool) for finding in found)
    with contextlib.suppress(ProofInputError):
        prove_together(hostile if base is world else world, [] if base is world else [hostile])


# --- an opinion of numpy on random changes


def leaves(value: Any, path: Path = ()) -> Iterator[Path]:
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(item, (*path, key))
    elif isinstance(value, int | float):
        yield path


def least(M: Any) -> float:
    return float(np.linalg.eigvalsh((np.array(M) + np.array(M).T) / 2.0)[0])


def refuted_site(data: Data, certificates) -> bool:
    environment, (name,) = data["environment"], data["structure"]
    b, theta, R = np.array(environment["b"]), environment["harvest"], environment["round_trip"]
    M = np.array(environment["mass"])
    if least(b) < -CLEARLY or min(theta) < -CLEARLY or environment["tank"] < 0.0 or R <= 0.0:
        return True
    if least(M - R / 2.0 * b) < -CLEARLY * np.abs(M).max():
        return True
    K = np.array(data["coupling"]["blocks"][name]["stiffness"])
    if least(K) <= 0.0:
        return True
    felt = np.linalg.inv(np.linalg.inv(K) + R / 2.0 * np.linalg.inv(b))
    if data["margins"].get("felt stiffness", -np.inf) > least(felt) * (1.0 + CLEARLY):
        return True
    Phi = np.array(data["levels"]["Phi_E"][name])
    if least(Phi - np.diag(theta)) < -CLEARLY:
        return True
    ordinary = {**data, "environment": {"type": "declared", "level": Phi.tolist()}}
    ordinary["levels"] = {**data["levels"], "Phi_E": Phi.tolist()}
    try:
        return bool(certificates.refuted(ordinary))
    except KeyError:  # the opinion has come to the environment: there is nothing more to refute
        return False


def refuted_world(data: Data, certificates) -> bool:
    if not data["period"] > 0.0:
        return True
    Phi, promised = np.zeros((3, 3)), np.zeros((3, 3))
    Phi[:2, :2], Phi[2:, 2:] = data["levels"]["Phi_E"]["cab"], data["levels"]["Phi_E"]["cc"]
    promised[2:, 2:] = data["in_tick"]["level"]
    links = data["environment"]["links"]
    if min(min(link["stiffness"], link["damping"]) for link in links) < 0.0 or data["environment"]["delay"] < 0:
        return True
    if data["environment"]["masses"]["hub"] <= 0.0:
        return True
    link = data["wave_links"]["cab"]
    if least(link["b"]) < -CLEARLY or link["tank"] < 0.0:
        return True
    A = least(promised - Phi)
    if A < -CLEARLY or data["margins"].get("(A)", -np.inf) > A + CLEARLY:
        return True
    K, D, _ = certificates.network_matrices(data["environment"], data["ports"])
    Z = D + data["period"] * K / 2.0
    Z[:3, :3] += Phi
    return least(Z) < -CLEARLY


@pytest.mark.parametrize("kind", ["site", "world"])
def test_what_is_made_false_is_not_proved(
    kind: str, site: Data, world: Data, certificates, request: pytest.FixtureRequest
) -> None:
    """Two hundred false claims each, from changes of every size; names and ids are those of the changed terms."""
    data = site if kind == "site" else world
    refuted = refuted_site if kind == "site" else refuted_world
    sections = ("period", "environment", "wave_links", "in_tick", "coupling", "levels", "margins")
    choose = random.Random(f"contracts of a {kind}")
    spots = [found for key in sections if key in data and (found := list(leaves(data[key], (key,))))]
    assert not refuted(data, certificates)
    false: dict[str, int] = {}
    for _ in range(3000):
        path = choose.choice(choose.choice(spots))
        old: Any = data
        for key in path:
            old = old[key]
        new = old * (1.0 + choose.choice((-1.0, 1.0)) * 10.0 ** choose.uniform(-4.0, 1.0))
        new = choose.choice((-old, 0.0, old + 1.0)) if choose.random() < 0.2 else new
        mutant = changed(data, path, int(new) if isinstance(old, int) else new)
        if isinstance(path[-1], int) and isinstance(path[-2], int):
            mutant = changed(mutant, (*path[:-2], path[-1], path[-2]), new)
        if path[0] != "margins":
            mutant["margins"] = {}
        try:
            if not refuted(mutant, certificates):
                continue
        except (np.linalg.LinAlgError, ZeroDivisionError):
            continue  # no opinion
        false[path[0]] = false.get(path[0], 0) + 1
        assert not proved(certificates.seal(renamed(mutant))), (path, old, new)
        if sum(false.values()) == 200:
            break
    assert sum(false.values()) == 200, false
    assert len(false) >= 5, false
