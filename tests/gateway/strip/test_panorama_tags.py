"""Of a panorama's XMP and a 360° video's XML the projection stays, and nothing that its writer could say of himself."""

from __future__ import annotations

import io

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from capture2vr.gateway.strip import jpeg, mp4
from capture2vr.gateway.strip.panorama_tags import XMP_OF_PICTURES, projection_of_picture, projection_of_video
from tests.support.photos.spherical_films import XML, spherical

XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    b'<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"><dc:creator>Jane Doe'
    b"</dc:creator><GPano:ProjectionType>equirectangular</GPano:ProjectionType><GPano:UsePanoramaViewer>True"
    b"</GPano:UsePanoramaViewer><GPano:FullPanoWidthPixels>6000</GPano:FullPanoWidthPixels>"
    b"<GPano:CroppedAreaTopPixels>17</GPano:CroppedAreaTopPixels><GPano:PoseHeadingDegrees>81.5"
    b"</GPano:PoseHeadingDegrees><exif:GPSLatitude>48,8.5N</exif:GPSLatitude></rdf:Description></rdf:RDF></x:xmpmeta>"
)


def test_a_picture_keeps_its_projection_alone() -> None:
    stream = io.BytesIO()
    Image.fromarray(np.zeros((8, 16, 3), np.uint8)).save(stream, "JPEG", xmp=XMP)
    data = bytearray(stream.getvalue())
    assert jpeg.clean(data).removed == ("XMP",)
    assert b'GPano:FullPanoWidthPixels="6000" GPano:CroppedAreaTopPixels="17"/>' in data
    assert b'GPano:ProjectionType="equirectangular"' in data
    assert not any(secret in data for secret in (b"Jane", b"48,8", b"81.5"))
    assert len(data) == len(stream.getvalue())
    assert jpeg.clean(data).removed == (), "the second time there is nothing left"


@pytest.mark.parametrize("stereo", ["", "top-bottom"])
def test_a_video_keeps_its_projection_alone(stereo: str, tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as target:
        stream = target.add_stream("mpeg4", rate=30)
        stream.width, stream.height = 64, 32
        target.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 64, 3), np.uint8), format="rgb24")))
        target.mux(stream.encode())
    data = bytearray(spherical(path, stereo).read_bytes())
    assert "SphericalVideo" in mp4.clean(data).removed
    assert b"Jane" not in data
    path.write_bytes(data)
    with av.open(str(path)) as source:
        kinds = {each.type.name for each in next(source.decode(video=0)).side_data}
    assert kinds >= ({"SPHERICAL", "STEREO3D"} if stereo else {"SPHERICAL"})
    assert mp4.clean(data).removed == ()


@given(st.binary(max_size=300), st.integers(0, 400), st.booleans())
def test_what_is_kept_is_as_long_and_is_kept_again(noise: bytes, at: int, video: bool) -> None:
    whole = XML % b"" if video else XMP_OF_PICTURES + XMP
    keep = projection_of_video if video else projection_of_picture
    block = whole[:at] + noise + whole[at:]
    kept = keep(block)
    assert len(kept) in (0, len(block))
    assert keep(kept) == kept
    foreign = {*range(256)} - {*keep(whole), *b"-+.0123456789"}
    assert not foreign & {*kept}, "no byte of what is not known"
