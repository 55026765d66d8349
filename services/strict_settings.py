"""What every service's settings share: frozen, read from the environment once, and a mistyped variable is an error.

A silent typo (`EDGE_SLOT=4`) is the costliest kind of setting: everything starts, and nothing is as asked.
"""

from __future__ import annotations

import difflib
import os
import re
from typing import Annotated, Any

from pydantic import BeforeValidator, SecretBytes, SecretStr, ValidationError
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

Plain = str | int | float | bool | None

_PASSWORD_IN_URL = re.compile(r"(?<=://)([^/@:]*):[^/@]*(?=@)")


def _split_commas(value: object) -> object:
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


LOOPBACK = frozenset({"127.0.0.1", "::1", "localhost"})
"""Hosts to listen on that only this machine can reach."""

CommaList = Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split_commas)]
"""A list in one variable: `GATEWAY_WORKERS=a:50051,b:50051`."""


class SettingsError(ValueError):
    """The environment does not describe a service. The sentence names every variable at fault and quotes no value."""


class StrictSettings(BaseSettings):
    """Base of one frozen settings class per service; the subclass sets `env_prefix` ("EDGE_") and its fields.

    Built in entry points only, then passed on. Keyword arguments win over the environment.
    Raises SettingsError for a variable that has the prefix and names no field, and for a value that does not fit.
    """

    model_config = SettingsConfigDict(frozen=True, extra="forbid", env_ignore_empty=True, hide_input_in_errors=True)

    def __init__(self, **values: Any) -> None:
        _reject_unknown(self._prefix(), type(self).model_fields.keys())
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise SettingsError(_sentence(self._prefix(), error)) from None

    def describe(self) -> dict[str, Plain]:
        """The resolved settings for the log, by variable name: secrets only as set or unset, no password in a URL."""
        return {self._prefix() + name.upper(): _shown(getattr(self, name)) for name in type(self).model_fields}

    @classmethod
    def _prefix(cls) -> str:
        return str(cls.model_config.get("env_prefix", "")).upper()


def _reject_unknown(prefix: str, fields: Any) -> None:
    known = {prefix + field.upper() for field in fields}
    unknown = sorted(name for name in os.environ if name.upper().startswith(prefix) and name.upper() not in known)
    if prefix and unknown:
        raise SettingsError("; ".join(f"{name} is no setting{_suggestion(name, known)}" for name in unknown))


def _suggestion(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name.upper(), sorted(known), n=1)
    return f", did you mean {near[0]}?" if near else f"; there are {', '.join(sorted(known))}"


def _sentence(prefix: str, error: ValidationError) -> str:
    """Names the variables and says why, without the values: one of them may be a secret."""
    return "; ".join(f"{prefix}{'.'.join(map(str, e['loc'])).upper()}: {e['msg']}" for e in error.errors())


def _shown(value: object) -> Plain:
    if isinstance(value, SecretStr | SecretBytes):
        return "(set)" if value.get_secret_value() else "(unset)"
    if isinstance(value, int | float | bool) or value is None:
        return value
    text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
    return _PASSWORD_IN_URL.sub(r"\1:***", text)
