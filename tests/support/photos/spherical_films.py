"""Videos of all sides: the box in which cameras say so, added to a video whose index comes last."""

from __future__ import annotations

import struct
from pathlib import Path

UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")
XML = (
    b'<?xml version="1.0"?><rdf:SphericalVideo xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" '
    b'xmlns:GSpherical="http://ns.google.com/videos/1.0/spherical/"><GSpherical:Spherical>true</GSpherical:Spherical>'
    b"<GSpherical:Stitched>true</GSpherical:Stitched><GSpherical:StitchingSoftware>Jane's camera, at home"
    b"</GSpherical:StitchingSoftware><GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>"
    b"%s</rdf:SphericalVideo>"
)


def spherical(path: Path, stereo: str = "") -> Path:
    """Say of an mp4 that it shows all sides; stereo: left-right or top-bottom."""
    data = bytearray(path.read_bytes())
    mode = f"<GSpherical:StereoMode>{stereo}</GSpherical:StereoMode>".encode() if stereo else b""
    content = UUID + XML % mode
    box = struct.pack(">I4s", 8 + len(content), b"uuid") + content
    moov, trak = data.rindex(b"moov") - 4, data.rindex(b"trak") - 4
    assert data.find(b"mdat") < moov, "offsets of samples would change"
    end = trak + struct.unpack_from(">I", data, trak)[0]
    for at in (moov, trak):
        struct.pack_into(">I", data, at, struct.unpack_from(">I", data, at)[0] + len(box))
    data[end:end] = box
    path.write_bytes(data)
    return path
