"""The service of the bench `soak`, of which a part is killed every minute: S3, Postgres, two gateways, workers."""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil
from sqlalchemy.engine import Engine

from capture2vr.cli.up import free_port
from capture2vr.gateway.database.database import open_engine
from capture2vr.storage.catalogue.signing import Keys, generate_key, read_signer
from capture2vr.storage.s3 import S3Store
from tests.referees.postgres import PostgresServer
from tests.referees.s3 import server as s3
from tests.support.in_process_gateway import capture
from tests.support.service_processes import ServiceProcess

GATEWAYS, WORKERS = 2, 4
CAPTURE = "cap_1"
_BUCKET = "soak"


class Site:
    """Runs within a `with` block. What it has stored is there again in the next one."""

    def __init__(self, folder: Path, weed: Path, postgres: Path, *, publishers: int) -> None:
        self.folder, self._weed, self._postgres, self._publishers = folder, weed, postgres, publishers
        self._stack = ExitStack()
        self._s3 = ExitStack()
        self._ports = s3.free_ports()

    def __enter__(self) -> Site:
        with ExitStack() as failed:
            failed.push(self._stack)
            self._start()
            failed.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stack.close()

    @property
    def keys(self) -> Keys:
        """That sign the collections."""
        return Keys((read_signer(self.folder / "collection.key"),))

    @property
    def kills(self) -> list[tuple[str, Callable[[], None]]]:
        """What is killed in turn, and comes back at once."""
        workers = [(f"worker {number}", _again(each)) for number, each in enumerate(self.workers)]
        gateways = [(f"gateway {number}", _again(each)) for number, each in enumerate(self.gateways)]
        return [workers[0], gateways[0], workers[1], ("store", self._kill_s3), workers[2], gateways[1], workers[3],
                ("database", self._kill_database)]  # fmt: skip

    def memory_mb(self) -> list[float]:
        """MB of the gateways, the workers, the store, the database: pages that processes share count once."""
        groups = (
            [each.pid for each in self.gateways],
            [each.pid for each in self.workers],
            [self._s3_process.pid],
            [self._database.pid],
        )
        return [sum(map(_proportional_mb, group)) for group in groups]

    def _start(self) -> None:
        keys = self._keys_of_s3()
        self._start_s3(keys)
        self._stack.callback(self._s3.close)
        self.store = S3Store(
            bucket=_BUCKET,
            access_key=keys["STORAGE_ACCESS_KEY"],
            secret_key=keys["STORAGE_SECRET_KEY"],
            endpoint=f"http://127.0.0.1:{self._ports[0]}",
        )
        self.store.create_bucket()
        if not (self.folder / "collection.key").exists():
            generate_key(self.folder / "collection.key")
        capture(self.store, CAPTURE)
        database = self.folder / "postgres"
        database.mkdir(exist_ok=True)
        # A killed server leaves it behind, with the id of a process that may be somebody else's now.
        (database / "data" / "postmaster.pid").unlink(missing_ok=True)
        self._database = PostgresServer(self._postgres, database)
        self._database.start()
        self._stack.callback(self._database.stop)
        self.engine: Engine = open_engine(self._database.url)
        self._stack.callback(self.engine.dispose)
        storage = {
            "STORAGE_KIND": "s3",
            "STORAGE_BUCKET": _BUCKET,
            "STORAGE_ENDPOINT": f"http://127.0.0.1:{self._ports[0]}",
            "STORAGE_SIGNING_KEY": self.folder / "collection.key",
            **keys,
        }
        ports = [free_port() for _ in range(WORKERS)]
        self.workers = [self._worker(number, port, storage) for number, port in enumerate(ports)]
        addresses = ",".join(f"127.0.0.1:{port}" for port in ports)
        self.gateway_urls, self.gateways = [], []
        for number in range(GATEWAYS):
            port = free_port()
            self.gateway_urls.append(f"http://127.0.0.1:{port}")
            self.gateways.append(self._gateway(number, port, addresses, storage))

    def _worker(self, number: int, port: int, storage: dict[str, Any]) -> ServiceProcess:
        slots = -(-self._publishers // WORKERS)
        return self._process(
            ServiceProcess(
                "tests.bench.load.soak_worker",
                self.folder / f"worker{number}.log",
                str(self.folder / "bundles"),
                str(self.folder / "publications.jsonl"),
                EDGE_PORT=port,
                EDGE_SLOTS=slots,
                EDGE_SCRATCH=self.folder / "scratch",
                OMP_NUM_THREADS=1,
                **storage,
            )
        )

    def _gateway(self, number: int, port: int, workers: str, storage: dict[str, Any]) -> ServiceProcess:
        limits = ("JOBS_AT_ONCE", "REQUESTS_PER_MINUTE", "ADDRESS_REQUESTS_PER_MINUTE", "PROCESSOR_S_PER_MINUTE")
        return self._process(
            ServiceProcess(
                "capture2vr.gateway",
                self.folder / f"gateway{number}.log",
                GATEWAY_PORT=port,
                GATEWAY_DATA_DIR=self.folder / f"gateway{number}",
                GATEWAY_DATABASE_URL=self._database.url,
                GATEWAY_WORKERS=workers,
                GATEWAY_LOG_LEVEL="WARNING",
                **{f"GATEWAY_LIMIT_{name}": 0 for name in limits} | storage,
            )
        )

    def _process(self, process: ServiceProcess) -> ServiceProcess:
        self._stack.callback(process.kill)
        return process

    def _keys_of_s3(self) -> dict[str, str]:
        path = self.folder / "s3.json"
        if not path.exists():
            (self.folder / "s3" / "data").mkdir(parents=True)
            path.write_text(json.dumps({"STORAGE_ACCESS_KEY": "soak", "STORAGE_SECRET_KEY": secrets.token_hex(16)}))
        keys: dict[str, str] = json.loads(path.read_text())
        return keys

    def _start_s3(self, keys: dict[str, str]) -> None:
        # One bucket in few volumes: those of tests are small, because each test has a bucket.
        started = s3.process(self._weed, self.folder / "s3", self._ports, "-master.volumeSizeLimitMB=1024", **keys)
        self._s3_process = self._s3.enter_context(started)
        if not s3.answers(f"http://127.0.0.1:{self._ports[0]}", self._s3_process):
            raise RuntimeError(f"the S3 server did not start: {self.folder / 's3' / 'log'}")

    def _kill_s3(self) -> None:
        self._s3.close()
        self._start_s3(self._keys_of_s3())

    def _kill_database(self) -> None:
        self._database.kill()
        self._database.start()


def _again(process: ServiceProcess) -> Callable[[], None]:
    def kill() -> None:
        process.kill()
        process.start()

    return kill


def _proportional_mb(process: int) -> float:
    """MB of a process and its children, by proportional set size."""
    total = 0.0
    with suppress(psutil.NoSuchProcess):
        above = psutil.Process(process)
        for each in (above, *above.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                total += each.memory_full_info().pss / 1e6
    return total
