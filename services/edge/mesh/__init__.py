"""Meshes: extracted from a distance field, cleaned, simplified, coloured, measured, shown and packed. numpy only.

Everything here takes a `DistanceFn` or a `Mesh`, never a network and never a capture.
"""

from services.edge.mesh.clean import clean
from services.edge.mesh.colour import carry_colours
from services.edge.mesh.extract import extract
from services.edge.mesh.glb import to_glb
from services.edge.mesh.nouns import Mesh, Textured
from services.edge.mesh.ply import ply_bytes, write_ply
from services.edge.mesh.render import render_sheet
from services.edge.mesh.simplify import lods, simplify
from services.edge.mesh.spacing import auto_resolution

__all__ = [
    "Mesh",
    "Textured",
    "auto_resolution",
    "carry_colours",
    "clean",
    "extract",
    "lods",
    "ply_bytes",
    "render_sheet",
    "simplify",
    "to_glb",
    "write_ply",
]
