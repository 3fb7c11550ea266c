"""The extras of the package, and which libraries each of them brings.

``pip install manyhands`` brings what a guest and a node need. What finds couplings, records, draws or serves a page
needs more (docs/installing.md). A command or a function that needs an extra in every case calls :func:`require` before
it begins. Where it depends on the session, :func:`explained` turns a failed import into the same sentence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Final

EXTRAS: Final[Mapping[str, tuple[str, ...]]] = {
    "design": ("scipy", "cvxpy", "clarabel", "flint"),
    "proof": ("flint",),
    "record": ("mcap", "zstandard"),
    "plot": ("matplotlib",),
    "view": ("starlette", "uvicorn", "websockets", "h11"),
    "parquet": ("pyarrow",),
    "pandas": ("pandas",),
    "foxglove": ("foxglove",),
    "ros": ("rosbags", "zenoh"),
    "mujoco": ("mujoco",),
    "mesh": ("trimesh",),
    "haply": ("websockets",),
}
"""The modules that are imported from each extra of pyproject.toml.

Where one belongs to two of them, :func:`explained` names the first.
"""


class MissingExtra(ImportError):
    """Something needs an extra that is not installed; the message names it, and the command that installs it."""


def require(*extras: str) -> None:
    """Refuse to begin without these extras.

    Raises:
        MissingExtra: a module of theirs is missing.
    """
    missing = {extra: [module for module in EXTRAS[extra] if find_spec(module) is None] for extra in extras}
    missing = {extra: modules for extra, modules in missing.items() if modules}
    if missing:
        raise MissingExtra(_sentence([*missing], [module for modules in missing.values() for module in modules]))


@contextmanager
def explained() -> Iterator[None]:
    """Turn the failed import of a module of an extra into a :class:`MissingExtra`; any other is raised as it is."""
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        extras = [extra for extra, modules in EXTRAS.items() if module in modules][:1]
        if not extras:
            raise
        raise MissingExtra(_sentence(extras, [module]), name=error.name) from error


def _sentence(extras: Sequence[str], modules: Sequence[str]) -> str:
    listed = ",".join(extras)
    expected = f"the extra {listed}" if len(extras) == 1 else f"the extras {', '.join(extras)}"
    return f"found no {', '.join(modules)}; expected {expected}: pip install 'manyhands[{listed}]'"
