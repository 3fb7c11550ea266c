"""A user's own model as the environment: how it is made, and how it is asked for proxies or for forces.

A session names the model's factory (:mod:`manyhands.nodes.kernel.factory`). The environment's process calls it once,
and asks the model that it returns once a tick: for proxies (:class:`ProxyModel`) where the session states their
stiffness, else for forces (:class:`ForceModel`).

**Buttons.** A model whose method has a parameter ``buttons`` besides is given those that are held down in the tick, as
a frozenset of names such as ``anna.grip``. What it does with them is its own; its level is kept all the same.

**The model is trusted code.** It runs in the environment's process with that process's rights, and nothing here
confines it: to start a session that names a model is to run the model's code. It receives no key and no socket, and of
the session only the factory's arguments.

**The answers of the model are not trusted.** An exception ends the session with the model's name. So do answers of a
wrong shape, not finite, or beyond :data:`MOST_FORCE` or :data:`MOST_POSITION`, and no such force reaches a port. A
model that does not return holds up its ticks; devices then let go by themselves, as for every environment that is late.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Final, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from manyhands.design.models.axis import units_by_port, units_of
from manyhands.nodes.kernel.factory import FactoryError, FactoryName, in_one_line, made_by
from manyhands.nodes.kernel.orientation import UPRIGHT, Quaternion, unit

Vector = NDArray[np.float64]

MOST_FORCE = 1e9
"""The greatest force of a model, N. Beyond it a force is a mistake; its square is still exact enough for a ledger."""


MOST_POSITION = 1e3
"""The greatest coordinate of a proxy, m, from where the tools begin. Beyond it a position is a mistake."""

PROXY = "proxy"
STEP = "step"
REACT = "react"
BUTTONS = "buttons"
"""The parameter by which a method asks for the buttons."""


class ProxyModel(Protocol):
    """The interface of a model whose forces are springs to proxies (:mod:`manyhands.nodes.environment.proxy`)."""

    def proxy(self, x: Vector, k: int) -> Any:
        """The proxies q(k), m: where the tools would be if they could not enter what they touch.

        Args:
            x: where the tools of this tick would be without any force of the model, r(k), m, one entry for each port.
                The model may keep the array.
            k: the tick, counted from 0 since the model was made.

        Returns:
            One number for each port, in any form that numpy converts to m finite floats. A model that touches nothing
            returns x.
        """
        ...


class Engine(Protocol):
    """The interface of a physics engine, whose tools are avatars: bodies of its own, joined to the tools by springs.

    It is made by a factory of (ports, period, parameters), as every model. Where ``type: engine`` names it, the
    parameters are ``model`` (the text of the model's file), ``assets`` (the files that it names, by name, in base64),
    ``tools`` (a name in the model for each port), ``turning`` (the ports that turn: in rad, and in N·m), ``bodies``
    (those whose positions are reported) and ``stiffness`` (the largest K at each port, N/m or N·m/rad).

    An engine may have a method ``drawing()`` besides. It is asked for it before the first step, and returns what its
    world looks like (:class:`manyhands.nodes.environment.drawing.WorldDrawing`), which the page of a session draws.

    Where the session lists ``orientations``, bodies that are seen to turn, the parameters have these names under that
    key, and the engine has ``orientations()``: for each of them the unit quaternion of its orientation, its real part
    and then its imaginary parts, after :meth:`step`.

    Where hands turn tools, the parameters have ``avatars``, a name in the model for each such tool, and
    ``avatar_stiffness``, k of its spring, N*m/rad. The engine then has ``turn(torques)``, which is called before each
    step with the torque on each avatar over that step, N*m, three numbers in the world's axes. It also has
    ``avatars()``: for each avatar the unit quaternion by which it is turned from where it began.
    """

    def step(self, x: Vector, f: Vector) -> Any:
        """Advance by one period, and return where the avatars are then, q(k), m, one number for each port.

        Args:
            x: where the tools of this tick would be without any force of the engine, r(k), m.
            f: the forces of the springs on the tools in the tick before, N, from where the avatars were; the avatars
                feel -f. While the proxy test holds a proxy, the tool feels less.
        """
        ...

    def positions(self) -> Any:
        """x, y and z of each reported body, m."""
        ...


class ForceModel(Protocol):
    """The interface of a model that is asked for forces, ahead of the tick's motion."""

    def react(self, x_e: Vector, k: int) -> Any:
        """The forces f_v(k) that the model wants to exert on the hands, N.

        Args:
            x_e: the predicted tool positions of this tick, p + D_V f_v(k-1), m, one entry for each port. The model may
                keep the array.
            k: the tick, counted from 0 since the model was made.

        Returns:
            One number for each port, in any form that numpy converts to m finite floats. A spring of stiffness c to
            the origin returns -c * x_e.
        """
        ...


EnvironmentModel: TypeAlias = ProxyModel | Engine | ForceModel


class ModelFailure(Exception):
    """A model gave no usable answer; the message names it, the tick, what was found and what was expected."""


def make_model(name: FactoryName, ports: tuple[str, ...], T: float, method: str | None = None) -> EnvironmentModel:
    """Import a factory and call it for the model of these ports with the period T (s).

    Args:
        name: the factory.
        ports: of the session, in order.
        T: period, s.
        method: what the model is asked by, :data:`PROXY` or :data:`REACT`; None for either.

    Raises:
        FactoryError: the factory cannot be imported or fails, or its result has no such method.
    """
    model: EnvironmentModel = made_by(name, "model", ports, T)
    has = [one for one in (PROXY, STEP, REACT) if callable(getattr(model, one, None))]
    wanted = {PROXY: {PROXY, STEP}, REACT: {REACT}, None: {PROXY, STEP, REACT}}[method]
    if not wanted & {*has}:
        found = " ".join([type(model).__name__, *(f"with {one} alone" for one in has)])
        raise FactoryError(f"the model {name.factory} cannot be asked: found {found}; expected {_EXPECTED[method]}")
    return model


_EXPECTED: Final[Mapping[str | None, str]] = {
    None: "an object with proxy(x, k), step(x, f) or react(x_e, k)",
    PROXY: "an object with proxy(x, k) or step(x, f), for the session states the stiffness of its proxies",
    REACT: "an object with react(x_e, k); for a model with proxy(x, k) or step(x, f), state stiffness in the session's "
    "environment, or check-model's --stiffness",
}


def _asks_for_buttons(method: Any) -> bool:
    """Whether a model's method has a parameter of that name."""
    try:
        return callable(method) and BUTTONS in inspect.signature(method).parameters
    except (TypeError, ValueError):  # of a built-in function, which tells none
        return False


class AskedModel:
    """A model and the checks on its answers.

    Attributes:
        failure: what was wrong with its first bad answer, after which it is not asked again; None before.
    """

    def __init__(
        self,
        name: str,
        model: EnvironmentModel,
        ports: tuple[str, ...],
        turning: Collection[str] = (),
        buttons: Sequence[str] = (),
    ) -> None:
        """Ask a model.

        Args:
            name: of it, for messages.
            model: the model.
            ports: at which it is asked for forces or proxies.
            turning: those of them that turn.
            buttons: the names of the buttons, in the order of their bits.
        """
        self._name, self._ports, self._model, self._buttons = name, ports, model, tuple(buttons)
        self._units, self._all = units_by_port(ports, turning), units_of(ports, turning)
        self._down: frozenset[str] = frozenset()
        self._wants = {one for one in (PROXY, STEP, REACT) if _asks_for_buttons(getattr(model, one, None))}
        self._none = np.zeros(len(ports))
        self.failure: str | None = None

    def press(self, pressed: int) -> None:
        """Tell the model from the next tick on which buttons are held down, where it asks for them."""
        self._down = frozenset(name for i, name in enumerate(self._buttons) if pressed >> i & 1)

    def _also(self, method: str) -> dict[str, frozenset[str]]:
        """What a method is given beside its arguments."""
        return {BUTTONS: self._down} if method in self._wants else {}

    def forces(self, x_e: Vector, k: int) -> Vector:
        """The model's forces at x_e, N; zero once it has failed. The model may keep the array ``x_e``, m."""
        model: Any = self._model
        also = self._also(REACT)
        found = self._answer(lambda at, tick: model.react(at, tick, **also), x_e, k, ("force", "N", MOST_FORCE))
        return self._none if found is None else found

    def proxies(self, x: Vector, f: Vector, k: int) -> Vector | None:
        """The model's proxies for the tools at x, m, or an engine's avatars; None once it has failed.

        Args:
            x: r(k), m; the model may keep the array.
            f: the springs' forces on the tools from where the avatars are, in the tick before, N, for an engine, which
                may keep the array.
            k: the tick.
        """
        model: Any = self._model
        kind = ("position", "m", MOST_POSITION)
        if callable(getattr(model, STEP, None)):
            also = self._also(STEP)
            return self._answer(lambda at, tick: model.step(at, f, **also), x, k, kind)
        also = self._also(PROXY)
        return self._answer(lambda at, tick: model.proxy(at, tick, **also), x, k, kind)

    def positions(self, bodies: int) -> list[float]:
        """Three coordinates of each of an engine's reported bodies, m; 0 where it has failed or gives others."""
        model: Any = self._model
        try:
            found = np.array(model.positions(), dtype=np.float64) if self.failure is None else np.zeros(0)
        except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code, as above
            self.failure = f"the engine {self._name} failed: found {in_one_line(error)}; expected positions in m"
            found = np.zeros(0)
        if found.shape == (3 * bodies,) and np.all(np.abs(found) <= MOST_POSITION):
            return [*map(float, found)]
        if self.failure is None:
            self.failure = (
                f"the engine {self._name} failed: found positions of the shape {found.shape}, or beyond "
                f"{MOST_POSITION:g} m; expected {3 * bodies} finite numbers, three for each body"
            )
        return [0.0] * (3 * bodies)

    def orientations(self, bodies: int) -> list[float]:
        """A unit quaternion of each body whose orientation is reported; upright where it has failed or gives others."""
        model: Any = self._model
        return [part for turn in self._quaternions(lambda: model.orientations(), bodies, "bodies") for part in turn]

    def turn(self, torques: Vector) -> None:
        """Turn an engine's avatars by these torques over its next step, N*m, three numbers in the world's axes each."""
        model: Any = self._model
        if self.failure is not None:
            return
        try:
            model.turn(torques)
        except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code, as above
            self.failure = f"the engine {self._name} failed: found {in_one_line(error)}; expected avatars that turn"

    def avatars(self, tools: int) -> list[Quaternion]:
        """The orientation of each avatar from where it began; upright where the engine has failed or gives others."""
        model: Any = self._model
        return self._quaternions(lambda: model.avatars(), tools, "avatars")

    def _quaternions(self, ask: Callable[[], Any], number: int, whose: str) -> list[Quaternion]:
        """So many orientations as the engine gives them, normalised; upright once it has failed, or fails with them."""
        if self.failure is None:
            try:
                numbers = [float(part) for part in ask()]
                found = [unit(numbers[at : at + 4]) for at in range(0, len(numbers), 4)]
            except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code, as above
                self.failure = f"the engine {self._name} failed: found {in_one_line(error)}; expected orientations"
            else:
                turned = [one for one in found if one is not None]
                if len(turned) == len(found) == number:
                    return turned
                self.failure = (
                    f"the engine {self._name} failed: found {numbers!r:.80}; expected a unit quaternion for each of "
                    f"{number} {whose}"
                )
        return [UPRIGHT] * number

    def _answer(
        self, ask: Callable[[Vector, int], Any], x: Vector, k: int, kind: tuple[str, str, float]
    ) -> Vector | None:
        """The checked answer; None once the model has failed, with :attr:`failure` as the reason."""
        if self.failure is not None:
            return None
        what, unit, most = kind
        m, expected = len(self._ports), f"{what}s in {self._all(unit)}"
        try:
            # a copy: the model may change the array that it has returned
            answer = np.array(ask(x, k), dtype=np.float64)
        except (Exception, SystemExit) as error:  # noqa: BLE001 -- foreign code: no exception of its may end the loop unnamed
            found = in_one_line(error)
        else:
            # written with not: a comparison with NaN is false, so NaN is refused as well
            if answer.shape != (m,):
                found, expected = f"an answer of the shape {answer.shape}", f"{m} {what}s, one a port"
            elif not np.abs(answer).max() <= most:
                port = int(np.argmin(np.abs(answer) <= most))
                unit = self._units[self._ports[port]](unit)
                found = f"a {what} of {answer[port]:g} {unit} at {self._ports[port]}"
                expected = f"a finite number of at most {most:g} {unit} in size"
            else:
                return answer
        at = f"failed at tick {k}: found {found}; expected {expected}"
        if callable(getattr(self._model, STEP, None)):  # its arithmetic is the engine's, its numbers are the file's
            self.failure = f"the engine {self._name} {at}; its file is environment.model"
        else:
            self.failure = f"the model {self._name} {at}; see its code"
        return None
