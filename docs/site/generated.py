"""Directives of the site for what is not written by hand: public names, commands, and the keys of a session file.

    ```{public-names} manyhands            the names of a package's stub, each with its docstring
    ```{commands}                          the help of every command
    ```{session-keys}                      every key of a session file, from its JSON schema

The schema itself is on the site as ``session.schema.json``.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from manyhands.launch.app.cli import GROUPS, app
from manyhands.launch.session.schema import session_schema

SCHEMA_FILE: Final = "session.schema.json"
"""Where the schema is on the site, below its root."""

_WIDTH: Final = 80  # columns of the commands' help
_ROLE: Final = re.compile(r":\w+:`~?\.?([^`]+)`")
_CITATION: Final = re.compile(r"\[([A-Z][A-Za-z]+\d{4}|PEP\d+)\]_")


def public_names(package: str) -> dict[str, str]:
    """The names that a package's stub declares, each with the module where it is."""
    stub = importlib.import_module(package).__file__ or ""
    lines = ast.parse(Path(stub).with_suffix(".pyi").read_text(encoding="utf-8")).body
    return {
        alias.asname or alias.name: f"{line.module}"
        for line in lines
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }


def returned(function: Callable[..., object]) -> list[type]:
    """The classes of this program that a function returns."""
    return classes_in(function.__annotations__.get("return", ""), function.__module__)


def classes_in(annotation: object, module: str) -> list[type]:
    """The classes of this program that an annotation names, also those that only a checker of types imports."""
    written = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    found = [_named(sys.modules[module], name) for name in re.findall(r"\b[A-Za-z_]\w*\b(?!\()", written)]
    return [one for one in found if isinstance(one, type) and one.__module__.startswith("manyhands.")]


def _named(module: ModuleType, name: str) -> object:
    """What a name in an annotation of a module stands for; None where it is no name of this program."""
    if name in vars(module):
        return vars(module)[name]
    home = _imported(module).get(name)
    return None if home is None else getattr(importlib.import_module(home), name, None)


@cache
def _imported(module: ModuleType) -> dict[str, str]:
    """The names of this program that a module imports, also for a checker of types alone, each with its module."""
    lines = [line for line in ast.walk(ast.parse(inspect.getsource(module))) if isinstance(line, ast.ImportFrom)]
    ours = [(line.module or "", line.names) for line in lines if (line.module or "").startswith("manyhands.")]
    return {alias.name: home for home, names in ours for alias in names}


class _Written(SphinxDirective):
    """A directive whose content is Markdown that is made here."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        return self.parse_text_to_nodes("\n".join(self.lines()), allow_section_headings=True)

    def lines(self) -> Iterator[str]:
        """The content, line by line."""
        raise NotImplementedError


class PublicNames(_Written):
    """The names of a package's stub in their order, by autodoc; below a function, the class that only it returns."""

    required_arguments = 1
    optional_arguments = 0

    def lines(self) -> Iterator[str]:
        """Each name in a section of its own."""
        package = self.arguments[0]
        named = {getattr(importlib.import_module(module), name) for name, module in _names_of_both().items()}
        for name, module in public_names(package).items():
            found = getattr(importlib.import_module(module), name)
            if inspect.ismodule(found):
                continue  # a page of its own
            yield from (f"## {name}", "", "```{eval-rst}")
            if inspect.isclass(found):
                shown = {key: _about(value) for key, value in vars(found).items() if not key.startswith("_")}
                members = ", ".join(key for key, about in shown.items() if "Example:" in about)  # for users, not for us
                yield f".. autoclass:: {module}.{name}"
                yield f"   :members: {members}" if members else ""
            else:
                yield f".. autofunction:: {module}.{name}"
            yield from ("```", "")
            for one in returned(found) if inspect.isfunction(found) else ():
                if one not in named:
                    named.add(one)
                    yield from (f"### {one.__name__}", "", f"What `{name}` returns.", "", "```{eval-rst}")
                    yield from (f".. autoclass:: {one.__module__}.{one.__name__}()", "   :members:", "```", "")


def _names_of_both() -> dict[str, str]:
    """The public names of both packages, each with its module."""
    return public_names("manyhands") | public_names("manyhands.design.passivity")


