"""Folders of images for a batch that is called as a library."""

from dataclasses import replace
from pathlib import Path

from depthcli.inference.loading import SessionLoader
from depthcli.io.manifest import OK, CacheKey, KnownDepthEntry, ManifestRow, OutputFile
from depthcli.jobs.batch.plan import BatchPlan, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from helpers.file_trees import contents
from helpers.tiny import synthetic_image, write_image, write_model

NAMES = ("a.png", "z.png", "hall/b.png")
ORIGIN = CacheKey("0" * 64, "tiny", "1" * 64, "1.0")


def row(name: str, seconds: float = 0.5) -> ManifestRow:
    """Of an image that was done, with all that a row can state."""
    outputs = (OutputFile(f"{name}.depth.png", 12, "2" * 64),)
    done = ManifestRow(
        name, OK, ORIGIN, outputs, seconds, "3" * 64, warnings=("far",), camera="60°"
    )
    return replace(done, anchors=KnownDepthEntry(9, 8, 0.25, "4" * 64))


def of_plan(folder: Path, plan: BatchPlan, options: BatchOptions | None = None) -> BatchRequest:
    """A batch of a plan, by two workers."""
    loader = SessionLoader(write_model(folder / "model", camera={"hfov_deg": 60.0}), "cpu")
    return BatchRequest(plan, options or BatchOptions(), loader, workers=2)


def request(folder: Path, out: str = "out", options: BatchOptions | None = None) -> BatchRequest:
    """A batch of the images in the folder ``in``."""
    return of_plan(folder, plan_folder(str(folder / "in"), str(folder / out)), options)


def images(folder: Path) -> None:
    """Three images, no two alike."""
    for number, name in enumerate(NAMES):
        write_image(folder / "in" / name, synthetic_image(24, 32 + number))


def outputs(folder: Path) -> dict[str, bytes]:
    """All but the manifest, whose seconds differ."""
    files = contents(folder).items()
    return {name: data for name, data in files if name != "manifest.jsonl"}


def kept(folder: Path, out: str = "out", options: BatchOptions | None = None) -> dict[str, bool]:
    """Which inputs a batch finds done already."""
    results = list(Batch(request(folder, out, options)))
    return {result.row.input: result.is_kept for result in results}
