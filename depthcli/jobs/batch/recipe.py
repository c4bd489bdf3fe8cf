"""What the outputs of a batch follow from, and which of them are right already."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from depthcli._version import __version__
from depthcli.core.fingerprint import fingerprint
from depthcli.errors import UsageError
from depthcli.io.listing.folder import is_video
from depthcli.io.video.formats import COUNTERPARTS, VIDEO_FORMATS, VideoFormat
from depthcli.io.writers.formats import FORMATS, Format
from depthcli.jobs.batch.manifest import Origin, is_intact

if TYPE_CHECKING:
    from depthcli.core.camera import Camera
    from depthcli.core.picture_limit import PictureLimit
    from depthcli.inference.pipeline import Pipeline
    from depthcli.io.listing.folder import Found
    from depthcli.io.writers.options import WriterOptions
    from depthcli.jobs.batch.journal import Rows
    from depthcli.jobs.batch.manifest import Row
    from depthcli.jobs.batch.plan import Plan


class Recipe(NamedTuple):
    """The options of a batch.

    Attributes:
        formats: what to write.
        looks: options of the formats.
        camera: what is known of the camera.
        limit: pictures beyond it are refused.
        provider_options: of the provider, as ``KEY=VALUE`` words.
    """

    formats: tuple[Format, ...]
    looks: WriterOptions
    camera: Camera
    limit: PictureLimit
    provider_options: tuple[str, ...] = ()

    def origin(self, pipeline: Pipeline) -> Origin:
        """What outputs follow from, besides their input."""
        model, card = pipeline.session.model, pipeline.card
        # Providers differ in the last digits; threads, workers and batch sizes do not. What the
        # card says decides as much as the weights do, and is no part of their file.
        checksum = fingerprint(
            self.formats,
            self.looks,
            self.camera,
            pipeline.detail,
            pipeline.session.provider,
            sorted(self.provider_options),
            (card.input, card.output, card.camera),
        )
        return Origin(checksum, card.name, model.sha256, __version__)


class Targets(NamedTuple):
    """The outputs that a batch is after.

    Attributes:
        plan: all inputs.
        recipe: the options.
        origin: what follows from the recipe and the model.
        rows: what earlier batches did.
    """

    plan: Plan
    recipe: Recipe
    origin: Origin
    rows: Rows

    def check_apart(self) -> None:
        """Refuse outputs that would replace inputs, which can lie side by side in a list.

        Raises:
            UsageError: one would.
        """
        out = os.path.realpath(self.plan.out)
        inputs = {_place(Path(found.path)) for found in self.plan.inputs}
        if not any(place.startswith(os.path.join(out, "")) for place in inputs):  # noqa: PTH118
            return
        for found in self.plan.inputs:
            for path in self.of(found).values():
                if _place(path) in inputs:
                    raise UsageError(
                        f"{path}, the output for {found.name}, is an input; choose another --out"
                    )

    def of(self, found: Found) -> dict[Format, Path] | dict[VideoFormat, Path]:
        """Where the outputs of an input go."""
        return self.of_video(found) if is_video(found.name) else self.of_picture(found)

    def of_picture(self, found: Found) -> dict[Format, Path]:
        """Where the outputs of a picture go."""
        base = self.plan.names.base(found.name)
        return {f: self.plan.out / (base + FORMATS[f].suffix) for f in self.recipe.formats}

    def of_video(self, found: Found) -> dict[VideoFormat, Path]:
        """Where the outputs of a video go; a sequence's name holds ``%06d``."""
        base = self.plan.names.base(found.name)
        chosen = [COUNTERPARTS[f] for f in self.recipe.formats if f in COUNTERPARTS]
        return {which: self.plan.out / (base + VIDEO_FORMATS[which].suffix) for which in chosen}

    def kept(self, found: Found, sha256: str) -> Row | None:
        """The row of an earlier batch, if its outputs are still there and still right."""
        row = self.rows.row(found.name)
        if row is None or not row.holds(self._names(found, row), sha256, self.origin):
            return None
        return row if all(is_intact(self.plan.out, file) for file in row.outputs) else None

    def _names(self, found: Found, row: Row) -> list[str]:
        if not is_video(found.name):
            paths = self.of_picture(found).values()
            return [path.relative_to(self.plan.out).as_posix() for path in paths]
        # How many frames there are is known only once they are written.
        base = self.plan.names.base(found.name)
        return [file.path for file in row.outputs if file.path.startswith(f"{base}.")]


def _place(path: Path) -> str:
    """A file's own place: links to its folder are followed, one that it is itself is not."""
    return os.path.join(_real_folder(path.parent), path.name)  # noqa: PTH118


@lru_cache
def _real_folder(folder: Path) -> str:
    return os.path.realpath(folder)
