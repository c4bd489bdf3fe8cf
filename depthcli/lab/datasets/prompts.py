"""Known depth as sensors give it: points, lidar lines and small depth cameras, drawn from a map."""

import re
from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from depthcli.core.options import short_repr
from depthcli.core.types import Float32Array, Float64Array, Int64Array
from depthcli.errors import UsageError

_Map = Float32Array
_Places = tuple[Int64Array, Int64Array]

Part = tuple[float, float, float, float]
"""Left, top, right and bottom of a part of an image, as fractions of it."""
WHOLE: Part = (0.0, 0.0, 1.0, 1.0)

_WRONG_RATIO = 1.2, 3.0  # of wrong to true depth, as seen past an edge
_NEARER = 0.25  # share of wrong points that are nearer by as much
_SLOPE = 0.1  # largest, of lidar lines
_LEAST_DENSITY = 0.3  # of the points of a lidar line
_EDGE, _EDGE_HOLES = 0.1, 0.7  # log ratio of neighbours at an edge, and share of them without depth
_CORNER_PX = 5
_FORM = re.compile(r"([a-z]+):([1-9]\d{0,6})((?:,(?:noise|wrong)=0?\.\d+)*)")


class Pattern(StrEnum):
    """Places of known depth in an image."""

    UNIFORM = "uniform"  #: points anywhere; the size is their number
    LIDAR = "lidar"  #: slanted lines; the size is their number
    CAMERA = "camera"  #: a depth camera, with holes at edges; the size is its columns
    CORNERS = (
        "corners"  #: corners of the image, as visual odometry tracks; the size is their number
    )


@dataclass(frozen=True, slots=True)
class Prompt:
    """What is known of the depth of an image, and with which errors."""

    pattern: Pattern  #: the places
    size: int  #: number of points, lines or columns
    noise: float = 0.0  #: standard deviation, relative to depth
    has_kinect_noise: bool = False  #: whether noise grows with distance, as Kinect's
    wrong: float = 0.0  #: share of points that are 1.2 to 3 times as far, or as near
    shift_px: tuple[float, float] = (0.0, 0.0)  #: columns and rows by which all points are off
    jitter_px: float = 0.0  #: standard deviation of further shifts of each point
    part: Part = WHOLE  #: the part of the image that has points
    range_m: float = 5.0  #: of a depth camera

    def __str__(self) -> str:
        errors = {"noise": self.noise, "wrong": self.wrong}
        suffix = "".join(f",{name}={share:g}" for name, share in errors.items() if share)
        return f"{self.pattern}:{self.size}{suffix}"

    def draw(self, depth_m: _Map, gray: _Map, random: np.random.Generator) -> _Map:
        """Draw known depth, (H, W) float32 metres, 0 where nothing is known.

        It is that of ``depth_m``, (H, W) metres, 0 or NaN for none, of the image ``gray`` (H, W).
        """
        height, width = depth_m.shape
        y, x = _PLACES[self.pattern](self, depth_m, gray, random)
        left, top, right, bottom = self.part
        inside = (x >= left * width) & (x < right * width)
        inside &= (y >= top * height) & (y < bottom * height)
        y, x = y[inside], x[inside]
        shift = np.array(self.shift_px)[:, None] + random.normal(0, self.jitter_px, (2, len(x)))
        columns, rows = np.rint(shift).astype(np.int64)
        seen_m = depth_m[(y + rows).clip(0, height - 1), (x + columns).clip(0, width - 1)]
        seen_m = self._with_errors(seen_m.astype(np.float64), random)
        sparse = np.zeros(depth_m.shape, np.float32)
        has_depth = np.isfinite(seen_m) & (seen_m > 0)
        sparse[y[has_depth], x[has_depth]] = seen_m[has_depth]
        return sparse

    def _with_errors(self, seen_m: Float64Array, random: np.random.Generator) -> Float64Array:
        # Kinect's: Nguyen, Izadi, Lovell: Modeling Kinect sensor noise for improved 3D
        # reconstruction and tracking. 3DIMPVT 2012.
        kinect_m = 0.0012 + 0.0019 * (seen_m - 0.4) ** 2
        noise_m = kinect_m if self.has_kinect_noise else self.noise * seen_m
        seen_m = seen_m + noise_m * random.standard_normal(len(seen_m))
        is_wrong = random.random(len(seen_m)) < self.wrong
        ratio = random.uniform(*_WRONG_RATIO, len(seen_m))
        ratio = np.where(random.random(len(seen_m)) < _NEARER, 1 / ratio, ratio)
        return np.where(is_wrong, seen_m * ratio, seen_m)


