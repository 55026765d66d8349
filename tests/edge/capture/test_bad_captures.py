"""Hostile and broken captures: each gets its own code, the file and the reason, never a traceback."""

from __future__ import annotations

import io
import json
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.ExifTags import IFD, Base

from capture2vr.edge.capture.images import MAX_PIXELS, header_size
from capture2vr.edge.errors import CaptureError
from capture2vr.edge.read_capture import read_capture
from tests.support import captures
from tests.support.gltf_files import posed_glb

XYZ, RGB, NORMALS = captures.sphere()
LINE = np.outer(np.linspace(0, 1, 300), [1.0, 2.0, 3.0]).astype(np.float32)


def png_header(width: int, height: int) -> bytes:
    """A PNG that claims a size and holds next to nothing."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return head + b"\0\0\0\0IEND\xaeB`\x82"


def las_bytes(suffix: str) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"scan{suffix}"
        captures.save_las(path, XYZ, RGB)
        return path.read_bytes()


def hemisphere_bytes(kind: str) -> bytes:
    return captures.as_bytes(captures.hemisphere().export(file_type=kind))


def coloured_glb() -> bytes:
    """A mesh with everything that is rewritten: normalised positions, vertex colours, and a texture's transform."""
    mesh = captures.hemisphere()
    transform = {"KHR_texture_transform": {"offset": [0.1, 0.2], "rotation": 0.3, "scale": [2, 3]}}
    return captures.glb_bytes(
        {
            "POSITION": np.rint(mesh.vertices * 32767).astype(np.int16),
            "TEXCOORD_0": np.rint(255 * np.abs(mesh.vertices[:, :2])).astype(np.uint8),
            "COLOR_0": np.full((len(mesh.vertices), 4), 128, np.uint8),
        },
        mesh.faces,
        normalised=("POSITION", "TEXCOORD_0", "COLOR_0"),
        material={"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": transform}}},
        picture=np.full((4, 4, 3), 200, np.uint8),
        required=("KHR_mesh_quantization", "KHR_texture_transform"),
    )


def old_laz() -> bytes:
    """Compressed point by point, as LASzip's record says: its user id, then 50 bytes, then the compressor."""
    data = bytearray(las_bytes(".laz"))
    at = data.index(b"laszip encoded") + 52
    data[at : at + 2] = b"\1\0"
    return bytes(data)


def hostile_laz() -> bytes:
    """A chunk table that makes the decoder allocate 32 GiB, at which it ends its process."""
    data = bytearray(las_bytes(".laz"))
    (offset,) = struct.unpack_from("<I", data, 96)
    (table,) = struct.unpack_from("<q", data, offset)
    struct.pack_into("<I", data, table + 4, 2**31 - 1)
    return bytes(data)


def broken_npy(header: str) -> bytes:
    text = header.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def ply_claiming(vertices: str) -> bytes:
    return captures.ply_bytes(XYZ).replace(b"vertex 500", f"vertex {vertices}".encode())


