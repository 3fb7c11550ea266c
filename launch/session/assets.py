"""The files of an engine's model: a text, and its assets beside it, each by its name alone.

A session may come from a stranger. So a model's files are those that stand in the session file's own folder: no other
folder is named, no link is followed, and only regular files within limits are read. Once read they are part of the
session, so that a bundle, a recording and a replay need none of them.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from pydantic import ValidationInfo

from manyhands.design.files import read_regular
from manyhands.launch.session.errors import show
from manyhands.launch.session.fields import refuse
from manyhands.launch.session.forms import JsonSchema, either, list_of
from manyhands.launch.session.limits import MAX_ASSET_BYTES, MAX_ASSETS, MAX_MODEL_BYTES

FILE_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}", re.ASCII)
"""The name of a model's file: of no other folder, and not hidden."""

_NAME_MEANING: Final = "the name of a file in the session file's folder: letters, digits, '_', '.' and '-'"
_ASSETS_MEANING: Final = "a list of names of files in the session file's folder"
_NAME: Final[JsonSchema] = {"type": "string", "pattern": f"^{FILE_NAME.pattern}$"}

ASSETS: Final = either(list_of(_NAME, MAX_ASSETS, 0), {"type": "object", "additionalProperties": {"type": "string"}})
"""The form of assets: names, or the files themselves, in base64 by name, as a kept session has them."""


def model_text(value: object, info: ValidationInfo) -> str:
    """The text of a model's file, from its name; or the text itself, with line ends or a tag.

    Raises:
        PydanticCustomError: it is neither; or the file cannot be read, is no text, or is too long.
    """
    return text_in(value, f"{_NAME_MEANING}, or the model's text", lambda name: _read(name, MAX_MODEL_BYTES, info))


def text_in(value: object, expected: str, read: Callable[[str], bytes]) -> str:
    """A text with line ends or a tag, or the text of the file that ``read`` reads by its name.

    Raises:
        PydanticCustomError: it is neither; or the file cannot be read, is no text, or is too long.
    """
    if not isinstance(value, str) or not value.strip():
        raise refuse(show(value), expected)
    if "\n" in value or "<" in value:
        text = value
    else:
        try:
            text = read(value).decode()
        except UnicodeDecodeError as error:
            raise refuse(f"{value!r}, which cannot be read: {error.reason}", "a text in UTF-8") from error
    if len(text) > MAX_MODEL_BYTES:
        raise refuse(f"a text of {len(text)} characters", f"at most {MAX_MODEL_BYTES}")
    return text


def model_assets(value: object, info: ValidationInfo) -> dict[str, str]:
    """The files of a model by name, in base64, from a list of their names or from such a mapping.

    Raises:
        PydanticCustomError: a name is not one of a file in the session file's folder; or the files cannot be read, or
            are too many or too long.
    """
    if not isinstance(value, list | tuple | Mapping) or not all(isinstance(name, str) for name in value):
        raise refuse(show(value), _ASSETS_MEANING)
    if len(value) > MAX_ASSETS or len({*value}) < len(value):
        raise refuse(f"{len(value)} names", f"at most {MAX_ASSETS}, each once")
    found, total = {}, 0
    for name in value:
        content = _decoded(name, value[name]) if isinstance(value, Mapping) else _read(name, MAX_ASSET_BYTES, info)
        total += len(content)
        if total > MAX_ASSET_BYTES:
            raise refuse(f"files of more than {MAX_ASSET_BYTES} bytes together", "at most as many")
        found[name] = base64.b64encode(content).decode()
    return found


def _decoded(name: str, content: object) -> bytes:
    if not FILE_NAME.fullmatch(name):
        raise refuse(show(name), _NAME_MEANING)
    try:
        return base64.b64decode(content if isinstance(content, str) else "-", validate=True)
    except (binascii.Error, ValueError) as error:
        raise refuse(f"a content of {name!r} that is not base64", _ASSETS_MEANING) from error


def _read(name: str, most: int, info: ValidationInfo) -> bytes:
    if not FILE_NAME.fullmatch(name):
        raise refuse(show(name), _NAME_MEANING)
    path: Path = (info.context or {}).get("folder", Path()) / name
    if path.is_symlink():
        raise refuse(f"{name!r}, which is a link", "the file itself, in the session file's folder")
    try:
        return read_regular(path, most)
    except (OSError, ValueError) as error:
        raise refuse(f"{name!r}, which cannot be read: {error}", "a file beside the session file") from error
