"""A session with wave links falls into parts that are designed alone, and whose certificates belong together."""

from __future__ import annotations

import json
import random
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manyhands.design.certificate import content, from_content, identity, to_json
from manyhands.design.errors import CertificateError, Infeasible
from manyhands.design.ladder import automatic_delays, design_ladder
from manyhands.design.levels.contract import margin_of
from manyhands.design.proof import prove, prove_together, prove_world
from manyhands.design.wave_link import felt_mass
from manyhands.design.world import World, save_world, world_content, world_differences
from manyhands.launch.plan.sites import IN_TICK, SessionPart, differences_from, in_tick, site, world
from manyhands.launch.session import Session, WaveLink, load_session

DEVICE = "{dof: 1, osp: 1.37, driver: simulated, mass: 0.2}"
LINKED = {
    "cx": "{mass: 0.05, round_trip: 0.004, period: 0.00025, tau: 0.00005}",
    "cy": "{b: 20, round_trip: 0.006, harvest: 0.2}",
    "cz": "",
}


def session(tmp_path: Path, links: dict[str, str] | None = None, *overrides: str, floating: bool = False) -> Session:
    """Hands on one hub, which hangs on a spring or floats; with a wave link where a coupling has a text."""
    links = LINKED if links is None else links
    devices = {name: f"d{name[1:]}" for name in links}
    lines = ["session: linked", "period: 0.001", "devices:"]
    lines += [f"  {device}: {DEVICE}" for device in devices.values()]
    lines += ["couplings:"]
    lines += [f"  {c}: {{devices: [{d}]{f', wave_link: {links[c]}' if links[c] else ''}}}" for c, d in devices.items()]
    lines += ["environment:", "  type: network", "  masses: {hub: 3.0}", "  links:"]
    lines += [f"    - {{between: [{device}, hub], stiffness: 3500, damping: 0.2}}" for device in devices.values()]
    lines += [] if floating else ["    - {between: [hub, ground], stiffness: 2600, damping: 0.5}"]
    lines += ["design: {coupling: spring-damper, objective: stiffest}"]
    path = tmp_path / "linked.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return load_session(path, overrides)


def data_of(made: World | Any) -> dict[str, Any]:
    plain = world_content(made) if isinstance(made, World) else content(made)
    return {"id": made.id, **plain}


def parts(given: Session) -> tuple[SessionPart, ...]:
    sites = tuple(site(given, name) for name in given.wave_links)
    return sites if len(sites) == len(given.couplings) else (*sites, in_tick(given))


def designed(given: Session) -> dict[str, Any]:
    return {part.name: part.design().certificate for part in parts(given)}


def test_every_part_is_proved_and_meets_the_world(tmp_path: Path) -> None:
    given = session(tmp_path)
    made = designed(given)
    assert list(made) == ["cx", "cy", IN_TICK]
    whole = world(given)
    for certificate in made.values():
        assert all(finding.holds for finding in prove(data_of(certificate)))
        assert from_content(json.loads(to_json(certificate))).loop.environment == certificate.loop.environment
        assert differences_from(certificate, given) == []
    assert all(finding.holds for finding in prove_world(data_of(whole)))
    together = prove_together(data_of(whole), [data_of(certificate) for certificate in made.values()])
    assert [finding.holds for finding in together] == [True] * 3
    assert world_differences(data_of(whole), whole) == []
    # by hand: two users at 1 kHz have 2 Delta_D/T = 2740 N/m; cx has 4 kHz and 0.05 ms: 1.37/(0.125 ms + 0.075 ms)
    assert made[IN_TICK].spring_damper.stiffness[0, 0] == pytest.approx(2740.0, rel=1e-3)
    assert made["cx"].spring_damper.stiffness[0, 0] == pytest.approx(6850.0, rel=5e-3)
    assert made["cx"].loop.environment.b[0, 0] == 2 * 0.05 / 0.004
    felt = {name: made[name].margins["felt stiffness"] for name in ("cx", "cy")}
    springs = {name: made[name].spring_damper.stiffness[0, 0] for name in felt}
    assert felt["cx"] == pytest.approx(1.0 / (1.0 / springs["cx"] + 0.002 / 25.0))
    assert felt["cy"] == pytest.approx(1.0 / (1.0 / springs["cy"] + 0.003 / 20.0))
    assert "felt stiffness" not in made[IN_TICK].margins


