"""The evaluation protocol: how predictions and their edges are compared with ground truth."""

from dataclasses import dataclass, field

import numpy as np

from depthcli.core.imageops import resize_bilinear
from depthcli.core.options import AUTO_TILE, Upsampling
from depthcli.core.types import BoolArray, DepthKind, DepthMap, Float32Array, FloatArray
from depthcli.errors import DatasetError
from depthcli.lab.metrics.alignment import align
from depthcli.lab.metrics.boundary import BoundaryScores, boundary_scores
from depthcli.lab.metrics.depth import MAX_DEPTH_M, MIN_DEPTH_M, DepthPixels
from depthcli.lab.options import Alignment, Averaging, Crop, Mask

EIGEN_ROWS = slice(45, 471)
EIGEN_COLUMNS = slice(41, 601)
FULL_SIZE_PX = (640, 480)
S2D_PX = (320, 240)
_S2D_ROWS, _S2D_COLUMNS = slice(12, 468), slice(16, 624)
"""The middle of images of half the size.

Source: Ma and Karaman, "Sparse-to-Dense", ICRA 2018.
"""
_GARG_ROWS, _GARG_COLUMNS = (0.40810811, 0.99189189), (0.03594771, 0.96405229)
"""Shares of an image of KITTI.

Source: Garg et al., "Unsupervised CNN for Single View Depth Estimation", ECCV 2016.
"""

# A pixel interpolated from valid pixels only has weight one.
_MIN_VALID_WEIGHT = 0.9999
_MIN_INFINITE_WEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Truth:
    """The pixels of one image that are evaluated."""

    valid: BoolArray  #: (H, W) bool at the size at which depth is compared
    depth_m: Float32Array  #: (N,) float32, metres, the depth where ``valid``


@dataclass(frozen=True, slots=True)
class EvalProtocol:
    """An evaluation protocol; the defaults are the headline protocol."""

    averaging: Averaging = Averaging.IMAGE  #: per image or over pooled pixels
    crop: Crop = Crop.NONE  #: part of the frame that is evaluated
    mask: Mask = Mask.FILLED  #: pixels that have ground truth
    compare_px: tuple[int, int] | None = (
        None  #: (width, height) to resize both to; None for truth's
    )
    upsampling: Upsampling = Upsampling.BILINEAR  #: of the models' depth to the image's size
    tile_px: int | None = None  #: width of the models' tiles; None for no tiles, 0 for 3/4 of it
    full_size_px: tuple[int, int] | None = FULL_SIZE_PX  #: (width, height) of truth; None for any
    min_m: float = MIN_DEPTH_M  #: smallest depth evaluated, metres; predictions are clamped to it
    max_m: float = MAX_DEPTH_M  #: largest depth evaluated, metres; predictions are clamped to it
    #: also compute boundary metrics; this changes neither the other metrics nor the name
    boundary: bool = field(default=False, compare=False)

    @property
    def size_px(self) -> tuple[int, int] | None:
        """Width and height at which both are compared; None for truth's."""
        is_half = self.compare_px is None and self.crop is Crop.S2D
        return S2D_PX if is_half else self.compare_px

    @property
    def name(self) -> str:
        """Short name: "headline", or what differs from it."""
        tile = "3/4 of the width" if self.tile_px == AUTO_TILE else f"{self.tile_px} px"
        changes = [
            (self.averaging != HEADLINE.averaging, f"{self.averaging} average"),
            (self.crop != HEADLINE.crop, f"{self.crop} crop"),
            (self.mask != HEADLINE.mask, f"{self.mask}-valid mask"),
            (self.compare_px is not None, f"compared at {_size_text(self.compare_px)}"),
            (self.full_size_px != HEADLINE.full_size_px, _size_text(self.full_size_px)),
            (self.min_m != HEADLINE.min_m, f"min {self.min_m:g} m"),
            (self.max_m != HEADLINE.max_m, f"max {self.max_m:g} m"),
            (self.upsampling != HEADLINE.upsampling, f"{self.upsampling} upsampling"),
            (self.tile_px != HEADLINE.tile_px, f"tiles of {tile}"),
        ]
        return ", ".join(text for differs, text in changes if differs) or "headline"

    @property
    def description(self) -> str:
        """All choices in one line."""
        frame = "full frame" if self.crop is Crop.NONE else f"{self.crop} crop"
        filled = "known depth" if self.full_size_px is None else "in-filled depth"
        truth = filled if self.mask is Mask.FILLED else "raw-valid depth"
        average = "mean of images" if self.averaging is Averaging.IMAGE else "pooled pixels"
        size = _size_text(self.size_px or self.full_size_px)
        return f"{truth}, {frame} at {size}, {self.min_m:g} < g < {self.max_m:g} m, {average}"

    def truth(self, depth_m: Float32Array, raw_depth_m: Float32Array | None = None) -> Truth:
        """Select the pixels to evaluate, of depth and raw depth (H, W) in metres, 0 for none."""
        height, width = depth_m.shape
        if self.full_size_px is not None and (width, height) != self.full_size_px:
            message = f"the depth is {width}×{height}, not {_size_text(self.full_size_px)}"
            raise DatasetError(message, "give the data set at its full size")
        valid = (depth_m > self.min_m) & (depth_m < self.max_m)
        if raw_depth_m is not None:
            if raw_depth_m.shape != depth_m.shape:
                raise DatasetError(f"raw depth is {raw_depth_m.shape} but depth is {depth_m.shape}")
            valid &= raw_depth_m > 0
        if self.crop is not Crop.NONE:
            valid &= _crop(self.crop, depth_m.shape)
        if size_px := self.size_px:
            valid = resize_bilinear(valid.astype(np.float32), *size_px) > _MIN_VALID_WEIGHT
            depth_m = resize_bilinear(depth_m, *size_px)
        return Truth(valid, _select(depth_m, valid))

    def compare(self, depth: DepthMap, truth: Truth, alignment: Alignment) -> DepthPixels:
        """Resize a prediction of any size, select the valid pixels, align, and clamp."""
        height, width = truth.valid.shape
        values = depth.values
        if values.shape != truth.valid.shape:
            least_m = self.max_m if depth.kind is DepthKind.METRIC else -np.inf
            values = _resized(values, width, height, least_m)
        predicted: FloatArray = _select(values, truth.valid)
        turned = False
        if alignment is not Alignment.NONE or depth.kind is not DepthKind.METRIC:
            exact = predicted.astype(np.float64), truth.depth_m.astype(np.float64)
            predicted, turned = align(*exact, alignment, depth.kind)
        return DepthPixels(truth.depth_m, predicted, self.min_m, self.max_m, is_reversed=turned)