SINGLE: dict[str, tuple[str, str, Callable[[], bytes]]] = {
    "empty file": ("CAPTURE_EMPTY", "scan.ply", lambda: b""),
    "text called .ply": ("CAPTURE_UNREADABLE", "scan.ply", lambda: b"Dear reader,\nthis is a letter.\n"),
    "text called .las": ("CAPTURE_UNREADABLE", "scan.las", lambda: b"Dear reader,\nthis is a letter.\n"),
    "a letter": ("CAPTURE_UNKNOWN_FORMAT", "letter.txt", lambda: b"Dear reader,\nthis is a letter.\n"),
    "a photo": ("IMAGE_UNREADABLE", "IMG_1.JPG", lambda: b"\xff\xd8\xff\xe0" + b"\0" * 64),
    "a zip": ("CAPTURE_UNKNOWN_FORMAT", "scan.zip", lambda: b"PK\x03\x04" + b"\0" * 64),
    "a USDZ": ("CAPTURE_UNKNOWN_FORMAT", "shoe.usdz", lambda: b"PK\x03\x04" + b"\0" * 64),
    "cut PLY": ("CAPTURE_TRUNCATED", "scan.ply", lambda: captures.ply_bytes(XYZ, RGB)[:-100]),
    "cut ASCII PLY": ("CAPTURE_TRUNCATED", "scan.ply", lambda: captures.ply_bytes(XYZ, form="ascii")[:-400]),
    "PLY cut in its header": ("CAPTURE_TRUNCATED", "scan.ply", lambda: captures.ply_bytes(XYZ)[:60]),
    "PLY of 10^12 points": ("CAPTURE_TRUNCATED", "scan.ply", lambda: ply_claiming("1000000000000")),
    "PLY of -1 points": ("CAPTURE_UNREADABLE", "scan.ply", lambda: ply_claiming("-1")),
    "PLY of many points": ("CAPTURE_UNREADABLE", "scan.ply", lambda: ply_claiming("many")),
    "PLY of 10^5000 points": ("CAPTURE_UNREADABLE", "scan.ply", lambda: ply_claiming("1" + "0" * 5000)),
    "PLY without x": (
        "CAPTURE_UNREADABLE",
        "scan.ply",
        lambda: captures.ply_bytes(XYZ).replace(b"float x", b"float q"),
    ),
    "PLY of no points": ("CAPTURE_TOO_FEW_POINTS", "scan.ply", lambda: captures.ply_bytes(XYZ[:0])),
    "cut PCD": ("CAPTURE_TRUNCATED", "scan.pcd", lambda: captures.pcd_bytes(XYZ, RGB, NORMALS)[:-50]),
    "cut LZF PCD": (
        "CAPTURE_TRUNCATED",
        "scan.pcd",
        lambda: captures.pcd_bytes(XYZ, RGB, NORMALS, form="binary_compressed")[:-50],
    ),
    "PCD of 10^15 points": (
        "CAPTURE_TRUNCATED",
        "scan.pcd",
        lambda: captures.pcd_bytes(XYZ, RGB, NORMALS).replace(b"POINTS 500", b"POINTS 1000000000000000"),
    ),
    "cut LAS": ("CAPTURE_TRUNCATED", "scan.las", lambda: las_bytes(".las")[:-50]),
    "cut LAZ": ("CAPTURE_TRUNCATED", "scan.laz", lambda: las_bytes(".laz")[:-200]),
    "LAZ of before 2011": ("CAPTURE_UNREADABLE", "scan.laz", old_laz),
    "LAZ of 2^31 chunks": ("CAPTURE_UNREADABLE", "scan.laz", hostile_laz),
    "LAS header alone": ("CAPTURE_TRUNCATED", "scan.las", lambda: las_bytes(".las")[:100]),
    "cut npy": ("CAPTURE_TRUNCATED", "scan.npy", lambda: captures.npy_bytes(XYZ)[:-4]),
    "npy of 10^12 points": (
        "CAPTURE_TRUNCATED",
        "scan.npy",
        lambda: broken_npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 3)}"),
    ),
    "pickled npy": ("CAPTURE_UNREADABLE", "scan.npy", lambda: captures.npy_bytes(np.array([{"a": 1}] * 300, object))),
    "a pickle": ("CAPTURE_UNREADABLE", "scan.npy", lambda: pickle.dumps(XYZ)),
    "npy of text": ("CAPTURE_UNREADABLE", "scan.npy", lambda: captures.npy_bytes(np.array(["one", "two"]))),
    "npy of a vector": ("CAPTURE_UNREADABLE", "scan.npy", lambda: captures.npy_bytes(np.arange(300.0))),
    "NaN": ("CAPTURE_NOT_FINITE", "scan.ply", lambda: captures.ply_bytes(XYZ * np.nan)),
    "1e30": ("CAPTURE_NOT_FINITE", "scan.ply", lambda: captures.ply_bytes(XYZ * np.float32(1e30))),
    "12 points": ("CAPTURE_TOO_FEW_POINTS", "scan.ply", lambda: captures.ply_bytes(XYZ[:12])),
    "12 points, repeated": (
        "CAPTURE_TOO_FEW_POINTS",
        "scan.ply",
        lambda: captures.ply_bytes(np.tile(XYZ[:12], (5000, 1))),
    ),
    "all points equal": ("CAPTURE_DEGENERATE", "scan.ply", lambda: captures.ply_bytes(np.tile(XYZ[:1], (300, 1)))),
    "a million times one point": (
        "CAPTURE_DEGENERATE",
        "scan.ply",
        lambda: captures.ply_bytes(np.tile(XYZ[:1], (1_000_000, 1))),
    ),
    "a line": ("CAPTURE_DEGENERATE", "scan.ply", lambda: captures.ply_bytes(LINE)),
    "OBJ of 12 vertices": (
        "CAPTURE_TOO_FEW_POINTS",
        "scan.obj",
        lambda: b"".join(b"v %d 0 1\n" % index for index in range(12)),
    ),
    "OBJ with a face of vertices that are not there": ("CAPTURE_UNREADABLE", "a.obj", lambda: b"v 0 0 0\nf 1 2 3\n"),
    "OFF of 10^12": ("CAPTURE_TRUNCATED", "a.off", lambda: b"OFF\n1000000000000 3 0\n0 0 0\n"),
    "cut GLB": ("CAPTURE_TRUNCATED", "a.glb", lambda: hemisphere_bytes("glb")[:-100]),
    "glTF without its buffer": (
        "CAPTURE_UNREADABLE",
        "a.gltf",
        lambda: b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "gone.bin", "byteLength": 9}]}',
    ),
    "glTF that reaches outside": (
        "CAPTURE_UNREADABLE",
        "a.gltf",
        lambda: b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "../../etc/passwd", "byteLength": 9}]}',
    ),
    "glTF of 10^12 zeros": (
        "CAPTURE_TOO_LARGE",
        "a.gltf",
        lambda: b'{"asset": {"version": "2.0"}, "accessors": [{"count": 1000000000000, "type": "VEC3"}]}',
    ),
    "GLB whose colours reach past its buffer": (
        "CAPTURE_UNREADABLE",
        "a.glb",
        lambda: coloured_glb().replace(b'"count": 642, "componentType": 5121', b'"count": 643, "componentType": 5121'),
    ),
    "GLB cut in its second chunk": (
        "CAPTURE_TRUNCATED",
        "a.glb",
        lambda: captures.glb_of({"asset": {"version": "2.0"}}, b"")[:-8] + struct.pack("<I4s", 900, b"BIN\0"),
    ),
    "GLB with colours of two numbers": (
        "CAPTURE_UNREADABLE",
        "a.glb",
        lambda: captures.glb_bytes(
            {"POSITION": np.eye(3, dtype=np.float32), "COLOR_0": np.ones((3, 2), np.float32)}, np.array([[0, 1, 2]])
        ),
    ),
    "rows of infinity": ("CAPTURE_NOT_FINITE", "a.xyz", lambda: b"1e400 2 3\n" * 300),
    "columns of other names": ("CAPTURE_UNREADABLE", "a.csv", lambda: b"time,a,b,c\n" + b"1,2,3,4\n" * 300),
}  # fmt: skip


