"""The keys of a session that advice names are keys of a session, with the values that are told."""

from __future__ import annotations

import re

import pytest
import yaml

from manyhands.launch.session import Session, SessionError
from manyhands.nodes.monitor.health import PROMISES

BASE = """
session: told
period: 0.001
devices:
  d: {dof: 1, osp: 1.0, driver: simulated, mass: 0.2, step: 0.00001, friction: {least: 0.1}}
couplings: {c: {devices: [d]}}
environment: {type: network, links: [{between: [d.0, ground], stiffness: 100}]}
design: {coupling: spring-damper}
"""
TEXTS = " ".join(f"{text.claim} {text.advice} {text.moved}" for text in PROMISES.values())


def with_keys(path: list[str], value: object) -> Session:
    tree = yaml.safe_load(BASE)
    into = tree["devices"]["d"] if path[0] == "limits" else tree
    for key in path[:-1]:
        into = into.setdefault(key, {})
    into[path[-1]] = value
    return Session.from_dict(tree)


@pytest.mark.parametrize("key", sorted({*re.findall(r"\b((?:faults|design|limits)\.[a-z_]+)", TEXTS)}))
def test_a_key_that_advice_names_is_one(key: str) -> None:
    with_keys(key.split("."), 0.005)
    with pytest.raises(SessionError, match="unknown key"):
        with_keys([*key.split(".")[:-1], f"{key.rpartition('.')[2]}s"], 0.005)


@pytest.mark.parametrize(("part", "entries"), re.findall(r"\b(faults): (\{[^}]*\})", TEXTS))
def test_entries_that_advice_states_are_accepted_as_they_stand(part: str, entries: str) -> None:
    for key, value in yaml.safe_load(entries).items():
        with_keys([part, key], value)


def test_advice_names_some() -> None:
    assert len(re.findall(r"\b(?:faults|design|limits)\.[a-z_]+|\bfaults: \{", TEXTS)) >= 4
