"""Options that several commands share, in groups by purpose."""

from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import field
from functools import partial
from typing import Annotated, Any, Literal

import typer

from depthcli.cli.groups import OPTION, USUAL, checked, group
from depthcli.cli.screen import console
from depthcli.core import options as choices
from depthcli.core.camera import FOCAL_35MM, FOCAL_PX, HFOV_DEG, PIXEL_ASPECT
from depthcli.io.formats import table as formats

MAX_THREADS = 1024
# Importing onnxruntime is slow; a test compares these names with it.
_ACCELERATED = ("cuda", "tensorrt", "rocm", "migraphx", "directml", "coreml", "openvino")
PROVIDERS = ("auto", "cpu", *_ACCELERATED)


def cards() -> list[str]:
    """Names of ready cards."""
    from depthcli.models.catalog import ready_names

    return [*ready_names()]


def models() -> list[str]:
    """Names for ``--model``."""
    from depthcli.models.catalog import list_locations

    return [name for name, _ in list_locations()]


positive = checked(formats.POSITIVE)
not_negative = checked(choices.Rule("0 or greater", lambda x: 0 <= x < float("inf")))
png_scale_range = checked(formats.PNG_SCALE)
field_of_view = checked(HFOV_DEG)
focal_length = checked(FOCAL_PX)


def option(text: str, *names: str, default: Any = None, **settings: Any) -> Any:  # noqa: ANN401
    """A field of a group that is an option: its help, and what ``typer.Option`` takes."""
    parameter = typer.Option(*names, help=text, **settings)
    return field(default=default, metadata={OPTION: parameter})


usual = partial(option, rich_help_panel=USUAL)  #: one that stands first in the help


UpsampleOption = Annotated[
    choices.Upsampling,
    typer.Option(
        help="Upsampling to the image's size: guided by the image's edges, bilinear, or as the "
        "model's authors do."
    ),
]


@group
class RuntimeOptions:
    """Model and speed."""

    provider: str = option(
        "Execution provider: auto, cpu, cuda, tensorrt, rocm, migraphx, directml, coreml "
        "or openvino. One that is requested by name must be available.",
        default="auto",
        metavar="NAME",
        autocompletion=lambda: PROVIDERS,  # of which typer takes those that begin as typed
    )
    provider_option: list[str] | None = option(
        "Option of the provider given with --provider, such as device_id=1; repeatable.",
        metavar="KEY=VALUE",
    )
    threads: int | None = option(
        "Inference threads per worker. Default: cores / workers.", min=1, max=MAX_THREADS
    )


@group
class ModelOptions:
    """Model and speed."""

    model: str | None = usual(
        "Name ('depthcli models list'), .onnx file, or folder with a card.json.",
        "--model",
        metavar="MODEL",
        autocompletion=models,
    )
    runtime: RuntimeOptions


@group
class PinholeOptions:
    """Camera."""

    focal_px: float | None = usual(
        "Focal length in pixels of the image; scales metric depth.", callback=focal_length
    )
    hfov: float | None = usual(
        "Horizontal field of view in degrees, instead of --focal-px. Default: from EXIF, "
        "else the model's camera.",
        callback=field_of_view,
    )
    focal_35mm: float | None = option(
        "Focal length in millimetres as its 35-mm equivalent, instead of --focal-px.",
        callback=checked(FOCAL_35MM),
        metavar="MM",
    )
    pixel_aspect: float | None = option(
        "Width of a pixel by its height: 2 for views squeezed side by side. Default: as stated.",
        callback=checked(PIXEL_ASPECT),
        metavar="RATIO",
    )
    centre_px: str | None = option(
        "Principal point in pixels, for point clouds and for the metadata of the outputs; "
        "0,0 is the middle of the first pixel. Default: the middle of the image; for 'convert' "
        "that of the input, if it states one.",
        metavar="CX,CY",
    )
    calibration: str | None = option(
        "Calibration of the camera, instead of --focal-px and --centre-px: of ROS, OpenCV, "
        "Kalibr, COLMAP, nerfstudio, Open3D, ORB-SLAM, VINS or KITTI, or a 3×3 matrix as text.",
        metavar="FILE",
    )
    rectified: bool = option(
        "The images are rectified: the camera is that of projection_matrix (P) in --calibration.",
        default=False,
    )