def test_who_else_takes_part_does_not_change_a_site_by_a_byte(tmp_path: Path) -> None:
    before = {name: to_json(certificate) for name, certificate in designed(session(tmp_path)).items()}
    joined = designed(session(tmp_path, {**LINKED, "cw": "{mass: 0.5, round_trip: 0.04}"}))
    assert {name: to_json(joined[name]) for name in before} == before
    left = designed(session(tmp_path, {"cx": LINKED["cx"], "cz": ""}))
    assert {name: to_json(left[name]) for name in left} == {name: before[name] for name in left}
    alone = designed(session(tmp_path, {"cy": LINKED["cy"]}))
    assert to_json(alone["cy"]) == before["cy"]
    harder = session(tmp_path, None, "environment.links.0.stiffness=9000", "devices.dz.osp=0.4")
    assert {name: to_json(site(harder, name).design().certificate) for name in ("cx", "cy")} == {
        name: before[name] for name in ("cx", "cy")
    }


def test_a_world_says_what_differs(tmp_path: Path) -> None:
    given = session(tmp_path)
    data = data_of(world(given))
    for override, key in (
        ("environment.links.0.stiffness=9000", "environment"),
        ("couplings.cy.wave_link.b=21", "wave_links"),
        ("couplings.cy.wave_link.tank=0.006", "wave_links"),
        ("session=other", "session"),
    ):
        assert f"the {key} differs from the session's" in world_differences(
            data, world(session(tmp_path, None, override))
        )
    # what belongs to a site alone is none of the world's
    other = session(
        tmp_path, None, "couplings.cy.wave_link.harvest=0.1", "devices.dx.osp=2", "couplings.cy.wave_link.depth=3"
    )
    assert world_differences(data, world(other)) == []


def test_a_certificate_says_what_differs_from_its_part(tmp_path: Path) -> None:
    given = session(tmp_path)
    made = designed(given)
    assert differences_from(made["cy"], session(tmp_path, None, "couplings.cy.wave_link.harvest=0.1")) == [
        "the environment differs"
    ]
    assert differences_from(made[IN_TICK], session(tmp_path, None, "devices.dz.osp=1"))
    without = session(tmp_path, {"cx": "", "cy": "", "cz": ""})
    assert "the environment differs" in differences_from(made[IN_TICK], without)
    assert "the environment differs" in differences_from(made["cx"], without)
    only = session(tmp_path, {**LINKED, "cz": "{b: 3}"})
    with pytest.raises(ValueError, match="linked: found a wave link at every coupling"):
        in_tick(only)
    for name in ("cy", IN_TICK):
        relinked = session(tmp_path, {**LINKED, "cy": "", "cz": "{b: 3}"}) if name == "cy" else only
        (text,) = differences_from(made[name], relinked)
        assert text.endswith("and no part like this one")


def test_a_site_is_designed_beside_a_world_that_is_refused(tmp_path: Path) -> None:
    given = session(tmp_path, None, "environment={type: python, model: 'a:b', level: 0, enforce: false}")
    before = site(session(tmp_path), "cx").design().certificate
    assert to_json(site(given, "cx").design().certificate) == to_json(before)
    with pytest.raises(Infeasible, match="its level is not enforced"):
        in_tick(given)


def test_a_floating_world_keeps_its_contracts_though_not_strictly(tmp_path: Path) -> None:
    given = session(tmp_path, None, "environment.links.0.damping=0", floating=True)
    whole = world(given)
    assert whole.margins == {"(A)": 0.0}
    assert not np.any(whole.Phi_E)
    assert all(finding.holds for finding in prove_world(data_of(whole)))


@pytest.mark.parametrize(
    ("override", "reason"),
    [
        ("environment.delay=1", "the environment needs 1.95 N·s/m"),
        ("environment={type: python, model: 'a:b', level: 0.2}", "the environment needs 0.2 N·s/m"),
        (
            "environment={type: python, model: 'a:b', level: [[0, 0, 0.1], [0, 0, 0], [0.1, 0, 0.2]]}",
            "joins ports of wave links with ports of users in the tick",
        ),
        ("environment={type: python, model: 'a:b', level: 0, enforce: false}", "its level is not enforced"),
    ],
)
def test_a_world_that_lacks_passivity_at_a_wave_link_is_refused(tmp_path: Path, override: str, reason: str) -> None:
    with pytest.raises(Infeasible, match=reason.replace("*", r"\*")):
        world(session(tmp_path, None, override))


