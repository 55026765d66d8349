"""capture2vr: reconstruct a phone's capture as a 3D asset for VR headsets.

From a point cloud to a mesh:

    import numpy as np
    import capture2vr

    mesh = capture2vr.mesh_from_points(np.load("cloud.npy"))
    mesh.to_trimesh().export("mesh.glb")

From a folder of photos to levels of detail, textures and a certificate:

    made = capture2vr.reconstruct("photos", progress=print)
    made.save("result")

The names in `__all__` are the public ones; everything else may change without notice. They are loaded when they are
first used: importing the package takes milliseconds.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # true for type checkers, which know the name; `typing` itself would be half of what is loaded
if TYPE_CHECKING:
    from capture2vr.client.assets import ListedAsset
    from capture2vr.client.client import Client
    from capture2vr.client.nouns import JobProgress, RemoteJob, StoredCapture, UploadProgress
    from capture2vr.client.pull import PulledAsset, PulledFile
    from capture2vr.edge.capture.nouns import Capture
    from capture2vr.edge.errors import CaptureError, EdgeError
    from capture2vr.edge.mesh.nouns import Mesh
    from capture2vr.edge.progress import Progress
    from capture2vr.errors import BadInput, Capture2vrError, GatewayError, JobFailed, VerificationError
    from capture2vr.library.reconstruct import mesh_from_points, reconstruct
    from capture2vr.library.reconstruction import Reconstruction
    from capture2vr.library.source import read_capture

__version__ = "0.1.0"

__all__ = [
    "BadInput",
    "Capture",
    "Capture2vrError",
    "CaptureError",
    "Client",
    "EdgeError",
    "GatewayError",
    "JobFailed",
    "JobProgress",
    "ListedAsset",
    "Mesh",
    "Progress",
    "PulledAsset",
    "PulledFile",
    "Reconstruction",
    "RemoteJob",
    "StoredCapture",
    "UploadProgress",
    "VerificationError",
    "__version__",
    "mesh_from_points",
    "read_capture",
    "reconstruct",
]

# The module that each public name is loaded from. The imports above say the same to type checkers.
_MODULES = {
    "capture2vr.client.assets": ("ListedAsset",),
    "capture2vr.client.client": ("Client",),
    "capture2vr.client.nouns": ("JobProgress", "RemoteJob", "StoredCapture", "UploadProgress"),
    "capture2vr.client.pull": ("PulledAsset", "PulledFile"),
    "capture2vr.edge.capture.nouns": ("Capture",),
    "capture2vr.edge.errors": ("CaptureError", "EdgeError"),
    "capture2vr.edge.mesh.nouns": ("Mesh",),
    "capture2vr.edge.progress": ("Progress",),
    "capture2vr.errors": ("BadInput", "Capture2vrError", "GatewayError", "JobFailed", "VerificationError"),
    "capture2vr.library.reconstruct": ("mesh_from_points", "reconstruct"),
    "capture2vr.library.reconstruction": ("Reconstruction",),
    "capture2vr.library.source": ("read_capture",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # for a type checker, any name would be one

    def __getattr__(name: str) -> object:
        """Load a public name when it is first used (PEP 562)."""
        if name not in _HOMES:
            raise AttributeError(f"module 'capture2vr' has no attribute '{name}'")
        try:
            value = globals()[name] = getattr(import_module(_HOMES[name]), name)
        except ModuleNotFoundError as error:
            raise _without(error, name) from None
        return value

    def _without(error: ModuleNotFoundError, name: str) -> ModuleNotFoundError:
        """Return an error that says what to install for a public name."""
        extra = "storage" if ".client." in _HOMES[name] else "edge"
        what = f"capture2vr.{name} needs {error.name}: pip install 'capture2vr[{extra}]'"
        return ModuleNotFoundError(what, name=error.name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"TYPE_CHECKING", "annotations", "import_module"})