@group
class LensOptions(PinholeOptions):
    """Camera."""

    undistort: bool = option(
        "Remove the lens distortion in --calibration first; outputs are of the rectified images.",
        default=False,
    )


@group
class CameraOptions(LensOptions):
    """Camera."""

    camera: str | None = option(
        "Use the scale, field of view and lens that 'depthcli calibrate' kept under this name.",
        metavar="NAME",
    )


@group
class StatedCameraOptions(PinholeOptions):
    """Camera."""

    # Unlike those of predict, they do not scale depth.
    focal_px: float | None = option(
        "Focal length in pixels, for point clouds, --from-kind and the metadata of the outputs; "
        "other depth stays as it is. Default: what the input states.",
        callback=focal_length,
    )
    hfov: float | None = option(
        "Horizontal field of view in degrees, instead of --focal-px.", callback=field_of_view
    )


@group
class DepthFileOptions:
    """Depth file."""

    from_scale: float | None = usual(
        "Units per metre: 1000 for millimetres, 100 for centimetres, 256 in KITTI. Default: from "
        "the file, else 1000 for PNG and video, 1 for floats. Of disparity, units per pixel.",
        callback=png_scale_range,
    )
    from_kind: choices.DepthEncoding | None = usual(
        "Meaning of the numbers in a file that does not state it: metric (depth along the camera "
        "axis, the default), distance (along the ray of each pixel), disparity (stereo, needs "
        "--baseline), inverse (1/depth, metric with --from-scale) or relative. Distance and "
        "disparity need the focal length."
    )
    baseline: float | None = option(
        "Metres between the two cameras, for --from-kind disparity.", callback=positive
    )
    from_layer: str | None = option(
        "Layer or part of an EXR that holds the depth, such as 'depth_left'. Default: the "
        "likeliest by its name, of the eye of its image."
    )
    frame: int | None = option(
        "Frame to read, from 0, of a depth video (.mkv) or of several maps in NPY or NPZ.", min=0
    )


@group
class KnownDepthOptions:
    """Known depth."""

    anchor: list[str] | None = option(
        "Point of known depth: column and row from 0 at the top left, and metres; repeatable. One "
        "point fits the scale; for more, see --anchors-fit.",
        metavar="X,Y,METRES",
    )
    anchors: str | None = option(
        "Known depth, such as that of a lidar: a CSV table with the columns x, y and depth_m; a "
        "sparse depth map of the image's size (as 'info' reads; 0 or NaN is unknown); a cloud "
        "(PLY, PCD, BIN; needs --calibration); a folder with cameras, images and points3D of "
        "COLMAP; or self: what a phone stored within each image (HEIC, JPEG). For 'batch', a "
        "folder with a file for each image, or topic:NAME of a bag; for 'video', for each frame "
        "by its number, or a table with a column frame or time_s.",
        "--anchors",
        "--points",
        metavar="FILE|DIR|self|topic:NAME",
    )
    extrinsics: str | None = option(
        "Transform of a cloud to the axes of the camera (x right, y down, z forward): 3x4 "
        "numbers, x y z qx qy qz qw, /tf_static of ROS, KITTI's calibration, or T_cam_lidar.",
        metavar="FILE",
    )
    anchors_scale: float | None = option(
        "Units per metre of --anchors. Default: from the file, else 1000 for integers (needed "
        "for NPY), 1 for floats.",
        callback=png_scale_range,
    )
    anchors_kind: choices.DepthEncoding | None = option(
        "Meaning of the numbers in --anchors, as --from-kind of 'convert': distance along the "
        "ray and disparity (with --baseline) need --focal-px, --hfov or --calibration."
    )
    baseline: float | None = option(
        "Metres between the two cameras, for --anchors-kind disparity.", callback=positive
    )


