"""Data classes as plain data, the values of JSON, and back: each field by its annotation.

A class declares its fields once. :func:`written` makes an object of an instance, with the fields' names in their order,
and :func:`read` makes the instance again. It takes nothing on trust: a key that is missing or unknown, a value of a
different type (a bool is no int), and a number that is not finite are refused with their place, what was found and what
was expected (:class:`Unfit`). The class itself refuses in ``__post_init__`` what does not fit together. Whoever reads
the file or the frame bounds its size.

=========================  =============================================
annotation                 plain data
=========================  =============================================
bool, int, str, StrEnum    the value
float                      a finite number
``X | None``               null or X
``tuple[X, ...]``          a list; of ``tuple[X, Y]`` one of that length
``Mapping[str, X]``        an object
``NDArray[np.float64]``    {"shape": [rows, columns], "entries": [...]}
a data class               an object with its fields
``Any``                    any value, as it is
=========================  =============================================

``Annotated[X, ...]`` adds what a type cannot say: a :class:`Requirement`, or a :class:`PlainForm` in place of its own,
such as :func:`by_kind` for a union of classes. A field of the type ``Added[X]`` may be missing, and then has its
default: what was written before it was added lacks it.

A class of a compiled module keeps no parameters of its annotations, and so has no form: its module stays uncompiled.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import cache
from itertools import repeat
from types import NoneType, UnionType
from typing import Annotated, Any, Final, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

_ADDED: Final = object()
Added = Annotated[T, _ADDED]
"""A field that may be missing."""


class Unfit(ValueError):
    """Plain data are not what they should be; the message has the place, what was found and what was expected."""

    def __init__(self, text: str, place: str = "") -> None:
        """The error at this place, in the form ``.name[0]``; empty for the data as a whole."""
        super().__init__(f"{place.removeprefix('.')}: {text}" if place else text)
        self.text, self.place = text, place

    def within(self, key: str | int | None) -> Unfit:
        """The same error, seen from where ``key`` leads to the data; None for the same place."""
        step = f".{key}" if isinstance(key, str) and key.isidentifier() else f"[{shown(key)}]"
        return Unfit(self.text, ("" if key is None else step) + self.place)


class NotFinite(Unfit):
    """A number that must be finite is infinite or not a number."""


class PlainForm(NamedTuple):
    """The plain data of a type: ``write`` makes them of a value; ``read`` makes a value of them, or refuses them.

    Raises:
        Unfit: from ``read``; a form that is stated in an annotation may raise what ``_WRONG`` has.
    """

    write: Callable[[Any], Any]
    read: Callable[[Any], Any]


class Requirement(NamedTuple):
    """What a value has to be beyond its type, as a test and in words."""

    holds: Callable[[Any], bool]
    words: str


def shown(value: object) -> str:
    """A short and printable text for a value from outside."""
    if isinstance(value, (str, bytes, list, dict, tuple)) and len(value) > 40:
        return f"{type(value).__name__} of length {len(value)}"
    return f"{value!r:.120}"


def same(value: Any) -> Any:
    """The value: it is plain already."""
    return value


def written(value: Any) -> Any:
    """The plain data of an instance of a data class."""
    return form_of(type(value)).write(value)


def read(kind: type[T], data: object) -> T:
    """The instance of a data class that :func:`written` made ``data`` of.

    Raises:
        Unfit: the data are of no instance.
    """
    value: T = _read(form_of(kind), data)
    return value


def optional(of: PlainForm) -> PlainForm:
    """Null, or what ``of`` says."""
    return PlainForm(*(lambda value, way=way: None if value is None else way(value) for way in of))


def by_kind(**kinds: type[Any]) -> PlainForm:
    """A union of data classes; the key ``kind``, before their own, has the name that the class has here."""
    names = {of: name for name, of in kinds.items()}

    def read_kind(data: Any) -> Any:
        kind = _OBJECT.read(data).get("kind")
        if type(kind) is not str or kind not in kinds:
            raise Unfit(f"found {shown(kind)}; expected one of {', '.join(kinds)}", ".kind")
        return read(kinds[kind], {key: value for key, value in data.items() if key != "kind"})

    return PlainForm(lambda value: {"kind": names[type(value)], **written(value)}, read_kind)


def form_of(annotation: Any) -> PlainForm:
    """The form of a type, by its annotation.

    Raises:
        TypeError: the annotation has no form.
    """
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _annotated(*parts)
    named = annotation if origin is None else origin
    if hasattr(named, "__value__"):  # of a ``type`` statement, such as NDArray in numpy 2.5, whose kind decides
        return form_of(named.__value__)
    if origin in (UnionType, Union) and NoneType in parts and len(parts) == 2:
        return optional(form_of(parts[parts[0] is NoneType]))
    if origin is tuple:
        return _tuple(parts)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _object(form_of(parts[1]))
    if origin is np.ndarray:
        return PlainForm(lambda M: {"shape": list(M.shape), "entries": M.ravel().tolist()}, _matrix)
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    if hasattr(annotation, "__dataclass_fields__"):
        return _record(annotation)
    if isinstance(annotation, type) and issubclass(annotation, StrEnum):
        members = {str(member): member for member in annotation}
        name = _annotated(str, Requirement(members.__contains__, f"one of {', '.join(members)}"))
        return PlainForm(str, lambda data: members[name.read(data)])
    raise TypeError(f"found the annotation {annotation!r}; expected one that has a form in plain data")


_WRONG: Final = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""What a class, or a form of another module, may raise over data that it cannot use."""