HEADLINE = EvalProtocol()


def compare_boundaries(pixels: DepthPixels, truth: Truth) -> BoundaryScores:
    """Boundary scores of a result of :meth:`EvalProtocol.compare` with the same ground truth."""
    truth_m, predicted_m = np.ones((2, *truth.valid.shape))
    truth_m[truth.valid], predicted_m[truth.valid] = pixels.truth_m, pixels.predicted_m
    return boundary_scores(truth_m, predicted_m, truth.valid)


def _resized(values: Float32Array, width: int, height: int, least: float) -> Float32Array:
    """Values at another size; infinite where most of the weight is that of infinite ones.

    Elsewhere, these count as the largest finite value, and at least as ``least``.
    """
    infinite = np.isposinf(values)
    if not infinite.any():
        return resize_bilinear(values, width, height)
    # Interpolation turns infinity times zero into NaN.
    largest = np.max(values, initial=least, where=np.isfinite(values))
    filled = np.where(infinite, np.float32(largest if np.isfinite(largest) else 0), values)
    resized = resize_bilinear(filled, width, height)
    weight = resize_bilinear(infinite.astype(np.float32), width, height)
    return np.where(weight > _MIN_INFINITE_WEIGHT, np.float32(np.inf), resized)


def _select(values: Float32Array, valid: BoolArray) -> Float32Array:
    """The valid values, (N,); without a copy if all are valid."""
    return values.ravel() if valid.all() else values[valid]


def _size_text(size_px: tuple[int, int] | None) -> str:
    return "native size" if size_px is None else f"{size_px[0]}×{size_px[1]}"


def _crop(crop: Crop, shape: tuple[int, ...]) -> BoolArray:
    inside = np.zeros(shape, np.bool_)
    part: tuple[slice, ...] = (EIGEN_ROWS, EIGEN_COLUMNS)
    if crop is Crop.S2D:
        part = (_S2D_ROWS, _S2D_COLUMNS)
    if crop is Crop.GARG:
        sides = zip((_GARG_ROWS, _GARG_COLUMNS), shape, strict=True)
        part = tuple(slice(int(low * size), int(high * size)) for (low, high), size in sides)
    elif shape[::-1] != FULL_SIZE_PX:
        raise DatasetError(f"the crop {crop} is defined at {_size_text(FULL_SIZE_PX)} only")
    inside[part] = True
    return inside
