"""Numbers in JSON documents that others send: texts and truth values are none, arrays have a length that is known."""

from __future__ import annotations

from typing import Any

from pydantic import WithJsonSchema


def require_number(value: Any) -> Any:
    """Refuse texts and truth values, which would be converted to numbers. Raises ValueError."""
    if isinstance(value, bool | str | bytes):
        raise ValueError("must be a number")
    return value


def array_schema(length: int, largest: float, *, least: float | None = None) -> WithJsonSchema:
    """Return the JSON Schema of an array of so many numbers, from `least` (-largest) to `largest`.

    Generators of clients do not know that of a tuple.
    """
    number = {"type": "number", "minimum": -largest if least is None else least, "maximum": largest}
    return WithJsonSchema({"type": "array", "items": number, "minItems": length, "maxItems": length})
