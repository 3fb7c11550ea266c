"""The sessions that come with the package, by name."""

from __future__ import annotations

import importlib.resources
from collections.abc import Sequence
from pathlib import Path

from manyhands.launch.session import Session, load_session


def load_named(name: Path | str, overrides: Sequence[str] = ()) -> Session:
    """The session at a path, or the shipped one of that name, with or without its suffix.

    Args:
        name: a path; one that does not exist and names no folder may be a shipped session.
        overrides: ``KEY.PATH=VALUE`` each.

    Raises:
        SessionError: whatever is wrong with either.
    """
    path = Path(name)
    if not path.exists() and len(path.parts) == 1:
        shipped = importlib.resources.files("manyhands.launch") / "sessions" / f"{path.name.removesuffix('.yaml')}.yaml"
        with importlib.resources.as_file(shipped) as file:
            if file.exists():
                return load_session(file, overrides)
    return load_session(path, overrides)
