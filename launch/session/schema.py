"""The JSON schema of session files, by which editors complete and check what somebody writes.

It is of draft 7, which every editor knows. Nothing of the format stands here: keys, descriptions and defaults are those
of the models, and the form of a value is that of the check which reads it (``json_schema``), or stands beside it.

A schema looks at one value at a time. It accepts whatever the reader accepts, and it refuses unknown and missing keys,
wrong types and numbers out of their range. Names that lead nowhere, sizes that do not fit and systems that are not
passive are left to the reader.
"""

from __future__ import annotations

import inspect
from typing import Any, Final

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from manyhands.launch.session.device import Device
from manyhands.launch.session.device_file import with_from
from manyhands.launch.session.fields import SessionModel
from manyhands.launch.session.forms import JsonSchema
from manyhands.launch.session.session import Session

DIALECT: Final = "http://json-schema.org/draft-07/schema#"


def session_schema() -> JsonSchema:
    """The JSON schema of session files; short names of drivers and models are those that are installed here."""
    schema = Session.model_json_schema(schema_generator=_Schema)
    return {"$schema": DIALECT, **schema, "title": "A session file of manyhands"}


class _Schema(GenerateJsonSchema):
    """Pydantic's schema of the models, with the forms that the checks accept in place of the types that they return."""

    def function_before_schema(self, schema: core_schema.BeforeValidatorFunctionSchema) -> JsonSchemaValue:
        """The form that a check accepts; where it leaves entries to their type, completed by that."""
        inner = super().function_before_schema(schema)
        accepted: JsonSchemaValue | None = getattr(schema["function"]["function"], "json_schema", None)
        if accepted is None:
            return inner
        entries = {"array": "items", "object": "additionalProperties"}.get(accepted.get("type", ""))
        return accepted if entries is None or entries in accepted else {**inner, **accepted}

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        """The value alone: a key without a value is an error in a session file."""
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        """The value with its default, if a file could state it."""
        described = super().default_schema(schema)
        if described.get("default", ...) is None:
            del described["default"]
        return described

    def encode_default(self, dft: Any) -> Any:
        """A default as a file would state it."""
        if isinstance(dft, SessionModel):
            return dft.model_dump(mode="json", exclude_none=True)
        return super().encode_default(dft)

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """A part of the session; of its documentation the first line is for readers of a file."""
        described = super().model_schema(schema)
        documentation = inspect.getdoc(schema["cls"]) or ""
        described = {**described, "description": documentation.partition("\n")[0]}
        return with_from(described) if schema["cls"] is Device else described

    def field_title_should_be_set(self, schema: Any) -> bool:
        """No titles: they would repeat the keys."""
        return False
