"""What a batch is asked for, besides its inputs."""

from dataclasses import dataclass, field

from depthcli.core.camera import Camera
from depthcli.core.choices import MAX_PIXELS, PLAIN, Detail
from depthcli.core.picture_limit import PictureLimit
from depthcli.inference.loading import SessionLoader
from depthcli.io.manifest.row import ManifestFormat
from depthcli.io.writers.formats import Format
from depthcli.io.writers.options import WriterOptions
from depthcli.jobs.batch.failure_budget import FailureBudget
from depthcli.jobs.batch.plan import Plan


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """How each input becomes its outputs."""

    formats: tuple[Format, ...] = (Format.PNG16,)  #: what to write, each once
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    camera: Camera = field(default_factory=Camera)  #: what is known of the camera
    detail: Detail = PLAIN  #: how depth becomes that of a full-size picture
    max_pixels: int = MAX_PIXELS  #: larger pictures are refused

    @property
    def limit(self) -> PictureLimit:
        """Pictures beyond it are refused."""
        return PictureLimit(self.max_pixels, self.detail)


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """A batch."""

    plan: Plan  #: inputs, and the names of their outputs
    #: how each input becomes its outputs
    options: BatchOptions = field(default_factory=BatchOptions)
    #: which model runs, and how; without a number of threads, with each worker's share of the cores
    model: SessionLoader = field(default_factory=SessionLoader)
    #: pictures, or chunks of them, at the same time; None for one a core
    workers: int | None = None
    #: pictures in one run of the network; None for what suits the provider
    batch_size: int | None = None
    #: its format; None for that of the manifest that is there, or JSON lines
    manifest: ManifestFormat | None = None
    budget: FailureBudget | None = None  #: how much may fail before it stops; None for any number
