"""Depth for programs that reconstruct a scene: names of its files, and the tables that they read.

3D Gaussian splatting reads ``sparse/0/depth_params.json`` and ``a.png`` for ``a.jpg``
(github.com/graphdeco-inria/gaussian-splatting), nerfstudio reads ``transforms.json``
(docs.nerf.studio), and COLMAP ``stereo/depth_maps/a.jpg.geometric.bin``.
"""

import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from depthcli.core.options import SceneLayout
from depthcli.core.validation import FieldError, parsed_json
from depthcli.errors import UsageError, os_errors_as
from depthcli.io.formats.png16 import read_metadata
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.guard import Guard
from depthcli.io.manifest import ManifestRow
from depthcli.io.storage.atomic import atomic_path
from depthcli.io.stored.metadata import SOFTWARE, UINT16_MAX

DEPTH_PARAMS, TRANSFORMS = "depth_params.json", "transforms.json"
_READER_STEPS = 2**16  # 3D Gaussian splatting divides by it
_FAR_M = 1e9  # whose inverse is 0: an image's scale depends on its nearest pixel alone
_PATHS = ("ply_file_path", "file_path", "mask_path")  # of transforms.json, relative to its folder


def format_of(layout: SceneLayout) -> Format:
    """The format that the programs of a layout read."""
    return Format.PNG16 if layout is SceneLayout.GSPLAT else Format.COLMAP


def writing_for(layout: SceneLayout | None, writing: WriterOptions) -> WriterOptions:
    """Options of the formats for a layout: inverse depth, from 0, for 3D Gaussian splatting."""
    if layout is not SceneLayout.GSPLAT:
        return writing
    return replace(writing, png_inverse=True, vmax=writing.vmax or _FAR_M)


def check_tables(
    layout: SceneLayout | None, transforms: Path | None, out: Path, *, overwrite: bool
) -> None:
    """Check, before a batch, that its tables may be written.

    OutputError if not, or UsageError if ``transforms`` is not nerfstudio's.
    """
    guard = Guard.of([transforms] if transforms else [], overwrite=overwrite)
    if layout is SceneLayout.GSPLAT:
        guard.check(out / DEPTH_PARAMS)
    if transforms is not None:
        read_transforms(transforms)
        guard.check(out / TRANSFORMS)


def write_tables(
    layout: SceneLayout | None, transforms: Path | None, out: Path, rows: Iterable[ManifestRow]
) -> None:
    """Write the tables of the images that have depth in an output folder."""
    done = [row for row in rows if row.outputs]
    if layout is SceneLayout.GSPLAT:
        _write(out / DEPTH_PARAMS, dict(_depth_params(out, done)))
    if transforms is not None:
        _write(out / TRANSFORMS, _with_depth(transforms, out, done))


def _depth_params(out: Path, rows: Collection[ManifestRow]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Scale and offset of each PNG, by its name without suffix.

    Inverse depth is ``steps / 65536 * scale + offset``, where the PNG has 1 for the lower end of
    its range and 65535 for the higher.
    """
    paths = (file.path for row in rows for file in row.outputs if file.path.endswith(".png"))
    for path in (path for path in paths if (out / path).is_file()):
        texts = read_metadata(out / path)
        if texts.get("scale") == "inverse":
            low, high = map(float, texts["range"].split())
            step = (high - low) / (UINT16_MAX - 1)
            numbers = {"scale": step * _READER_STEPS, "offset": low - step}
            yield path.removesuffix(".png"), {**numbers, "software": SOFTWARE}


def read_transforms(path: Path) -> dict[str, Any]:
    """The description of a scene for nerfstudio; UsageError if it cannot be read."""
    with os_errors_as(UsageError, f"cannot read {path}"):
        data = path.read_bytes()
    try:
        scene: Any = parsed_json(data)
        if all(isinstance(frame["file_path"], str) for frame in scene["frames"]):
            return dict(scene)
    except (FieldError, KeyError, TypeError):
        pass
    raise UsageError(f"{path} has no frames with a file_path", option="transforms")


def _with_depth(path: Path, out: Path, rows: Iterable[ManifestRow]) -> dict[str, Any]:
    """A scene with the depth of each frame; frames without are left out, as nerfstudio needs it."""
    scene, folder = read_transforms(path), path.parent
    depths = {
        os.path.realpath(str(row.input_path)): file.path
        for row in rows
        for file in row.outputs
        if file.path.endswith(".png")
    }
    frames = []
    for frame in scene["frames"]:
        depth = depths.get(os.path.realpath(folder / frame["file_path"]))
        if depth is not None:
            frames.append({**_moved(frame, folder, out), "depth_file_path": depth})
    return {"software": SOFTWARE, **_moved(scene, folder, out), "frames": frames}


def _moved(fields: Mapping[str, Any], folder: Path, out: Path) -> dict[str, Any]:
    """Fields whose paths start from another folder."""
    paths = {name: fields[name] for name in _PATHS if name in fields}
    return {**fields, **{n: os.path.relpath(folder / path, out) for n, path in paths.items()}}


def _write(path: Path, table: Mapping[str, Any]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(table, indent=2) + "\n", "utf-8")
