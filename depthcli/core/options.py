"""Choices for options of depth maps and models; safe texts; no numpy, for the help."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, TypeVar

from depthcli.errors import InputError, UsageError

_Choice = TypeVar("_Choice", bound=StrEnum)


class Rule(NamedTuple):
    """A constraint on a value besides its type."""

    what: str  #: what the value has to be, for messages
    holds: Callable[[Any], object]  #: whether a value satisfies it
    is_finite: bool = True  #: whether not-a-number and infinity are refused before


def chosen(kind: type[_Choice], value: str, what: str) -> _Choice:
    """A value as one of an enumeration; UsageError, which says what it is, if it is none."""
    if value not in tuple(kind):
        raise UsageError(f"{what} is {' or '.join(kind)}, not {short_repr(value)}")
    return kind(value)


def suggestion(word: str, names: Iterable[str], otherwise: str = "") -> str:
    """Advice about an unknown name: a similar one, or what to do otherwise."""
    from difflib import get_close_matches  # noqa: PLC0415 - for errors only

    close = get_close_matches(word, names)
    return f"did you mean {close[0]!r}?" if close else otherwise


class Upsampling(StrEnum):
    """Upsampling of depth from the network's size to the image's."""

    GUIDED = "guided"  #: edges follow those of the image
    BILINEAR = "bilinear"  #: bilinear interpolation; the image is not used
    MODEL = "model"  #: as the model's authors do, if its card says; else bilinear


class DepthMask(StrEnum):
    """Which pixels get no depth."""

    NONE = "none"  #: none that the network gives one
    MODEL = "model"  #: those that the network's own mask excludes, such as sky


class Colormap(StrEnum):
    """Colormaps of a preview."""

    INFERNO = "inferno"
    TURBO = "turbo"
    MAGMA = "magma"
    VIRIDIS = "viridis"
    SPECTRAL = "spectral"
    GRAY = "gray"


class Near(StrEnum):
    """Colour of near depth in a preview."""

    WARM = "warm"  #: the warm end of the colormap, or its bright one
    WHITE = "white"
    BLACK = "black"


class Eye(StrEnum):
    """A view of a stereo image or video."""

    LEFT = "left"
    RIGHT = "right"


class DepthEncoding(StrEnum):
    """Meaning of the numbers in a depth file."""

    METRIC = "metric"  #: depth along the camera axis
    DISTANCE = "distance"  #: distance from the camera, along the ray of each pixel
    RELATIVE = "relative"  #: depth up to an unknown scale and shift; larger is farther
    INVERSE = "inverse"  #: 1/depth: of metres if the scale is given, else up to scale and shift
    DISPARITY = "disparity"  #: displacement between rectified images in pixels; needs a baseline


MILLIMETRES = 1000.0  #: default units per metre of 16-bit depth
AUTO_TILE = 0  #: stands for tiles of 3/4 of the image's width; see docs/sharpness.md
GPU_BATCH = 8  #: batch size of the network on other providers than the CPU
MAX_PIXELS = 250_000_000  #: larger images are refused, unless another limit is given


class SceneLayout(StrEnum):
    """Programs that reconstruct a scene, whose names of depth files are used."""

    GSPLAT = "3dgs"  #: 3D Gaussian splatting: inverse depth in ``a.png``
    COLMAP = "colmap"  #: dense maps in ``a.jpg.geometric.bin``


class DepthFit(StrEnum):
    """How depth is fitted to known points."""

    GLOBAL = "global"  #: by a scale and a shift of the whole map
    LOCAL = "local"  #: by these; from five points on, the rest is spread over the map
    NETWORK = "network"  #: by a model that takes the points, and the rest as above


@dataclass(frozen=True, slots=True)
class UpsamplingOptions:
    """Upsampling and tiling from a network's output to a full-size image."""

    upsampling: Upsampling = Upsampling.GUIDED  #: how depth gets the image's size
    #: width of tiles in pixels of the image; None for no tiles, 0 for 3/4 of its width
    tile_px: int | None = None
    mask: DepthMask = DepthMask.NONE  #: which pixels get no depth
    error: bool = False  #: whether the relative error that depth is expected to have is estimated

    def __post_init__(self) -> None:
        upsampling = chosen(Upsampling, self.upsampling, "upsampling")
        object.__setattr__(self, "upsampling", upsampling)
        object.__setattr__(self, "mask", chosen(DepthMask, self.mask, "mask"))


