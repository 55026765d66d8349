"""Settings of the gateway, from the environment variables GATEWAY_*; read once at the start and passed on."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import SettingsConfigDict

from capture2vr.gateway.workers.worker_addresses import check_worker_address
from capture2vr.process.grpc_security import ClientCredentials, check_token, read_client_credentials
from capture2vr.process.strict_settings import LOOPBACK, CommaList, SettingsError, StrictSettings


class GatewaySettings(StrictSettings):
    """Address, data folder, workers, limits and timeouts of the gateway."""

    model_config = SettingsConfigDict(env_prefix="GATEWAY_")

    host: str = "127.0.0.1"  # only this machine can connect by default
    port: int = Field(default=8080, ge=0, le=65535)  # 0 chooses a free one
    # Where others reach the port, if that is not `host`: in a container, the address on which the port is published.
    published_host: str = ""
    open: bool = False  # let everybody in without an access key, also from other machines
    # An access key with every scope that is created at the start where it is not known yet: for installations that have
    # their secrets before their database. Once revoked, it stays so.
    operator_key: SecretStr = SecretStr("")
    # Token for GET /metrics alone, in place of an access key of scope operate, or a file that holds it.
    metrics_token: SecretStr = SecretStr("")
    metrics_token_file: Path | None = None
    data_dir: Path = Path("capture2vr-data")  # jobs database and staged uploads
    workers: CommaList = ("127.0.0.1:50051",)  # dns:///HOST:PORT: all addresses behind a name
    edge_ca: Path | None = None  # CA certificates (PEM) that verify the workers' certificates; none: gRPC without TLS
    edge_token: SecretStr = SecretStr("")  # the workers' EDGE_TOKEN; needs edge_ca
    public_url: str = ""  # URL by which phones and headsets reach this gateway; empty: the one of the request
    database_url: str = ""  # empty: SQLite in data_dir
    # Host names by which clients may reach this gateway, besides addresses, local names and public_url's; "*" for all.
    allowed_hosts: CommaList = ()
    cors_origins: CommaList = ()  # origins whose pages may call the API (CORS); "*" for all
    log_level: str = Field(default="INFO", pattern="^(DEBUG|INFO|WARNING|ERROR)$")

    max_upload_bytes: int = Field(default=2 << 30, ge=1)  # a minute of 4K video with depth is about 1 GB
    # Seconds after its last byte in which an upload can go on; then what there is of it is removed.
    upload_expires_s: float = Field(default=86_400.0, gt=0)
    max_files: int = Field(default=2000, ge=1)  # a minute of frames at 30 Hz

    webhook_private: bool = False  # send webhooks to private addresses too, and without TLS

    # Limits of a tenant, each 0 for none; operators set others for single tenants. They hold for callers with a key.
    limit_requests_per_minute: int = Field(default=6_000, ge=0)
    limit_uploads_at_once: int = Field(default=64, ge=0)
    limit_jobs_at_once: int = Field(default=200, ge=0)  # that have not ended
    limit_jobs_per_day: int = Field(default=0, ge=0)
    limit_stored_bytes: int = Field(default=0, ge=0)
    limit_capture_bytes: int = Field(default=0, ge=0)  # beside max_upload_bytes
    limit_job_seconds: int = Field(default=14_400, ge=0)  # that one may compute: large scenes take two hours
    limit_processor_s_per_minute: int = Field(
        default=120, ge=0
    )  # of checks and inspections: of two cores, all the time
    limit_presets: CommaList = ()  # that jobs may name; empty: all but those of the literature
    # Of a client's address, with or without a key; this machine's own are not counted.
    limit_address_requests_per_minute: int = Field(default=3_000, ge=0)
    limit_address_connections: int = Field(default=512, ge=0)  # open ones; behind a proxy all are the proxy's

    # Of all search indexes of large collections, in data_dir: 250 bytes an asset; 0: each search reads all shards.
    search_bytes: int = Field(default=2 << 30, ge=0)

    # After which jobs that have ended are deleted, of tenants that have set no other number; 0: never.
    jobs_days: int = Field(default=90, ge=0)
    snapshots: int = Field(default=7, ge=0)  # of the SQLite database, one a day, that are kept in data_dir; 0: none
    scrub_days: float = Field(default=7.0, ge=0)  # between two scrubs of a store that is a folder; 0: none

    lease_s: float = Field(default=10.0, gt=0)  # after so long without renewal another gateway takes the job over
    silence_s: float = Field(default=15.0, gt=0)  # three of the worker's heartbeats missed: the stream is dead
    attach_for_s: float = Field(default=10.0, ge=0)  # try so long to reattach to a lost run, then queue the job again
    # Deadline of the call that starts a run; what still runs then is followed on, until it ends or is cancelled.
    job_timeout_s: float = Field(default=6 * 3600.0, gt=0)
    # First pause before a job runs again; doubles with every attempt and every refusal, 60 s at most.
    retry_s: float = Field(default=1.0, gt=0)
    max_attempts: int = Field(default=5, ge=1)  # runs of one job that may end with a lost worker
    # Used until a worker has reported its presets; the first is the default.
    presets: CommaList = ("auto", "draft", "standard", "fine", "splats", "scene", "scene-tiles")

    @field_validator("workers")
    @classmethod
    def _check_workers(cls, workers: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(map(check_worker_address, workers))

    @field_validator("database_url")
    @classmethod
    def _check_database_url(cls, url: str) -> str:
        if url and not _is_database_url(url):
            raise ValueError("must be postgresql://user:password@host/database, or sqlite:///file")
        return url

    @property
    def database(self) -> str:
        """URL of the jobs database."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'gateway.db'}"

    @property
    def snapshots_dir(self) -> Path:
        """Folder of the database's snapshots."""
        return self.data_dir / "snapshots"

    @property
    def reached_host(self) -> str:
        """Address on which clients reach the port."""
        return self.published_host or self.host

    @property
    def is_public(self) -> bool:
        """Whether other machines can connect."""
        return self.reached_host not in LOOPBACK


def _is_database_url(url: str) -> bool:
    from sqlalchemy.engine import make_url  # here: who has none need not wait for the import
    from sqlalchemy.exc import ArgumentError

    try:
        return make_url(url).get_backend_name() in ("postgresql", "postgres", "sqlite")
    except (ArgumentError, ValueError):  # the second for a port that is no number
        return False


def worker_credentials(settings: GatewaySettings) -> ClientCredentials:
    """Read the CA and the token for calls to workers. Raises SettingsError that names the variable and the file."""
    names = ("GATEWAY_EDGE_CA", "GATEWAY_EDGE_TOKEN")
    return read_client_credentials(settings.edge_ca, settings.edge_token.get_secret_value(), names=names)


def read_metrics_token(settings: GatewaySettings) -> str:
    """Return the token of the settings or of their file; "" for none. Raises SettingsError that names the variable."""
    token, file = settings.metrics_token.get_secret_value(), settings.metrics_token_file
    if not token and file is not None:
        try:
            token = file.read_text().strip()
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsError(f"GATEWAY_METRICS_TOKEN_FILE: {error}") from None
        if not token:
            raise SettingsError(f"GATEWAY_METRICS_TOKEN_FILE: {file} is empty")
    check_token(token, "GATEWAY_METRICS_TOKEN")
    return token
