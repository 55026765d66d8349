"""Photos are shrunk a few at once, and those that wait for it are not in memory yet."""

from __future__ import annotations

import asyncio
import io

from PIL import Image

from services.gateway.pictures.picture_processes import PictureProcesses
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
