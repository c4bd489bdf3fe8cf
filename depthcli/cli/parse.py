"""Values of options as the objects that the jobs take; UsageError for one that is not valid.

Profiles are tables of a TOML file whose options are defaults of a command: of ``depthcli.toml`` in
the working directory, then of the same file in the user's configuration folder.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from depthcli.cli import options as groups
from depthcli.cli.groups import Given
from depthcli.cli.table import PROFILE_COMMANDS, PROGRAM, plain_command
from depthcli.core import options as choices
from depthcli.core.camera import DEPTH_M, UNKNOWN_CAMERA, Anchor, Intrinsics
from depthcli.core.options import ReadOptions, UpsamplingOptions, short_repr, suggestion
from depthcli.errors import InputError, UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import FORMATS, Format, WriterOptions, format_of
from depthcli.io.storage.paths import RemotePath, path_of, read_regular, safe_name, user_folder
from depthcli.video.formats import VideoFormat, video_format_of

if TYPE_CHECKING:
    from fractions import Fraction

    from depthcli.io.stored.depth import DepthReadOptions
    from depthcli.known.files import KnownDepthFiles

ALTERNATIVES = (
    ("calibration", "cameras", "focal_px", "hfov", "focal_35mm"),
    ("calibration", "camera"),
    ("calibration", "centre_px"),
    ("calibration", "pixel_aspect"),
    ("rectified", "undistort"),
    ("anchor", "anchors"),
    ("png_scale", "png_normalize", "png_inverse"),
)  #: parameters of which only one is given, because they state the same
_BOX_COMMAS = 3


def session_loader(
    model: str | None, runtime: groups.RuntimeOptions, threads: int | None = None
) -> SessionLoader:
    """The loader of a model; ``threads`` in place of those of the options."""
    pairs = [word.partition("=") for word in runtime.provider_option or ()]
    if not all(key and equals for key, equals, _ in pairs):
        raise UsageError("each is KEY=VALUE, for example device_id=1", option="provider_option")
    options = {key: value for key, _, value in pairs}
    return SessionLoader(model, runtime.provider, threads or runtime.threads, options)


def detail(options: groups.DetailOptions) -> UpsamplingOptions:
    """Upsampling, tiles and mask; UsageError if the tile is neither ``auto`` nor a width."""
    tile = options.tile
    more = (options.mask, options.error) if isinstance(options, groups.MapOptions) else ()
    if tile in {None, "auto"}:
        return UpsamplingOptions(options.upsample, choices.AUTO_TILE if tile else None, *more)
    if not re.fullmatch(r"0*[1-9][0-9]{0,8}", str(tile)):
        raise UsageError(f"{short_repr(tile)} is neither auto nor a width in pixels", option="tile")
    return UpsamplingOptions(options.upsample, int(str(tile)), *more)


def camera(options: groups.PinholeOptions) -> Intrinsics:
    """The camera of the options."""
    refuse_alternatives({field.name: getattr(options, field.name) for field in fields(options)})
    undistort = getattr(options, "undistort", False)  # not of files that hold depth
    if (options.rectified or undistort) and options.calibration is None:
        problem = "{undistort} is" if undistort else "{rectified} is"
        raise UsageError("", f"{problem} for {{calibration}}: give both or neither")
    if options.calibration is None:
        centre_px = None
        if options.centre_px is not None:
            x, y = numbers(options.centre_px, "CX,CY", "319.5,239.5", option="centre_px")
            centre_px = x, y
        intrinsics = Intrinsics(
            options.focal_px,
            options.hfov,
            centre_px,
            pixel_aspect=options.pixel_aspect,
            focal_35mm=options.focal_35mm,
        )
        name = getattr(options, "camera", None)
        has_table = getattr(options, "cameras", None) is not None
        return intrinsics if name is None else _kept(name, intrinsics, has_table=has_table)
    from depthcli.io.calibration import read_calibration

    try:
        intrinsics = read_calibration(options.calibration, rectified=options.rectified)
        return replace(intrinsics, is_undistorted=undistort)
    except InputError as error:
        raise UsageError(error.message.problem, option="calibration") from error


def _kept(name: str, explicit: Intrinsics, *, has_table: bool) -> Intrinsics:
    """A calibrated camera, with the focal length or principal point that is given."""
    from depthcli.io.calibration import kept_camera

    calibrated = kept_camera(name)
    if calibrated.is_undistorted and (has_table or explicit != UNKNOWN_CAMERA):
        problem = f"the images of {name} are rectified by the calibration of its lens"
        raise UsageError(problem, "leave {focal_px}, {hfov}, {centre_px} and {cameras} out")
    if explicit.has_focal:
        return replace(explicit, scale=calibrated.scale)
    calibrated = replace(calibrated, pixel_aspect=explicit.pixel_aspect or calibrated.pixel_aspect)
    if explicit.centre_px is None:
        return calibrated
    # In pixels of images of any size, unlike the kept focal length.
    return replace(calibrated, centre_px=explicit.centre_px, focal_px=None, size_px=None)


def reading(options: groups.ReadOptions, eye: choices.Eye | None = None) -> ReadOptions:
    """Options of reading images; only some commands choose the eye."""
    names = [name for name in ReadOptions._fields if name != "eye"]
    return ReadOptions(**{name: getattr(options, name) for name in names}, eye=eye)


def depth_reading(options: groups.DepthFileOptions, camera: Intrinsics) -> DepthReadOptions:
    """Statements of the user about a depth file; UsageError if a baseline without disparity."""
    from depthcli.io.stored.depth import DepthReadOptions

    kind, baseline_m, layer = options.from_kind, options.baseline, options.from_layer
    if baseline_m is not None and kind is not choices.DepthEncoding.DISPARITY:
        raise UsageError("", "{baseline} is for {from_kind} disparity")
    read_options = DepthReadOptions(options.from_scale, kind, layer=layer, frame=options.frame)
    return replace(read_options, camera=camera, baseline_m=baseline_m)


def known_depth(
    options: groups.KnownDepthOptions,
    camera: Intrinsics = UNKNOWN_CAMERA,
    *,
    is_folder: bool | None = False,
) -> KnownDepthFiles | tuple[Anchor, ...]:
    """The points of known depth, or files of them for images of a camera.

    With ``is_folder``, a path has to be a folder with a file for each image; None is for a video,
    whose frames have no depth of their own.
    """
    path = options.anchors
    refuse_alternatives({"anchor": options.anchor, "anchors": path})
    if path is None:
        return _listed_points(options)
    from depthcli.known.files import SELF, KnownDepthFiles

    files = KnownDepthFiles(
        path,
        options.anchors_scale,
        options.anchors_kind,
        camera,
        options.baseline,
        path_of(options.extrinsics) if options.extrinsics else None,
    )
    place = path_of(path)
    if options.extrinsics and not files.may_be_clouds:
        raise UsageError("", "{extrinsics} is for clouds: leave it out, or name one in {anchors}")
    is_stated = path == SELF or files.topic is not None
    if is_stated and (files.scale or files.kind):
        raise UsageError("", "{anchors_scale} and {anchors_kind} are for files in {anchors}")
    if is_stated and is_folder is None:
        raise UsageError("the frames of a video have no depth of their own", option="anchors")
    if camera.is_undistorted and files.is_by_image:
        problem = "its points are of the images with their distortion"
        raise UsageError(problem, "leave {undistort} or {camera} out", option="anchors")
    is_local = not isinstance(place, RemotePath) and not files.is_by_image
    if is_local and is_folder is not None and place.is_dir() != is_folder:
        problem = "not a folder with a file for each image" if is_folder else "a folder, not a file"
        advice = "" if is_folder else "'depthcli batch' takes a folder with a file for each image"
        raise UsageError(f"{safe_name(path)} is {problem}", advice, option="anchors")
    if options.baseline is not None and options.anchors_kind is not choices.DepthEncoding.DISPARITY:
        raise UsageError("", "{baseline} is for {anchors_kind} disparity")
    return files


def map_options(
    camera_options: groups.CameraOptions,
    fit: groups.FitOptions,
    read: groups.ImageOptions,
    upsampling: groups.MapOptions,
    writing: WriterOptions,
    *,
    is_folder: bool | None = False,
    eye: choices.Eye | None = None,
) -> dict[str, Any]:
    """Values of the fields of :class:`~depthcli.jobs.outputs.MapOptions`."""
    refuse_alternatives(vars(writing))
    seen_by = camera(camera_options)
    return {
        "writing": writing,
        "camera": seen_by,
        "anchors": known_depth(fit, seen_by, is_folder=is_folder),
        "anchors_fit": fit.anchors_fit,
        "reading": reading(read, eye),
        "detail": detail(upsampling),
        "max_pixels": read.max_pixels,
    }


def refuse_alternatives(values: Mapping[str, object]) -> None:
    """UsageError if two of the options that state the same have a value."""
    for names in ALTERNATIVES:
        chosen = [name for name in names if values.get(name) not in (None, False, [])]
        if len(chosen) > 1:
            raise UsageError("", f"give {{{chosen[0]}}} or {{{chosen[1]}}}, not both")


def _are_indices(*values: float) -> bool:
    return all(value >= 0 and value.is_integer() for value in values)


def numbers(
    word: str, form: str, example: str, holds: Callable[..., bool] | None = None, option: str = ""
) -> list[float]:
    """The numbers of a form such as ``X,Y``; UsageError if it is not so, or out of range."""
    try:
        values = [float(part) for part in word.split(",")]
    except ValueError:
        values = []
    is_whole = len(values) == form.count(",") + 1 and all(map(math.isfinite, values))
    if not is_whole or (holds and not holds(*values)):
        problem = f"{short_repr(word)} is not {form}"
        raise UsageError(problem, f"give, for example, {example}", option=option)
    return values


def area(word: str) -> tuple[int, ...] | str:
    """Parse ``X,Y``, a box ``X0,Y0,X1,Y1``, or the name of a file with a mask."""
    if not re.fullmatch(r"[-+.\d\s]*,[-+.,\d\s]*", word):
        return word
    is_box = word.count(",") == _BOX_COMMAS
    form = ("X0,Y0,X1,Y1", "0,0,320,240") if is_box else ("X,Y", "320,240")
    return tuple(map(int, numbers(word, *form, _are_indices)))


def _listed_points(options: groups.KnownDepthOptions) -> tuple[Anchor, ...]:
    for name in ("anchors_scale", "anchors_kind", "baseline", "extrinsics"):
        if getattr(options, name) is not None:
            raise UsageError("", f"{{{name}}} is for {{anchors}}: give both or neither")
    if getattr(options, "anchors_fit", None) and not options.anchor:
        raise UsageError("", "{anchors_fit} is for {anchors} and {anchor}: give one of them")
    return tuple(map(_point, options.anchor or ()))


def _point(word: str) -> Anchor:
    def holds(x: float, y: float, depth_m: float) -> bool:
        return _are_indices(x, y) and bool(DEPTH_M.holds(depth_m))

    x, y, depth_m = numbers(word, "X,Y,METRES", "320,240,2.5", holds, "anchor")
    return Anchor(int(x), int(y), depth_m)


def size(word: str, option: str = "size") -> tuple[int, int]:
    """Parse a width and height such as ``640x480``; UsageError if it is no such."""
    sides = re.fullmatch(r"([1-9][0-9]{0,4})x([1-9][0-9]{0,4})", word)
    if sides is None:
        raise UsageError(f"{short_repr(word)} is not WIDTHxHEIGHT in pixels", option=option)
    return int(sides[1]), int(sides[2])


def fps(word: str, option: str = "fps") -> Fraction:
    """Parse a frame rate: ``24``, ``23.976`` or ``24000/1001``; UsageError if it is no such."""
    from depthcli.video.frames import parse_rate

    rate = parse_rate(word.strip())
    if rate is None:
        problem = f"{short_repr(word)} is not a frame rate such as 24, 23.976 or 24000/1001"
        raise UsageError(problem, option=option)
    return rate


_NORMALIZED = "png16 with --png-normalize or --png-inverse"
_RANGE_OPTIONS = {_NORMALIZED: Format.PNG16.facts.range_options}
OUTPUT_OPTIONS = {str(name): facts.options for name, facts in FORMATS.items()}
"""The options that each format uses, by parameter name."""


def unused_by_outputs(
    explicit: Mapping[str, str],
    formats: Iterable[str],
    writing: WriterOptions,
    used_by: Mapping[str, Collection[str]] = OUTPUT_OPTIONS,
) -> list[str]:
    """Warnings about options of other formats.

    Options of a profile, which serves several runs, are left out.
    """
    kinds = {*formats}
    if writing.is_normalized and kinds & {name for name in FORMATS if FORMATS[name].range_options}:
        kinds.add(_NORMALIZED)
    warnings, used = [], {**used_by, **_RANGE_OPTIONS}
    for name, word in explicit.items():
        users = [kind for kind, options in used.items() if name in options]
        if users and kinds.isdisjoint(users):
            warnings.append(f"{word} has no effect: it is for {', '.join(users)}")
    return warnings


_PROFILES = "depthcli.toml"
_MAX_PROFILE_BYTES = 2**20
_NOT_IN_PROFILES = frozenset({"help", "debug", "profile", "out"})


def profile_files() -> tuple[Path, ...]:
    """The files that may hold profiles; the first one that holds a name decides."""
    return Path(_PROFILES), user_folder("config") / _PROFILES


def read_profiles(path: Path) -> dict[str, dict[str, Any]]:
    """The profiles of a file by name; none if there is no such file."""
    import tomllib

    try:
        return tomllib.loads(read_regular(path, _MAX_PROFILE_BYTES).decode("utf-8-sig"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise UsageError(f"{path} is not TOML: {error}") from error


def profile_names() -> tuple[str, ...]:
    """Names of all profiles, sorted."""
    return tuple(sorted({name for path in profile_files() for name in read_profiles(path)}))


def apply_profile(context: Any, name: str) -> None:  # noqa: ANN401 - typer's own
    """Set a profile's options as the defaults of the current command."""
    tables = (read_profiles(path).get(name) for path in profile_files())
    values = next((table for table in tables if table is not None), None)
    if values is None:
        there = ", ".join(profile_names()) or f"none in {' and '.join(map(str, profile_files()))}"
        raise UsageError(f"no profile named {name!r}; there are: {there}")
    parameters, defaults = _options_of(context.command), {}
    for key, value in values.items():
        if key in parameters:
            if isinstance(value, bool) and not parameters[key].is_flag:
                raise UsageError(f"profile {name!r}: {key} takes a value, not true or false")
            listed = value if isinstance(value, list) or not parameters[key].multiple else [value]
            if parameters[key].name == "formats":  # without those of other commands
                of_any, of_own = {*Format, *VideoFormat}, parameters[key].type.choices
                listed = [word for word in listed if word in of_own or word not in of_any] or None
            defaults[str(parameters[key].name)] = listed
            continue
        names = {key for name in PROFILE_COMMANDS for key in _options_of(plain_command(name))}
        if key not in names:
            hint = suggestion(key, names, f"see '{PROGRAM} {context.info_name} --help'")
            raise UsageError(f"profile {name!r}: no option named {key!r}", hint)
    context.default_map = _Defaults(context, defaults)


