"""Devices with a driver of another package: their keys, their delays in what is to be certified, and names of ports."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from manyhands.design.certificate import differences
from manyhands.launch.plan.certificates import with_delay_of
from manyhands.launch.plan.loop import NotCertified, coupling_request, haptic_loop, stated_delay
from manyhands.launch.plan.sites import in_tick, site_loop
from manyhands.launch.session import Session, SessionError, load_session
from manyhands.nodes.kernel.driver_statement import DeviceTiming

T = 1e-3


def tree(design: Mapping[str, Any] | None = None, **device: Any) -> dict[str, Any]:
    """A session of one device with a driver of another package, and one that is simulated."""
    own = {"dof": 1, "osp": 1.37, "driver": "some.package:factory", **device}
    return {
        "session": "plugged",
        "period": T,
        "devices": {"d": own, "e": {"dof": 1, "osp": 1.37, "driver": "simulated", "mass": 0.2}},
        "couplings": {"c": {"ports": ["d"]}, "b": {"devices": ["e"]}},
        "environment": {"type": "network", "links": [{"between": ["d", "e"], "stiffness": 100}]},
        "design": {"coupling": "spring-damper", **(design or {})},
    }


def loaded(folder: Path, content: Mapping[str, Any]) -> Session:
    path = folder / "session.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")
    return load_session(path)


CURVED = {"least": 0.1, "most": 0.2, "pitch": 0.01}


@pytest.mark.parametrize(
    ("device", "key", "found", "expected"),
    [
        ({"driver": "nothing"}, "devices.d.driver", "'nothing'", "one of simulated, trace, browser"),
        ({"driver": "a.b:c.d"}, "devices.d.driver", "'a.b:c.d'", "package.module:factory"),
        ({"driver": 3}, "devices.d.driver", "3", "package.module:factory"),
        ({"step": -1e-5}, "devices.d.step", "-1e-05", "a step in m of at least 0"),
        ({"friction": 0.1}, "devices.d.friction", "0.1", "{least: c}, with the least dry friction in N"),
        ({"friction": {"most": 0.1}}, "devices.d.friction", "no key 'least'", "least, the least dry friction in N"),
        ({"friction": {"least": 0}}, "devices.d.friction.least", "0", "a friction in N greater than 0"),
        ({"friction": {"least": [1, 2]}}, "devices.d.friction.least", "a list of 2", "one value, or a list of 1"),
        ({"friction": CURVED}, "devices.d.friction.most", "most with", "least alone: the driver's device has its own"),
        ({"damping": 2.0}, "devices.d.damping", "damping with 'driver: some.package:factory'", "no damping"),
        ({"damping": 2.0}, "devices.d.damping", "damping with", "no damping"),
        ({"hand": {}}, "devices.d.hand", "hand with", "no hand"),
        ({"trace": {"times": [0, 1], "values": [0, 0]}}, "devices.d.trace", "trace with", "no trace"),
        ({"time": "own"}, "devices.d.time", "time: own with", "time: wall"),
        ({"parameters": [1]}, "devices.d.parameters", "a list of 1", "a mapping from names to values"),
        ({"sample_age": -1}, "devices.d.sample_age", "-1", "a time in s from 0 to 0.1"),
        ({"age_jitter": 1e-4}, "devices.d.age_jitter", "0.0001", "at most the sample_age"),
        ({"sample_age": 2e-3}, "devices.d", "0.002 s of sample_age", "at most the period of 0.001 s"),
        ({"axis_map": ["x", "y"]}, "devices.d.axis_map", "a list of 2", "1 axis of the driver"),
        ({"axis_map": ["+x"]}, "devices.d.axis_map.0", "'+x'", "after a minus"),
        ({"scale": 0}, "devices.d.scale", "0", "a scale greater than 0"),
    ],
)
def test_what_is_wrong_with_such_a_device_is_named(
    tmp_path: Path, device: dict[str, Any], key: str, found: str, expected: str
) -> None:
    with pytest.raises(SessionError) as caught:
        loaded(tmp_path, tree(**device))
    assert caught.value.key == key
    assert found in caught.value.found
    assert expected in caught.value.expected


@pytest.mark.parametrize("key", ["parameters", "sample_age", "age_jitter", "actuation_delay", "axis_map", "scale"])
def test_its_keys_are_no_other_devices(tmp_path: Path, key: str) -> None:
    value: Any = {"parameters": {}, "axis_map": ["x"], "scale": 2.0}.get(key, 0.0)
    content = tree()
    content["devices"]["e"][key] = value
    with pytest.raises(SessionError, match=f"devices.e.{key}: found {key} with 'driver: simulated'"):
        loaded(tmp_path, content)


def test_it_is_read_again_from_its_plain_form(tmp_path: Path) -> None:
    session = loaded(tmp_path, tree(sample_age=2e-4, axis_map=["-y"], scale=2, parameters={"a": [1, "b"]}))
    assert Session.model_validate(session.as_plain()) == session
    assert session.with_code_in(tmp_path) == session
    assert str(tmp_path) not in json.dumps(session.with_code_in(tmp_path).as_plain())
    code = session.with_code_in(tmp_path).with_delay(2e-4).foreign_code["devices.d.driver"]
    assert (code.factory, code.parameters) == ("some.package:factory", {"a": [1, "b"]})
    assert code.folder == str(tmp_path)
    assert session.devices["d"].timing == DeviceTiming(2e-4)


def test_a_short_name_is_replaced_by_the_factory_that_is_published(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = importlib.metadata.EntryPoint("falcon", "novint.driver:Falcon", "manyhands.drivers")
    odd = importlib.metadata.EntryPoint("odd", "novint.driver", "manyhands.drivers")

    def installed(group: str) -> list[importlib.metadata.EntryPoint]:
        return [entry, odd] if group == "manyhands.drivers" else []

    monkeypatch.setattr(importlib.metadata, "entry_points", installed)
    assert loaded(tmp_path, tree(driver="falcon")).devices["d"].driver == "novint.driver:Falcon"
    for unknown, meant in (("falcn", "did you mean 'falcon'?"), ("odd", "manyhands.drivers")):
        with pytest.raises(SessionError, match=r"one of simulated, trace, .*serial-board, falcon") as caught:
            loaded(tmp_path, tree(driver=unknown))
        assert meant in str(caught.value)


def test_the_latency_is_a_part_of_what_is_to_be_certified(tmp_path: Path) -> None:
    late: dict[str, Any] = {"sample_age": 3e-4, "actuation_delay": 1e-4}
    session = loaded(tmp_path, tree(**late))
    loop = haptic_loop(session)
    assert (stated_delay(session), loop.tau) == (4e-4, 4e-4)
    assert loop.period_tolerance == pytest.approx(0.3)  # of samples that are 0 to 0.3 ms old
    steady = haptic_loop(loaded(tmp_path, tree(**late, age_jitter=0.0)))
    assert (steady.tau, steady.period_tolerance) == (4e-4, 0.0)
    stated = haptic_loop(loaded(tmp_path, tree({"tau": 6e-4, "period_tolerance": 0.4}, **late)))
    assert (stated.tau, stated.period_tolerance) == (6e-4, 0.4)
    with pytest.raises(SessionError, match=r"design.tau: found 0.0002; expected at least 0.0004 s, the sample_age and"):
        loaded(tmp_path, tree({"tau": 2e-4}, **late))
    with pytest.raises(NotCertified, match="no measurement"):
        stated_delay(loaded(tmp_path, tree({"tau": "auto"}, **late)))


def test_a_certificate_for_less_than_the_latency_is_not_the_sessions(tmp_path: Path) -> None:
    prompt = in_tick(loaded(tmp_path, tree())).design().certificate
    late = with_delay_of(prompt, loaded(tmp_path, tree(actuation_delay=1e-4)))
    assert haptic_loop(late).tau == 1e-4
    assert "the delay inside the tick differs" in differences(prompt, haptic_loop(late), coupling_request(late))[0]
    covered = replace(prompt, loop=replace(prompt.loop, tau=2e-4))
    assert haptic_loop(with_delay_of(covered, loaded(tmp_path, tree(actuation_delay=1e-4)))).tau == 2e-4


def test_the_latency_counts_at_the_site_of_a_wave_link(tmp_path: Path) -> None:
    content = tree(sample_age=2e-4)
    content["couplings"]["c"]["wave_link"] = {"mass": 0.05, "round_trip": 0.004}
    assert site_loop(loaded(tmp_path, content), "c").tau == 2e-4
    content["couplings"]["c"]["wave_link"]["tau"] = 1e-4
    with pytest.raises(SessionError, match=r"couplings.c.wave_link.tau: found 0.0001; expected at least 0.0002 s"):
        loaded(tmp_path, content)


def test_the_only_port_of_a_device_is_also_its_port_0(tmp_path: Path) -> None:
    content = tree()
    content["couplings"]["c"] = {"ports": ["d.0"]}
    content["environment"]["links"] = [{"between": ["d.0", "e.0"], "stiffness": 100}]
    assert loaded(tmp_path, content) == loaded(tmp_path, tree())
    named = tree(axes=["x"])
    named["couplings"]["c"] = {"ports": ["d.0"]}
    named["environment"]["links"] = [{"between": ["d.0", "e"], "stiffness": 100}]
    session = loaded(tmp_path, named)
    assert session.blocks_by_name["c"] == ("d.x",)
    for wrong in ("d.1", "d.00"):
        content["couplings"]["c"] = {"ports": [wrong]}
        with pytest.raises(SessionError, match=rf"unknown port '{wrong}'"):
            loaded(tmp_path, content)
