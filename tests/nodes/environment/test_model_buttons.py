"""A model is given the buttons that are held down where its signature asks for them, and nothing else changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from manyhands.launch.conformance.judgement import Conformance
from manyhands.launch.conformance.model import check_model
from manyhands.nodes.environment.enforced import BlackBox, EnforcedCore
from manyhands.nodes.environment.model import AskedModel
from manyhands.nodes.environment.proxy import ProxyLaw

BUTTONS = ("anna.grip", "ben.grip")
T = 1e-3


class Asking:
    """Notes what it is given in each tick; one of its methods is taken, by a test."""

    def __init__(self) -> None:
        self.seen: list[Any] = []

    def noted(self, x: np.ndarray, k: Any, buttons: frozenset[str]) -> np.ndarray:
        self.seen.append(buttons)
        return 0.0 * x


class Forces(Asking):
    def react(self, x_e: np.ndarray, k: int, buttons: frozenset[str]) -> np.ndarray:
        return self.noted(x_e, k, buttons)


class Proxies(Asking):
    def proxy(self, x: np.ndarray, k: int, *, buttons: frozenset[str] = frozenset()) -> np.ndarray:
        return self.noted(x, k, buttons) + x


class Steps(Asking):
    def step(self, x: np.ndarray, f: np.ndarray, buttons: frozenset[str]) -> np.ndarray:
        return self.noted(x, f, buttons) + x


class Plain(Asking):
    def react(self, x_e: np.ndarray, k: int) -> np.ndarray:
        return self.noted(x_e, k, frozenset({"not asked"}))


def core_of(model: Any) -> EnforcedCore:
    asked = AskedModel("some:model", model, ("p",), buttons=BUTTONS)
    law = BlackBox(asked) if hasattr(model, "react") else ProxyLaw(asked, 100.0 * np.eye(1), None, T, [(0,)])
    return EnforcedCore(law, 1e-3 * np.eye(1), np.eye(1), T, True)


@pytest.mark.parametrize("kind", [Forces, Proxies, Steps])
def test_it_is_given_those_of_the_tick(kind: type[Asking]) -> None:
    model = kind()
    core = core_of(model)
    for pressed in (0b00, 0b01, 0b11, 0b10):
        core.press(pressed)
        core.react([0.001])
        core.settle()
    assert model.seen == [frozenset(), {"anna.grip"}, {"anna.grip", "ben.grip"}, {"ben.grip"}]
    assert core.failure is None


def test_a_model_that_does_not_ask_is_called_as_ever() -> None:
    model = Plain()
    core = core_of(model)
    core.press(0b11)
    core.react([0.001])
    assert (model.seen, core.failure) == ([{"not asked"}], None)


def test_the_suite_for_models_tries_one_that_asks_for_buttons() -> None:
    found = list(check_model("some:model", Forces, ("p",), T, 0.02))
    assert not [one for one in found if one.check == "exception" and one.verdict is Conformance.BROKEN]