class _Defaults(dict[str, Any]):
    """Defaults by parameter name, left out where the command line gives an alternative.

    Options on the command line are processed first, so they are known when a default is looked up.
    """

    def __init__(self, context: Any, values: dict[str, Any]) -> None:  # noqa: ANN401 - typer's own
        super().__init__(values)
        self._context = context

    def get(self, name: str, default: Any = None) -> Any:  # noqa: ANN401 - as dict has it
        """The default of a parameter that is not on the command line."""
        explicit = Given.of(self._context)
        others = {other for names in _EXCLUDING if name in names for other in names} - {name}
        if name == "formats" and "out" in explicit:  # whose name may select the format
            out = str(self._context.params.get("out"))
            others |= {"out"} if format_of(out) or video_format_of(out) else set()
        return super().get(name, default) if others.isdisjoint(explicit) else default


_EXCLUDING = (
    *ALTERNATIVES,
    ("rectified", "cameras", "focal_px", "hfov", "focal_35mm"),
    ("rectified", "centre_px"),
    ("colormap", "near"),
)  #: parameters of which one on the command line overrides the others of a profile


def _options_of(command: Any) -> dict[str, Any]:  # noqa: ANN401 - typer's own types
    """A command's options that a profile may hold, by name without leading dashes."""
    options = [p for p in command.params if p.param_type_name == "option"]
    named = {max(p.opts, key=len).removeprefix("--"): p for p in options}
    return {name: p for name, p in named.items() if name not in _NOT_IN_PROFILES}
