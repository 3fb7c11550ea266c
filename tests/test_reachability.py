"""Every module, function, class and method of the product is reached from an entry point, the public API or a document.

The roots are the commands of pyproject.toml and of manyhands' own list, every ``__main__``, the names that
:data:`PUBLIC` packages declare in ``__all__``, the examples, and the documents: the Python that they show and the
``manyhands.…`` names in their text. From there the search follows what the code itself refers to. Tests are no root:
what only they use belongs to tests/support.

A name at a module's top level is followed exactly, through imports. An attribute is followed by its name alone, to
every class that is reached. So a dead method hides behind a living one of the same name, and nothing living is
reported.
"""

from __future__ import annotations

import ast
import doctest
import functools
import importlib
import os
import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import manyhands
from manyhands.launch.app.cli import GROUPS
from manyhands.nodes.kernel.factory import MESH, SHIPPED

PRODUCT = Path(manyhands.__file__).parent
REPOSITORY = Path(__file__).parents[1]
PUBLIC = ("manyhands", "manyhands.design.passivity")

TRANSPARENT = {
    "abstractmethod", "cache", "cached_property", "classmethod", "contextmanager", "dataclass", "final", "lru_cache",
    "overload", "override", "property", "runtime_checkable", "setter", "staticmethod", "total_ordering", "unique",
}  # fmt: skip
"""Decorators that hand nobody else the function; any other one registers it, so that its module reaches it."""

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


@dataclass(frozen=True)
class Unit:
    """A piece of code that is reached or not: a module's top level, a function, a class's body, or a method.

    Attributes:
        module: dotted name of the module.
        name: of the function or class; empty for the top level.
        method: of the method; empty for the others.
    """

    module: str
    name: str = ""
    method: str = ""

    def __str__(self) -> str:
        return ".".join(filter(None, (self.module, self.name, self.method)))


@dataclass
class Module:
    """The content of a module's source.

    Attributes:
        code: the statements of every unit.
        package: where its relative imports begin.
        imports: what each name that is imported at the top level stands for: a module, or a name in one.
        registered: units that a decorator passes to other code.
    """

    name: str
    package: str
    code: dict[Unit, list[ast.AST]] = field(default_factory=dict)
    imports: dict[str, tuple[str, str]] = field(default_factory=dict)
    registered: set[Unit] = field(default_factory=set)


def sources(top: Path, name: str) -> dict[str, Module]:
    """Every module below ``top``, links included, by its dotted name."""
    found = {}
    for folder, folders, files in os.walk(top, followlinks=True):
        folders[:] = [one for one in folders if one != "__pycache__"]
        for file in files:
            if file.endswith(".py"):
                path = Path(folder) / file
                parts = [name, *path.relative_to(top).with_suffix("").parts]
                package = ".".join(parts[:-1])
                dotted = package if parts[-1] == "__init__" else ".".join(parts)
                found[dotted] = module_of(dotted, package, path.read_text(encoding="utf-8"))
    return found


def module_of(name: str, package: str, text: str) -> Module:
    """The content of a module's source."""
    module = Module(name, package)
    top = Unit(name)
    module.code[top] = []
    for statement in flat(ast.parse(text).body):
        if isinstance(statement, Definition):
            unit = Unit(name, statement.name)
            add(module, unit, statement)
            if isinstance(statement, ast.ClassDef):
                module.code[unit] = [*statement.decorator_list, *statement.bases, *statement.keywords]
                for inner in statement.body:
                    if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
                        add(module, Unit(name, statement.name, inner.name), inner)
                    else:
                        module.code[unit].append(inner)
            continue
        module.code[top].append(statement)
        module.imports.update(imports_of(statement, package))
    return module