@pytest.mark.parametrize("name", SINGLE)
def test_a_bad_file_has_its_code(name: str, tmp_path: Path) -> None:
    code, file, make = SINGLE[name]
    (tmp_path / file).write_bytes(make())
    for place in (tmp_path, tmp_path / file):
        with pytest.raises(CaptureError) as caught:
            read_capture(place)
        assert (caught.value.code, caught.value.file) == (code, file)
        assert caught.value.message
        assert all(caught.value.hints)
        assert caught.value.hints
        assert not caught.value.retryable


@pytest.mark.parametrize("model", ["shoe.fbx", "shoe.usdc", "Shoe.DAE"])
def test_the_textures_of_a_model_that_is_not_read_are_no_photos(model: str, tmp_path: Path) -> None:
    (tmp_path / model).write_bytes(b"Kaydara FBX Binary  \0")
    for number in range(4):
        Image.fromarray(np.full((64, 64, 3), 40 * number, np.uint8)).save(tmp_path / f"texture_{number}.png")
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path)
    assert (caught.value.code, caught.value.file) == ("CAPTURE_UNKNOWN_FORMAT", model)
    assert "GLB" in caught.value.hints[0]
    exif = Image.Exif()
    exif.get_ifd(IFD.Exif)[Base.FocalLengthIn35mmFilm] = 26
    for number in range(4):
        Image.new("RGB", (64, 64)).save(tmp_path / f"IMG_{number}.jpg", exif=exif)
    assert read_capture(tmp_path).kind == "photos", "photos beside the model that an app made of them"


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path)
    assert caught.value.code == "CAPTURE_EMPTY"


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path / "gone")
    assert caught.value.code == "CAPTURE_EMPTY"


