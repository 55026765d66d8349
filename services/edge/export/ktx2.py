"""Encode textures as KTX2, which stay compressed on the graphics card: at most a quarter of a JPEG's memory there.

The encoder is Basis Universal (ETC1S) in WebAssembly, since no Python package has it: npm's ktx2-encoder, run by Node
in a child process. Node and the package are needed for KTX2 only.
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

from capture2vr.edge.arrays import Bytes, Tick, no_tick
from capture2vr.edge.child_process import ChildError, run_child
from capture2vr.edge.errors import EdgeError
from capture2vr.sentences.sentence import say

VERSION = "0.6.0"
"""Version of npm's ktx2-encoder; another version may give other bytes."""

_IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_BLOCK_TEXELS, _BLOCK_BYTES = 4, 16  # texels along a block's side, and bytes of a block as BC7 or ASTC, the largest
_LONGEST_SECONDS = 600.0  # 2,048² takes 30 s; a machine may be twenty times as busy

EncodeKtx2 = Callable[[Bytes, Tick], bytes]
"""Encoder of a texture: image (side,side,3) uint8 sRGB -> bytes of a KTX2 file. The tick is called all the while."""


class Ktx2Error(EdgeError):
    """A texture could not be encoded as KTX2."""

    def __init__(self, why: str) -> None:
        super().__init__("KTX2_FAILED", why, hints=(say("use_target_without_ktx2_textures"),))


def ktx2_unavailable(why: str) -> EdgeError:
    """Make the error for a target that wants KTX2 where there is no encoder."""
    install = f"`npm install --prefix FOLDER ktx2-encoder@{VERSION}`, and set EDGE_KTX2=FOLDER for the worker"
    hint = f"use the target without -ktx2, or install the encoder: Node, {install}"
    return EdgeError("KTX2_UNAVAILABLE", say("textures_cannot_be_encoded", why=why), hints=(hint,))


@dataclass(frozen=True, slots=True)
class Ktx2Encoder:
    """Runs npm's ktx2-encoder as an `EncodeKtx2`. node: path of the program; package: folder of the npm package."""

    node: Path
    package: Path

    @classmethod
    def at(cls, folder: Path) -> Ktx2Encoder:
        """Find the encoder that npm has installed in a folder. Raises EdgeError KTX2_UNAVAILABLE."""
        node, package = shutil.which("node"), folder.absolute() / "node_modules" / "ktx2-encoder"
        if node is None:
            raise ktx2_unavailable("the program `node` is not on the PATH")
        try:
            version = json.loads((package / "package.json").read_text(encoding="utf-8"))["version"]
        except (OSError, ValueError, KeyError):
            raise ktx2_unavailable(f"npm has not installed ktx2-encoder in {folder}") from None
        if version != VERSION:
            raise ktx2_unavailable(f"{folder} has ktx2-encoder {version}, version {VERSION} is needed")
        return cls(Path(node), package)

    def __call__(self, picture: Bytes, tick: Tick = no_tick, *, most_seconds: float = _LONGEST_SECONDS) -> bytes:
        """Encode an image (H,W,3) uint8 sRGB with all mips; equal images give equal bytes.

        Raises Ktx2Error where the encoder fails or takes longer than `most_seconds`. When `tick` raises, the process is
        killed at once.
        """
        program, (height, width, _) = Path(__file__).with_name("ktx2_child.mjs"), picture.shape
        opaque = np.concatenate([picture, np.full_like(picture[..., :1], 255)], axis=2)
        try:
            with tempfile.TemporaryDirectory(prefix="ktx2-") as name:
                folder = Path(name)
                (folder / "picture.rgba").write_bytes(opaque.tobytes())
                command = (self.node, program, self.package, folder, str(width), str(height))
                run_child(command, "ktx2-encoder", folder / "log", tick, most_seconds=most_seconds)
                return (folder / "picture.ktx2").read_bytes()
        except ChildError as error:
            raise Ktx2Error(str(error)) from None
        except OSError as error:  # the disk is full, or no process can be started
            raise Ktx2Error(f"ktx2-encoder could not be run: {error.strerror or error}") from None


@dataclass(frozen=True, slots=True)
class Ktx2Header:
    """Header of a KTX2 file (Khronos, KTX 2.0, section 3).

    vk_format         0: no format of Vulkan, but one that is transcoded to a format of the card
    supercompression  0 none, 1 BasisLZ (ETC1S), 2 Zstandard
    """

    vk_format: int
    width: int
    height: int
    levels: int
    supercompression: int

    @classmethod
    def of(cls, ktx2: bytes) -> Ktx2Header:
        """Read the header of a KTX2 file. Raises ValueError where it is not one."""
        if ktx2[:12] != _IDENTIFIER or len(ktx2) < 48:
            raise ValueError("not a KTX2 file")
        vk_format, _, width, height, _, _, _, levels, supercompression = struct.unpack_from("<9I", ktx2, 12)
        return cls(vk_format, width, height, levels, supercompression)

    @property
    def device_bytes(self) -> int:
        """Bytes on a graphics card, with mips, in a format of one byte per texel. Some cards need only half of it."""
        total = 0
        for level in range(max(self.levels, 1)):
            across, down = (-(-max(side >> level, 1) // _BLOCK_TEXELS) for side in (self.width, self.height))
            total += _BLOCK_BYTES * across * down
        return total
