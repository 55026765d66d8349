"""A picture as KTX2, which stays packed on the graphics card: a quarter of the memory that a JPEG takes there, or less.

Basis Universal packs it (ETC1S), in WebAssembly, since there is no Python package that does: npm's ktx2-encoder, run by
Node in a process of its own. Who wants such files installs both; nothing else needs them.
"""

from __future__ import annotations

import json
import shutil
import struct
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from services.edge.arrays import Bytes, Tick, no_tick
from services.edge.errors import EdgeError
from services.edge.mesh.child import ChildError, run_child

VERSION = "0.6.0"
"""Of npm's ktx2-encoder: another one may give other bytes."""

_IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_BLOCK_TEXELS, _BLOCK_BYTES = 4, 16  # along a side of a block, and its size as BC7 or ASTC: the largest
_LONGEST_SECONDS = 600.0  # 2,048² takes 30 s; a machine may be twenty times as busy

Encode = Callable[[Bytes, Tick], bytes]
"""A picture (side,side,3) uint8 sRGB -> a KTX2 file. The tick hears all the while."""


class Ktx2Error(EdgeError):
    """No KTX2 came of a picture."""

    def __init__(self, why: str) -> None:
        super().__init__("KTX2_FAILED", why, hints=("ask for the target without -ktx2: its textures are JPEG",))


def unavailable(why: str) -> EdgeError:
    """What a worker says to who asks for KTX2 where none can be written."""
    install = f"`npm install --prefix FOLDER ktx2-encoder@{VERSION}`, and EDGE_KTX2=FOLDER for the worker"
    hint = f"ask for the target without -ktx2, or give the worker an encoder: Node, {install}"
    return EdgeError("KTX2_UNAVAILABLE", f"no KTX2 can be written here: {why}", hints=(hint,))


@dataclass(frozen=True, slots=True)
class Ktx2Encoder:
    """An `Encode`. node: the program; package: folder of npm's ktx2-encoder."""

    node: Path
    package: Path

    @classmethod
    def at(cls, folder: Path) -> Ktx2Encoder:
        """The one that npm has installed below a folder. Raises EdgeError KTX2_UNAVAILABLE."""
        node, package = shutil.which("node"), folder.absolute() / "node_modules" / "ktx2-encoder"
        if node is None:
            raise unavailable("there is no program `node` on the PATH")
        try:
            version = json.loads((package / "package.json").read_text(encoding="utf-8"))["version"]
        except (OSError, ValueError, KeyError):
            raise unavailable(f"npm has not installed ktx2-encoder in {folder}") from None
        if version != VERSION:
            raise unavailable(f"{folder} has ktx2-encoder {version} rather than {VERSION}")
        return cls(Path(node), package)

    def __call__(self, picture: Bytes, tick: Tick = no_tick, *, most_seconds: float = _LONGEST_SECONDS) -> bytes:
        """With all mips; equal pictures give equal bytes. When `tick` raises, the process ends at once.

        Raises Ktx2Error where nothing comes of it within `most_seconds`.
        """
        program, (height, width, _) = Path(__file__).with_name("ktx2_child.mjs"), picture.shape
        opaque = np.concatenate([picture, np.full_like(picture[..., :1], 255)], axis=2)
        try:
            with tempfile.TemporaryDirectory(prefix="ktx2-") as name:
                folder = Path(name)
                (folder / "picture.rgba").write_bytes(opaque.tobytes())
                command = (self.node, program, self.package, folder, str(width), str(height))
                run_child(command, "ktx2-encoder", folder / "log", tick, most_seconds)
                return (folder / "picture.ktx2").read_bytes()
        except ChildError as error:
            raise Ktx2Error(str(error)) from None
        except OSError as error:  # a full disk, no process to be had
            raise Ktx2Error(f"ktx2-encoder could not be run: {error.strerror or error}") from None


@dataclass(frozen=True, slots=True)
class Ktx2Header:
    """What a KTX2 file says of itself (Khronos, KTX 2.0, section 3).

    vk_format         0: neither Vulkan's nor any card's, to be turned into one that a card knows
    supercompression  0 none, 1 BasisLZ (ETC1S), 2 Zstandard
    """

    vk_format: int
    width: int
    height: int
    levels: int
    supercompression: int

    @classmethod
    def of(cls, ktx2: bytes) -> Ktx2Header:
        """Raises ValueError for what is none."""
        if ktx2[:12] != _IDENTIFIER or len(ktx2) < 48:
            raise ValueError("that is no KTX2 file")
        vk_format, _, width, height, _, _, _, levels, supercompression = struct.unpack_from("<9I", ktx2, 12)
        return cls(vk_format, width, height, levels, supercompression)

    @property
    def device_bytes(self) -> int:
        """On a card, as blocks of a byte a texel, mips included. Some cards take half of it."""
        total = 0
        for level in range(max(self.levels, 1)):
            across, down = (-(-max(side >> level, 1) // _BLOCK_TEXELS) for side in (self.width, self.height))
            total += _BLOCK_BYTES * across * down
        return total
