"""From what pydantic reports to the one :class:`SessionError` that a person reads."""

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any, Final, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from manyhands.launch.session.error import SessionError, key_text, listed, one_of, show
from manyhands.launch.session.fields import DEVICE_AXES, PROBLEMS, Problem, SessionModel
from manyhands.launch.session.source import KeyPath, SessionTree

_COMPARED: Final = 64  # unknown keys of one part that are compared with a missing one


def problems_in(error: ValidationError, model: type[SessionModel]) -> Iterator[Problem]:
    """The problems of a failed validation of ``model``, each at its full path."""
    details = error.errors(include_url=False)
    unknown: dict[KeyPath, list[str]] = {}
    for detail in details:
        if detail["type"] == "extra_forbidden":
            unknown.setdefault(detail["loc"][:-1], []).append(str(detail["loc"][-1]))
    for detail in details:
        if detail["type"] == "missing":
            misspelt = unknown.get(detail["loc"][:-1], [])[:_COMPARED]
            if get_close_matches(str(detail["loc"][-1]), misspelt, n=1):
                continue  # the misspelt key is what to tell, not that the right one is missing
        yield from _translated(detail, model)


def nulls_in(data: object, path: KeyPath = ()) -> Iterator[Problem]:
    """Every key that is written without a value: left out and left empty are not the same."""
    if data is None:
        yield Problem(path, "nothing", "a value, or the key left out")
    children = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for step, child in children:
        yield from nulls_in(child, (*path, step))


def first_error(tree: SessionTree, problems: list[Problem]) -> SessionError:
    """The error for the first problem in the order of the file; overrides come before it."""
    located = []
    seen = set()
    for problem in problems:
        path, place = tree.locate(problem.at)
        # what was written once may fail once for each axis
        if (path, problem.found) not in seen:
            seen.add((path, problem.found))
            located.append((place.line or 0, place, path, problem))
    _, place, path, problem = min(located, key=lambda entry: entry[0])
    return SessionError(
        place.source, place.line, key_text(path), problem.found, problem.expected, more=len(located) - 1
    )


def _translated(detail: ErrorDetails, model: type[SessionModel]) -> Iterator[Problem]:
    path: KeyPath = detail["loc"]
    match detail["type"]:
        case kind if kind == PROBLEMS:
            for problem in detail["ctx"]["problems"]:
                yield problem._replace(at=(*path, *problem.at))
        case "missing":
            inner = _model_at(model, path[:-1])
            meaning = keys_of(inner).get(str(path[-1]), "") if inner else ""
            yield Problem(path[:-1], f"no key {path[-1]!r}", f"{path[-1]}, {meaning}")
        case "extra_forbidden":
            inner = _model_at(model, path[:-1])
            valid = keys_of(inner) if inner else ()
            yield Problem(path, f"the unknown key {show(path[-1])}", one_of(valid, path[-1]))
        case "model_type":
            inner = _model_at(model, path)
            keys = f" with the keys {listed(keys_of(inner))}" if inner else ""
            yield Problem(path, show(detail["input"]), f"a mapping{keys}")
        case _:
            yield Problem(path, show(detail["input"]), detail["msg"])


def keys_of(model: type[SessionModel]) -> dict[str, str]:
    """The keys that a part may have, with what each is."""
    named = {field.alias or name: field.description or "" for name, field in model.model_fields.items()}
    return {name: meaning for name, meaning in named.items() if name != DEVICE_AXES}


def _model_at(model: type[SessionModel], path: KeyPath) -> type[SessionModel] | None:
    """The model that stands at a path, found by walking the annotations."""
    current: Any = model
    for step in path:
        if isinstance(current, type) and issubclass(current, SessionModel):
            fields = {field.alias or name: field for name, field in current.model_fields.items()}
            current = fields[str(step)].annotation if step in fields else None
        else:
            current = next(iter(get_args(current)[-1:]), None) if get_origin(current) is dict else _item(current)
        current = _without_none(current)
    return current if isinstance(current, type) and issubclass(current, SessionModel) else None


def _item(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is tuple else None


def _without_none(annotation: Any) -> Any:
    """X of ``X | None``."""
    options = [option for option in get_args(annotation) if option is not type(None)]
    return options[0] if type(None) in get_args(annotation) and len(options) == 1 else annotation