def edit_json(path: Path, change: Callable[[dict], object]) -> None:
    tree = json.loads(path.read_text())
    change(tree)
    path.write_text(json.dumps(tree))


def nerf(change: Callable[[dict], object]) -> Callable[[Path], None]:
    return lambda folder: edit_json(folder / "transforms.json", change)


def photos_of(change: Callable[[dict], object]) -> Callable[[Path], None]:
    """The same without depth."""
    return nerf(lambda tree: [change(tree), *(frame.pop("depth_file_path") for frame in tree["frames"])])


def set_pose(entry: object) -> Callable[[dict], object]:
    def change(tree: dict) -> None:
        for frame in tree["frames"]:
            frame["transform_matrix"] = entry

    return change


def write(name: str, data: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(data)


def cut(name: str, keep: int) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:keep])


def remove(*names: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for name in names:
            (folder / name).unlink()

    return change


def escape(written: str) -> Callable[[Path], None]:
    return nerf(lambda tree: tree["frames"][1].update(depth_file_path=written))


MIRROR = np.diag([-1.0, 1, 1, 1]).tolist()
SCALED = np.diag([2.0, 2, 2, 1]).tolist()
ALL_DEPTH = [f"depth/{index}.png" for index in range(4)]

RECORDINGS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "empty trajectory": ("open3d", "CAPTURE_NO_POSES", write("trajectory.log", b"\n")),
    "cut trajectory": ("open3d", "CAPTURE_TRUNCATED", write("trajectory.log", b"0 0 1\n1 0 0 0\n0 1 0 0\n")),
    "a trajectory of words": ("open3d", "CAPTURE_UNREADABLE", write("trajectory.log", b"a b c d\n" * 20)),
    "a depth image too few": ("open3d", "CAPTURE_COUNT_MISMATCH", remove("depth/00002.png")),
    "a colour image too few": ("open3d", "CAPTURE_COUNT_MISMATCH", remove("color/00002.jpg")),
    "no focal length": (
        "open3d",
        "CAPTURE_BAD_INTRINSICS",
        lambda folder: edit_json(folder / "camera.json", lambda tree: tree.update(intrinsic_matrix=[0] * 9)),
    ),
    "a camera of another shape": (
        "open3d",
        "CAPTURE_BAD_INTRINSICS",
        lambda folder: edit_json(folder / "camera.json", lambda tree: tree.update(width=1000)),
    ),
    "a gigantic depth image": ("open3d", "IMAGE_TOO_LARGE", write("depth/00001.png", png_header(60_000, 60_000))),
    "half of the depth cut": (
        "open3d",
        "IMAGE_UNREADABLE",
        lambda folder: [cut(f"depth/0000{index}.png", 200)(folder) for index in (0, 1)],
    ),
    "a depth image of text": ("open3d", "IMAGE_UNREADABLE", write("depth/00000.png", b"not a picture")),
    "the last of two depth images broken": (
        "open3d",
        "IMAGE_UNREADABLE",
        lambda folder: [
            remove(
                *(
                    f"{kind}/0000{index}{end}"
                    for kind, end in (("depth", ".png"), ("color", ".jpg"))
                    for index in (2, 3)
                )
            )(folder),
            write("trajectory.log", b"\n".join((folder / "trajectory.log").read_bytes().splitlines()[:10]))(folder),
            write("depth/00001.png", png_header(captures.WIDTH, captures.HEIGHT))(folder),
        ],
    ),
    "a header without pixels": ("open3d", "IMAGE_UNREADABLE", write("depth/00000.png", png_header(64, 48))),
    "depth that is black": (
        "open3d",
        "CAPTURE_EMPTY",
        lambda folder: [
            captures.save_png(folder / f"depth/0000{index}.png", np.zeros((48, 64), np.uint16)) for index in range(4)
        ],
    ),
    "a picture of depth": (
        "open3d",
        "IMAGE_UNREADABLE",
        lambda folder: captures.save_png(folder / "depth/00000.png", np.ones((48, 64), np.uint8)),
    ),
    "depth of two sizes": (
        "open3d",
        "CAPTURE_BAD_INTRINSICS",
        lambda folder: captures.save_png(folder / "depth/00002.png", np.ones((24, 32), np.uint16)),
    ),
    "seven columns": ("tum", "CAPTURE_UNREADABLE", write("groundtruth.txt", b"1 2 3 4 5 6 7\n")),
    "poses of another day": ("tum", "CAPTURE_NO_POSES", write("groundtruth.txt", b"5 0 0 0 0 0 0 1\n")),
    "a quaternion of length 0": ("tum", "CAPTURE_BAD_POSE", write("groundtruth.txt", b"1305031102 0 0 0 0 0 0 0\n")),
    "NaN pose": ("nerfstudio", "CAPTURE_BAD_POSE", nerf(set_pose(np.full((4, 4), np.nan).tolist()))),
    "one NaN pose": (
        "nerfstudio",
        "CAPTURE_BAD_POSE",
        nerf(lambda tree: tree["frames"][0]["transform_matrix"][0].__setitem__(3, float("nan"))),
    ),
    "mirroring pose": ("nerfstudio", "CAPTURE_BAD_POSE", nerf(set_pose(MIRROR))),
    "scaled pose": ("nerfstudio", "CAPTURE_BAD_POSE", nerf(set_pose(SCALED))),
    "pose of words": ("nerfstudio", "CAPTURE_UNREADABLE", nerf(set_pose("left"))),
    "pose of three numbers": ("nerfstudio", "CAPTURE_UNREADABLE", nerf(set_pose([1, 2, 3]))),
    "focal length 0": ("nerfstudio", "CAPTURE_BAD_INTRINSICS", nerf(lambda tree: tree.update(fl_x=0))),
    "focal length of 400 digits": ("nerfstudio", "CAPTURE_UNREADABLE", nerf(lambda tree: tree.update(fl_x=10**400))),
    "fisheye": ("nerfstudio", "CAPTURE_BAD_INTRINSICS", nerf(lambda tree: tree.update(camera_model="OPENCV_FISHEYE"))),
    "no focal length at all": (
        "nerfstudio",
        "CAPTURE_BAD_INTRINSICS",
        nerf(lambda tree: [tree.pop("fl_x"), tree.pop("fl_y")]),
    ),
    "a depth unit of 0": ("nerfstudio", "CAPTURE_UNREADABLE", nerf(lambda tree: tree.update(integer_depth_scale=0))),
    "no frames": ("nerfstudio", "CAPTURE_EMPTY", nerf(lambda tree: tree.update(frames=[]))),
    "frames of words": ("nerfstudio", "CAPTURE_UNREADABLE", nerf(lambda tree: tree.update(frames=["a"]))),
    "images missing, without depth": (
        "nerfstudio",
        "CAPTURE_COUNT_MISMATCH",
        photos_of(lambda tree: [frame.update(file_path="gone.jpg") for frame in tree["frames"]]),
    ),
    "mirrored photos without depth": ("nerfstudio", "CAPTURE_BAD_POSE", photos_of(set_pose(MIRROR))),
    "NaN poses without depth": (
        "nerfstudio",
        "CAPTURE_BAD_POSE",
        photos_of(set_pose(np.full((4, 4), np.nan).tolist())),
    ),
    "focal length 0 without depth": (
        "nerfstudio",
        "CAPTURE_BAD_INTRINSICS",
        photos_of(lambda tree: tree.update(fl_x=0)),
    ),
    "NaN distortion without depth": (
        "nerfstudio",
        "CAPTURE_BAD_INTRINSICS",
        photos_of(lambda tree: tree.update(k1=float("nan"))),
    ),
    "all depth missing": ("nerfstudio", "CAPTURE_COUNT_MISMATCH", remove(*ALL_DEPTH)),
    "not JSON": ("nerfstudio", "CAPTURE_UNREADABLE", write("transforms.json", b"{")),
    "deep JSON": ("nerfstudio", "CAPTURE_UNREADABLE", write("transforms.json", b'{"a":' * 100_000)),
    "path upward": ("nerfstudio", "CAPTURE_UNREADABLE", escape("../../etc/passwd")),
    "hidden path upward": ("nerfstudio", "CAPTURE_UNREADABLE", escape("depth/../../secret.png")),
    "absolute path": ("nerfstudio", "CAPTURE_UNREADABLE", escape("/etc/passwd")),
    "Windows path": ("nerfstudio", "CAPTURE_UNREADABLE", escape("C:\\secret.png")),
    "Windows path upward": ("nerfstudio", "CAPTURE_UNREADABLE", escape("..\\secret.png")),
    "Record3D without poses": (
        "record3d",
        "CAPTURE_NO_POSES",
        lambda folder: edit_json(folder / "metadata", lambda tree: tree.update(poses=[])),
    ),
    "Record3D with half of the poses": (
        "record3d",
        "CAPTURE_COUNT_MISMATCH",
        lambda folder: edit_json(folder / "metadata", lambda tree: tree.update(poses=tree["poses"][:2])),
    ),
    "Record3D of another size": (
        "record3d",
        "IMAGE_UNREADABLE",
        lambda folder: edit_json(folder / "metadata", lambda tree: tree.update(dw=128, dh=96)),
    ),
    "Record3D with gigantic depth": (
        "record3d",
        "IMAGE_TOO_LARGE",
        lambda folder: edit_json(folder / "metadata", lambda tree: tree.update(dw=60_000, dh=60_000)),
    ),
    "broken LZFSE": ("record3d", "IMAGE_UNREADABLE", write("rgbd/0.depth", b"bvx2 is not what follows")),
    "Stray with a broken video": ("stray", "CAPTURE_UNREADABLE", write("rgb.mp4", b"no video at all")),
    "Stray without its matrix": ("stray", "CAPTURE_BAD_INTRINSICS", remove("camera_matrix.csv")),
    "Stray with frames named by words": ("stray", "CAPTURE_UNREADABLE", write("depth/first.png", b"")),
    "Polycam without a number": (
        "polycam",
        "CAPTURE_UNREADABLE",
        lambda folder: [edit_json(path, lambda tree: tree.pop("fx")) for path in folder.rglob("17*.json")],
    ),
    "DEPTH16 of an odd size": ("depth16", "CAPTURE_TRUNCATED", cut("00000000_depth16.bin", 1000)),
    "empty DEPTH16": ("depth16", "CAPTURE_TRUNCATED", cut("00000000_depth16.bin", 0)),
    "poses of other frames": ("depth16", "CAPTURE_NO_POSES", write("poses.csv", b"frame,tx\nother,1\n")),
    "a header and no poses": ("depth16", "CAPTURE_NO_POSES", write("poses.csv", b"frame,tx\n")),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_bad_recording_has_its_code(name: str, tmp_path: Path) -> None:
    kind, code, spoil = RECORDINGS[name]
    folder = captures.RGBD[kind](tmp_path)
    spoil(folder)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert caught.value.code == code
    assert caught.value.message
    assert caught.value.hints


def spoil_one(frame: dict) -> None:
    frame["transform_matrix"] = MIRROR


def lose_one(frame: dict) -> None:
    frame["file_path"] = "images/gone.jpg"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [(spoil_one, "images/2.jpg: has a camera pose that is mirrored"), (lose_one, "1 images missing: images/gone.jpg")],
)
def test_one_bad_photo_among_posed_ones_is_a_warning(spoil: Callable[[dict], None], says: str, tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    photos_of(lambda tree: spoil(tree["frames"][2]))(folder)
    capture = read_capture(folder)
    assert (capture.kind, len(capture.photos)) == ("photos", 3)
    assert says in capture.warnings[0]


def test_mirrored_axes_say_what_to_do(tmp_path: Path) -> None:
    folder = captures.write_nerfstudio(tmp_path)
    nerf(set_pose(MIRROR))(folder)
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    assert "right-handed" in caught.value.hints[0]


def test_an_unpacking_bomb_in_an_r3d_is_refused(tmp_path: Path) -> None:
    """A gigabyte of zeros in a megabyte of zip is refused by the entry's size, before a byte is unpacked."""
    archive = captures.write_r3d(tmp_path)
    meta = json.loads((tmp_path / "inside/metadata").read_text())
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as target:
        target.writestr("metadata", json.dumps(meta | {"poses": meta["poses"][:1]}))
        with target.open("rgbd/0.depth", "w") as entry:
            for _ in range(100):
                entry.write(b"\0" * 2**20)
    with pytest.raises(CaptureError) as caught:
        read_capture(archive)
    assert caught.value.code == "CAPTURE_TOO_LARGE"


def test_links_out_of_the_folder_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "secret.ply").write_bytes(captures.ply_bytes(XYZ))
    inside = tmp_path / "capture"
    inside.mkdir()
    (inside / "scan.ply").symlink_to(tmp_path / "secret.ply")
    (inside / "more").symlink_to(tmp_path)
    with pytest.raises(CaptureError) as caught:
        read_capture(inside)
    assert caught.value.code == "CAPTURE_EMPTY"


