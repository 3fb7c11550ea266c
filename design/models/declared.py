"""Environments of which only a level is known: models and engines, scenes, springs to proxies.

A declared environment, such as a physics engine or a neural simulator, has no matrices to prove anything about. Only
its level is known, and a passivity controller at its ports enforces that level at run time. Condition (10) of
[Bianchini2010]_ needs no more: with E_hat (-Phi_E)-ISP, by proof or by a controller, Theorem 3 holds. Its passivity
argument needs neither linearity nor time invariance. The certificate of such a loop is conditional, and states so.

Springs to proxies are declared environments too, whatever proposes the proxies. A test in every tick keeps their level
(docs/decisions/0042-proxies.md), and no controller is needed for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NoReturn

import numpy as np

from manyhands.design.errors import Infeasible
from manyhands.design.models.brief import brief_repr
from manyhands.design.models.integrators import Split
from manyhands.design.models.kind import Environment, WhatRuns
from manyhands.design.models.scene import MOST_DRIVE, ContactScene
from manyhands.design.models.statespace import Matrix, StateSpace, matrix


@dataclass(frozen=True, eq=False)
class DeclaredEnvironment(Environment):
    """An environment of which only its declared level is known.

    Attributes:
        ports: names of the m ports.
        level: Phi_E, m x m symmetric, N*s/m; 0 for a passive environment, above 0 for one that lacks passivity.
        enforced: whether a passivity controller enforces that level at run time.

    Raises:
        ValueError: the level is not symmetric, or not m x m.
    """

    ports: tuple[str, ...]
    level: Matrix
    enforced: bool = True

    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.ports)
        object.__setattr__(self, "level", matrix(self.level, m, m))
        if np.any(self.level != self.level.T):
            raise ValueError("environment.level: expected a symmetric matrix")

    def __eq__(self, other: object) -> bool:
        """Equal when every number is, of the same kind."""
        return type(self) is type(other) and all(
            np.array_equal(getattr(self, part.name), getattr(other, part.name)) for part in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]  # matrices have none

    @property
    def declared_level(self) -> Matrix:
        """The level, whether it is kept or not."""
        return self.level

    @property
    def controlled(self) -> bool:
        """As declared."""
        return self.enforced

    @property
    def order(self) -> int:
        """0: there is no Rest."""
        return 0

    def terms(self) -> dict[str, Any]:
        """The level that a design counts on; raises Infeasible if nothing keeps it."""
        return {"type": "declared", "level": self.promised().tolist()}

    def running(self, T: float) -> WhatRuns:
        """The level that is kept."""
        return WhatRuns(level=self.level if self.enforced else None)

    @property
    def kept(self) -> str:
        """A controller."""
        return "enforced: not proved, its declared level is kept at run time by a controller"

    def verdict(self, block: str) -> str:
        """Proved, under what a controller does."""
        return "proved, where the level of the environment is enforced at run time"

    def promised(self) -> Matrix:
        """The level that a design may count on.

        Raises:
            Infeasible: no controller enforces it.
        """
        if not self.enforced:
            raise Infeasible("nothing is proved about the environment's model, and its level is not enforced")
        return self.level

    def environment(self, T: float) -> StateSpace:
        """Refused by Infeasible: E is not known."""
        self._refuse()

    def split(self, T: float) -> Split:
        """Refused by Infeasible: E_hat is not known."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise Infeasible(
            "this needs the dynamics of the environment, but only the declared level of its model is known; expected "
            "an objective that does not need them, feasible or stiffest, or a network or matrices as the environment"
        )


