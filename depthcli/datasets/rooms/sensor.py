"""Simulated sensors: a camera for light, and a Kinect for depth."""

import cv2
import numpy as np
import numpy.typing as npt

from depthcli.datasets.rooms.patterns import Floats
from depthcli.datasets.rooms.render import View

_BASELINE_M, _RANGE_M = 0.075, (0.5, 9.5)
_SAME_SURFACE_PX = 1.5  # neighbours on a slanted surface differ by less in disparity


def photograph(light: Floats, random: np.random.Generator) -> npt.NDArray[np.uint8]:
    """A picture (H, W, 3) RGB uint8 of linear light: exposure, blur, tint, noise, gamma."""
    luma = np.einsum("hwc,c->hw", light, np.array([0.3, 0.6, 0.1], np.float32))
    middle = float(np.exp(np.log(luma + 1e-3).mean()))
    gamma = random.uniform(1.3, 2.1)
    exposed = light * (random.triangular(0.15, 0.38, 0.7) ** gamma / middle)
    exposed *= random.uniform(0.88, 1.12, 3).astype(np.float32)
    height, width = luma.shape
    sigma = min(random.exponential(0.25), 1.0) * width / 256
    if sigma > 0.15:
        exposed = np.asarray(cv2.GaussianBlur(exposed, (0, 0), sigma), np.float32)
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    exposed *= (1 - random.uniform(0, 0.3) * (x * x + y * y) / 2)[..., None].astype(np.float32)
    grain = random.exponential(0.012)
    noise = random.standard_normal(exposed.shape, np.float32)
    exposed += noise * grain * np.sqrt(np.maximum(exposed, 0) * 0.6 + 0.02)
    # Film and phone cameras compress highlights instead of clipping them.
    knee = np.clip(exposed, 0, None)
    knee = np.where(knee > 0.7, 0.7 + 0.3 * np.tanh((knee - 0.7) / 0.3), knee)
    encoded = knee ** (1 / gamma)
    levels: npt.NDArray[np.uint8] = np.rint(np.clip(encoded, 0, 1) * 255).astype(np.uint8)
    return levels


def kinect(view: View, focal_px: float, random: np.random.Generator) -> Floats:
    """Depth (H, W) in metres of a simulated structured-light sensor, 0 where it measures nothing.

    Noise increases with the square of the distance, disparity is quantized, edges are ragged, and
    there are holes in the projector's shadow (its baseline is 7.5 cm), on mirrors, black screens
    and grazing surfaces, and out of range. Source: Khoshelham and Elberink, Sensors 2012.
    """
    height, width = view.depth_m.shape
    rows, columns = np.mgrid[:height, :width]
    fray = random.normal(0, 0.6, (2, height, width)).round().astype(int)
    depth = view.depth_m[
        np.clip(rows + fray[0], 0, height - 1), np.clip(columns + fray[1], 0, width - 1)
    ]
    with np.errstate(divide="ignore"):
        disparity = (
            _BASELINE_M * focal_px / depth + random.normal(0, 0.05, depth.shape) * width / 640
        )
        step = width / 640 / 8
        measured = _BASELINE_M * focal_px / (np.round(disparity / step) * step)
    shadow = _projector_shadow(view.depth_m, focal_px)
    smooth = cv2.GaussianBlur(random.standard_normal((height, width)), (0, 0), 3) * 10
    weak = view.slant + 0.1 * smooth < 0.16
    shiny = (view.specular > 0.5) | ((view.specular > 0.03) & (smooth > 0))
    out = ~((measured >= _RANGE_M[0]) & (measured <= _RANGE_M[1])) | (view.depth_m == 0)
    return np.where(shadow | weak | shiny | out, 0, measured).astype(np.float32)


def _projector_shadow(depth_m: Floats, focal_px: float) -> npt.NDArray[np.bool_]:
    """(H, W) where a nearer point is on the same ray of the projector, left of the camera's."""
    rows, columns = np.indices(depth_m.shape)
    distance_m = np.where(depth_m > 0, depth_m, np.inf)  # the outdoors shades nothing
    disparity = _BASELINE_M * focal_px / distance_m
    place = columns - disparity + np.ceil(disparity.max())
    nearest = np.zeros((depth_m.shape[0], int(place.max()) + 2))
    for column in (np.floor(place), np.floor(place) + 1):
        np.maximum.at(nearest, (rows, column.astype(int)), disparity)
    lit_by = nearest[rows, np.rint(place).astype(int)]
    return np.asarray(lit_by > disparity + _SAME_SURFACE_PX, np.bool_)
