"""From the text of a session file to plain data, with the line of every value.

The parser removes YAML's surprises before anything is validated. Scalars follow the core schema of YAML 1.2, so
``1e-3`` is a number and ``no`` a word; under YAML 1.1, PyYAML's own, ``1e-3`` is a word, ``no`` is false, ``017`` is 15
and ``1:30`` is 90. A repeated key is refused; PyYAML would take its last value. Tags are refused, so that no text names
a Python type. Aliases are expanded under a limit, so that a short file cannot become a huge one.

The result consists of ``dict``, ``list``, ``str``, ``int``, ``float``, ``bool`` and ``None``. Every key and list item
has a :class:`SourcePlace`, from which later errors take the line.
"""

import gc
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import yaml
from yaml.composer import Composer
from yaml.events import CollectionStartEvent, ScalarEvent
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.scanner import Scanner

from manyhands.design.files import read_regular
from manyhands.launch.session.errors import SessionError, key_text, one_of, show
from manyhands.launch.session.limits import MAX_DEPTH, MAX_FILE_BYTES, MAX_NODES, MAX_OVERRIDE_CHARACTERS, MAX_OVERRIDES

_INT: Final = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT: Final = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITE: Final = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_WORDS: Final[Mapping[str, bool | float | None]] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}
_LONGEST_INT: Final = 18  # digits; a longer number becomes a float, whose size in memory is fixed


def plain_scalar(text: str) -> str | int | float | bool | None:
    """The value of an unquoted scalar in the core schema of YAML 1.2."""
    if text in _WORDS:
        return _WORDS[text]
    if _INT.fullmatch(text):
        if len(text) > _LONGEST_INT:
            return float(text) if text.lstrip("-+").isdecimal() else float("inf")
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if infinite := _INFINITE.fullmatch(text):
        return float(infinite[1] + "inf")
    return text


KeyPath: TypeAlias = tuple[str | int, ...]

_YAML: Final = "YAML: 'key: value' lines indented by spaces, with quotes around text that holds ': ' or ' #'"


@dataclass(frozen=True, slots=True)
class SourcePlace:
    """The origin of a value: a file and a line, or a ``--set`` option, which has no line."""

    source: str
    line: int | None


@dataclass(frozen=True, slots=True)
class SessionTree:
    """The plain data of a session, with the place of every key and list item."""

    source: str
    data: dict[str, object]
    places: Mapping[KeyPath, SourcePlace]

    def locate(self, path: KeyPath) -> tuple[KeyPath, SourcePlace]:
        """The place of ``path``, or of the nearest enclosing key that the file has; with that key's path."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.places:
                return path[:length], self.places[path[:length]]
        return (), self.places[()]


def read_tree(path: Path, kind: str = "session file", first: str = "session: NAME") -> SessionTree:
    """Read a session file, or another file of keys and values.

    Args:
        path: the file.
        kind: what it is, for messages.
        first: how it begins, for messages.

    Raises:
        SessionError: the file cannot be read, is too large, is not UTF-8 or is not acceptable YAML.
    """
    source = str(path)
    try:
        content = read_regular(path, MAX_FILE_BYTES)
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte in it
        reason = getattr(error, "strerror", None) or str(error)
        raise SessionError(source, None, "", f"{reason.lower()}", f"a {kind} that can be read") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        found = f"the byte 0x{content[error.start]:02x}, which is not UTF-8"
        raise SessionError(source, line, "", found, "a text file in UTF-8") from None
    return parse_tree(text, source, first)


def parse_tree(text: str, source: str, first: str = "session: NAME") -> SessionTree:
    """Turn the text of a session into plain data; errors name it by ``source``, and how it has to begin.

    Raises:
        SessionError: the text is not acceptable YAML, or not a mapping.
    """
    with _without_collector():
        node = _compose(text, source, has_lines=True)
        builder = _Builder(source, has_lines=True)
        data = None if node is None else builder.build(node, ())
    if not isinstance(data, dict):
        line = 1 if node is None else _line(node)
        found = "an empty file" if data is None else f"{show(data)} at the top"
        raise SessionError(source, line, "", found, f"keys and values, beginning with '{first}'")
    return SessionTree(source, data, {(): SourcePlace(source, 1), **builder.places})


if TYPE_CHECKING or not yaml.__with_libyaml__:

    class _Events(Reader, Scanner, Parser):
        """The parser of PyYAML in Python, from text to events."""

        def __init__(self, text: str) -> None:
            Reader.__init__(self, text)
            Scanner.__init__(self)
            Parser.__init__(self)

else:  # libyaml, which is in PyYAML's wheels, takes a tenth of the time: PyYAML alone takes 30 s for the largest file
    from yaml.cyaml import CParser as _Events


@contextmanager
def _without_collector() -> Iterator[None]:
    """Disable the garbage collector, which would traverse the growing tree again and again: half of the time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


