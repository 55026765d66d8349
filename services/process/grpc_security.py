"""TLS and token authentication between a worker and its callers; the files are checked before the service starts.

Both are optional. A token without TLS is refused: whoever reads one call on the network could make the next.
"""

from __future__ import annotations

import ssl
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import grpc

from capture2vr.process.strict_settings import SettingsError

TOKEN_CHARS = 16
"""Fewest characters of a token: a shorter one could be guessed. `openssl rand -hex 32` prints 64."""

Options = Sequence[tuple[str, int | str]]


@dataclass(frozen=True, slots=True)
class ServerSecurity:
    """A worker's TLS certificate and key (PEM), and the token that callers must send. No certificate: plain gRPC."""

    cert: bytes = b""
    key: bytes = field(default=b"", repr=False)
    token: str = field(default="", repr=False)

    @property
    def credentials(self) -> grpc.ServerCredentials | None:
        """gRPC's credentials for the listening port; None for plain gRPC."""
        return grpc.ssl_server_credentials([(self.key, self.cert)]) if self.cert else None


NO_SECURITY = ServerSecurity()


@dataclass(frozen=True, slots=True)
class ClientCredentials:
    """A caller's trusted CA certificates (PEM), and the token that it sends. No certificates: plain gRPC."""

    ca: bytes = b""
    token: str = field(default="", repr=False)

    def channel(self, address: str, options: Options) -> grpc.Channel:
        """Open a synchronous gRPC channel, for use from threads."""
        if (credentials := self._credentials()) is None:
            return grpc.insecure_channel(address, options=options)
        return grpc.secure_channel(address, credentials, options=options)

    def aio_channel(self, address: str, options: Options) -> grpc.aio.Channel:
        """Return an asyncio channel; it belongs to the running event loop."""
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


NO_CREDENTIALS = ClientCredentials()


def read_server_security(
    cert: Path | None, key: Path | None, token: str, *, names: tuple[str, str, str]
) -> ServerSecurity:
    """Read and check a worker's certificate and key. Raises SettingsError naming the variable and the file at fault.

    names  the environment variables of certificate, key and token
    """
    cert_variable, key_variable, token_variable = names
    _check_token(token, token_variable, cert_variable, has_tls=cert is not None)
    if (cert is None) != (key is None):
        raise SettingsError(f"{cert_variable} and {key_variable} go together: set both or none")
    if cert is None or key is None:
        return NO_SECURITY
    security = ServerSecurity(_read(cert, cert_variable), _read(key, key_variable), token)
    try:
        # An empty password for an encrypted key: OpenSSL would otherwise ask for one at a terminal and wait for ever.
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(cert, key, password=lambda: "")
    except (ssl.SSLError, ValueError, TypeError) as error:
        raise SettingsError(
            f"{cert_variable} and {key_variable}: {cert} and {key} are not a PEM certificate and its unencrypted PEM "
            f"key: {error}"
        ) from None
    _check_validity(security.cert, f"{cert_variable}: {cert}")
    return security


def read_client_credentials(ca: Path | None, token: str, *, names: tuple[str, str]) -> ClientCredentials:
    """Read and check a caller's CA certificates. Raises SettingsError naming the variable and the file at fault.

    names  the environment variables of CA certificates and token
    """
    ca_variable, token_variable = names
    _check_token(token, token_variable, ca_variable, has_tls=ca is not None)
    if ca is None:
        return NO_CREDENTIALS
    credentials = ClientCredentials(_read(ca, ca_variable), token)
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(cafile=ca)
    except ssl.SSLError as error:
        raise SettingsError(f"{ca_variable}: {ca} contains no PEM certificate: {error}") from None
    return credentials


def certificate_host(cert: bytes) -> str:
    """Return the first host name or IP address of a PEM certificate, "localhost" where it has none.

    A health check on loopback must ask for that name, or TLS refuses the certificate.
    """
    from cryptography import x509

    found = x509.load_pem_x509_certificate(cert)
    try:
        names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        names = x509.SubjectAlternativeName([])
    return str(next((name.value for name in names if isinstance(name, x509.DNSName | x509.IPAddress)), "localhost"))


def first_expiry(certificates: bytes) -> float:
    """Return when the first of these PEM certificates expires, in seconds since the epoch."""
    from cryptography import x509

    found = x509.load_pem_x509_certificates(certificates)
    return min(certificate.not_valid_after_utc for certificate in found).timestamp()


def check_token(token: str, variable: str) -> None:
    """Raise SettingsError for a token that is too short, or not printable ASCII (it goes in a header); "" is fine."""
    if token and (len(token) < TOKEN_CHARS or not (token.isascii() and token.isprintable()) or " " in token):
        raise SettingsError(
            f"{variable}: use at least {TOKEN_CHARS} ASCII letters, digits or signs without spaces; "
            f"`openssl rand -hex 32` makes a good one"
        )


def _check_token(token: str, token_variable: str, tls_variable: str, *, has_tls: bool) -> None:
    """Raise SettingsError for a token that cannot be used, or has no TLS."""
    check_token(token, token_variable)
    if token and not has_tls:
        raise SettingsError(
            f"{token_variable} needs {tls_variable}: without TLS others on the network could read the token"
        )


def _check_validity(cert: bytes, what: str) -> None:
    """Raise SettingsError for a certificate that is not valid yet, or has expired."""
    from cryptography import x509

    found, now = x509.load_pem_x509_certificate(cert), datetime.now(UTC)
    if not found.not_valid_before_utc <= now <= found.not_valid_after_utc:
        since, until = (f"{each:%Y-%m-%d}" for each in (found.not_valid_before_utc, found.not_valid_after_utc))
        raise SettingsError(f"{what} is valid from {since} to {until}, not now: make a new certificate")


def _read(path: Path, variable: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise SettingsError(f"{variable}: {path} cannot be read: {error.strerror}") from None
