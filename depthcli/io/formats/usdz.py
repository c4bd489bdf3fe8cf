"""A mesh as USDZ, which iPhones, iPads and Macs show in augmented reality (Quick Look).

usd-core is an extra; the only module that imports it.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np

from depthcli.core.options import INSTALL_USD
from depthcli.core.types import DepthMap, Float32Array, Frame
from depthcli.errors import OutputError, UsageError
from depthcli.io.formats.geometry import Mesh, MeshWriter, texture_jpeg
from depthcli.io.storage.atomic import NO_ROOM, temporary_folder
from depthcli.io.stored.metadata import metadata_texts

try:
    from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt
except ImportError as error:
    raise UsageError("usdz needs usd-core", INSTALL_USD) from error

_LAYER, _TEXTURE = "depthcli.usdc", "depthcli.jpg"
_ROOT = "/depth"
_TIME_S = 500_000_000  # of the files in the archive, so that equal requests give equal bytes


class UsdzWriter(MeshWriter):
    """Metres: x right, y up, the camera at the origin looks along -z."""

    def write(self, depth: DepthMap, path: Path, frame: Frame | None = None) -> tuple[str, ...]:
        """Write the mesh with the image on it, which the light of a scene does not change."""
        mesh, warnings = self.mesh(depth)
        with temporary_folder() as folder:
            files, target = [folder / _LAYER], folder / "depth.usdz"
            try:
                stage = Usd.Stage.CreateNew(str(files[0]))
                shape = _shape(stage, mesh)
                stage.SetMetadata("customLayerData", metadata_texts(depth))
                if frame is not None:
                    files.append(folder / _TEXTURE)
                    files[-1].write_bytes(texture_jpeg(frame))
                    _cover(stage, shape, self.uv(mesh, depth))
                stage.Save()
                with Sdf.ZipFileWriter.CreateNew(str(target)) as archive:
                    for file in files:
                        os.utime(file, (_TIME_S, _TIME_S))
                        archive.AddFile(str(file), file.name)
            except (OSError, Tf.ErrorException) as error:
                raise OutputError(*NO_ROOM) from error
            path.write_bytes(target.read_bytes())
        return warnings


def _shape(stage: Any, mesh: Mesh) -> Any:  # noqa: ANN401 - of pxr, which states no types
    """The mesh, seen from both sides and without smoothing."""
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, _ROOT).GetPrim())
    shape = UsdGeom.Mesh.Define(stage, f"{_ROOT}/mesh")
    shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(mesh.xyz_m))
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).ravel()))
    counts = np.full(len(mesh.faces), mesh.faces.shape[1], np.int32)
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(counts))
    ends_m = np.stack([mesh.xyz_m.min(0), mesh.xyz_m.max(0)])
    shape.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(ends_m))
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shape.CreateDoubleSidedAttr(True)
    return shape


def _cover(stage: Any, shape: Any, uv: Float32Array) -> None:  # noqa: ANN401 - of pxr
    """Put the image on the mesh, as light that it emits; v is 0 at the bottom."""
    kind = Sdf.ValueTypeNames
    places = UsdGeom.PrimvarsAPI(shape).CreatePrimvar(
        "st", kind.TexCoord2fArray, UsdGeom.Tokens.vertex
    )
    places.Set(
        Vt.Vec2fArray.FromNumpy(uv * np.array([1, -1], np.float32) + np.array([0, 1], np.float32))
    )
    material = UsdShade.Material.Define(stage, f"{_ROOT}/material")

    def shader(name: str, id_: str, **inputs: tuple[Any, object]) -> Any:  # noqa: ANN401 - of pxr
        node = UsdShade.Shader.Define(stage, f"{_ROOT}/material/{name}")
        node.CreateIdAttr(id_)
        for key, (type_, value) in inputs.items():
            node.CreateInput(key, type_).Set(value)
        return node

    st = shader("st", "UsdPrimvarReader_float2", varname=(kind.String, "st"))
    texture = shader(
        "texture",
        "UsdUVTexture",
        file=(kind.Asset, _TEXTURE),
        wrapS=(kind.Token, "clamp"),
        wrapT=(kind.Token, "clamp"),
        sourceColorSpace=(kind.Token, "sRGB"),
    )
    surface = shader(
        "surface",
        "UsdPreviewSurface",
        diffuseColor=(kind.Color3f, Gf.Vec3f(0)),
        useSpecularWorkflow=(kind.Int, 1),
        specularColor=(kind.Color3f, Gf.Vec3f(0)),
        roughness=(kind.Float, 1.0),
    )
    texture.CreateInput("st", kind.Float2).ConnectToSource(st.CreateOutput("result", kind.Float2))
    rgb = texture.CreateOutput("rgb", kind.Float3)
    surface.CreateInput("emissiveColor", kind.Color3f).ConnectToSource(rgb)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", kind.Token))
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(material)