@pytest.mark.parametrize(
    ("texture", "code"), [("huge.png", "IMAGE_TOO_LARGE"), ("../../etc/passwd", "CAPTURE_UNREADABLE")]
)
def test_textures_are_judged_before_they_are_opened(texture: str, code: str, tmp_path: Path) -> None:
    (tmp_path / "huge.png").write_bytes(png_header(60_000, 60_000))
    (tmp_path / "a.mtl").write_text(f"newmtl paint\nmap_Kd {texture}\n")
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl paint\nf 1/1 2/2 3/3\n"
    (tmp_path / "a.obj").write_text("mtllib a.mtl\n" + faces)
    with pytest.raises(CaptureError) as caught:
        read_capture(tmp_path)
    assert caught.value.code == code


def test_the_pixel_limit_is_read_from_the_header() -> None:
    assert header_size(png_header(60_000, 60_000)) == (60_000, 60_000)
    assert MAX_PIXELS < 60_000 * 60_000


VALID = {
    "ply": captures.ply_bytes(XYZ, RGB, NORMALS),
    "ply ascii": captures.ply_bytes(XYZ, RGB, form="ascii"),
    "splat ply": captures.splat_ply_bytes(XYZ, RGB, np.full(len(XYZ), 0.9)),
    "mesh ply": hemisphere_bytes("ply"),
    "pcd": captures.pcd_bytes(XYZ, RGB, NORMALS),
    "pcd lzf": captures.pcd_bytes(XYZ, RGB, NORMALS, form="binary_compressed"),
    "npy": captures.npy_bytes(XYZ),
    "las": las_bytes(".las"),
    "xyz": b"".join(b"%f %f %f\n" % tuple(row) for row in XYZ.tolist()),
    "obj": hemisphere_bytes("obj"),
    "off": hemisphere_bytes("off"),
    "stl": hemisphere_bytes("stl"),
    "glb": hemisphere_bytes("glb"),
    "coloured glb": coloured_glb(),
}


