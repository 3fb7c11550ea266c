"""What a run of the tests has designed is not designed again: designs by the content of what is asked.

Most tests need a prepared session, and not the solver: each file, and each command within the tests' process, would
design the same shipped sessions anew. Tests in tests/design and tests/attack call the solver itself, and are not
served from here.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import io
import pickle
from collections.abc import Callable
from typing import Any, Final

import pytest

DESIGNS: Final = ("synthesis.design", "ladder.design_ladder", "world_synthesis.design_world")
"""What designs, in manyhands.design; the product imports each when it first needs it."""

OWN: Final = ("builtins", "manyhands", "numpy")
"""What may be in a key. Code of others, such as a test's own model, is named by a key, but not told."""


serving = True
"""Whether the test that runs may be given what another had designed; tests/conftest.py says so."""


class _Key(pickle.Pickler):
    """Writes the content of what is asked; refuses what has code of others in it."""

    def reducer_override(self, obj: Any) -> Any:
        module = getattr(obj, "__module__", None) if callable(obj) else type(obj).__module__
        if str(module).partition(".")[0] not in OWN:
            raise pickle.PicklingError(f"found {obj!r}; expected what {OWN} define")
        return NotImplemented


def key(*asked: object) -> bytes | None:
    """The content of what is asked; None where it cannot be told."""
    written = io.BytesIO()
    try:
        _Key(written, protocol=5).dump(asked)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None
    return written.getvalue()


def remembering(made: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, which makes nothing twice; the steps that it told of the first time are told again.

    What it raises, and a search that the user ended, is not kept.
    """
    known: dict[bytes, tuple[Any, list[str]]] = {}
    signature = inspect.signature(made)

    @functools.wraps(made)
    def ask(*arguments: Any, **options: Any) -> Any:
        wanted = signature.bind(*arguments, **options).arguments
        progress = wanted.pop("progress", None) or (lambda _: None)
        asked = key(wanted) if serving else None
        if asked is not None and asked in known:
            found, steps = known[asked]
            for text in steps:
                progress(text)
            return found
        steps = []

        def step(text: str) -> None:
            steps.append(text)
            progress(text)

        found = made(**wanted, progress=step)
        if asked is not None and not getattr(found, "interrupted", False):
            known[asked] = found, steps
        return found

    return ask


def remember(patch: pytest.MonkeyPatch) -> None:
    """Design each thing once, until the patch is undone."""
    for name in DESIGNS:
        module, _, function = name.rpartition(".")
        found = importlib.import_module(f"manyhands.design.{module}")
        patch.setattr(found, function, remembering(getattr(found, function)))
