"""Names of a package that are imported at their first use and declared in its stub file.

A package that exports names of heavy modules has a stub ``__init__.pyi`` beside its ``__init__.py``. Each line
``from MODULE import NAME as NAME`` of the stub is read by type checkers and editors, and at run time by
:func:`lazy_names`: the stub is the only place where a name and its module stand. Importing the package reads nothing.
"""

from __future__ import annotations

import importlib
import sys

TYPE_CHECKING = False  # without importing typing: every node and every command pays for what is imported here
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The functions ``__getattr__`` and ``__dir__`` of a package ([PEP562]_).

    ``__all__`` is one of the names that ``__getattr__`` returns: the names of the stub, sorted.

    Args:
        package: its dotted name.
        file: its ``__init__.py``; the stub is beside it.
    """
    known: dict[str, tuple[str, str]] = {}

    def homes() -> dict[str, tuple[str, str]]:
        if not known:
            with open(f"{file.removesuffix('.py')}.pyi", encoding="utf-8") as stub:
                known.update(_imports(stub.read()))
        return known

    def find(name: str) -> Any:
        """A name of the stub, imported from its module.

        Raises:
            AttributeError: the stub does not have the name.
            MissingExtra: its module imports one of an extra that is not installed.
        """
        if name == "__all__":
            return sorted(homes())
        if name.startswith("__") or name not in homes():  # the import system asks for __path__ and the like
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])
        from manyhands.extras import explained

        module, own = homes()[name]
        with explained():
            found = getattr(importlib.import_module(module), own, None)
        if found is None:
            found = importlib.import_module(f"{module}.{own}")
        sys.modules[package].__dict__[name] = found  # the next use finds it without this function
        return found

    def names() -> list[str]:
        return sorted({*sys.modules[package].__dict__, *homes()})

    return find, names


def _imports(stub: str) -> dict[str, tuple[str, str]]:
    """The module, and the name there, of each name that the stub imports under an alias."""
    import ast  # at the first use of a name, and not when the package is imported

    return {
        alias.asname: (statement.module, alias.name)
        for statement in ast.parse(stub).body
        if isinstance(statement, ast.ImportFrom) and statement.module is not None
        for alias in statement.names
        if alias.asname is not None
    }
