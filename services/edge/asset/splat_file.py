"""Gaussian splats as a file of a bundle: trained on the photos that the asset is made from."""

from __future__ import annotations

from capture2vr.edge.arrays import Floats, Tick
from capture2vr.edge.asset.manifest import AssetSubject
from capture2vr.edge.errors import EdgeError
from capture2vr.edge.mesh.nouns import Mesh, TexturedMesh
from capture2vr.edge.render.place_views import posed_picture
from capture2vr.edge.splats.spz import to_spz
from capture2vr.edge.splats.surface_splats import cover_with_splats
from capture2vr.order.download_formats import SPLATS
from capture2vr.sentences.sentence import say

_COUNT = 100_000  # a third of what a headset draws, which a CPU trains in minutes


def splat_file(
    finest: Mesh | TexturedMesh, subject: AssetSubject, to_asset: Floats, device: str, tick: Tick
) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Train splats as the preset says; return the file by name, or a warning that says why there is none.

    finest    the finest level of detail, in the asset frame, which the splats cover at first
    to_asset  (4,4) from the capture frame to the asset frame
    """
    if not subject.colours.texture_views:
        return {}, (say("no_splats_trained_capture"),)
    # Imported here: a worker that trains nothing must not load torch.
    from capture2vr.edge.splat_training.train_splats import train_splats

    pictures = [posed_picture(view, to_asset) for view in subject.colours.texture_views]
    mesh = finest.mesh if isinstance(finest, TexturedMesh) else finest
    try:
        start = cover_with_splats(finest, _COUNT)
        trained = train_splats(start, mesh, pictures, steps=subject.preset.splat_steps, device=device, tick=tick)
    except EdgeError as error:
        if error.code == "GPU_OOM" and device != "cpu":
            files, warnings = splat_file(finest, subject, to_asset, "cpu", tick)
            return files, (say("splats_trained_on_cpu", why=error.message), *warnings)
        return {}, (say("no_splats_trained", why=error.message),)
    except MemoryError:
        return {}, (say("no_splats_trained_not_enough"),)
    return {SPLATS: to_spz(trained)}, ()
