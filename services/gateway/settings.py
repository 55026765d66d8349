"""Settings of the gateway: GATEWAY_* variables, read once by an entry point and passed on."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, SecretStr
from pydantic_settings import SettingsConfigDict

from services.link import Caller, read_caller
from services.strict_settings import LOOPBACK, CommaList, StrictSettings


class GatewaySettings(StrictSettings):
    """Where the gateway listens, where it keeps its jobs, and whom it gives them to."""

    model_config = SettingsConfigDict(env_prefix="GATEWAY_")

    host: str = "127.0.0.1"  # nothing asks for access keys yet, so nothing but this machine may connect unless told
    port: int = Field(default=8080, ge=0, le=65535)  # 0 chooses a free one
    data_dir: Path = Path("capture2vr-data")  # jobs database and staged uploads
    workers: CommaList = ("127.0.0.1:50051",)
    edge_ca: Path | None = None  # certificates (PEM) that vouch for the workers; none: they speak plain gRPC
    edge_token: SecretStr = SecretStr("")  # the workers' EDGE_TOKEN; needs edge_ca
    public_url: str = ""  # how phones and headsets reach this gateway; empty: as the request did
    database_url: str = ""  # empty: SQLite in data_dir
    cors_origins: CommaList = ()  # origins whose pages may call the API; "*" for all
    log_level: str = Field(default="INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$")

    max_upload_bytes: int = Field(default=2 << 30, ge=1)  # a minute of 4K video with depth is about 1 GB
    max_files: int = Field(default=2000, ge=1)  # a minute of frames at 30 Hz

    lease_s: float = Field(default=10.0, gt=0)  # a gateway that is silent for longer has lost its jobs to another
    silence_s: float = Field(default=15.0, gt=0)  # three of the worker's heartbeats missed: the stream is dead
    attach_for_s: float = Field(default=10.0, ge=0)  # how long to look for a lost worker before the job goes elsewhere
    job_timeout_s: float = Field(
        default=6 * 3600.0, gt=0
    )  # deadline of the longest call; a trained field takes minutes
    retry_s: float = Field(
        default=1.0, gt=0
    )  # first pause before a job runs again; doubles with every attempt, 60 s at most
    max_attempts: int = Field(default=5, ge=1)  # runs of one job that may end with a lost worker
    # Taken while no worker has been heard of; the first is the default.
    presets: CommaList = ("auto", "draft", "standard", "fine", "scene")

    @property
    def database(self) -> str:
        """The database's URL."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'gateway.db'}"

    @property
    def is_public(self) -> bool:
        """Whether others than this machine can connect."""
        return self.host not in LOOPBACK


def open_way_to_workers(settings: GatewaySettings) -> Caller:
    """How workers are called. Raises SettingsError that names the variable and the file at fault."""
    names = ("GATEWAY_EDGE_CA", "GATEWAY_EDGE_TOKEN")
    return read_caller(settings.edge_ca, settings.edge_token.get_secret_value(), names=names)
