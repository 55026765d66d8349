"""Run beside usd-core, not by pytest: what it makes of .usdz files, as one JSON list."""

from __future__ import annotations

import json
import sys
from typing import Any

from pxr import Ar, Usd, UsdGeom, UsdShade, UsdValidation  # type: ignore[import-not-found]


def reading(path: str) -> dict[str, Any]:
    stage = Usd.Stage.Open(path)
    (mesh,) = (UsdGeom.Mesh(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh))
    material, _ = UsdShade.MaterialBindingAPI(mesh.GetPrim()).ComputeBoundMaterial()
    surface, _, _ = material.ComputeSurfaceSource()
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    return {
        "faults": faults(stage),
        "root": stage.GetDefaultPrim().GetName(),
        "metres": UsdGeom.GetStageMetersPerUnit(stage),
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        "points": rows(mesh.GetPointsAttr().Get()),
        "counts": list(mesh.GetFaceVertexCountsAttr().Get()),
        "corners": list(mesh.GetFaceVertexIndicesAttr().Get()),
        "normals": rows(mesh.GetNormalsAttr().Get()),
        "normals_of": str(mesh.GetNormalsInterpolation()),
        "extent": rows(mesh.GetExtentAttr().Get()),
        "double_sided": mesh.GetDoubleSidedAttr().Get(),
        "subdivided": str(mesh.GetSubdivisionSchemeAttr().Get()),
        "st": rows(st.Get()) if st else [],
        "st_of": str(st.GetInterpolation()) if st else "",
        "grey": rows([surface.GetInput("diffuseColor").Get() or ()]),
        "picture": picture(surface),
    }


def faults(stage: Any) -> list[str]:
    """What any of usd-core's validators, Apple's rules for packages among them, says about the stage."""
    every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [
        f"{error.GetName()}: {error.GetMessage()}" for error in UsdValidation.ValidationContext(every).Validate(stage)
    ]


def picture(surface: Any) -> str:
    """The bytes of the base colour's texture in hexadecimal, found by its connections; "" where there is none."""
    colour = surface.GetInput("diffuseColor")
    if not colour.HasConnectedSource():
        return ""
    texture = UsdShade.Shader(colour.GetConnectedSources()[0][0].source.GetPrim())
    place = UsdShade.Shader(texture.GetInput("st").GetConnectedSources()[0][0].source.GetPrim())
    assert place.GetInput("varname").Get() == "st"
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(texture.GetInput("file").Get().resolvedPath))
    return bytes(asset.GetBuffer()).hex() if asset else ""


def rows(vectors: Any) -> list[list[float]]:
    return [list(vector) for vector in vectors]


print(json.dumps([reading(path) for path in sys.argv[1:]]))
