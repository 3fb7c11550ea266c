"""Session files by path, or by name among those in the package."""

from __future__ import annotations

import difflib
import importlib.resources
import re
from collections.abc import Sequence
from importlib.resources.abc import Traversable
from pathlib import Path

from manyhands.launch.session.errors import SessionError, show
from manyhands.launch.session.fields import SESSION_NAME
from manyhands.launch.session.session import Session, load_session


def shipped_sessions() -> dict[str, Traversable]:
    """The session files in the package by name, without their suffix, in alphabetical order."""
    folder = importlib.resources.files("manyhands.launch") / "sessions"
    files = {file.name.removesuffix(".yaml"): file for file in folder.iterdir() if file.name.endswith(".yaml")}
    return dict(sorted(files.items()))


def load_named(name: Path | str, overrides: Sequence[str] = ()) -> Session:
    """The session at a path, or the shipped session of that name, with or without its suffix.

    Args:
        name: a path; if no such file exists and it is in no other folder, a shipped session is looked for.
        overrides: ``KEY.PATH=VALUE`` each.

    Raises:
        SessionError: the file or an override is wrong, or there is none of that name.
    """
    path = Path(name)
    # a folder may have the name as well: `manyhands host ball` makes one
    of_a_folder = path.is_dir() and path.name.removesuffix(".yaml") in shipped_sessions()
    if len(path.parts) != 1 or (path.exists() and not of_a_folder):
        return load_session(path, overrides).with_code_in(path.parent)
    with importlib.resources.as_file(shipped_session(path.name)) as file:
        return load_session(file, overrides)


def shipped_session(name: str) -> Traversable:
    """The file of a shipped session, by its name with or without the suffix.

    Raises:
        SessionError: there is none of that name.
    """
    shipped = shipped_sessions()
    wanted = name.removesuffix(".yaml")
    if wanted not in shipped:
        near = difflib.get_close_matches(wanted, shipped, n=1)
        meant = f" (did you mean {near[0]!r}?)" if near else ""
        expected = f"a session file, or one that `manyhands sessions` lists{meant}"
        raise SessionError(name, None, "", "neither a file nor a shipped session of this name", expected)
    return shipped[wanted]


def shipped_copy(template: str, name: str) -> str:
    """The text of a shipped session, with its comments, under another name. No session is read for it.

    Raises:
        SessionError: there is no such template, or no session may have the name.
    """
    text = shipped_session(template).read_text()
    if re.fullmatch(SESSION_NAME.pattern, name) is None:
        raise SessionError("NAME", None, "", show(name), f"{SESSION_NAME.what}: {SESSION_NAME.words}")
    return re.sub(r"^session: .*$", f"session: {name}", text, count=1, flags=re.MULTILINE)
