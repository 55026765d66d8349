"""What Blender reads of the files that the command line names, as JSON: {triangles, colours, low, high} or {fault}.

`--render FILE` before a file draws it too. Run with `bpy` on PYTHONPATH. It imports no module of ours.
"""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np

IMPORTERS = {
    ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
    ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    ".ply": lambda path: bpy.ops.wm.ply_import(filepath=path),
    ".stl": lambda path: bpy.ops.wm.stl_import(filepath=path),
    ".usdz": lambda path: bpy.ops.wm.usd_import(filepath=path),
}


def read(path: str) -> dict[str, Any]:
    """Import a file into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    IMPORTERS[Path(path).suffix](path)
    objects = [each for each in bpy.data.objects if each.type == "MESH"]
    triangles, corners, coloured = 0, [], False
    for each in objects:
        each.data.calc_loop_triangles()
        triangles += len(each.data.loop_triangles)
        coloured |= len(each.data.color_attributes) > 0
        xyz = np.empty(3 * len(each.data.vertices), np.float32)
        each.data.vertices.foreach_get("co", xyz)
        world = np.array(each.matrix_world)
        corners.append(xyz.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3])
    xyz = np.concatenate(corners)
    pictures = [image for image in bpy.data.images if image.size[0] > 0]
    return {
        "triangles": triangles,
        "colours": "texture" if pictures else "vertices" if coloured else "none",
        "low": xyz.min(axis=0).tolist(),
        "high": xyz.max(axis=0).tolist(),
    }


def render(file: str, low: list[float], high: list[float]) -> None:
    """Draw what was imported last, from the front and a little above, on the processor."""
    middle, size = np.add(low, high) / 2, float(np.linalg.norm(np.subtract(high, low)))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = (middle[0], middle[1] - 1.5 * size, middle[2] + 0.6 * size)
    camera.rotation_euler = (math.atan2(1.5, 0.6), 0, 0)
    camera.data.clip_start = 1e-3 * size
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("world")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs[1].default_value = 1.0
    scene.world.node_tree.nodes["Background"].inputs[0].default_value = (1, 1, 1, 1)
    scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 16, "CPU"
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = scene.render.resolution_y = 320
    scene.render.image_settings.file_format, scene.render.filepath = "JPEG", file
    bpy.ops.render.render(write_still=True)


def main(arguments: list[str]) -> None:
    """Read all files; what Blender itself prints goes to standard error."""
    answer = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    readings = []
    picture = ""
    for argument in arguments:
        if picture == "next":
            picture = argument
        elif argument == "--render":
            picture = "next"
        else:
            try:
                readings.append(read(argument))
                if picture:
                    render(picture, readings[-1]["low"], readings[-1]["high"])
            except (RuntimeError, ValueError, KeyError) as error:
                readings.append({"fault": str(error)[:200]})
            picture = ""
    answer.write(json.dumps(readings))
    answer.flush()
    os._exit(0)  # taking Blender down may crash, with all that was read


main(sys.argv[1:])
