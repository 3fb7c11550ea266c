"""What the others ask of a virtual environment E, from tool displacement x_e (m) to the force on the tools (N).

A kind of environment is a class. It says what E is, how a certificate states it, what its process runs, and on what its
level rests. Design, certificates, plans and reports ask these questions, and know no kind by its name. The answers here
are those of an environment whose matrices are known, and of which nothing more is known. A kind states only where its
own answers differ.

The function that reads a kind from a certificate is one line in the table of :mod:`manyhands.design.environments`. The
proof (:mod:`manyhands.design.proof`) reads certificates by code of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from manyhands.design.models.axis import Units
from manyhands.design.models.integrators import Split
from manyhands.design.models.scene import ContactScene
from manyhands.design.models.statespace import Matrix, StateSpace

if TYPE_CHECKING:  # a network is a kind itself
    from manyhands.design.models.network import Network, NetworkLink

Counts: TypeAlias = Literal["part", "compliance"] | None
"""What of an environment may be counted in series with the coupling (docs/decisions/0045-series-compliance.md).

A part of the compliance of a port's own link, 0 ... 1, or the compliance of a plain spring, m/N; or nothing.
"""


@dataclass(frozen=True, eq=False)
class WhatRuns:
    """What an environment's process runs: matrices, a scene, or a model that the session names.

    Attributes:
        E: discrete, from displacement (m) to force (N); None for a scene and for a model.
        storage: P of the energy 1/2 eta^T P eta in E's state, J; None where no physics gives it.
        level: the declared Phi_E that is kept at run time, N*s/m; None where E is known, and where nothing keeps it.
        scene: in place of E.
        stiffness: K of the springs to a model's proxies, N/m; None for all others.
        tank: what a world of proxies may give out beyond what it has received, J.
    """

    E: StateSpace | None = None
    storage: Matrix | None = None
    level: Matrix | None = None
    scene: ContactScene | None = None
    stiffness: Matrix | None = None
    tank: float = 0.0


class Environment(ABC):
    """An environment with m ports, as the design, its certificate and the environment's process use it."""

    if TYPE_CHECKING:  # most kinds have it as a field, whose default a property of this class would become

        @property
        @abstractmethod
        def ports(self) -> tuple[str, ...]:
            """Names of the m ports, in order."""

    @property
    @abstractmethod
    def order(self) -> int:
        """The order of Rest, or slightly more: the size that a storage matrix would have."""

    @abstractmethod
    def environment(self, T: float) -> StateSpace:
        """E, discrete with period T (s); raises Infeasible if only a level is known."""

    @abstractmethod
    def split(self, T: float) -> Split:
        """E_hat without its integrators; raises Infeasible if E_hat is passive at no level."""

    @abstractmethod
    def terms(self) -> dict[str, Any]:
        """The physical data as JSON values, by the keys of a certificate's ``environment``."""

    def running(self, T: float) -> WhatRuns:
        """What its process runs with period T (s)."""
        return WhatRuns(E=self.environment(T))

    @property
    def passive_network(self) -> Network | None:
        """The network whose energy proves this environment passive; None if physics proves nothing."""
        return None

    @property
    def only_energy(self) -> bool:
        """Whether nothing sharper than the energy of :attr:`passive_network` proves its level."""
        return False

    @property
    def declared_level(self) -> Matrix | None:
        """Phi_E, m x m, N*s/m, of an environment of which nothing else is known; None where E is known."""
        return None

    def promised(self) -> Matrix | None:
        """The declared level, as a design may count on it; raises Infeasible if nothing keeps it at run time."""
        return self.declared_level

    @property
    def controlled(self) -> bool:
        """Whether its level is not proved, and a passivity controller enforces it at run time."""
        return False

    @property
    def late(self) -> bool:
        """Whether its forces come a tick or more after their displacements."""
        return False

    @property
    def at_any_period(self) -> bool:
        """Whether it is known at other periods than its own; a system in discrete time is not."""
        return True

    @property
    def stiffnesses(self) -> tuple[float, ...]:
        """The stiffness of each of its springs, N/m, of the softest network where it stands for many; empty without."""
        network = self.passive_network
        return () if network is None else tuple(link.stiffness for link in network.links)

    @property
    def counts(self) -> Counts:
        """What of it may be counted in series with the coupling."""
        return None

    def contacts(self) -> dict[str, NetworkLink]:
        """The link by which a port meets the rest of the world, by port; empty where there are no links."""
        return {}

    def stiffened(self, parts: Mapping[str, float]) -> Environment:
        """E', the world without what is counted of it, by port; only for a world of which something :attr:`counts`."""
        raise TypeError(f"found parts of a {type(self).__name__}; expected a world of which something may be counted")

    def counted(self, parts: Mapping[str, float], T: float) -> StateSpace:
        """C, what is counted of it by port, from force (N) to displacement (m), m x m, with period T (s)."""
        return StateSpace.static(np.zeros((len(self.ports),) * 2))

    @property
    def nominal(self) -> Environment:
        """The environment that a session runs, where this stands for many."""
        return self

    def margins(self, compliance: Callable[[], Matrix]) -> dict[str, float]:
        """The margins that it adds to a certificate, from the compliance V(1) of the coupling, m x m, m/N."""
        return {}

    @property
    def kept(self) -> str:
        """What it is, and what keeps its level, in words; empty where the proof does."""
        return ""

    def rows(self, margins: Mapping[str, float], units: Units) -> dict[str, str | Matrix]:
        """What a report says of it beside its certificate's margins: what keeps its level, where the proof does not.

        Args:
            margins: of the certificate.
            units: of its ports.
        """
        return {"environment": self.kept} if self.kept else {}

    def verdict(self, block: str) -> str:
        """What a proof has shown, in words, for a certificate whose first block of V has this name."""
        return "proved"
