"""The schemas have only what Foxglove, Lichtblick and PlotJuggler read, and name every field that has a fixed form."""

import json
from typing import Any

import pytest

from companion.recording import records
from companion.recording.records import TYPES, schema

TOPICS = [
    value
    for name, value in vars(records).items()
    if isinstance(value, str) and value.startswith("/") and name.isupper()
]


def check_object(described: dict[str, Any]) -> None:
    """As Lichtblick reads a schema: anything else there is an error, and the topic cannot be opened."""
    assert described["type"] == "object"
    for field in described["properties"].values():
        item = field["items"] if field["type"] == "array" else field
        if item["type"] == "object":
            check_object(item)
        else:
            assert item["type"] in ("boolean", "string", "number", "integer")


def test_every_topic_has_a_schema() -> None:
    assert set(TYPES) == set(TOPICS)


@pytest.mark.parametrize("topic", TOPICS)
def test_a_schema_is_plain(topic: str) -> None:
    name, text = schema(topic)
    described = json.loads(text)
    assert described["title"] == name
    check_object(described)
    assert b"$ref" not in text
    assert b"anyOf" not in text


def test_a_field_without_a_value_has_its_plain_type() -> None:
    fields = json.loads(schema(records.DECISION)[1])["properties"]
    assert fields["roll_deg"] == {"type": "number"}
    assert fields["reference_enu_m"] == {"type": "array", "items": {"type": "number"}}
    assert set(fields) == set(records.DecisionRecord.__struct_fields__)


def test_fields_without_a_fixed_form_are_left_out() -> None:
    assert "content" not in json.loads(schema(records.COMMAND)[1])["properties"]
    assert "telemetry" not in json.loads(schema(records.INBOX)[1])["properties"]
