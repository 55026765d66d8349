"""The edge worker's settings: `EDGE_*` variables, read once by the entry point."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from pydantic import ByteSize, Field, SecretStr, field_validator
from pydantic_settings import SettingsConfigDict

from capture2vr.edge.engine.address import check_engine
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.process.grpc_security import (
    ClientCredentials,
    ServerSecurity,
    first_expiry,
    read_client_credentials,
    read_server_security,
)
from capture2vr.process.strict_settings import LOOPBACK, SettingsError, StrictSettings

_ADDRESS = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?):(?P<port>\d{1,5})", re.ASCII)
"""host:port, where the host is a name, an IPv4 address, or an IPv6 address in brackets."""

_SOCKET = "unix:"


class EdgeSettings(StrictSettings):
    """Settings of an edge worker: its address, slots, memory, folders, credentials and limits."""

    model_config = SettingsConfigDict(env_prefix="EDGE_")

    host: str = Field(
        "127.0.0.1", min_length=1, description="Address to listen on, or unix:PATH of a socket for this user alone."
    )
    open: bool = Field(False, description="Take jobs without a token, also where other machines reach the address.")
    port: int = Field(50051, ge=0, le=65535, description="Port to listen on; 0: any free port, which is logged.")
    metrics_port: int = Field(0, ge=0, le=65535, description="Port of GET /metrics (Prometheus); 0: none.")
    slots: int = Field(1, ge=1, le=64, description="Jobs computed at once.")
    queue: int = Field(8, ge=0, le=1000, description="Jobs that may wait for a slot; more are RESOURCE_EXHAUSTED.")
    scratch: Path = Field(
        Path(tempfile.gettempdir(), "capture2vr-edge"),
        description="Folder of uploads and unpacked captures; several workers may share one.",
    )
    device: str = Field("cpu", pattern=r"^(auto|cpu|cuda(:\d+)?)$", description="Device that fields are trained on.")
    memory: ByteSize = Field(
        ByteSize(0), ge=0, description="Memory of all fits together; 0: a share of the device's memory."
    )
    presets: Path | None = Field(None, description="Folder of TOML files: the operator's presets beside the product's.")
    ktx2: Path | None = Field(None, description="Folder with npm's ktx2-encoder; none: targets with -ktx2 are refused.")
    models: Path | None = Field(None, description="Folder of learned models (`capture2vr models`); none: none is used.")
    generator: str = Field("", description="http://host:port of a generator, for the preset generate; empty: none.")
    engine: str = Field("local", description="Where tasks run that are many: local, or a Ray cluster, ray://host:port.")
    central: str = Field("", description="host:port of a worker that fits the fields; empty: they are fitted here.")
    tls_cert: Path | None = Field(None, description="The worker's certificate (PEM, with its chain); none: no TLS.")
    tls_key: Path | None = Field(None, description="The certificate's private key (PEM, not encrypted).")
    token: SecretStr = Field(SecretStr(""), description="Token that every caller must send; empty: none. Needs TLS.")
    central_ca: Path | None = Field(None, description="CA certificates (PEM) to check central's with; none: no TLS.")
    central_token: SecretStr = Field(SecretStr(""), description="The EDGE_TOKEN of central.")
    reflection: bool = Field(False, description="Answer gRPC reflection (grpcurl); for development.")
    log_level: str = Field("INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$", description="How much is logged.")
    job_s: float = Field(86_400.0, gt=0, description="Most seconds that a job computes, after which it fails.")
    drain_s: float = Field(30.0, ge=0, le=3600, description="Seconds that running jobs get to finish after SIGTERM.")
    max_capture_bytes: int = Field(4 << 30, ge=1, description="Largest capture archive taken, in bytes.")

    @field_validator("engine")
    @classmethod
    def _an_engine(cls, value: str) -> str:
        return check_engine(value)

    @field_validator("generator")
    @classmethod
    def _an_origin(cls, value: str) -> str:
        GeneratorServer.at(value)
        return value

    @field_validator("central")
    @classmethod
    def _an_address(cls, value: str) -> str:
        found = _ADDRESS.fullmatch(value)
        if value and not (found and 0 < int(found["port"]) <= 65535):
            raise ValueError("must be host:port, as in central.example:50051")
        return value

    @property
    def is_socket(self) -> bool:
        """Whether the worker listens on a socket in the file system."""
        return self.host.startswith(_SOCKET)

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach the worker."""
        return self.is_socket or self.host in LOOPBACK

    @property
    def takes_strangers(self) -> bool:
        """Whether others than this machine's users reach the worker, and need no token."""
        return not self.is_local and not self.token.get_secret_value()

    @property
    def metrics_host(self) -> str:
        """Address of GET /metrics."""
        return "127.0.0.1" if self.is_socket else self.host


def server_security(settings: EdgeSettings) -> ServerSecurity:
    """Read the worker's certificate, key and token. Raises SettingsError naming the variable and the file at fault."""
    names = ("EDGE_TLS_CERT", "EDGE_TLS_KEY", "EDGE_TOKEN")
    return read_server_security(settings.tls_cert, settings.tls_key, settings.token.get_secret_value(), names=names)


def refuse_without_token(settings: EdgeSettings) -> None:
    """Raises SettingsError where others reach the worker without a token, unless the settings want it so."""
    if settings.open or not settings.takes_strangers:
        return
    why = "everybody who reaches this address could run jobs, in the name of any tenant"
    then = "set EDGE_TOKEN with EDGE_TLS_CERT and EDGE_TLS_KEY, or EDGE_OPEN=true where only gateways reach it"
    raise SettingsError(f"EDGE_HOST={settings.host}: {why}; {then}")


def central_credentials(settings: EdgeSettings) -> ClientCredentials:
    """Read central's CA certificates and token. Raises SettingsError naming the variable and the file at fault."""
    names = ("EDGE_CENTRAL_CA", "EDGE_CENTRAL_TOKEN")
    return read_client_credentials(settings.central_ca, settings.central_token.get_secret_value(), names=names)


def certificate_expiries(settings: EdgeSettings) -> dict[str, float]:
    """Return when the first certificate of each file expires (seconds since the epoch), by the setting that names it.

    Raises SettingsError for a file that cannot be used.
    """
    files = {"EDGE_TLS_CERT": server_security(settings).cert, "EDGE_CENTRAL_CA": central_credentials(settings).ca}
    return {name: first_expiry(content) for name, content in files.items() if content}