class _Loader(Composer, _Events):
    """PyYAML up to the node graph, without YAML 1.1 scalars; it checks depth, count and tags of nodes as they come."""

    def __init__(self, text: str, builder: "_Builder") -> None:
        _Events.__init__(self, text)
        Composer.__init__(self)
        self._builder = builder
        self._depth = 0
        self._count = 0

    def resolve(self, _kind: object, _value: object, _implicit: object) -> str:
        """No tag: :func:`plain_scalar` finds the type of a scalar."""
        return ""

    def descend_resolver(self, _parent: object, _index: object) -> None:
        """Do nothing: no type depends on a node's path."""

    def ascend_resolver(self) -> None:
        """Do nothing: no type depends on a node's path."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose one node, and refuse tags, deep nesting and too many nodes.

        Raises:
            SessionError: the node is refused.
        """
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]  # the stubs leave it untyped
        if isinstance(event, ScalarEvent | CollectionStartEvent) and event.tag is not None:
            raise self._builder.error(event, (), f"the tag {event.tag}", "plain YAML, without tags")
        if self._depth >= MAX_DEPTH:
            raise self._builder.error(event, (), f"nesting deeper than {MAX_DEPTH}", "a flatter file")
        self._count += 1
        if self._count > MAX_NODES:
            raise self._builder.error(event, (), f"more than {MAX_NODES} values", "a smaller file")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


def _compose(text: str, source: str, has_lines: bool) -> yaml.Node | None:
    """The node graph of one YAML document; ``None`` for an empty one."""
    builder = _Builder(source, has_lines)
    if strange := Reader.NON_PRINTABLE.search(text):
        line = text.count("\n", 0, strange.start()) + 1 if has_lines else None
        found = f"the character {strange.group()!r}, which YAML does not allow"
        raise SessionError(source, line, "", found, _YAML)
    try:
        node: yaml.Node | None = _Loader(text, builder).get_single_node()
        return node
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else None
        problem = ", ".join(part for part in (error.context, error.problem) if part)
        if mark is not None and "\t" in "".join(text.split("\n", mark.line + 1)[mark.line : mark.line + 1]):
            problem += r"; the line has the character '\t'"
        found = f"text that is not YAML ({problem})"
    except (ValueError, OverflowError) as error:  # PyYAML lets these through for numbers in escapes
        line = None
        found = f"text that is not YAML ({error})"
    raise SessionError(source, line if has_lines else None, "", found, _YAML)