@dataclass(frozen=True, eq=False)
class DeclaredScene(DeclaredEnvironment):
    """A scene, of which the design uses the level 0: that of an exact solution of its ticks, kept by a controller.

    Attributes:
        scene: the tools, bodies and obstacles.
    """

    ports: tuple[str, ...] = field(init=False)
    level: Matrix = field(init=False)
    enforced: bool = field(init=False, default=True)
    scene: ContactScene

    kept = "a scene, level 0: by its contacts' energy, and enforced at run time by a controller"
    __repr__ = brief_repr

    def __post_init__(self) -> None:
        m = len(self.scene.ports)
        object.__setattr__(self, "ports", self.scene.ports)
        object.__setattr__(self, "level", np.zeros((m, m)))
        super().__post_init__()

    def terms(self) -> dict[str, Any]:
        """Those of the scene."""
        return self.scene.terms()

    def running(self, T: float) -> WhatRuns:
        """The scene, at the level 0."""
        return WhatRuns(level=self.level, scene=self.scene)


@dataclass(frozen=True, eq=False)
class ProxyEnvironment(DeclaredEnvironment):
    """Springs from the tools to proxies, f = -K (x_e - q), whose level the proxy test keeps at every tick.

    Attributes:
        stiffness: K, m x m symmetric positive definite, N/m.
        content: the digest of what proposes the proxies, where it is data, as of a mesh; None for code. Nothing is
            proved of it; it makes the certificate of another mesh another one.
        tank: what the world may give out beyond what it has received, J. It counts as stored at the start.

    Raises:
        ValueError: K is not symmetric positive definite, the level has a negative eigenvalue, or the tank is negative.
    """

    enforced: bool = field(init=False, default=True)
    stiffness: Matrix = field(default_factory=lambda: np.zeros((0, 0)))
    content: str | None = None
    tank: float = 0.0

    controlled = False  # by the proxy test in its place
    __repr__ = brief_repr

    def __post_init__(self) -> None:
        super().__post_init__()
        m = len(self.ports)
        object.__setattr__(self, "stiffness", matrix(self.stiffness, m, m))
        if np.any(self.stiffness != self.stiffness.T) or not np.linalg.eigvalsh(self.stiffness)[0] > 0.0:
            raise ValueError("environment.stiffness: expected a symmetric positive definite matrix")
        values = np.linalg.eigvalsh(self.level)
        if values[0] < -1e-12 * max(abs(values[-1]), 1.0):
            raise ValueError("environment.level: expected no negative eigenvalue, for a held proxy costs no energy")
        if not 0.0 <= self.tank <= MOST_DRIVE:
            raise ValueError(f"environment.tank: found {self.tank} J; expected 0 to {MOST_DRIVE:g} J")

    def terms(self) -> dict[str, Any]:
        """Level and springs; of what proposes the proxies its digest alone."""
        content = {} if self.content is None else {"content": self.content}
        tank = {"tank": self.tank} if self.tank else {}
        return {"type": "proxy", "level": self.level.tolist(), "stiffness": self.stiffness.tolist(), **content, **tank}

    def running(self, T: float) -> WhatRuns:
        """The springs to the proxies."""
        return WhatRuns(level=self.level, stiffness=self.stiffness, tank=self.tank)

    @property
    def kept(self) -> str:
        """The proxy test, and with a tank what it lets out."""
        gives = f"; they give out at most the {self.tank:g} J of their tank" if self.tank else ""
        return f"springs to proxies: their level is kept by the proxy test at every tick{gives}"

    def verdict(self, block: str) -> str:
        """Proved, under what the proxy test does."""
        gives = f", and the world gives out at most the {self.tank:g} J of its tank" if self.tank else ""
        return f"proved, where the level of the environment is kept by the proxy test at every tick{gives}"


def proxies_of(data: Mapping[str, Any], ports: tuple[str, ...]) -> ProxyEnvironment:
    """The environment that :meth:`ProxyEnvironment.terms` wrote (:func:`.environment_of`)."""
    m = len(ports)
    content = str(data["content"]) if "content" in data else None
    level, K = matrix(data["level"], m, m), matrix(data["stiffness"], m, m)
    return ProxyEnvironment(ports, level, K, content, float(data.get("tank", 0.0)))