def _uniform(prompt: Prompt, depth_m: _Map, _gray: _Map, random: np.random.Generator) -> _Places:
    places = np.flatnonzero(depth_m > 0)
    chosen = random.choice(places, min(prompt.size, len(places)), replace=False)
    return np.divmod(chosen, depth_m.shape[1])


def _lidar(prompt: Prompt, depth_m: _Map, _gray: _Map, random: np.random.Generator) -> _Places:
    height, width = depth_m.shape
    slope, phase = random.uniform(-_SLOPE, _SLOPE), random.random()
    x, size = np.arange(width), prompt.size
    lines = (np.arange(size)[:, None] + phase) * height / size + slope * (x - width / 2)
    y, x = np.rint(lines).astype(np.int64).ravel(), np.tile(x, size)
    is_point = (y >= 0) & (y < height)
    is_point &= random.random(len(x)) < random.uniform(_LEAST_DENSITY, 1)
    return y[is_point], x[is_point]


def _camera(prompt: Prompt, depth_m: _Map, _gray: _Map, random: np.random.Generator) -> _Places:
    height, width = depth_m.shape
    columns = min(prompt.size, width)
    rows = max(1, round(columns * height / width))
    x = ((np.arange(columns) + 0.5) * width / columns).astype(np.int64)
    y = ((np.arange(rows) + 0.5) * height / rows).astype(np.int64)
    seen_m, around = depth_m[y[:, None], x], np.ones((3, 3), np.uint8)
    log_depth = np.log(np.where(seen_m > 0, seen_m, 1)).astype(np.float32)
    jump = np.asarray(cv2.morphologyEx(log_depth, cv2.MORPH_GRADIENT, around))
    is_hole = (jump > _EDGE) & (random.random(seen_m.shape) < _EDGE_HOLES)
    places = np.nonzero((seen_m > 0) & (seen_m < prompt.range_m) & ~is_hole)
    return y[places[0]], x[places[1]]


def _corners(prompt: Prompt, depth_m: _Map, gray: _Map, _random: np.random.Generator) -> _Places:
    response = np.asarray(cv2.cornerMinEigenVal(gray, _CORNER_PX))
    around = np.ones((_CORNER_PX, _CORNER_PX), np.uint8)
    is_corner = (response == np.asarray(cv2.dilate(response, around))) & (depth_m > 0)
    y, x = np.nonzero(is_corner)
    best = np.argsort(-response[y, x], kind="stable")[: prompt.size]
    return y[best], x[best]


_PLACES = {
    Pattern.UNIFORM: _uniform,
    Pattern.LIDAR: _lidar,
    Pattern.CAMERA: _camera,
    Pattern.CORNERS: _corners,
}


def parsed_prompt(text: str) -> Prompt:
    """A prompt of the form ``uniform:500`` or ``lidar:4,noise=0.02,wrong=0.25``."""
    form = _FORM.fullmatch(text)
    if form is None or form[1] not in tuple(Pattern):
        names = ":N, ".join(Pattern)
        advice = f"give {names}:N, and if needed ,noise=0.02 or ,wrong=0.25"
        raise UsageError(f"{short_repr(text)} is no pattern: {advice}")
    errors = dict(part.split("=") for part in form[3].split(",")[1:])
    noise, wrong = (float(errors.get(name, 0)) for name in ("noise", "wrong"))
    return Prompt(Pattern(form[1]), int(form[2]), noise, wrong=wrong)
