"""What plan, run and reports ask of the environment of a session: one class a kind, with its keys and its answers.

None of them knows a kind by its name. The answers here are those of an environment of which nothing is to be drawn or
asked; a kind states only where its own differ. A kind is one line in the table of
:mod:`manyhands.launch.session.environment`.
"""

from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias

from manyhands.design.models.kind import Environment
from manyhands.design.models.network import NetworkLink
from manyhands.design.models.scene import ContactScene
from manyhands.launch.session.fields import Flag, Problem, SessionModel

Enforce: TypeAlias = Flag
"""Whether a passivity controller keeps the environment's level at run time."""

ENFORCE_MEANING: Final = "whether a passivity controller keeps its level at run time"

NO_HANDS: Final[Mapping[str, float]] = MappingProxyType({})
"""No device whose orientation is a port."""


class EnvironmentKind(SessionModel):
    """The environment of a session, whose key ``type`` names its kind.

    Attributes:
        in_series: whether some of its compliance may be counted in series, as long as its key ``delay``, if any, is 0.
    """

    in_series: ClassVar[bool] = False

    if TYPE_CHECKING:  # keys of the kinds, which a property of this class would shadow

        @property
        @abstractmethod
        def type(self) -> str:
            """The name of the kind."""

        @property
        @abstractmethod
        def enforce(self) -> bool:
            """Whether a passivity controller keeps its level at run time."""

    @abstractmethod
    def problems(self, ports: tuple[str, ...]) -> Iterator[Problem]:
        """What is wrong with it in a session with these ports."""

    turns: ClassVar[bool] = True
    """Whether a port may turn; otherwise its coordinates are those of places."""

    def turning_problems(self, ports: tuple[str, ...], turning: Collection[str]) -> Iterator[Problem]:
        """What is wrong with it where these of the session's ports turn."""
        if not self.turns and turning:
            port = next(port for port in ports if port in turning)
            expected = f"ports that translate, or another type: a tool of a {self.type} moves along axes"
            yield Problem((), f"the port {port!r}, which turns", expected)

    @property
    def turning(self) -> tuple[str, ...]:
        """The names in :meth:`reported` of what turns."""
        return ()

    @abstractmethod
    def for_design(self, ports: tuple[str, ...]) -> Environment:
        """The same as design has it, in a session with these ports and without :meth:`problems`.

        Raises:
            Infeasible: a static gain is stated that its poles do not permit.
        """

    @property
    def buttons(self) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
        """The buttons that it uses: where it names each, its device and its name."""
        return iter(())

    def code(
        self, ports: tuple[str, ...], turning: Collection[str] = (), hands: Mapping[str, float] = NO_HANDS
    ) -> tuple[str, dict[str, Any]] | None:
        """The factory of the model that is asked, and its parameters, where these ports turn; None where none is.

        Args:
            ports: of the session, in order.
            turning: those that turn.
            hands: by device whose orientation is a port, the greatest k of its spring, N·m/rad.
        """
        return None

    @property
    def turned(self) -> tuple[str, ...]:
        """The devices whose tools it can turn in space."""
        return ()

    @property
    def tried_first(self) -> bool:
        """Whether its model is made once before anything is started: it may be refused, and is no stranger's code."""
        return False

    def reported(self, ports: tuple[str, ...]) -> tuple[str, ...]:
        """The masses, or coordinates of bodies, whose positions are reported, in the order of the state."""
        return ()

    @property
    def oriented(self) -> tuple[str, ...]:
        """The bodies whose orientations are reported besides their positions."""
        return ()

    def masses_and_springs(self, ports: tuple[str, ...]) -> tuple[dict[str, float], tuple[NetworkLink, ...]]:
        """By name in :meth:`reported` the mass, kg, or 0 where it is not known here; and the springs, for drawing."""
        return dict.fromkeys(self.reported(ports), 0.0), ()

    def geometry(self, ports: tuple[str, ...]) -> ContactScene | None:
        """Tools, bodies and obstacles for drawing; None for an environment without places."""
        return None

    def hardest(self, ports: tuple[str, ...]) -> dict[str, float]:
        """By port the stiffness of the hardest thing that it meets, N/m; without those that meet nothing known here."""
        met = [
            (port, arm * arm * link.stiffness)
            for link in self.masses_and_springs(ports)[1]
            for port, arm in zip(link.ends, link.arms, strict=True)
            if port in ports
        ]
        if (scene := self.geometry(ports)) is not None:
            moved = {tool.name: tool.ports for tool in scene.tools}
            met += [
                (ports[index], pair.surface.stiffness)
                for pair in scene.contacts.pairs
                for name in pair.names
                for index in moved.get(name, ())
            ]
        found: dict[str, float] = {}
        for port, stiffness in met:
            found[port] = max(found.get(port, 0.0), stiffness)
        return found

    @property
    def without_series(self) -> str:
        """Why none of its compliance may be counted in series, as in *found ... with ...*; empty where it may be."""
        if self.in_series and not getattr(self, "delay", 0):  # a key of some kinds
            return ""
        return f"an environment of type {self.type}{' with a delay' if self.in_series else ''}"
