"""Base class of every service's settings: read from the environment once, frozen, unknown variables are errors.

A typo that nobody reports (`EDGE_SLOT=4`) is costly: the service starts, but not with the settings that were meant.
"""

from __future__ import annotations

import difflib
import os
import re
from typing import Annotated, Any

from pydantic import BeforeValidator, SecretBytes, SecretStr, ValidationError
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

Plain = str | int | float | bool | None
"""A value that JSON can hold as it is."""

_PASSWORD_IN_URL = re.compile(r"(?<=://)([^/@:]*):[^/@]*(?=@)")


def _split_commas(value: object) -> object:
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
"""Host names to listen on that only this machine can reach."""

CommaList = Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split_commas)]
"""A list in one variable: `GATEWAY_WORKERS=a:50051,b:50051`."""


class SettingsError(ValueError):
    """A wrong setting. The message names every variable at fault, and quotes no value: one may be a secret."""


class StrictSettings(BaseSettings):
    """Base of each service's frozen settings class; the subclass sets `env_prefix` ("EDGE_") and its fields.

    Built in entry points only, then passed on. Keyword arguments override the environment.
    Raises SettingsError for a variable with the prefix that is no field, and for a value that does not fit.
    """

    model_config = SettingsConfigDict(frozen=True, extra="forbid", env_ignore_empty=True, hide_input_in_errors=True)

    def __init__(self, **values: Any) -> None:
        _reject_unknown(self._prefix(), type(self).model_fields.keys())
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise SettingsError(_sentence(self._prefix(), error)) from None

    def describe(self) -> dict[str, Plain]:
        """Return the settings for the log, by variable name: secrets only as set or unset, URLs without passwords."""
        return {self._prefix() + name.upper(): _shown(getattr(self, name)) for name in type(self).model_fields}

    @classmethod
    def _prefix(cls) -> str:
        return str(cls.model_config.get("env_prefix", "")).upper()


def _reject_unknown(prefix: str, fields: Any) -> None:
    known = {prefix + field.upper() for field in fields}
    unknown = sorted(name for name in os.environ if name.upper().startswith(prefix) and name.upper() not in known)
    if prefix and unknown:
        raise SettingsError("; ".join(f"{name} is not a setting{_suggestion(name, known)}" for name in unknown))


def _suggestion(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name.upper(), sorted(known), n=1)
    return f", did you mean {near[0]}?" if near else f"; the settings are {', '.join(sorted(known))}"


def _sentence(prefix: str, error: ValidationError) -> str:
    """Return the error's message: each variable at fault with the reason, without values, which may be secrets."""
    reasons = ((e["loc"], e["msg"].removeprefix("Value error, ")) for e in error.errors())
    return "; ".join(f"{prefix}{'.'.join(map(str, place)).upper()}: {reason}" for place, reason in reasons)


def _shown(value: object) -> Plain:
    if isinstance(value, SecretStr | SecretBytes):
        return "(set)" if value.get_secret_value() else "(unset)"
    if isinstance(value, int | float | bool) or value is None:
        return value
    text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return _PASSWORD_IN_URL.sub(r"\1:***", text)