@pytest.mark.parametrize(
    "override",
    [
        "environment={type: python, model: 'a:b', level: [-0.1, 0, 0.2]}",
        "environment.links=[{between: [dx, hub], stiffness: {between: [3000, 3800]}, damping: 0.1},"
        "{between: [dy, hub], stiffness: 3800},{between: [dz, hub], stiffness: 3800}]",
        "environment={type: transfer-function, entries: [[{num: [0.3, 100], den: [1]},0,0],"
        "[0,{num: [0.3, 100], den: [1]},0],[0,0,{num: [0.3, 100], den: [1]}]]}",
        "design={coupling: linear, order: {cx: 1, cy: 2, cz: 2}, objective: stiffest}",
        "design={coupling: given, stiffness: [700, 800, 900], damping: 0.1}",
        "design={coupling: spring-damper, tau: 0.0002, period_tolerance: 0.1}",
    ],
)
def test_every_kind_of_world_and_coupling(tmp_path: Path, override: str) -> None:
    given = session(tmp_path, None, override)
    made, whole = designed(given), world(given)
    assert all(finding.holds for certificate in made.values() for finding in prove(data_of(certificate)))
    assert all(finding.holds for finding in prove_world(data_of(whole)))
    assert all(f.holds for f in prove_together(data_of(whole), [data_of(c) for c in made.values()]))
    stiffness = {"cx": 700.0, "cy": 800.0, IN_TICK: 900.0}
    if "given" in override:
        assert {name: float(c.spring_damper.stiffness[0, 0]) for name, c in made.items()} == stiffness


def test_a_coupling_of_several_ports_has_a_matrix_b(tmp_path: Path) -> None:
    given = session(tmp_path)
    plain = given.as_plain()
    plain["couplings"] = {
        "cz": {"devices": ["dz"]},
        "both": {
            "ports": ["dy", "dx"],
            "wave_link": {"b": [[20.0, 3.0], [3.0, 10.0]], "round_trip": 0.01, "harvest": [0.3, 0.2]},
        },
    }
    joined = Session.model_validate(plain)
    made, whole = designed(joined), world(joined)
    both = made["both"]
    assert both.loop.ports == ("dy", "dx")
    assert [device.ports for device in both.loop.devices] == [(1,), (0,)]
    assert np.array_equal(both.loop.environment.level, np.diag([0.3, 0.2]))
    assert all(f.holds for f in prove_together(data_of(whole), [data_of(c) for c in made.values()]))
    least = np.linalg.eigvalsh(np.linalg.inv(np.linalg.inv(both.coupling[0].stiffness) + 0.005 * np.linalg.inv(
        [[20.0, 3.0], [3.0, 10.0]])))[0]  # fmt: skip
    assert both.margins["felt stiffness"] == pytest.approx(least)


def test_a_site_has_a_ladder_like_any_loop(tmp_path: Path) -> None:
    part = site(session(tmp_path), "cy")
    first = part.design().certificate
    found = design_ladder(first, part.request, automatic_delays(first.loop))
    (note,) = found.notes  # with a delay of a whole tick 1.37/9 = 0.152 N*s/m are left, less than the harvest of 0.2
    assert note.startswith("no rung for a delay of 1 ms: ")
    assert found.ladder is not None
    assert found.ladder.taus == (0.0, 0.25e-3, 0.5e-3)
    assert found.ladder.independent
    felt = [rung.margins["felt stiffness"] for rung in found.ladder.rungs]
    assert felt == sorted(felt, reverse=True)
    assert all(finding.holds for rung in found.ladder.rungs for finding in prove(data_of(rung)))


def test_the_parts_conditions_give_the_condition_of_the_whole(tmp_path: Path) -> None:
    """blkdiag(Delta_G, Delta_V, 0) - J S Phi_E S J' >= 0 at every ratio; strictly for users in the tick."""
    choose = random.Random("ratios")
    given = session(tmp_path, None, "environment={type: python, model: 'a:b', level: [-0.3, 0, 0.4]}")
    (*_, others), whole = parts(given), world(given)
    levels = others.design().certificate.levels
    Delta_G, Delta_V = levels.device.share * levels.Delta_D[0], levels.Delta_V[0]
    least = min(Delta_G[0, 0], Delta_V[0, 0], margin_of(Delta_G, Delta_V, levels.Phi_E))
    for _ in range(200):
        S = np.diag([choose.choice((0.0, choose.random(), 1.0)) for _ in range(3)])
        # rows: y and u of dz, then w of dx and dy at the world's faces
        J = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        M = np.zeros((4, 4))
        M[0, 0], M[1, 1] = Delta_G[0, 0], Delta_V[0, 0]
        M -= J @ S @ whole.Phi_E @ S @ J.T
        assert np.linalg.eigvalsh(M - np.diag([least, least, 0.0, 0.0]))[0] >= -1e-12


@given(mass=st.floats(1e-6, 100.0), round_trip=st.floats(1e-6, 10.0))
def test_the_impedance_for_a_mass_is_exactly_within_it(mass: float, round_trip: float) -> None:
    link = WaveLink.model_validate({"mass": mass, "round_trip": round_trip})
    (b,) = link.impedance(1)[0]
    half = Fraction(repr(float(b))) * Fraction(repr(round_trip)) / 2
    assert half <= Fraction(repr(mass))
    assert felt_mass(np.array([[b]]), round_trip)[0, 0] == pytest.approx(mass, rel=1e-12)


