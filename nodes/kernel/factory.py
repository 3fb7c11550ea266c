"""Code of other packages that a session names: what a name is, where its module is looked for, and how it is called.

A session names a *factory*, "package.module:function": of a model of the environment
(:mod:`manyhands.nodes.environment.model`), or of a driver (:mod:`manyhands.nodes.device.plugin`). The process that
needs the object imports the module and calls the factory once with the node's ports, the period and the session's
parameters. Reading, designing, proving and drawing a session import nothing.

**The code is trusted.** It runs with the rights of the process that imports it, and nothing here confines it. Python's
import path is searched first, then the folder of the session file. So no file beside a session file can take the place
of an installed module.

A package may publish a factory under a short name, by an entry point of the group :data:`DRIVERS`, :data:`MODELS` or
:data:`ENGINES`.
:func:`published` reads the names from the packages' metadata and imports none of them.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from manyhands.extras import MissingExtra, explained
from manyhands.nodes.kernel.lifetime import Stopped

FACTORY: Final = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", re.ASCII)
"""The form of a factory's name: package.module:function."""

DRIVERS: Final = "manyhands.drivers"
"""The group of the entry points that name drivers."""

MODELS: Final = "manyhands.models"
"""The group of the entry points that name models of the environment."""

ENGINES: Final = "manyhands.engines"
"""The group of the entry points that name physics engines."""

SHIPPED: Final[Mapping[str, Mapping[str, str]]] = {
    DRIVERS: {
        "evdev-wheel": "manyhands.devices.evdev:EvdevWheel",
        "force-dimension": "manyhands.devices.force_dimension:ForceDimension",
        "haply-inverse3": "manyhands.devices.haply:HaplyInverse3",
        "moteus": "manyhands.devices.moteus:Moteus",
        "odrive": "manyhands.devices.odrive:ODrive",
        "serial-board": "manyhands.devices.serial_board:SerialBoard",
    },
    ENGINES: {"mujoco": "manyhands.nodes.environment.mujoco:MujocoEngine"},
}
"""The factories of this package under short names, by group: its own code, of which no run warns."""

LIBRARY: Final = "library"
"""The parameter of such a driver that names the file of a maker's library."""

LOADS: Final[Mapping[str, str]] = {
    SHIPPED[DRIVERS]["force-dimension"]: "libdrd as FORCEDIM_SDK names it, or as the platform's search finds it",
}
"""Shipped drivers that load a library of the maker's, and which one where the session names none."""

EXTRA_OF: Final[Mapping[str, str]] = {SHIPPED[DRIVERS]["haply-inverse3"]: "haply"}
"""Shipped drivers that need an extra of this package, and which."""

MESH: Final = "manyhands.nodes.environment.mesh:MeshProxies"
"""This package's model of a mesh. It takes data alone, and checks them, so it needs no permission and no warning."""


class FactoryError(ValueError):
    """A factory cannot be imported or fails; the message names it and the reason."""


@dataclass(frozen=True)
class FactoryName:
    """A factory that a session names, and what it is called with.

    Attributes:
        factory: "package.module:function".
        parameters: the factory's third argument, plain data.
        folder: the folder of the session file, searched after Python's import path; empty for none.

    Raises:
        ValueError: the factory's name does not have that form.
    """

    factory: str
    parameters: Mapping[str, Any]
    folder: str = ""

    def __post_init__(self) -> None:
        if not FACTORY.fullmatch(self.factory):
            raise ValueError(f"found the name {self.factory!r:.80}; expected package.module:factory")


