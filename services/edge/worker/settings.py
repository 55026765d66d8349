"""The edge worker's settings: `EDGE_*` variables, read once by the entry point."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from pydantic import ByteSize, Field, SecretStr, field_validator
from pydantic_settings import SettingsConfigDict

from services.link import Caller, Door, read_caller, read_door
from services.strict_settings import LOOPBACK, StrictSettings

_ADDRESS = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9]([A-Za-z0-9._-]*[A-Za-z0-9])?):(?P<port>\d{1,5})", re.ASCII)
"""A name or an IPv4 address, or an IPv6 address in brackets, and a port."""


class EdgeSettings(StrictSettings):
    """Where a worker listens, how much it takes on, and where it may write."""

    model_config = SettingsConfigDict(env_prefix="EDGE_")

    host: str = Field(
        "127.0.0.1", min_length=1, description="Address to listen on: whoever reaches it may run jobs, but for `token`."
    )
    port: int = Field(50051, ge=0, le=65535, description="0 takes any free port and logs which.")
    slots: int = Field(1, ge=1, le=64, description="Jobs computed at once.")
    queue: int = Field(8, ge=0, le=1000, description="Jobs waiting for a slot; one more is RESOURCE_EXHAUSTED.")
    scratch: Path = Field(
        Path(tempfile.gettempdir(), "capture2vr-edge"),
        description="Folder of uploads and unpacked captures; several workers may share one.",
    )
    device: str = Field("cpu", pattern=r"^(auto|cpu|cuda(:\d+)?)$", description="What fields are trained on.")
    memory: ByteSize = Field(ByteSize(0), ge=0, description="What fits may take together; 0: a share of the device's.")
    presets: Path | None = Field(None, description="Folder of TOML files: the operator's presets beside the product's.")
    ktx2: Path | None = Field(None, description="Folder with npm's ktx2-encoder; none: targets with -ktx2 are refused.")
    central: str = Field("", description="host:port of a worker that fits the fields; empty: they are fitted here.")
    tls_cert: Path | None = Field(None, description="Certificate (PEM, with its chain) shown to callers; none: no TLS.")
    tls_key: Path | None = Field(None, description="The certificate's private key (PEM, not encrypted).")
    token: SecretStr = Field(SecretStr(""), description="What every caller must show; empty: nothing. Needs TLS.")
    central_ca: Path | None = Field(None, description="Certificates (PEM) that vouch for central; none: no TLS.")
    central_token: SecretStr = Field(SecretStr(""), description="The EDGE_TOKEN of central.")
    reflection: bool = Field(False, description="Answer gRPC reflection (grpcurl); for development.")
    log_level: str = Field("INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$", description="How much is logged.")
    drain_s: float = Field(30.0, ge=0, le=3600, description="Seconds that running jobs get after SIGTERM.")
    max_capture_bytes: int = Field(4 << 30, ge=1, description="Largest capture archive taken, in bytes.")

    @field_validator("central")
    @classmethod
    def _an_address(cls, value: str) -> str:
        found = _ADDRESS.fullmatch(value)
        if value and not (found and 0 < int(found["port"]) <= 65535):
            raise ValueError("must be host:port, as in central.example:50051")
        return value

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach the worker."""
        return self.host in LOOPBACK


def open_door(settings: EdgeSettings) -> Door:
    """How callers are received. Raises SettingsError that names the variable and the file at fault."""
    names = ("EDGE_TLS_CERT", "EDGE_TLS_KEY", "EDGE_TOKEN")
    return read_door(settings.tls_cert, settings.tls_key, settings.token.get_secret_value(), names=names)


def open_way_to_central(settings: EdgeSettings) -> Caller:
    """How central is called. Raises SettingsError that names the variable and the file at fault."""
    names = ("EDGE_CENTRAL_CA", "EDGE_CENTRAL_TOKEN")
    return read_caller(settings.central_ca, settings.central_token.get_secret_value(), names=names)