class _Builder:
    """Turns a node graph into plain data within the limits, and collects the place of every key and item."""

    def __init__(self, source: str, has_lines: bool) -> None:
        self.source = source
        self.has_lines = has_lines
        self.places: dict[KeyPath, SourcePlace] = {}
        self._open: set[int] = set()
        self._count = 0

    def place(self, node: yaml.Node | yaml.Event) -> SourcePlace:
        """The place at which a node begins."""
        return SourcePlace(self.source, _line(node) if self.has_lines else None)

    def error(self, node: yaml.Node | yaml.Event, path: KeyPath, found: str, expected: str) -> SessionError:
        """The error for a node at ``path``."""
        place = self.place(node)
        return SessionError(place.source, place.line, key_text(path), found, expected)

    def build(self, node: yaml.Node, path: KeyPath) -> object:
        """The plain value of a node; every alias becomes its own copy, so that an override changes one place only."""
        self._count += 1
        if self._count > MAX_NODES:
            raise self.error(node, path, f"more than {MAX_NODES} values", "a smaller file, with fewer aliases")
        if isinstance(node, yaml.ScalarNode):
            return node.value if node.style else plain_scalar(node.value)  # a scalar without quotes has no style
        if id(node) in self._open:
            raise self.error(node, path, "an anchor that holds an alias of itself", "an alias of something else")
        if len(path) >= MAX_DEPTH:
            raise self.error(node, path, f"nesting deeper than {MAX_DEPTH}", "a flatter file")
        self._open.add(id(node))
        value = self._sequence(node, path) if isinstance(node, yaml.SequenceNode) else self._mapping(node, path)
        self._open.discard(id(node))
        return value

    def _sequence(self, node: yaml.SequenceNode, path: KeyPath) -> list[object]:
        items = []
        for index, item in enumerate(node.value):
            self.places[(*path, index)] = self.place(item)
            items.append(self.build(item, (*path, index)))
        return items

    def _mapping(self, node: yaml.Node, path: KeyPath) -> dict[str, object]:
        entries: dict[str, object] = {}
        lines: dict[str, int] = {}
        for key_node, value_node in node.value:
            # only a scalar is built as a key: aliases in keys of keys would recurse without a limit
            key = self.build(key_node, path) if isinstance(key_node, yaml.ScalarNode) else key_node.value
            if not isinstance(key, str):
                expected = "a name as the key (in quotes, if it must look like a number)"
                raise self.error(key_node, path, f"the key {show(key)}", expected)
            line = _line(key_node)
            if key in entries:
                where = f" in lines {lines[key]} and {line}" if self.has_lines else ""
                raise self.error(key_node, (*path, key), f"the key {key!r} twice{where}", "each key once")
            lines[key] = line
            self.places[(*path, key)] = self.place(key_node)
            entries[key] = self.build(value_node, (*path, key))
        return entries


def _line(node: yaml.Node | yaml.Event) -> int:
    """The line, from 1, in which a node begins."""
    mark = node.start_mark
    return 1 if mark is None else int(mark.line) + 1


def apply_overrides(
    tree: SessionTree, overrides: Sequence[str], begun: Collection[KeyPath] = frozenset()
) -> SessionTree:
    """A new tree, in which each override ``KEY.PATH=VALUE`` has replaced a value, in order.

    The value is a YAML scalar or flow collection; a list item is named by its position, from 0. An override may add a
    key to an existing mapping, which validation then checks. It creates no mapping on the way there, except those that
    ``begun`` names.

    Raises:
        SessionError: an override has another form, or its path leads to nothing.
    """
    if len(overrides) > MAX_OVERRIDES:
        raise SessionError("--set", None, "", f"{len(overrides)} overrides", f"at most {MAX_OVERRIDES}")
    for override in overrides:
        tree = _apply(tree, override, begun)
    return tree


def read_choices(option: str) -> tuple[str, list[object]]:
    """The path and the values of ``KEY.PATH=[VALUE, ...]``, the option ``--vary``.

    Raises:
        SessionError: the option has another form.
    """
    dotted, node, source = _split(option, "--vary")
    values = None if node is None else _Builder(source, has_lines=False).build(node, ())
    if not isinstance(values, list) or not values:
        raise SessionError(source, None, dotted, show(values), "a list of values, such as design.tau=[0, 0.0005]")
    return dotted, values


