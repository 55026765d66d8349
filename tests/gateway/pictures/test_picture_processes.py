"""Photos are shrunk a few at once, and those that wait for it are not in memory yet."""

from __future__ import annotations

import asyncio
import io
from functools import partial
from pathlib import Path

import pytest
from PIL import Image

from capture2vr.gateway.errors import Problem
from capture2vr.gateway.pictures import picture_processes
from capture2vr.gateway.pictures.picture_processes import PictureProcesses
from tests.support.patience import PATIENCE_S


async def test_only_photos_that_are_shrunk_are_in_memory() -> None:
    buffer = io.BytesIO()
    Image.new("RGB", (40, 30)).save(buffer, "JPEG")
    processes, release = PictureProcesses(), asyncio.Event()
    reading, most, count = 0, 0, 5

    async def read() -> tuple[str, bytes]:
        nonlocal reading, most
        reading += 1
        most = max(most, reading)
        await release.wait()
        reading -= 1
        return "a.jpg", buffer.getvalue()

    try:
        async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
            tasks = [group.create_task(processes.shrink(read)) for _ in range(count)]
            while reading < 2:
                await asyncio.sleep(0)
            release.set()
        assert most == 2
        assert all(Image.open(io.BytesIO(task.result())).size == (40, 30) for task in tasks)
    finally:
        processes.close()


async def test_a_full_disk_is_told_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """/dev/full takes the photo's bytes, or the small picture's, as a disk without space does."""
    buffer = io.BytesIO()
    Image.new("RGB", (40, 30)).save(buffer, "JPEG")
    processes = PictureProcesses()

    async def read() -> tuple[str, bytes]:
        return "a.jpg", buffer.getvalue()

    try:
        for file in ("photo", "small.jpg"):
            folder = tmp_path / file
            folder.mkdir()
            (folder / file).symlink_to("/dev/full")
            monkeypatch.setattr(picture_processes, "TemporaryDirectory", partial(_Folder, folder))
            with pytest.raises(Problem) as problem:
                await processes.shrink(read)
            assert (problem.value.status, problem.value.code) == (507, "STORAGE_FULL"), file
    finally:
        processes.close()


class _Folder:
    """A folder that is there already, in the place of a temporary one."""

    def __init__(self, folder: Path, prefix: str) -> None:
        self.folder = folder

    def __enter__(self) -> str:
        return str(self.folder)

    def __exit__(self, *_: object) -> None:
        pass