def reads_or_names(folder: Path) -> None:
    try:
        capture = read_capture(folder)
    except CaptureError:
        return
    if capture.cloud is not None:
        assert np.isfinite(capture.cloud.xyz).all()


@pytest.mark.slow
@given(data=st.data(), kind=st.sampled_from(sorted(VALID)))
@settings(max_examples=250)
def test_damaged_clouds_are_read_or_named(data: st.DataObject, kind: str) -> None:
    """Truncations, overwritten bytes, and inserted bytes of valid files raise nothing but CaptureError."""
    valid = VALID[kind]
    damaged = bytearray(valid[: data.draw(st.integers(0, len(valid)))] if data.draw(st.booleans()) else valid)
    for _ in range(data.draw(st.integers(0, 8))):
        at = data.draw(st.integers(0, min(len(damaged), 600)))  # headers matter most
        damaged[at : at + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    with TemporaryDirectory() as folder:
        (Path(folder) / "scan").write_bytes(bytes(damaged))
        reads_or_names(Path(folder))


@given(
    data=st.binary(max_size=400), magic=st.sampled_from([b"", b"ply\n", b"LASF", b"glTF", b"\x93NUMPY", b"OFF\n", b"{"])
)
@settings(max_examples=200)
def test_random_bytes_are_named(data: bytes, magic: bytes) -> None:
    with TemporaryDirectory() as folder:
        (Path(folder) / "scan").write_bytes(magic + data)
        reads_or_names(Path(folder))


@pytest.mark.parametrize("kind", captures.RGBD)
def test_damaged_recordings_are_read_or_named(kind: str, tmp_path: Path) -> None:
    """Thirty kinds of damage to every format: a file cut, emptied, overwritten or taken away."""
    folder = captures.RGBD[kind](tmp_path / "whole")
    files = [folder] if folder.is_file() else sorted(path for path in folder.rglob("*") if path.is_file())
    rng = np.random.default_rng(1)
    for _ in range(30):
        path = files[rng.integers(len(files))]
        whole = path.read_bytes()
        damaged = bytearray(whole[: rng.integers(len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(6)):
            at = rng.integers(len(damaged) + 1)
            damaged[at : at + rng.integers(4)] = rng.bytes(rng.integers(4))
        path.write_bytes(bytes(damaged))
        reads_or_names(folder)
        path.write_bytes(whole)


ODD = (None, "x", "", [], {}, [[]], True, -1, 0, 0.5, 1e308, float("nan"), float("-inf"), 10**400, "../x", ["a"] * 16)


def odd_leaf(tree: object, rng: np.random.Generator) -> object:
    """The tree with one value, at a random depth, replaced by an odd one, or taken away."""
    if isinstance(tree, dict) and tree and rng.random() < 0.9:
        key = list(tree)[rng.integers(len(tree))]
        if rng.random() < 0.1:
            return {name: value for name, value in tree.items() if name != key}
        return tree | {key: odd_leaf(tree[key], rng)}
    if isinstance(tree, list) and tree and rng.random() < 0.9:
        at = int(rng.integers(len(tree)))
        return [*tree[:at], odd_leaf(tree[at], rng), *tree[at + 1 :]]
    return ODD[rng.integers(len(ODD))]


@pytest.mark.parametrize("kind", ["open3d", "tum", "nerfstudio", "record3d", "polycam", "3dscannerapp"])
def test_odd_values_in_metadata_are_read_or_named(kind: str, tmp_path: Path) -> None:
    folder = captures.RGBD[kind](tmp_path)
    files = [*folder.rglob("*.json"), *folder.rglob("metadata")]
    rng = np.random.default_rng(2)
    for _ in range(40):
        path = files[rng.integers(len(files))]
        whole = path.read_text()
        path.write_text(json.dumps(odd_leaf(json.loads(whole), rng)))
        reads_or_names(folder)
        path.write_text(whole)


@pytest.mark.slow
@pytest.mark.parametrize("make", [coloured_glb, posed_glb])
def test_odd_values_in_a_gltf_are_read_or_named(make: Callable[[], bytes], tmp_path: Path) -> None:
    data = make()
    length = int.from_bytes(data[12:16], "little")
    tree, chunk = json.loads(data[20 : 20 + length]), data[28 + length :]
    rng = np.random.default_rng(3)
    for _ in range(150):
        (tmp_path / "scan.glb").write_bytes(captures.glb_of(odd_leaf(tree, rng), chunk))  # type: ignore[arg-type]
        reads_or_names(tmp_path)


def test_npy_fuzz_never_unpickles(tmp_path: Path) -> None:
    """A pickle that would create a file creates none."""

    class Evil:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path.touch, (str(tmp_path / "owned"),))

    buffer = io.BytesIO()
    np.save(buffer, np.array([None] * 300, object))
    (tmp_path / "scan.npy").write_bytes(buffer.getvalue()[:128] + pickle.dumps(Evil()))
    with pytest.raises(CaptureError):
        read_capture(tmp_path / "scan.npy")
    assert not (tmp_path / "owned").exists()