def _about(value: object) -> str:
    """The docstring of a member, also of a class method."""
    return inspect.getdoc(getattr(value, "__func__", value)) or ""


class Commands(_Written):
    """Every command by its group, with the help that it prints."""

    def lines(self) -> Iterator[str]:
        """Each command in a section of its own."""
        group = typer.main.get_group(app)
        for title, listed in GROUPS.items():
            yield from (f"## {title}", "")
            for name in listed:
                command = group.get_command(None, name)  # type: ignore[arg-type]  # it needs no context
                with typer.Context(command, info_name=f"manyhands {name}", max_content_width=_WIDTH) as context:
                    yield from (f"### {name}", "", "```text", command.get_help(context), "```", "")


class SessionKeys(_Written):
    """Every part of a session file with its keys: what each means, its form, and its default."""

    def lines(self) -> Iterator[str]:
        """Each part in a section of its own."""
        schema = session_schema()
        parts = {"Session": schema, **schema["$defs"]}
        for title, part in parts.items():
            yield from (f"## {title}", "", part["description"], "")
            for key, form in part["properties"].items():
                required = ", required" if key in part.get("required", ()) else ""
                default = f"; by default `{json.dumps(form['default'])}`" if "default" in form else ""
                yield f"`{key}`{required}"
                yield f": {form['description']}. *{in_words(form)}*{default}"
                yield ""


def in_words(form: dict[str, Any]) -> str:
    """The form of a value in words, as a schema states it."""
    match form:
        case {"$ref": reference}:
            part = reference.rpartition("/")[2]
            return f"[{part}](#{part.lower()})"
        case {"anyOf": forms}:
            return ", or ".join(dict.fromkeys(in_words(one) for one in forms))
        case {"const": word} | {"enum": [word]}:
            return f"`{word}`"
        case {"enum": words}:
            return " or ".join(f"`{word}`" for word in words)
        case {"type": "array", "items": items}:
            least, most = form.get("minItems", 0), form.get("maxItems")
            return f"a list of {least if least == most else f'{least} to {most}'}, each: {in_words(items)}"
        case {"type": "object", "properties": properties}:
            return f"a mapping with {', '.join(f'`{key}`' for key in properties)}"
        case {"type": "object", "additionalProperties": {**values}}:
            return f"a mapping from names, each: {in_words(values)}"
        case {"type": "string"}:
            return f"text of the form `{form['pattern'].strip('^$')}`" if "pattern" in form else "text"
        case {"type": "boolean"}:
            return "true or false"
        case {"type": "integer" | "number" as kind}:
            return f"a {'whole ' if kind == 'integer' else ''}number{_bounds(form)}"
        case {"type": [*kinds]}:
            return " or ".join(kinds)
    raise ValueError(f"found the form {form}; expected one that is described here")


def _bounds(form: dict[str, Any]) -> str:
    """The bounds of a number, without those that every number has."""
    most = form["maximum"]
    if "exclusiveMinimum" in form:
        low = f" greater than {form['exclusiveMinimum']:g}"
    elif form["minimum"] <= -most:
        return ""
    elif most < 1e12:
        return f" from {form['minimum']:g} to {most:g}"
    else:
        low = f" of at least {form['minimum']:g}"
    return f"{low} and at most {most:g}" if most < 1e12 else low


def for_readers(_app: Sphinx, _what: str, _name: str, _object: object, _options: object, lines: list[str]) -> None:
    """Docstrings as the site shows them: names without links to what has no page, citations by their keys."""
    for index, line in enumerate(lines):
        plain = _ROLE.sub(lambda found: f"``{found[1].removeprefix('manyhands.')}``", line)
        lines[index] = _CITATION.sub(lambda found: f"[{found[1]}]", plain)


def write_schema(site: Sphinx, error: Exception | None) -> None:
    """Put the schema beside the pages."""
    if error is None and site.builder.format == "html":
        text = json.dumps(session_schema(), indent=1, ensure_ascii=False)
        (Path(site.outdir) / SCHEMA_FILE).write_text(text + "\n", encoding="utf-8")


def setup(site: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    site.add_directive("public-names", PublicNames)
    site.add_directive("commands", Commands)
    site.add_directive("session-keys", SessionKeys)
    site.connect("autodoc-process-docstring", for_readers)
    site.connect("build-finished", write_schema)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
