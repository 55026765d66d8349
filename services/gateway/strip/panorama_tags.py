"""Keep what XMP says of a panorama's projection, and nothing else of it: without that no reader can tell its angles.

Names: Google's "Photo Sphere XMP Metadata" (GPano) of pictures, "Spherical Video V1" (GSpherical) of videos. The facts
are written anew from numbers and known words, so that nothing of persons or places is left; blanks fill the block.
"""

from __future__ import annotations

import re

from capture2vr.order.panorama_names import AREA

_PICTURES = (*AREA, b"PosePitchDegrees", b"PoseRollDegrees")
_NUMBER = rb"""(?:\s*=\s*["']|>)\s*([-+]?\d{1,9}(?:\.\d{1,9})?)\s*["'<]"""
_PROJECTION = re.compile(rb"""GPano:ProjectionType(?:\s*=\s*["']|>)\s*equirectangular\s*["'<]""")
_SPHERICAL = re.compile(rb"<GSpherical:ProjectionType>\s*equirectangular\s*<")
_STEREO = re.compile(rb"<GSpherical:StereoMode>\s*(mono|left-right|top-bottom)\s*<")
XMP_OF_PICTURES = b"http://ns.adobe.com/xap/1.0/\0"
_RDF = b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'


def projection_of_picture(block: bytes) -> bytes:
    """Return a block of XMP of the same length with the facts of a panorama alone; b"" where it has none."""
    if not block.startswith(XMP_OF_PICTURES) or not _PROJECTION.search(block):
        return b""
    found = [(name, re.search(b"GPano:" + name + _NUMBER, block)) for name in _PICTURES]
    facts = b"".join(b' GPano:%s="%s"' % (name, match[1]) for name, match in found if match)
    text = (  # as short as XMP may be, which the block that it replaces cannot fall below
        b'<rdf:RDF %s><rdf:Description xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" '
        b'GPano:ProjectionType="equirectangular"%s/></rdf:RDF>'
    )
    return _filled(XMP_OF_PICTURES + text % (_RDF, facts), len(block))


def projection_of_video(block: bytes) -> bytes:
    """Return a block of XML of the same length with the facts of a video of all sides alone; b"" where it has none."""
    if not _SPHERICAL.search(block):
        return b""
    stereo = _STEREO.search(block)
    mode = b"<GSpherical:StereoMode>%s</GSpherical:StereoMode>" % stereo[1] if stereo else b""
    text = (
        b'<rdf:SphericalVideo %s xmlns:GSpherical="http://ns.google.com/videos/1.0/spherical/">'
        b"<GSpherical:Spherical>true</GSpherical:Spherical><GSpherical:Stitched>true</GSpherical:Stitched>"
        b"<GSpherical:StitchingSoftware>-</GSpherical:StitchingSoftware>"  # without it decoders take it for none
        b"<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>%s</rdf:SphericalVideo>"
    )
    return _filled(text % (_RDF, mode), len(block))


def _filled(text: bytes, size: int) -> bytes:
    return text.ljust(size) if len(text) <= size else b""