def test_a_prepared_session_runs_each_party_under_its_own_certificate(tmp_path: Path) -> None:
    from manyhands.launch.plan.bundles import RunPlan, cut
    from manyhands.launch.plan.prepare import prepare
    from manyhands.launch.plan.sites import IN_TICK
    from manyhands.nodes.kernel.bundle import SIMULATED, CouplingBundle, DeviceBundle, EnvironmentBundle

    prepared = prepare(session(tmp_path))
    assert prepared.certificate is None
    assert prepared.certified
    assert prepared.world is not None
    assert prepared.parts.keys() == {"cx", "cy", IN_TICK}
    bundles = cut(prepared, RunPlan(SIMULATED, None, ""))
    for coupling, device in (("cx", "dx"), ("cy", "dy"), ("cz", "dz")):
        own = prepared.certificate_of(coupling)
        assert own is prepared.certificate_of(device) is prepared.parts.get(coupling, prepared.parts[IN_TICK])
        block, hand = bundles[coupling], bundles[device]
        assert isinstance(block, CouplingBundle)
        assert isinstance(hand, DeviceBundle)
        assert hand.rungs[0].tau == own.tau
        np.testing.assert_array_equal(block.level, own.levels.Delta_V[0])
        assert block.common.period == own.loop.period
        assert (block.wave is not None) == (coupling in prepared.session.wave_links)
    world = bundles["environment"]
    assert isinstance(world, EnvironmentBundle)
    np.testing.assert_array_equal(world.Phi_E, prepared.world.Phi_E)
    assert world.waves.keys() == {"cx", "cy"}


def test_certificates_of_a_run_are_read_from_its_folder_and_of_no_other(tmp_path: Path) -> None:
    from manyhands.launch.plan.loop import NotCertified
    from manyhands.launch.plan.prepare import prepare
    from manyhands.launch.run.directory import kept_files

    given = session(tmp_path)
    prepared = prepare(given)
    for name, text in kept_files(prepared).items():
        (tmp_path / name).write_bytes(text)
    again = prepare(given, tmp_path / "certificate.json")
    assert again.id == prepared.id
    with pytest.raises(NotCertified, match=r"certificate\.cx\.json: a certificate of another session"):
        prepare(session(tmp_path, None, "devices.dx.osp=1.2"), tmp_path / "certificate.json")
    (tmp_path / "certificate.cx.json").unlink()
    with pytest.raises(CertificateError, match=r"certificate\.cx\.json"):
        prepare(given, tmp_path / "certificate.json")


def test_a_world_of_another_hand_keeps_its_own_level(tmp_path: Path) -> None:
    """A level that is proved serves, whichever version of a library found it."""
    from manyhands.launch.plan.prepare import prepare
    from manyhands.launch.run.directory import kept_files

    given = session(tmp_path)
    prepared = prepare(given)
    assert prepared.world is not None
    for name, text in kept_files(prepared).items():
        (tmp_path / name).write_bytes(text)
    found = prepared.world
    halved = {name: 0.5 * margin for name, margin in found.margins.items()}
    other = found.kept(0.5 * found.Phi_E, found.P_E, halved, {"algorithm": "by hand"})
    file = tmp_path / "certificate.json"
    save_world(other, file)
    again = prepare(given, file).world
    assert again is not None
    assert again.id == other.id != found.id
    np.testing.assert_array_equal(again.Phi_E, other.Phi_E)
    data = json.loads(file.read_text())
    data["margins"] = data.pop("margins")  # now after the method: written again, its id would be another
    data["id"] = identity(data)
    file.write_text(json.dumps(data))
    with pytest.raises(CertificateError, match=r"certificate\.json: not a world as manyhands writes it"):
        prepare(given, file)


def test_a_run_that_may_be_uncertified_still_has_the_parts_certificates(tmp_path: Path) -> None:
    """Never that of all couplings in the tick, which says nothing of a session with wave links."""
    from manyhands.launch.plan.prepare import prepare

    given = session(tmp_path)
    either = prepare(given, uncertified=True)
    assert either.certificate is None
    assert either.world is not None
    assert either.id == prepare(given).id
    stiff = ("design.coupling=given", "design.objective=feasible", "design.stiffness=9000", "design.damping=1")
    unproved = prepare(session(tmp_path, None, *stiff), uncertified=True)
    assert not unproved.certified
    assert unproved.certificates == ()