def made_by(name: FactoryName, what: str, ports: tuple[str, ...], T: float) -> Any:
    """Import a factory, and call it with the ports, the period T (s) and the parameters; returns what it returns.

    Args:
        name: the factory.
        what: the kind of its result, for the message: "model" or "driver".
        ports: of the node, in order.
        T: period, s.

    Raises:
        FactoryError: the module cannot be imported, has no such function, or the function raises.
    """
    module, _, function = name.factory.partition(":")
    if name.folder and name.folder not in sys.path:
        sys.path.append(name.folder)  # the last, so that it hides no installed module
    called = False
    try:
        with explained():
            factory = getattr(importlib.import_module(module), function)
            called = True
            return factory(ports, T, dict(name.parameters))
    except MissingExtra as error:
        raise FactoryError(f"the {what} {name.factory} cannot be made: {error}") from error
    except (Stopped, FactoryError):
        raise  # the process is to end, which is no failure of the factory; or a shipped one has said what is wrong
    except (Exception, SystemExit) as error:  # foreign code: every exception is reported with the factory's name
        where = f" or in {name.folder}" if name.folder else ""
        # what a factory says of its own hardware needs no more; a TypeError may be that it takes other arguments
        expected = f"; expected a factory of (ports, period, parameters) on Python's import path{where}"
        if module.endswith(".py") and not called:
            expected += f": a module is named without its suffix, {module.removesuffix('.py')}:{function}"
        elif isinstance(error, ModuleNotFoundError) and error.name is not None and not called:
            expected += f": install the package that has {error.name} into {sys.executable}, or name another module"
        raise FactoryError(
            f"the {what} {name.factory} cannot be made: found {in_one_line(error)}"
            f"{'' if called and not isinstance(error, TypeError) else expected}"
        ) from error


def place_of(name: FactoryName) -> str:
    """Where the code of a factory comes from, for a statement before it runs; imports nothing.

    Only the folder of the session file can be looked at without running a package's code.
    """
    top = name.factory.partition(":")[0].partition(".")[0]
    folder = Path(name.folder) if name.folder else None
    for path in () if folder is None else (folder / f"{top}.py", folder / top):
        if path.exists():
            return f"{path}, unless Python's import path has a module {top}"
    return "Python's import path"


def is_shipped(factory: str) -> bool:
    """Whether a factory is this package's own code."""
    return factory == MESH or any(factory in own.values() for own in SHIPPED.values())


def library_of(name: FactoryName) -> str | None:
    """The library of a maker that a shipped driver loads into its process, in words; None where it loads none."""
    if name.factory not in LOADS:
        return None
    return str(name.parameters.get(LIBRARY) or LOADS[name.factory])


def require_allowed(name: FactoryName | None, allowed: str | None) -> None:
    """Refuse to run code that a file from elsewhere names, unless the user of this machine has named it too.

    This package's model of a mesh needs no permission. A library that a file from elsewhere names is never loaded: its
    path is no name that says whose code it is.

    Args:
        name: the factory in the file; None for none.
        allowed: the factory that the user allows.

    Raises:
        FactoryError: the user has allowed no code, or other code than the file names, or the file names a library.
    """
    if name is not None and name.factory in LOADS and name.parameters.get(LIBRARY):
        raise FactoryError(
            f"parameters.{LIBRARY}: found {name.parameters[LIBRARY]!r:.200}, code that a file from elsewhere names; "
            f"expected none: this machine says itself what {name.factory} loads, {LOADS[name.factory]}"
        )
    if name is not None and name.factory != allowed and name.factory != MESH:
        raise FactoryError(
            f"found the factory {name.factory:.200}, whose code would run here with your rights, and "
            f"{'no permission for it' if allowed is None else f'a permission for {allowed:.200}'}; expected "
            f"--allow-code {name.factory:.200}, where you trust that package"
        )


def published(group: str) -> dict[str, str]:
    """The factories that installed packages publish under a short name, "package.module:function" by name.

    Args:
        group: :data:`DRIVERS`, :data:`MODELS` or :data:`ENGINES`.
    """
    found = importlib.metadata.entry_points(group=group)
    return dict(SHIPPED.get(group, {})) | {entry.name: entry.value for entry in found if FACTORY.fullmatch(entry.value)}


_MOST_TOLD: Final = 400
"""Characters of an exception's text that are told: a sentence of what was found, and one of what to do."""


def in_one_line(error: BaseException) -> str:
    """An exception in one line of bounded length; its text comes from foreign code, and may be anything."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # noqa: BLE001 -- a text that cannot be made must not hide that there was an error
        text = "without a text"
    return f"{type(error).__name__}: {text[:_MOST_TOLD]}" if text else type(error).__name__
