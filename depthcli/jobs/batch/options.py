"""What a batch is asked for, besides its inputs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.core.picture_limit import PictureLimit
from depthcli.inference.loading import SessionLoader
from depthcli.io.writers.formats import Format
from depthcli.io.writers.options import WriterOptions

if TYPE_CHECKING:
    from depthcli.jobs.batch.manifest import ManifestFormat
    from depthcli.jobs.batch.plan import Plan


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """How each input becomes its outputs.

    Attributes:
        formats: what to write, each once.
        writing: options of the formats.
        camera: what is known of the camera.
        detail: how depth becomes that of a full-size picture.
        max_pixels: larger pictures are refused.
    """

    formats: tuple[Format, ...] = (Format.PNG16,)
    writing: WriterOptions = field(default_factory=WriterOptions)
    camera: Camera = field(default_factory=Camera)
    detail: Detail = PLAIN
    max_pixels: int = MAX_PIXELS

    @property
    def limit(self) -> PictureLimit:
        """Pictures beyond it are refused."""
        return PictureLimit(self.max_pixels, self.detail)


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """A batch.

    Attributes:
        plan: inputs, and the names of their outputs.
        options: how each input becomes its outputs.
        model: which model runs, and how; without a number of threads, with each worker's share of
            the cores.
        workers: pictures, or chunks of them, at the same time; None for one a core.
        batch_size: pictures in one run of the network; None for what suits the provider.
        manifest: its format; None for that of the manifest that is there, or JSON lines.
    """

    plan: Plan
    options: BatchOptions = field(default_factory=BatchOptions)
    model: SessionLoader = field(default_factory=SessionLoader)
    workers: int | None = None
    batch_size: int | None = None
    manifest: ManifestFormat | None = None
