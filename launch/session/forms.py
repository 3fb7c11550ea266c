"""The form of a value in a session file, as a JSON schema, in the words that its parts are described with.

Every check has the form that it accepts, and :mod:`manyhands.launch.session.schema` puts the forms together.
"""

from collections.abc import Mapping
from typing import Any, TypeAlias

JsonSchema: TypeAlias = dict[str, Any]
"""The form of a value, as a JSON schema of draft 7."""


def either(*forms: JsonSchema) -> JsonSchema:
    """One of several forms."""
    return {"anyOf": [*forms]}


def list_of(form: JsonSchema, most: int, least: int = 1) -> JsonSchema:
    """A list of ``least`` to ``most`` values of a form."""
    return {"type": "array", "items": form, "minItems": least, "maxItems": most}


def mapping_of(required: Mapping[str, JsonSchema], others: Mapping[str, JsonSchema] | None = None) -> JsonSchema:
    """A mapping with these keys and no others."""
    properties = {**required, **(others or {})}
    return {"type": "object", "properties": properties, "required": [*required], "additionalProperties": False}


def without(*keys: str) -> JsonSchema:
    """A mapping that has none of these keys."""
    return {"properties": dict.fromkeys(keys, False)}


def one_key_of(first: str, second: str) -> JsonSchema:
    """A mapping that has one of two keys, and not both."""
    return {"oneOf": [{"required": [first]}, {"required": [second]}]}


def where(key: str, *values: str) -> JsonSchema:
    """A mapping in which a key has one of these values."""
    return {"properties": {key: {"enum": [*values]}}, "required": [key]}
