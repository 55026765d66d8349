"""How a worker and its callers know each other: TLS and a shared token, from files that are checked before they serve.

Each part is optional. A token without TLS is refused: whoever reads one call on the way could make the next.
"""

from __future__ import annotations

import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import grpc

from services.strict_settings import SettingsError

TOKEN_CHARS = 16
"""Fewer could be tried out; `openssl rand -hex 32` prints 64."""

Options = Sequence[tuple[str, int | str]]


@dataclass(frozen=True, slots=True)
class Door:
    """What a worker shows its callers, and asks of them; PEM. Without a certificate it speaks plain gRPC."""

    cert: bytes = b""
    key: bytes = field(default=b"", repr=False)
    token: str = field(default="", repr=False)

    @property
    def credentials(self) -> grpc.ServerCredentials | None:
        """Those of its port; None for plain gRPC."""
        return grpc.ssl_server_credentials([(self.key, self.cert)]) if self.cert else None


OPEN = Door()


@dataclass(frozen=True, slots=True)
class Caller:
    """What a caller believes of a worker (certificates of authorities, PEM), and shows it. Without any: plain gRPC."""

    ca: bytes = b""
    token: str = field(default="", repr=False)

    def channel(self, address: str, options: Options) -> grpc.Channel:
        """A channel of the threads' kind."""
        if (credentials := self._credentials()) is None:
            return grpc.insecure_channel(address, options=options)
        return grpc.secure_channel(address, credentials, options=options)

    def aio_channel(self, address: str, options: Options) -> grpc.aio.Channel:
        """A channel of the event loop's kind."""
        if (credentials := self._credentials()) is None:
            return grpc.aio.insecure_channel(address, options=options)
        return grpc.aio.secure_channel(address, credentials, options=options)

    def _credentials(self) -> grpc.ChannelCredentials | None:
        if not self.ca:
            return None
        tls = grpc.ssl_channel_credentials(root_certificates=self.ca)
        if not self.token:
            return tls
        return grpc.composite_channel_credentials(tls, grpc.access_token_call_credentials(self.token))


PLAIN = Caller()


def read_door(cert: Path | None, key: Path | None, token: str, *, names: tuple[str, str, str]) -> Door:
    """The door of these settings; `names` are their variables. Raises SettingsError that names what is at fault."""
    of_cert, of_key, of_token = names
    _check_token(token, of_token, of_cert, has_tls=cert is not None)
    if (cert is None) != (key is None):
        raise SettingsError(f"{of_cert} and {of_key} go together: set both or none")
    if cert is None or key is None:
        return OPEN
    door = Door(_read(cert, of_cert), _read(key, of_key), token)
    try:
        # No password: the question for one would wait at a terminal for ever.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password=lambda: "")
    except (ssl.SSLError, ValueError, TypeError) as error:
        raise SettingsError(
            f"{of_cert} and {of_key}: {cert} and {key} are no certificate with its plain key in PEM: {error}"
        ) from None
    _check_time(door.cert, f"{of_cert}: {cert}")
    return door


def read_caller(ca: Path | None, token: str, *, names: tuple[str, str]) -> Caller:
    """The caller of these settings; `names` are their variables. Raises SettingsError that names what is at fault."""
    of_ca, of_token = names
    _check_token(token, of_token, of_ca, has_tls=ca is not None)
    if ca is None:
        return PLAIN
    caller = Caller(_read(ca, of_ca), token)
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cafile=ca)
    except ssl.SSLError as error:
        raise SettingsError(f"{of_ca}: {ca} holds no certificate in PEM: {error}") from None
    return caller


def name_in(cert: bytes) -> str:
    """The first name that a certificate is for, by which its own machine may ask for it on loopback."""
    from cryptography import x509

    found = x509.load_pem_x509_certificate(cert)
    try:
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        names = x509.SubjectAlternativeName([])
    return str(next((name.value for name in names if isinstance(name, x509.DNSName | x509.IPAddress)), "localhost"))


def _check_token(token: str, of_token: str, of_tls: str, *, has_tls: bool) -> None:
    """Of printable ASCII because it travels in a header."""
    if not token:
        return
    if len(token) < TOKEN_CHARS or not (token.isascii() and token.isprintable()) or " " in token:
        raise SettingsError(
            f"{of_token}: use at least {TOKEN_CHARS} letters, digits and signs, as openssl rand -hex 32"
        )
    if not has_tls:
        raise SettingsError(f"{of_token} needs {of_tls}: without TLS the token could be read on the way")


def _check_time(cert: bytes, what: str) -> None:
    """Raises SettingsError for a certificate whose time has not come or is over."""
    from cryptography import x509

    found, now = x509.load_pem_x509_certificate(cert), datetime.now(UTC)
    if not found.not_valid_before_utc <= now <= found.not_valid_after_utc:
        since, until = (f"{each:%Y-%m-%d}" for each in (found.not_valid_before_utc, found.not_valid_after_utc))
        raise SettingsError(f"{what} holds from {since} to {until}, which is not now: make a new one")


def _read(path: Path, variable: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(f"{variable}: {path} cannot be read: {error.strerror}") from None
