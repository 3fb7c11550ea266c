"""The ladder from a session file to the bundles: which rungs there are, and which process gets what of them."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from manyhands.design.certificate import content, save
from manyhands.design.proof import prove
from manyhands.launch.plan.bundles import RunPlan, cut
from manyhands.launch.plan.prepare import Prepared, prepare
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.nodes.kernel import bundle as bundle_files
from manyhands.nodes.kernel.bundle import (
    BundleError,
    CouplingBundle,
    CouplingRung,
    DeviceBundle,
    DeviceRung,
    EnvironmentBundle,
)

SESSIONS = Path(__file__).parents[3] / "launch" / "sessions"
SINGLE = "design.ladder=[0.0006]"


def example(*overrides: str) -> Session:
    return load_session(SESSIONS / "example1.yaml", overrides)


@pytest.fixture(scope="module")
def prepared() -> Prepared:
    """Three levels of osp, so that no two devices have a rung in common."""
    return prepare(example("devices.dy.osp=1.5", "devices.dz.osp=2.5"))


# --- the key


@pytest.mark.parametrize(
    ("ladder", "found", "expected"),
    [
        ("[0.0002, 0.0002]", "0.0002 after the delay 0.0002", "delays that grow"),
        ("[0.0005, 0.0002]", "0.0002 after the delay 0.0005", "delays that grow"),
        ("[0.0001]", "0.0001 after tau 0.0001", "delays that grow"),
        ("[0.0005, 0.0011]", "0.0011 with a period of 0.001 s", "at most the period"),
        ("[-0.0005]", "-0.0005", "a delay inside the tick in s from 0"),
        ("[.nan]", "nan", "finite"),
        ("[soft]", "soft", "a delay inside the tick"),
        ("0.0005", "0.0005", "a list of 0 to 8 delays"),
        ("[1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4, 7e-4, 8e-4, 9e-4]", "", "a list of 0 to 8 delays"),
    ],
)
def test_a_ladder_that_is_none_is_refused_at_its_place(ladder: str, found: str, expected: str) -> None:
    with pytest.raises(SessionError) as refused:
        example("design.tau=0.0001", f"design.ladder={ladder}")
    text = str(refused.value)
    assert "design.ladder" in text
    assert found in text
    assert expected in text


def test_nothing_is_held_ready_for_no_coupling() -> None:
    with pytest.raises(SessionError, match="a ladder with 'coupling: none'"):
        example("design.coupling=none", SINGLE)
    assert example("design.coupling=none", "design.ladder=[]").design.ladder == ()


# --- what is prepared


def test_by_default_a_rung_is_designed_at_each_quarter_above_tau() -> None:
    ladder = prepare(example("design.tau=0.0003")).ladder
    assert ladder is not None
    assert ladder.taus == (0.0003, 0.0005, 0.001)
    assert prepare(example("design.tau=0.001")).ladder is None
    assert prepare(example("design.ladder=[]")).ladder is None
    stated = prepare(example(SINGLE)).ladder
    assert stated is not None
    assert stated.taus == (0.0, 0.0006)


def test_the_rungs_are_certificates_over_the_one_in_force(prepared: Prepared) -> None:
    assert prepared.ladder is not None
    assert prepared.ladder.rungs[0] is prepared.certificate
    assert prepared.notes == ()
    for rung in prepared.ladder.rungs:
        assert all(finding.holds for finding in prove(content(rung) | {"id": rung.id}))
        assert rung.asked == {"coupling": "spring-damper", "objective": "feasible", "algorithm": "convex"}


def test_a_certificate_from_a_file_is_given_the_same_ladder_anew(tmp_path: Path) -> None:
    session = example(SINGLE)
    designed = prepare(session)
    assert designed.certificate is not None
    save(designed.certificate, tmp_path / "c.json")
    read = prepare(session, tmp_path / "c.json")
    assert designed.ladder is not None
    assert read.ladder is not None
    assert [rung.id for rung in read.ladder.rungs] == [rung.id for rung in designed.ladder.rungs]


def test_delays_without_a_rung_are_reported() -> None:
    """Nothing is lost of the session: it runs without a ladder."""
    late = load_session(
        SESSIONS / "example1.yaml",
        [
            "environment.delay=1",
            *(f"environment.links.{i}.stiffness={k}" for i, k in enumerate((500, 450, 400, 300))),
            "design.ladder=[0.0009]",
        ],
    )
    found = prepare(late)
    assert found.certificate is not None
    assert found.ladder is None
    assert len(found.notes) == 1
    assert found.notes[0].startswith("no rung for a delay of 0.9 ms: ")


def test_a_device_is_given_the_tolerance_of_every_rung(tmp_path: Path) -> None:
    steady, unsteady = (
        cut(prepare(example("design.ladder=[0.0006]", *more)), RunPlan("simulated", tmp_path, ""))["dx"]
        for more in ((), ("design.period_tolerance=0.2",))
    )
    assert isinstance(steady, DeviceBundle)
    assert isinstance(unsteady, DeviceBundle)
    assert [(rung.tau, rung.period_tolerance) for rung in steady.rungs] == [(0.0, 0.0), (0.0006, 0.0)]
    assert [(rung.tau, rung.period_tolerance) for rung in unsteady.rungs] == [(0.0, 0.2), (0.0006, 0.2)]
    for of_steady, of_unsteady in zip(steady.promises, unsteady.promises, strict=True):
        assert of_unsteady.level[0, 0] < of_steady.level[0, 0]


def test_a_run_that_nothing_proves_has_no_ladder(tmp_path: Path) -> None:
    stiff = prepare(example("design.coupling=given", "design.stiffness=3000", SINGLE), uncertified=True)
    assert stiff.ladder is None
    bundles = cut(stiff, RunPlan("simulated", tmp_path, ""))
    for bundle in bundles.values():
        assert not isinstance(bundle, DeviceBundle | CouplingBundle) or len(bundle.rungs) == 1


# --- what each process is given


def test_each_process_is_given_its_own_part_of_every_rung(prepared: Prepared, tmp_path: Path) -> None:
    ladder = prepared.ladder
    assert ladder is not None
    bundles = cut(prepared, RunPlan("simulated", tmp_path, ""))
    environment = bundles["environment"]
    assert isinstance(environment, EnvironmentBundle)
    assert environment.Phi_E is ladder.Phi_E
    other = dataclasses.replace(ladder, Phi_E=0.5 * ladder.Phi_E)  # as where rung 0's own does not serve all
    mixed = cut(dataclasses.replace(prepared, ladder=other), RunPlan("simulated", tmp_path, ""))["environment"]
    assert isinstance(mixed, EnvironmentBundle)
    assert mixed.Phi_E is other.Phi_E
    for i, (device_name, name, osp) in enumerate((("dx", "cx", 1.37), ("dy", "cy", 1.5), ("dz", "cz", 2.5))):
        device, coupling = bundles[device_name], bundles[name]
        assert isinstance(device, DeviceBundle)
        assert isinstance(coupling, CouplingBundle)
        assert [rung.tau for rung in device.rungs] == list(ladder.taus)
        assert (coupling.rungs[0].block, coupling.rungs[0].K) == (coupling.block, coupling.K)
        assert np.array_equal(device.osp, [[osp]])
        assert [rung.period_tolerance for rung in device.rungs] == [0.0] * len(ladder.rungs)
        for rung, of_device, of_coupling, proof in zip(
            device.rungs, device.promises, coupling.rungs, ladder.rungs, strict=True
        ):
            share = proof.levels.device
            assert rung.share == share
            assert of_device.level[0, 0] == pytest.approx(share.share * osp)
            assert of_device.K[0, 0] == pytest.approx(share.kappa * 0.001 / osp)
            np.testing.assert_allclose(of_coupling.K, of_device.K)
            assert np.array_equal(of_coupling.block.D, proof.blocks[i].D)
            assert of_coupling.level is not None
            assert np.array_equal(of_coupling.level, proof.levels.Delta_V[i])
        softer = environment.feedthrough_rungs[name]
        assert [D.tolist() for D in softer] == [rung.block.D.tolist() for rung in coupling.softer]
        assert len(softer) == 3


@pytest.mark.parametrize(("breach", "rung"), [("soften", -1), ("warn", 0), ("stop", 0)])
def test_the_environment_gets_the_longest_delay_the_session_can_cover(
    prepared: Prepared, tmp_path: Path, breach: str, rung: int
) -> None:
    assert prepared.ladder is not None
    faults = prepared.session.faults.model_copy(update={"breach": breach})
    wished = dataclasses.replace(prepared, session=prepared.session.model_copy(update={"faults": faults}))
    environment = cut(wished, RunPlan("realtime", tmp_path, ""))["environment"]
    assert isinstance(environment, EnvironmentBundle)
    assert environment.longest_tau == prepared.ladder.taus[rung]


def numbers_in(text: str) -> set[str]:
    """The numbers that stand in a text, whole: digits within a longer number are none of their own."""
    return set(re.findall(r"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?", text))


def test_digits_within_a_longer_number_are_no_number() -> None:
    assert numbers_in('[11.370, {"K": -1.25e-05}, 0.5]') == {"11.370", "-1.25e-05", "0.5"}


def test_no_bundle_has_anothers_part_of_a_rung(prepared: Prepared, tmp_path: Path) -> None:
    bundles = cut(prepared, RunPlan("simulated", tmp_path, ""))
    known = {}
    for name, bundle in bundles.items():
        bundle_files.save(bundle, tmp_path / name)
        known[name] = numbers_in((tmp_path / name).read_text())
    for owner in ("cx", "cy", "cz"):
        coupling, device = bundles[owner], bundles[owner.replace("c", "d")]
        assert isinstance(coupling, CouplingBundle)
        assert isinstance(device, DeviceBundle)
        for rung in coupling.softer:
            assert rung.level is not None
            for number, knows in (
                (rung.level[0, 0], {owner}),
                (rung.block.C[0, 0], {owner}),
                (rung.block.D[0, 0], {owner, "environment"}),
            ):
                assert {name for name, numbers in known.items() if repr(float(number)) in numbers} == knows
        osp = repr(float(device.osp[0, 0]))
        assert {name for name, numbers in known.items() if osp in numbers} == {device.common.name}


@pytest.mark.parametrize("name", ["dx", "cx", "environment"])
def test_rungs_round_trip_exactly(prepared: Prepared, name: str, tmp_path: Path) -> None:
    bundle = cut(prepared, RunPlan("simulated", tmp_path, ""))[name]
    bundle_files.save(bundle, tmp_path / "a")
    bundle_files.save(bundle_files.load(tmp_path / "a", type(bundle)), tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_rungs_that_do_not_fit_their_node_are_refused(prepared: Prepared, tmp_path: Path) -> None:
    bundles = cut(prepared, RunPlan("simulated", tmp_path, ""))
    device, coupling, environment = bundles["dx"], bundles["cx"], bundles["environment"]
    assert isinstance(device, DeviceBundle)
    assert isinstance(coupling, CouplingBundle)
    assert isinstance(environment, EnvironmentBundle)
    two = np.eye(2)
    share = device.rungs[0].share
    for rungs, words in (
        ((*device.rungs, device.rungs[1]), "expected them to grow"),
        (tuple(DeviceRung(1e-5 * i, 0.0, share) for i in range(10)), "found 10 rungs"),
        ((), "found no rung"),
    ):
        with pytest.raises(ValueError, match=words):
            dataclasses.replace(device, rungs=rungs)
    for osp in (two, np.zeros((1, 1)), np.array([[np.nan]])):
        with pytest.raises(ValueError, match=r"found an osp of shape .*; expected 1 x 1, symmetric positive definite"):
            dataclasses.replace(device, osp=osp)
    first = coupling.softer[0]
    for softer, words in (
        ((CouplingRung(first.block, first.K, None),), "rung 1: found no level"),
        ((CouplingRung(first.block, first.K, two),), "rung 1: found a matrix"),
        ((first,) * 9, "at most 9"),
    ):
        with pytest.raises(ValueError, match=words):
            dataclasses.replace(coupling, softer=softer)
    some = dict(environment.feedthrough_rungs)
    for rungs, words in (
        ({**some, "cx": ()}, "the same rungs for each"),
        ({"cx": some["cx"]}, "the same rungs for each"),
        ({name: matrices * 3 for name, matrices in some.items()}, "found 10 rungs"),
    ):
        with pytest.raises(ValueError, match=words):
            dataclasses.replace(environment, feedthrough_rungs=rungs)


@pytest.mark.parametrize("tau", [True, "0.1", None, -1.0, 1e-5])
def test_a_file_with_a_delay_that_is_none_is_no_bundle(prepared: Prepared, tau: object, tmp_path: Path) -> None:
    bundle_files.save(cut(prepared, RunPlan("simulated", tmp_path, ""))["dx"], tmp_path / "dx")
    data = json.loads((tmp_path / "dx").read_text())
    data["rungs"][2]["tau"] = tau
    (tmp_path / "dx").write_text(json.dumps(data))
    with pytest.raises(BundleError, match="dx: not a bundle for a DeviceBundle"):
        bundle_files.load(tmp_path / "dx", DeviceBundle)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("period_tolerance", -0.1),
        ("period_tolerance", 1.1),
        ("kappa", 0.0),
        ("kappa", float("inf")),
        ("share", 0.0),
        ("share", 1.1),
        ("c", -1e-3),
        ("c", float("nan")),
        ("c", None),
    ],
)
def test_a_file_with_a_promise_that_is_none_is_no_bundle(
    prepared: Prepared, key: str, value: object, tmp_path: Path
) -> None:
    bundle_files.save(cut(prepared, RunPlan("simulated", tmp_path, ""))["dx"], tmp_path / "dx")
    data = json.loads((tmp_path / "dx").read_text())
    rung = data["rungs"][1]
    (rung if key in rung else rung["share"])[key] = value
    (tmp_path / "dx").write_text(json.dumps(data))
    with pytest.raises(BundleError, match="dx: not a bundle for a DeviceBundle"):
        bundle_files.load(tmp_path / "dx", DeviceBundle)