def _read(of: PlainForm, data: Any, key: str | int | None = None) -> Any:
    """What ``of`` reads; errors name the key that leads to the data, if there is one."""
    try:
        return of.read(data)
    except Unfit as error:
        raise error.within(key) from None
    except _WRONG as error:
        raise Unfit(f"found no {error}" if isinstance(error, KeyError) else str(error)).within(key) from error


def _typed(kind: type[Any], expected: str) -> PlainForm:
    def read_typed(data: Any) -> Any:
        if type(data) is not kind:
            raise Unfit(f"found {shown(data)}; expected {expected}")
        return data

    return PlainForm(same, read_typed)


def _number(data: Any) -> float:
    if type(data) not in (float, int) or not -sys.float_info.max <= data <= sys.float_info.max:
        raise Unfit(f"found {shown(data)}; expected a finite number")
    return float(data)


_LIST: Final = _typed(list, "a list")
_OBJECT: Final = _typed(dict, "an object")
_SCALARS: Final[Mapping[Any, PlainForm]] = {
    bool: _typed(bool, "true or false"),
    int: _typed(int, "a whole number"),
    str: _typed(str, "a text"),
    float: PlainForm(same, _number),
    Any: PlainForm(same, same),
}


def _annotated(kind: Any, *extras: Any) -> PlainForm:
    of = next((extra for extra in extras if isinstance(extra, PlainForm)), None) or form_of(kind)
    expected = [extra for extra in extras if isinstance(extra, Requirement)]

    def read_checked(data: Any) -> Any:
        value = of.read(data)
        for one in expected:
            if not one.holds(value):
                raise Unfit(f"found {shown(value)}; expected {one.words}")
        return value

    return PlainForm(of.write, read_checked)


def _tuple(parts: tuple[Any, ...]) -> PlainForm:
    own = [form_of(part) for part in parts if part is not ...]

    def each(items: Sequence[Any]) -> Any:
        if ... in parts:
            return zip(repeat(own[0]), items, strict=False)
        if len(items) != len(own):
            raise Unfit(f"found {len(items)} entries; expected {len(own)}")
        return zip(own, items, strict=True)

    def read_items(data: Any) -> tuple[Any, ...]:
        if parts == (float, ...) and {*map(type, _LIST.read(data))} <= {float} and all(map(math.isfinite, data)):
            return tuple(data)  # a recorded motion has a million of them
        return tuple(_read(of, item, place) for place, (of, item) in enumerate(each(_LIST.read(data))))

    return PlainForm(lambda value: [of.write(item) for of, item in each(value)], read_items)


def _object(of: PlainForm) -> PlainForm:
    return PlainForm(
        lambda value: {key: of.write(item) for key, item in value.items()},
        lambda data: {key: _read(of, item, key) for key, item in _OBJECT.read(data).items()},
    )


@dataclasses.dataclass(frozen=True)
class _Matrix:
    shape: tuple[int, int]
    entries: tuple[float, ...]


def _matrix(data: Any) -> NDArray[np.float64]:
    found = read(_Matrix, data)
    (rows, columns), entries = found.shape, found.entries
    if min(rows, columns) < 0 or rows * columns != len(entries):
        raise Unfit(f"found {len(entries)} entries; expected {rows} x {columns}")
    matrix = np.array(entries, dtype=np.float64).reshape(rows, columns)
    matrix.setflags(write=False)
    return matrix


@cache
def _record(kind: Any) -> PlainForm:
    hints = get_type_hints(kind, include_extras=True)
    forms = {field.name: form_of(hints[field.name]) for field in dataclasses.fields(kind)}
    needed = {name for name in forms if _ADDED not in get_args(hints[name])}

    def read_record(data: Any) -> Any:
        found = _OBJECT.read(data).keys()
        if strange := found - forms.keys():
            raise Unfit(f"found the unknown key {shown(min(strange))}; expected {', '.join(forms)}")
        if missing := needed - found:
            raise Unfit(f"found no {min(missing)}; expected {', '.join(forms)}")
        return kind(**{name: _read(of, data[name], name) for name, of in forms.items() if name in found})

    return PlainForm(lambda value: {name: of.write(getattr(value, name)) for name, of in forms.items()}, read_record)
