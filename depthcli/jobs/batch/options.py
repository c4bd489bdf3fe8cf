"""The request and the options of a batch."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from depthcli.core.anchors import AnchorPoints
from depthcli.core.camera import UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.core.choices import DEFAULT_DETAIL, MAX_PIXELS, Detail
from depthcli.core.picture_options import AS_STATED, ReadOptions
from depthcli.errors import InputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.depth.anchor_files import AnchorFiles
from depthcli.io.formats.table import Format, WriterOptions
from depthcli.io.listing.folder import InputFile
from depthcli.io.manifest.row import ManifestFormat
from depthcli.io.storage.atomic import is_same_file
from depthcli.io.storage.remote import path_of
from depthcli.jobs.batch.failure_budget import FailureBudget
from depthcli.jobs.batch.input_plan import Plan


@dataclass(frozen=True, slots=True)
class BatchOptions:
    """How each input is processed."""

    formats: tuple[Format, ...] = (Format.PNG16,)  #: output formats, each once
    writing: WriterOptions = field(default_factory=WriterOptions)  #: options of the formats
    camera: Intrinsics = UNKNOWN_CAMERA  #: what is known of the camera
    #: points of known depth, or a folder with a file of them for each image
    anchors: AnchorFiles | tuple[Anchor, ...] = ()
    reading: ReadOptions = AS_STATED  #: how images are read
    detail: Detail = DEFAULT_DETAIL  #: upsampling and tiles
    max_pixels: int = MAX_PIXELS  #: larger pictures are refused
    overwrite: bool = False  #: whether outputs may replace files of other programs

    def points_for(
        self, picture: InputFile, outputs: Iterable[Path], *, shares_stem: bool
    ) -> AnchorPoints | None:
        """The known depth of a picture; None if there is none for any.

        Args:
            picture: the picture.
            outputs: its outputs, which must not replace the known depth.
            shares_stem: whether another picture has the same name but for its suffix.

        Raises:
            InputError: that of this picture is missing, cannot be read, or would be replaced.
        """
        if isinstance(self.anchors, AnchorFiles):
            path = path_of(picture.path)
            file = self.anchors.file_for(picture.name, shares_stem=shares_stem, picture=path)
            if any(is_same_file(output, file) for output in outputs):
                raise InputError(f"{file} is its known depth; choose another --out")
            return self.anchors.read_file(file)
        return AnchorPoints.of(self.anchors) if self.anchors else None


@dataclass(frozen=True, slots=True)
class BatchRequest:
    """A batch."""

    plan: Plan  #: inputs, and the names of their outputs
    #: how each input is processed
    options: BatchOptions = field(default_factory=BatchOptions)
    #: model, provider and threads; by default, threads per worker are cores / workers
    model: SessionLoader = field(default_factory=SessionLoader)
    #: pictures, or chunks of them, processed in parallel; None for one per core
    workers: int | None = None
    #: pictures per inference; None for the provider's default
    batch_size: int | None = None
    #: format of the manifest; None for that of the existing one, or JSON lines
    manifest: ManifestFormat | None = None
    budget: FailureBudget | None = None  #: failures after which it stops; None for no limit
