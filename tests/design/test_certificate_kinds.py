"""Every kind of loop, coupling and claim that a certificate file may hold: written, read and proved from the file."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manyhands.design.certificate import content, describe_request, load, save, seal, to_json
from manyhands.design.levels.contract import ENERGY
from manyhands.design.models.coupling import Partition
from manyhands.design.models.environment import DelayedNetwork, NetworkBox, StateSpaceEnvironment, TransferEnvironment
from manyhands.design.models.network import GROUND, Network, NetworkLink
from manyhands.design.models.statespace import StateSpace
from manyhands.design.models.weights import Filter, Transparency
from manyhands.design.problem import CouplingRequest, HapticLoop, LinearGiven, SpringDamperGiven
from manyhands.design.proof import prove
from manyhands.design.synthesis import design


def aim(objective: str = "loop-shaping") -> Transparency:
    return Transparency(objective, Filter.from_continuous((1.0,), (1.0 / 125.0, 1.0), 1e-3), Filter.one())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "certificate.json"


def all_hold(data: Any) -> bool:
    return all(finding.holds for finding in prove(data))


def oscillator(method: str | None) -> StateSpaceEnvironment:
    """A mass on a spring behind each of three ports: 200 - 1e5/(s^2 + 2 s + 1500) N/m."""
    A, B = np.array([[0.0, 1.0], [-1500.0, -2.0]]), np.array([[0.0], [500.0]])
    one = StateSpace(A, B, np.array([[-200.0, 0.0]]), np.array([[200.0]]))
    if method is None:
        one = StateSpace(0.5 * np.eye(1), np.eye(1), np.array([[50.0]]), np.array([[100.0]]))
    I = np.eye(3)
    whole = StateSpace(*(np.kron(I, getattr(one, name)) for name in "ABCD"))
    return StateSpaceEnvironment(("dx", "dy", "dz"), whole, method, 0 if method else 1)


def kinds(problems) -> dict[str, tuple[HapticLoop, CouplingRequest]]:
    """One loop and wish for everything that a file may hold."""
    loop, soft = problems.example_1(), SpringDamperGiven(problems.uniform(800.0, 0.3))
    blocks = problems.blocks(loop, problems.C26)
    strong = problems.example_1(osp=8.0)
    low = problems.network
    high = Network(
        low.ports,
        tuple((name, 2.0 * mass) for name, mass in low.masses),
        tuple(
            NetworkLink(link.ends, 1.5 * link.stiffness, link.damping) if i else link
            for i, link in enumerate(low.links)
        ),
    )
    drifting = Network(low.ports, (("free", 1.0),), tuple(NetworkLink((port, "free"), 0.0, 0.5) for port in low.ports))
    rational = tuple(tuple((((3.0, 2.0, 400.0) if i == j else (50.0,)), (1.0,)) for j in range(3)) for i in range(3))
    proper = tuple(
        tuple(((100.0, 9000.0), (1.0, 100.0)) if i == j else ((0.0,), (1.0,)) for j in range(3)) for i in range(3)
    )

    def on(environment, base: HapticLoop = loop, tau: float = 0.0) -> HapticLoop:
        return dataclasses.replace(base, environment=environment, tau=tau)

    return {
        "network": (loop, soft),
        "no mass": (on(Network(low.ports, (), tuple(NetworkLink((p, GROUND), 500.0, 0.1) for p in low.ports))), soft),
        "drifting": (on(drifting), soft),
        "box": (on(NetworkBox(low, high)), soft),
        "late": (on(DelayedNetwork(low, 2), strong), SpringDamperGiven(problems.uniform(1.4e4, 0.5))),
        "tau": (on(low, tau=2.5e-4), soft),
        "longer periods": (dataclasses.replace(loop, period_tolerance=0.25), soft),
        "tau and longer periods": (dataclasses.replace(loop, tau=2.5e-4, period_tolerance=0.1), soft),
        "backward Euler": (on(oscillator("backward-euler")), soft),
        "Tustin": (on(oscillator("tustin"), strong), soft),
        "hold": (on(oscillator("zoh"), strong, tau=1e-4), soft),
        "discrete, late": (on(oscillator(None), strong), soft),
        "transfer function": (on(TransferEnvironment(low.ports, rational), strong), soft),
        "transfer function, Tustin, late": (on(TransferEnvironment(low.ports, proper, "tustin", 1), strong), soft),
        "linear": (loop, LinearGiven(blocks)),
        "static": (loop, LinearGiven((StateSpace.static([[1e-3]]),) * 3)),
        "shaped": (loop, SpringDamperGiven(problems.C26, aim())),
        "shaped, linear": (loop, LinearGiven(blocks, aim())),
        "closed loop": (loop, SpringDamperGiven(problems.C26, aim("closed-loop"))),
    }


KINDS = (
    "network", "no mass", "drifting", "box", "late", "tau", "longer periods", "tau and longer periods",
    "backward Euler", "Tustin", "hold", "discrete, late",
    "transfer function", "transfer function, Tustin, late", "linear", "static", "shaped", "shaped, linear",
    "closed loop",
)  # fmt: skip


def test_every_kind_is_named(problems) -> None:
    assert tuple(kinds(problems)) == KINDS


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_round_trips_and_is_proved_from_its_file(problems, path: Path, kind: str) -> None:
    loop, wanted = kinds(problems)[kind]
    certificate = design(loop, wanted).certificate
    save(certificate, path)
    read, data = load(path)
    assert to_json(read) == to_json(certificate)
    assert all_hold(data)
    assert read.loop.environment == loop.environment
    assert (read.loop.tau, read.tau) == (loop.tau, loop.tau)
    assert (read.loop.period_tolerance, read.period_tolerance) == (loop.period_tolerance,) * 2
    assert data["version"] == (4 if "longer periods" in kind else 3)
    assert ("period_tolerance" in data) == ("longer periods" in kind)
    assert (read.spring_damper is None) == isinstance(wanted, LinearGiven)
    assert (read.transparency is None) == (wanted.aim is None)
    assert read.asked == certificate.asked == describe_request(wanted, loop.partition.names)
    if read.transparency is not None:
        assert read.transparency.aim == wanted.aim
    assert isinstance(read.levels.P_E, str) == (kind in ("drifting", "box"))
    for one, other in zip(read.blocks, certificate.blocks, strict=True):
        np.testing.assert_array_equal(one.D, other.D)


def test_another_order_of_blocks_or_devices_gives_another_certificate_id(problems, path: Path) -> None:
    loop, wanted = problems.example_1(), SpringDamperGiven(problems.uniform(800.0, 0.3))
    names, blocks = loop.partition.names, loop.partition.blocks
    turned = (
        loop,
        dataclasses.replace(loop, devices=loop.devices[::-1]),
        dataclasses.replace(loop, partition=Partition(names[::-1], blocks[::-1])),
    )
    certificates = [design(one, wanted).certificate for one in turned]
    assert len({certificate.id for certificate in certificates}) == 3
    for certificate in certificates:
        save(certificate, path)
        read, data = load(path)
        assert all_hold(data)
        assert (read.id, read.loop.partition) == (certificate.id, certificate.loop.partition)
        assert [d.name for d in read.loop.devices] == [d.name for d in certificate.loop.devices]


def test_structured_phi_is_written_by_block_and_other_phi_whole(problems, path: Path) -> None:
    certificate = design(problems.example_1(), SpringDamperGiven(problems.C26)).certificate
    data = content(certificate)
    assert set(data["levels"]["Phi_E"]) == {"cx", "cy", "cz"}
    # a level for all of a passive environment, with entries between the blocks
    Phi_E = -0.01 * (np.eye(3) + 0.5 * np.ones((3, 3)))
    levels = dataclasses.replace(certificate.levels, Phi_E=Phi_E, P_E=ENERGY)
    whole = seal(dataclasses.replace(certificate, levels=levels, margins={}))
    save(whole, path)
    read, data = load(path)
    np.testing.assert_array_equal(data["levels"]["Phi_E"], Phi_E)
    np.testing.assert_array_equal(read.levels.Phi_E, Phi_E)
    assert all_hold(data)