def flat(statements: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements of a top level, those under ``if`` and ``try`` among them."""
    for statement in statements:
        if isinstance(statement, ast.If | ast.Try):
            inner = [*statement.body, *statement.orelse]
            if isinstance(statement, ast.Try):
                inner += [one for handler in statement.handlers for one in handler.body] + statement.finalbody
            else:
                yield ast.Expr(statement.test)
            yield from flat(inner)
        else:
            yield statement


def add(module: Module, unit: Unit, definition: Definition) -> None:
    """A definition, and whether it is registered; of two of one name (a property and its setter) both count."""
    module.code.setdefault(unit, []).append(definition)
    for decorator in definition.decorator_list:
        target = decorator.func if isinstance(decorator, ast.Call) else decorator
        if (target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")) not in TRANSPARENT:
            module.registered.add(unit)


def imports_of(node: ast.AST, package: str) -> dict[str, tuple[str, str]]:
    """What the names stand for that an import binds: (module, "") or (module, name)."""
    found = {}
    for one in ast.walk(node):
        if isinstance(one, ast.Import):
            for alias in one.names:
                bound = alias.asname or alias.name.split(".")[0]
                found[bound] = (alias.name if alias.asname else bound, "")
        elif isinstance(one, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - one.level + 1] if one.level else []
            source = ".".join([*above, *filter(None, [one.module])])
            for alias in one.names:
                found[alias.asname or alias.name] = (source, alias.name)
    return found


def imported_modules(node: ast.AST, package: str) -> Iterator[str]:
    """Modules that the imports in a piece of code run, and names that may be modules."""
    for one in ast.walk(node):
        if isinstance(one, ast.Import):
            yield from (alias.name for alias in one.names)
    for source, name in imports_of(node, package).values():
        yield source
        yield f"{source}.{name}"


class Search:
    """What is reached so far.

    Attributes:
        reached: units.
    """

    def __init__(self, modules: dict[str, Module]) -> None:
        self.modules = modules
        self.reached: set[Unit] = set()
        self._attributes: set[str] = set()
        self._new: list[Unit] = []

    def module(self, name: str) -> None:
        """A module is imported, and with it the packages that it is in."""
        parts = name.split(".")
        for end in range(1, len(parts) + 1):
            if (above := ".".join(parts[:end])) in self.modules:
                self._reach(Unit(above))
                if Unit(above, "__getattr__") in self.modules[above].code:
                    self._reach(Unit(above, "__getattr__"))
                for unit in self.modules[above].registered:
                    if not unit.method:
                        self._reach(unit)

    def name(self, module: str, name: str) -> None:
        """A name of a module's top level is used; what it was imported from is followed."""
        while module in self.modules:
            self.module(module)
            if Unit(module, name) in self.modules[module].code:
                self._reach(Unit(module, name))
                return
            if self._is_submodule(module, name):
                self.module(f"{module}.{name}")
                return
            source = self.modules[module].imports.get(name, (module, name))
            if source == (module, name):
                return
            module, name = source
        if not name:
            self.module(module)

    def public(self, one: Any) -> None:
        """A function or class of the public API, with all its public methods."""
        self.name(one.__module__, one.__qualname__)
        for unit in self.modules[one.__module__].code:
            if (unit.name, unit.method[:1] != "_") == (one.__qualname__, True):
                self._reach(unit)

    def code(self, nodes: Iterable[ast.AST], package: str, imports: dict[str, tuple[str, str]], within: str) -> None:
        """A piece of code runs, in the module ``within`` ("" for none of the product)."""
        for node in nodes:
            own = imports_of(node, package)
            imports = imports | own
            for name in imported_modules(node, package):
                self.module(name)
            local = locals_of(node) - set(own)
            for one in ast.walk(node):
                match one:
                    case ast.Name(id=name) if name not in local:
                        self._use(name, "", imports, within)
                    case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                        self._use(name, attribute, imports, within)
                        self._attributes.add(attribute)
                    case ast.Attribute(attr=attribute) | ast.keyword(arg=str(attribute)):
                        self._attributes.add(attribute)
                        self._dotted(one, imports)
                    case ast.MatchClass(kwd_attrs=names):
                        self._attributes.update(names)
                    case ast.Call(func=ast.Name(id="getattr" | "setattr" | "hasattr")):
                        self._attributes.update(text.value for text in one.args if is_text(text))
                    case ast.Constant(value=str(text)) if text in self.modules:
                        self.module(text)  # a process is started by it
                    case _:
                        pass

    def run(self) -> None:
        """Follow all that is reached to its end."""
        before = -1
        while before != len(self.reached):
            before = len(self.reached)
            while self._new:
                unit = self._new.pop()
                module = self.modules[unit.module]
                self.module(unit.module)
                self.code(module.code[unit], module.package, module.imports, unit.module)
            for module in self.modules.values():
                for unit in module.code:
                    if unit.method and Unit(unit.module, unit.name) in self.reached and self._called(unit, module):
                        self._reach(unit)

    def _called(self, unit: Unit, module: Module) -> bool:
        return (
            unit.method in self._attributes
            or unit in module.registered
            or called_by_a_base(unit)
            or (unit.method.startswith("__") and unit.method.endswith("__"))
        )

    def _reach(self, unit: Unit) -> None:
        if unit not in self.reached:
            self.reached.add(unit)
            self._new.append(unit)

    def _use(self, name: str, attribute: str, imports: dict[str, tuple[str, str]], within: str) -> None:
        """``name``, or an attribute of it, is used."""
        if within:
            self.name(within, name)
        if name not in imports:
            return
        module, imported = imports[name]
        if imported and not self._is_submodule(module, imported):
            self.name(module, imported)
        elif attribute:
            self.name(f"{module}.{imported}" if imported else module, attribute)

    def _is_submodule(self, module: str, name: str) -> bool:
        """Whether ``module.name`` is a module; a package may import a function of its submodule's name instead."""
        bound = self.modules[module].imports.get(name) if module in self.modules else None
        return f"{module}.{name}" in self.modules and bound in (None, (module, name))

    def _dotted(self, node: ast.AST, imports: dict[str, tuple[str, str]]) -> None:
        """``a.b.c`` where ``import a.b``."""
        parts: list[str] = []
        while isinstance(node, ast.Attribute):
            parts.insert(0, node.attr)
            node = node.value
        if isinstance(node, ast.Name) and node.id in imports and not imports[node.id][1]:
            *above, name = [imports[node.id][0], *parts]
            self.name(".".join(above), name)


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def locals_of(node: ast.AST) -> set[str]:
    """Names that a function binds itself: they are not those of the module."""
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return set()
    found = {one.arg for one in ast.walk(node.args) if isinstance(one, ast.arg)}
    return found | {one.id for one in ast.walk(node) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)}


