"""`python -m capture2vr.edge`: start one worker, configured by the environment variables EDGE_* and STORAGE_*."""

from __future__ import annotations

import sys
from collections.abc import Callable

from capture2vr.edge.engine.nouns import Needs
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.export.ktx2 import Ktx2Encoder
from capture2vr.edge.field.device import find_device
from capture2vr.edge.generated.server import GeneratorServer
from capture2vr.edge.jobs.available_presets import known_presets
from capture2vr.edge.jobs.central_client import Central
from capture2vr.edge.jobs.fit_job import FieldFitter
from capture2vr.edge.jobs.job_process import JobProcesses
from capture2vr.edge.jobs.job_task import Machine
from capture2vr.edge.jobs.reconstruct_job import Reconstructor
from capture2vr.edge.models.folder import ModelFolder
from capture2vr.edge.worker.control_group import own_control_group
from capture2vr.edge.worker.guard import is_container_start, run_guarded
from capture2vr.edge.worker.memory_budget import MemoryBudget, machine_bytes, machine_cores
from capture2vr.edge.worker.server import serve
from capture2vr.edge.worker.settings import EdgeSettings, central_credentials, server_security
from capture2vr.process.logs import configure
from capture2vr.process.private_files import hide_secrets, write_for_own_user
from capture2vr.process.strict_settings import SettingsError
from capture2vr.storage.settings import StorageSettings, open_policy, open_store

_VARIABLES = {"PRESET_INVALID": "EDGE_PRESETS", "KTX2_UNAVAILABLE": "EDGE_KTX2"}  # error code -> variable at fault


def start() -> int:
    """Run a worker until SIGTERM has drained it; return the exit status. Raises SettingsError for a wrong setting.

    In a container it runs in a child process, again whenever the kernel has killed it for want of memory.
    """
    write_for_own_user()
    hide_secrets()
    if not is_container_start():
        return _start(out_of_memory=False)
    settings = EdgeSettings()
    configure(settings.log_level)
    return run_guarded(
        lambda out_of_memory: _or_say_why(lambda: _start(out_of_memory=out_of_memory)), own_control_group()
    )


def _or_say_why(run: Callable[[], int]) -> int:
    """Return the exit status of `run`; for wrong settings write what is wrong to stderr, and return 2."""
    try:
        return run()
    except SettingsError as error:
        sys.stderr.write(f"edge: {error}\n")
        return 2


def _start(*, out_of_memory: bool) -> int:
    """Run a worker in this process. out_of_memory: whether the kernel has killed the one before it for that"""
    try:
        settings, storage = EdgeSettings(), StorageSettings()
        store, policy = open_store(storage), open_policy(storage)
        server_security(settings)  # checked before anything that is slow to load
        credentials = central_credentials(settings)
        device = find_device(settings.device)
        presets = known_presets(settings.presets)
        encode = Ktx2Encoder.at(settings.ktx2) if settings.ktx2 else None
    except ValueError as error:
        raise SettingsError(str(error)) from error
    except EdgeError as error:
        raise SettingsError(f"{_VARIABLES.get(error.code, 'EDGE_DEVICE')}: {error.message}") from error
    configure(settings.log_level)
    memory = MemoryBudget(settings.memory or device.memory_bytes or machine_bytes())
    central = Central(settings.central, credentials=credentials) if settings.central else None
    room = Needs(machine_cores() / settings.slots, 1 / settings.slots, machine_bytes() // settings.slots)
    models = ModelFolder(settings.models, device.name) if settings.models else None
    generator = GeneratorServer.at(settings.generator)
    machine = Machine(device.name, memory.total_bytes, encode, (settings.engine, room), models, generator)
    fitter = FieldFitter(store, presets, device, memory, policy, machine)
    processes = JobProcesses(most_seconds=settings.job_s)
    work = Reconstructor(fitter, central, storage.collection, processes)
    work.warm_up()
    return serve(settings, work, out_of_memory=out_of_memory)


def main() -> int:
    """Run the worker; return the exit status: 0 after SIGTERM, 1 when it could not start, 2 for wrong settings."""
    return _or_say_why(start)


if __name__ == "__main__":
    sys.exit(main())