DEFAULT_UPSAMPLING = UpsamplingOptions()  #: guided upsampling, no tiles
Detail = UpsamplingOptions  # its name until 0.17


def check_pixel_count(name: str, width: int, height: int, max_pixels: int) -> None:
    """Refuse an image by the size that its header claims, before any of it is decoded."""
    if width * height > max_pixels:
        problem = f"{name} claims {width}×{height} pixels, more than {max_pixels:,}"
        raise InputError(problem, "raise {max_pixels} if you trust the file")


WHITE_LEVEL = Rule("a whole number from 1 to 65535", lambda level: 1 <= level <= 0xFFFF)  # noqa: PLR2004
"""Values of white in 16-bit images."""
BLACK_LEVEL = Rule("a whole number from 0 to 65534", lambda level: 0 <= level < 0xFFFF)  # noqa: PLR2004
"""Values of black in 16-bit images."""
EXPOSURE = Rule("a number of stops from -20 to 20", lambda stops: abs(stops) <= 20)  # noqa: PLR2004
"""Exposures of images of linear light."""


class StereoLayout(StrEnum):
    """Arrangement of the views of two eyes."""

    SIDE_BY_SIDE = "side-by-side"  #: the left eye's view at the left
    TOP_BOTTOM = "top-bottom"  #: the left eye's view above
    HALF_SIDE_BY_SIDE = "half-side-by-side"  #: each squeezed to half of the width
    HALF_TOP_BOTTOM = "half-top-bottom"  #: each squeezed to half of the height
    ANAGLYPH = "anaglyph"  #: for glasses whose left side is red and whose right side is cyan


class Projection(StrEnum):
    """Mapping of directions to the pixels of an image."""

    PINHOLE = "pinhole"  #: straight lines stay straight, as in most photographs
    EQUIRECTANGULAR = "equirectangular"  #: columns are longitudes, rows latitudes: a panorama

    @property
    def is_other(self) -> bool:
        """Whether it is not that of a pinhole camera."""
        return self is not Projection.PINHOLE


class ReadOptions(NamedTuple):
    """Facts that the files of images do not state."""

    #: value of white in 16-bit integers; None for 65535, or what the file states
    white_level: int | None = None
    exposure: float = 0.0  #: stops by which linear light of an EXR is brightened
    layer: str | None = None  #: of an EXR, that is its image; None for the likeliest
    projection: Projection | None = None  #: None for a pinhole camera
    ignore_alpha: bool = False  #: whether transparent pixels are as good as others
    black_level: int = 0  #: value of black in 16-bit integers
    #: view of a stereo JPEG or video; None for the first image, and for whole frames
    eye: Eye | None = None


AS_STATED = ReadOptions()  #: what the files state, or the default


_MAX_CHARS = 60


def one_line(text: str) -> str:
    """Text with everything that is not printable escaped: file names may hold any byte."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def short_repr(value: object) -> str:
    """An untrusted value for a message: short, and of printable ASCII characters only."""
    text = one_line(ascii(value))  # that of a tensor has lines
    return text if len(text) <= _MAX_CHARS else f"{text[:_MAX_CHARS]}..."


INSTALL_RAY = "pip install 'depthcli[ray]'"
INSTALL_PYARROW = "pip install 'depthcli[parquet]'"
INSTALL_HEIF = "pip install 'depthcli[heif]'"
INSTALL_POINTS = "pip install 'depthcli[points]'"
INSTALL_USD = "pip install 'depthcli[usd]'"
INSTALL_FORMATS = "pip install 'depthcli[formats]'"
INSTALL_ROS = "pip install 'depthcli[ros]'"
INSTALL_CLOUD = "pip install 'depthcli[cloud]'"