@group
class FitOptions(KnownDepthOptions):
    """Known depth."""

    anchors_fit: choices.DepthFit | None = option(
        "How depth follows known points: global: scale and shift alone; local: also the errors "
        "that remain, spread over the image; network: a model that takes the points. Default: "
        "network if the model can, else local; without --model, 'prompted' takes two or more."
    )


@group
class ReadOptions:
    """Reading images."""

    white_level: int | None = option(
        "Value of white in 16-bit images of a camera with fewer bits: 1023 (10 bits), "
        "4095 (12), 16383 (14). Default: 65535.",
        min=1,
        max=65535,
    )
    black_level: int = option(
        "Value of black in 16-bit images, with --white-level for a thermal camera's range.",
        default=0,
        min=0,
        max=65534,
    )
    exposure: float = option(
        "Exposure of EXR images in stops: 1 doubles their linear light, -1 halves it.",
        default=0.0,
        callback=checked(choices.EXPOSURE),
        metavar="STOPS",
    )
    layer: str | None = option(
        "Layer or part of EXR images to read, such as 'beauty'. Default: the unnamed one, else "
        "the likeliest by its name."
    )
    projection: choices.Projection | None = option(
        "Projection of the images: equirectangular for panoramas of all directions, whose depth "
        "is then along the ray. Default: pinhole."
    )
    ignore_alpha: bool = option(
        "Estimate the depth of transparent pixels, too, by their hidden colours.", default=False
    )


@group
class ImageOptions(ReadOptions):
    """Reading images."""

    max_pixels: int = option(
        "Maximum number of pixels of an image.", default=choices.MAX_PIXELS, min=1
    )


@group
class DetailOptions:
    """Detail."""

    upsample: UpsampleOption = choices.Upsampling.GUIDED
    tile: str | None = option(
        "Refine the depth in tiles of this width; auto is 3/4 of the image's width.",
        metavar="auto|PIXELS",
    )


@group
class MapOptions(DetailOptions):
    """Detail."""

    mask: choices.DepthMask = option(
        "Pixels without depth: none, or those that the model's own mask excludes, such as sky.",
        default=choices.DepthMask.NONE,
    )
    error: bool = option(
        "Also estimate the expected relative error of depth, for EXR (channel 'error'), NPZ, html "
        "and --json. Outputs that need it imply it.",
        default=False,
    )


QuietOption = Annotated[
    bool, typer.Option("-q", "--quiet", rich_help_panel=USUAL, help="Print errors only.")
]


@group
class ScreenOptions:
    """Screen."""

    as_json: bool = usual(
        "Print JSON to stdout: an object per input, or one for the whole run.",
        "--json",
        default=False,
    )
    quiet: QuietOption = False
    progress: Literal["auto", "json"] = option(
        "Progress as a bar or lines (auto), or as JSON lines on stderr, for programs.",
        default="auto",
    )

    @property
    def shows_text(self) -> bool:
        """Whether results are printed as text."""
        return not (self.quiet or self.as_json)

    def show_progress(self) -> AbstractContextManager[console.ProgressDisplay]:
        """Show progress during a block, as JSON or where text is shown."""
        return console.show_progress(is_shown=self.shows_text, as_json=self.progress == "json")

    def warn_all(self, texts: Iterable[str]) -> None:
        """Print warnings, a line each, unless only errors are printed."""
        if not self.quiet:
            console.warn_all(texts)


FileArgument = Annotated[
    str,
    typer.Argument(
        metavar="FILE",
        help="Depth file: 16-bit PNG or PGM, EXR, NPY, NPZ, PFM, TIFF, COLMAP's .bin, or depth "
        "video (.mkv).",
    ),
]
SidecarOption = Annotated[
    bool,
    typer.Option(
        "--sidecar",
        rich_help_panel=USUAL,
        help="Also write a .json file with unit, scale, kind and model.",
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace existing files that depthcli did not write; an input is never replaced.",
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=MAX_THREADS,
        help="Number of inputs or frames processed in parallel. Default: one per core.",
        rich_help_panel="Model and speed",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON to stdout instead of text.")]
