import numpy as np
import pytest
from helpers import plain_evaluator as plain
from helpers.small_set import HEIGHT, WIDTH, noisy, small_set

from depthcli.core.options import AUTO_TILE, Upsampling
from depthcli.core.types import DepthMap
from depthcli.errors import DatasetError
from depthcli.lab.evaluation.protocol import HEADLINE, EvalProtocol
from depthcli.lab.metrics.depth import PixelSums
from depthcli.lab.options import Alignment, Averaging, Crop, Mask

SMALL = (WIDTH, HEIGHT)


def test_headline_counts_the_full_frame_inside_the_range() -> None:
    depth_m = np.full((480, 640), 2.0, np.float32)
    depth_m[0, :4] = [0, 1e-3, 10, 11]
    truth = EvalProtocol().truth(depth_m)
    assert truth.depth_m.size == 480 * 640 - 4
    assert not truth.valid[0, :4].any()


@pytest.mark.parametrize(
    ("crop", "shape", "expected"),
    [
        (Crop.EIGEN, (480, 640), (45, 470, 41, 600)),
        (Crop.S2D, (240, 320), (6, 233, 8, 311)),  # the middle 304 by 228 pixels
    ],
)
def test_crops(crop: Crop, shape: tuple[int, int], expected: tuple[int, ...]) -> None:
    truth = EvalProtocol(crop=crop).truth(np.full((480, 640), 2.0, np.float32))
    (top, left), (bottom, right) = (end(np.nonzero(truth.valid), 1) for end in (np.min, np.max))
    assert (truth.valid.shape, (top, bottom, left, right)) == (shape, expected)
    assert truth.depth_m.size == (bottom - top + 1) * (right - left + 1)


def test_raw_mask_counts_measured_pixels() -> None:
    dataset = small_set()
    protocol = EvalProtocol(mask=Mask.RAW, full_size_px=SMALL)
    truth = protocol.truth(dataset.depths_m[0], dataset.raw_depths_m[0])
    filled = EvalProtocol(full_size_px=SMALL).truth(dataset.depths_m[0])
    np.testing.assert_array_equal(truth.valid, filled.valid & (dataset.raw_depths_m[0] > 0))
    assert truth.depth_m.size < filled.depth_m.size


def test_truth_and_raw_depth_have_to_have_the_full_size() -> None:
    ones = np.ones((HEIGHT, WIDTH), np.float32)
    with pytest.raises(DatasetError):
        EvalProtocol().truth(ones)
    with pytest.raises(DatasetError):
        EvalProtocol(mask=Mask.RAW, full_size_px=SMALL).truth(ones, np.ones((2, 2), np.float32))
    assert EvalProtocol(full_size_px=None).truth(np.ones((3, 5), np.float32)).valid.all()


def test_comparison_at_another_size_equals_the_plain_loop() -> None:
    dataset = small_set()
    protocol = EvalProtocol(compare_px=(9, 9), full_size_px=SMALL)
    depth_m = dataset.depths_m[1]
    predicted = noisy(dataset)["0001"]
    truth = protocol.truth(depth_m)
    pixels = protocol.compare(DepthMap(predicted), truth, Alignment.NONE)

    inside = (depth_m > 1e-3) & (depth_m < 10)
    maps = (plain.bilinear(values, 9, 9) for values in (depth_m, predicted))
    pairs = plain.compare(*maps, valid=plain.bilinear(inside, 9, 9) > 1 - 1e-6)
    assert 0 < len(pairs[0]) < 81
    expected = plain.metrics(pairs)
    for name, value in PixelSums.of(pixels).scores().items():
        assert value == pytest.approx(expected[name], rel=2e-6, abs=1e-6), name


def test_no_invalid_pixel_is_blended_into_a_smaller_truth() -> None:
    depth_m = np.full((HEIGHT, WIDTH), 4.0, np.float32)
    depth_m[5, 5] = 0
    truth = EvalProtocol(compare_px=(8, 6), full_size_px=SMALL).truth(depth_m)
    assert set(truth.depth_m.tolist()) == {4.0}
    assert truth.valid.sum() == 47


def test_infinity_stays_far_when_it_is_resized() -> None:
    protocol = EvalProtocol(full_size_px=SMALL)
    truth = protocol.truth(np.full((HEIGHT, WIDTH), 2.0, np.float32))
    predicted = np.full((6, 8), 3.0, np.float32)
    predicted[2, 2] = np.inf
    pixels = protocol.compare(DepthMap(predicted), truth, Alignment.NONE)
    assert pixels.predicted_m.min() == 3.0
    assert pixels.predicted_m.max() > 6.0


@pytest.mark.parametrize("alignment", list(Alignment))
def test_infinity_is_the_maximum_after_alignment_whatever_the_size(alignment: Alignment) -> None:
    protocol = EvalProtocol(full_size_px=SMALL)
    truth_m = np.linspace(1, 9, 192, dtype=np.float32).reshape(HEIGHT, WIDTH)
    predicted = 2 * truth_m
    predicted[:, -1] = np.inf
    for size in (1, 2):
        values = np.kron(predicted, np.ones((size, size), np.float32))
        truth = protocol.truth(truth_m)
        pixels = protocol.compare(DepthMap(values), truth, alignment).predicted_m
        assert (pixels.reshape(HEIGHT, WIDTH)[:, -1] == 10).all()


@pytest.mark.parametrize(
    ("variant", "name"),
    [
        (EvalProtocol(averaging=Averaging.POOLED), "pooled average"),
        (EvalProtocol(crop=Crop.EIGEN), "eigen crop"),
        (EvalProtocol(mask=Mask.RAW), "raw-valid mask"),
        (EvalProtocol(compare_px=(256, 192)), "compared at 256×192"),
        (EvalProtocol(full_size_px=None), "native size"),
        (EvalProtocol(min_m=0.5), "min 0.5 m"),
        (EvalProtocol(max_m=80), "max 80 m"),
        (EvalProtocol(upsampling=Upsampling.GUIDED), "guided upsampling"),
        (EvalProtocol(tile_px=320), "tiles of 320 px"),
        (EvalProtocol(tile_px=AUTO_TILE), "tiles of 3/4 of the width"),
    ],
)
def test_no_variant_passes_for_the_headline(variant: EvalProtocol, name: str) -> None:
    assert variant.name == name
    assert variant != HEADLINE
