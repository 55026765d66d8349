"""Have photos shrunk in processes of their own, which run shrink_work.py."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from anyio import CapacityLimiter

from capture2vr.gateway.database.full_disk import is_disk_full
from capture2vr.gateway.errors import Problem, storage_full
from capture2vr.gateway.forked_talk import talk
from capture2vr.process.fork_client import ForkServer
from capture2vr.sentences.sentence import say

_AT_ONCE = 2  # photos, each with up to 768 MB; and with its bytes here, up to 128 MB


class PictureProcesses:
    """Shrinks photos, a few at once, each in a process that ends with it. The first one starts their server."""

    def __init__(self) -> None:
        self._at_once = CapacityLimiter(_AT_ONCE)
        self._server = ForkServer.of("capture2vr.gateway.pictures.shrink_work")

    def close(self) -> None:
        """Terminate the fork server; photos that are being shrunk are given up."""
        self._server.close()

    async def shrink(self, read: Callable[[], Awaitable[tuple[str, bytes]]]) -> bytes:
        """Return a small upright JPEG of a photo. Raises Problem PICTURE_UNREADABLE, STORAGE_FULL, and what
        `read` raises.

        read  returns the name of its file, for the message, and its bytes; called once there is a place for them
        """
        async with self._at_once:
            name, photo = await read()
            try:
                with TemporaryDirectory(prefix="picture-") as folder:
                    return await self._shrink(Path(folder), name, photo)
            except OSError as error:
                if not is_disk_full(error):
                    raise
                raise storage_full() from None

    async def _shrink(self, folder: Path, name: str, photo: bytes) -> bytes:
        source, target = folder / "photo", folder / "small.jpg"
        await asyncio.to_thread(source.write_bytes, photo)
        said = await talk(self._server.fork(), {"source": str(source), "target": str(target)})
        if "failed" in said:
            raise RuntimeError(f"a photo could not be shrunk: {said['failed']}")
        if "full" in said:
            raise storage_full()
        if "jpeg" not in said or said.get("ended") != 0:
            reason = said.get("unreadable", say("decoder_crashed_took_too_long"))
            detail = say("cannot_be_shown", reason=reason)
            raise Problem(422, "PICTURE_UNREADABLE", detail, file=name, hints=(say("choose_another_photo"),))
        return await asyncio.to_thread(target.read_bytes)