def documents() -> Iterator[tuple[Path, str]]:
    """Markdown of the repository, and the examples."""
    for path in [*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md"), *(PRODUCT / "protocol").rglob("*.md")]:
        yield path, path.read_text(encoding="utf-8")
    for path in (REPOSITORY / "examples").glob("*.py"):
        yield path, f"```python\n{path.read_text(encoding='utf-8')}\n```"


def python(block: str) -> str:
    """The statements of a block, without prompts and what is printed after them."""
    if not block.startswith(">>>"):
        return block
    return "".join(example.source for example in doctest.DocTestParser().get_examples(block))


def unreached(modules: dict[str, Module], commands: Iterable[str], texts: Iterable[str]) -> list[Unit]:
    """What no root reaches; of a module or class that is not reached only itself.

    Args:
        modules: the product's, by name.
        commands: entry points, "module:function".
        texts: documents.
    """
    search = Search(modules)
    for command in commands:
        search.name(*command.split(":"))
    for listed in (listed for group in GROUPS.values() for listed in group.values()):
        search.module(f"manyhands.launch.app.cli.{listed.module}")  # imported when one of its commands runs
    for name in modules:
        if name.rpartition(".")[2] == "__main__":
            search.module(name)
    for name in PUBLIC:
        package = importlib.import_module(name)
        for exported in getattr(package, "__all__", ()):
            one = getattr(package, exported)
            if not isinstance(one, ModuleType):
                search.public(one)
            elif callable(one):  # a room whose name is a function's, too
                search.name("manyhands.launch.app.api", exported)
    for text in texts:
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            search.code([ast.parse(python(textwrap.dedent(block)))], "", {}, "")
        for dotted in re.findall(r"\bmanyhands(?:\.\w+)+", text):
            module, _, name = dotted.rpartition(".")
            search.module(dotted) if dotted in modules else search.name(module, name)
    search.run()
    found = [unit for module in modules.values() for unit in module.code if unit not in search.reached]
    missing = set(found)
    return [
        unit
        for unit in found
        if not (unit.name and Unit(unit.module) in missing)
        and not (unit.method and Unit(unit.module, unit.name) in missing)
    ]


@functools.cache
def called_by_a_base(unit: Unit) -> bool:
    """Whether a class that is not the product's knows the method: it may call it."""
    found = getattr(importlib.import_module(unit.module), unit.name)
    return any(
        hasattr(base, unit.method) for base in found.__mro__[1:] if base.__module__.partition(".")[0] != "manyhands"
    )


CALLED_FROM_OUTSIDE = {
    # PyYAML's Composer calls what its Resolver has otherwise
    "manyhands.launch.session.yaml._Loader.ascend_resolver",
    "manyhands.launch.session.yaml._Loader.descend_resolver",
    "manyhands.launch.session.yaml._Loader.resolve",
}


def test_the_product_is_reached() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [MESH, *project["scripts"].values(), *(factory for own in SHIPPED.values() for factory in own.values())]
    found = unreached(sources(PRODUCT, "manyhands"), named, [text for _, text in documents()])
    lines = "\n".join(sorted(set(map(str, found)) - CALLED_FROM_OUTSIDE))
    assert not lines, f"nothing but tests reaches\n{lines}\nexpected none; delete it, or move it to tests/support"
