"""The kinds of environment by the name that a certificate has for them: one line a kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

from manyhands.design.models.declared import DeclaredEnvironment, DeclaredScene, proxies_of
from manyhands.design.models.environment import network_of, state_space_of, transfer_functions_of
from manyhands.design.models.kind import Environment
from manyhands.design.models.scene import scene_of
from manyhands.design.models.statespace import matrix
from manyhands.design.wave_link import WorldPromise, face_of

Reader: TypeAlias = Callable[[Mapping[str, Any], tuple[str, ...]], Environment]

KINDS: Final[Mapping[str, Reader]] = {
    "network": network_of,
    "scene": lambda data, ports: DeclaredScene(scene_of(data, ports)),
    "state-space": state_space_of,
    "transfer-function": transfer_functions_of,
    "declared": lambda data, ports: DeclaredEnvironment(ports, matrix(data["level"])),
    "proxy": proxies_of,
    "wave-link": face_of,
    "world": lambda data, ports: WorldPromise(ports, matrix(data["level"]), id=str(data["id"])),
}
"""By ``type``, the function that reads what :meth:`.Environment.terms` of that kind wrote, for given ports."""


def environment_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> Environment:
    """The environment that :meth:`.Environment.terms` wrote.

    Raises:
        KeyError, TypeError, ValueError: a key is missing, or its value makes no environment.
    """
    kind = data["type"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise ValueError(f"environment.type: found {kind!r}; expected one of {', '.join(map(repr, KINDS))}")
    return KINDS[kind](data, ports)
