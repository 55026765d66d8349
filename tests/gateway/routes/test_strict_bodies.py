"""Numbers of a request's body are numbers, truth values truth values: neither is made of the other, or of a text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, get_args

import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

import capture2vr.gateway.app  # noqa: F401 - with it come all bodies
from capture2vr.gateway.schemas import JobRequest, StrictBody


def bodies(of: type[BaseModel] = StrictBody) -> Iterator[type[BaseModel]]:
    for body in of.__subclasses__():
        yield body
        yield from bodies(body)


def kinds(annotation: Any) -> set[Any]:
    """The types of which a field's type is made."""
    return {annotation}.union(*map(kinds, get_args(annotation)))


def fields() -> Iterator[tuple[str, FieldInfo, tuple[Any, ...]]]:
    """Each field of numbers or of truth values, and what it is not."""
    for body in (JobRequest, *bodies()):
        for name, field in body.model_fields.items():
            found = kinds(field.annotation) & {int, float, bool}
            if found:
                one = (1, "true", 0) if found == {bool} else (True, "1", False)
                yield f"{body.__name__}.{name}", field, (*one, *([each] * 4 for each in one))


FIELDS = {name: (field, others) for name, field, others in fields()}


@pytest.mark.parametrize("name", FIELDS)
def test_a_value_of_another_type_is_refused(name: str) -> None:
    field, others = FIELDS[name]
    adapter = TypeAdapter(Annotated[field.annotation, field])
    for other in others:
        if name == "JobRequest.box" and other == ["1"] * 4:
            continue  # texts of a box are read by `PhotoBox`
        with pytest.raises(ValidationError):
            adapter.validate_python(other)