def _split(text: str, option: str) -> tuple[str, yaml.Node | None, str]:
    """The path of ``KEY.PATH=VALUE``, its value, and a name for messages.

    Raises:
        SessionError: the text has another form.
    """
    source = f"{option} {text if len(text) <= 80 else text[:77] + '...'}"
    dotted, equals, value = text.partition("=")
    dotted = dotted.strip()
    if not equals or not all(dotted.split(".")):
        found = "no '='" if not equals else f"the path {dotted!r}"
        raise SessionError(source, None, "", found, "KEY.PATH=VALUE, such as devices.dx.mass=0.3")
    if len(value) > MAX_OVERRIDE_CHARACTERS:
        raise SessionError(source, None, dotted, f"{len(value)} characters", f"at most {MAX_OVERRIDE_CHARACTERS}")
    node = _compose(value, source, has_lines=False)
    if isinstance(node, yaml.CollectionNode) and not node.flow_style:
        raise SessionError(source, None, dotted, show(value), "a plain value, or one in [ ] or { }")
    return dotted, node, source


def _apply(tree: SessionTree, override: str, begun: Collection[KeyPath]) -> SessionTree:
    dotted, node, source = _split(override, "--set")

    def build(path: KeyPath) -> tuple[object, Mapping[KeyPath, SourcePlace]]:
        builder = _Builder(source, has_lines=False)
        return None if node is None else builder.build(node, path), builder.places

    return replaced(tree, dotted.split("."), source, begun, build)


Built: TypeAlias = tuple[object, Mapping[KeyPath, SourcePlace]]
"""A plain value, and the place of every key and item in it."""


def replaced(
    tree: SessionTree, steps: Sequence[str], source: str, begun: Collection[KeyPath], build: Callable[[KeyPath], Built]
) -> SessionTree:
    """A new tree, with one value replaced, or one key added to an existing mapping.

    Args:
        tree: the session.
        steps: the path of the value; a list item is named by its position, from 0.
        source: where the value comes from, for messages.
        begun: the mappings that may be created on the way.
        build: makes the value for its path.

    Raises:
        SessionError: the path leads to nothing, or ``build`` refuses the value.
    """
    data = dict(tree.data)
    parent: Any = data  # always a dict or a list: other children are refused below
    path: KeyPath = ()
    places: dict[KeyPath, SourcePlace] = {}
    for depth, step in enumerate(steps[:-1], start=1):
        if (*path, step) in begun and isinstance(parent, dict) and step not in parent:
            parent[step] = {}
            places[(*path, step)] = SourcePlace(source, None)
        key = _existing(parent, step, path, source, steps[depth:])
        child = parent[key]
        if not isinstance(child, dict | list):
            raise SessionError(source, None, key_text((*path, key)), show(child), "a mapping or a list there")
        parent[key] = child.copy()
        parent, path = parent[key], (*path, key)
    last = steps[-1] if isinstance(parent, dict) else _existing(parent, steps[-1], path, source)
    path = (*path, last)
    parent[last], inner = build(path)
    kept = {at: place for at, place in tree.places.items() if at[: len(path)] != path}
    return SessionTree(tree.source, data, {**kept, **places, path: SourcePlace(source, None), **inner})


def _existing(
    parent: dict[str, object] | list[object], step: str, path: KeyPath, source: str, rest: Sequence[str] = ()
) -> str | int:
    """The key or position of ``parent`` that ``step`` names, on the way to ``rest`` within it."""
    if isinstance(parent, dict):
        if step in parent:
            return step
        expected = one_of(parent, step)
        # of names of parts, such as devices, each has its own keys; any other key may be right and absent from the file
        if rest and "did you mean" not in expected and not all(isinstance(value, dict) for value in parent.values()):
            whole = "".join(f"{{{key}: " for key in rest) + "..." + "}" * len(rest)
            expected += f", or {step!r} as a whole: {key_text((*path, step))}={whole}"
    else:
        if re.fullmatch(r"[0-9]{1,6}", step) and int(step) < len(parent):
            return int(step)
        expected = f"a position from 0 to {len(parent) - 1}" if parent else "a list with items"
    raise SessionError(source, None, key_text(path), f"no {step!r}", expected)
