"""The Python API used as its page says: images in, depth maps out, nonsense refused in a line."""

import math
import warnings
import weakref
from collections.abc import Iterator
from fractions import Fraction
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.tiny import synthetic_image, write_image, write_model
from helpers.videos import encode, write_depth_video, write_video
from PIL import Image

import depthcli
from depthcli.api.depth_map import CAMERA, SaveOptions
from depthcli.core.options import DepthFit
from depthcli.io.depth.read import read_metadata
from depthcli.io.formats.table import WriterOptions, names_of

PIXELS = synthetic_image()


@pytest.fixture
def model(tmp_path: Path) -> depthcli.DepthModel:
    """Bright is far; learned 60° across."""
    folder = write_model(tmp_path / "kinect", camera={"hfov_deg": 60.0})
    return depthcli.load_model(folder, provider="cpu", threads=1)


@pytest.fixture
def depth(model: depthcli.DepthModel) -> depthcli.DepthMap:
    """Of the synthetic image, 64×48, by a lens of 80 pixels."""
    return model.predict(PIXELS, focal_px=80)


def metric(values: list[list[float]], **known: Any) -> depthcli.DepthMap:
    return depthcli.DepthMap(np.array(values, np.float32), provenance=depthcli.Provenance(**known))


# Images


def test_ways_to_give_an_image_give_one_depth(model: depthcli.DepthModel, tmp_path: Path) -> None:
    path = write_image(tmp_path / "room.png")
    data = path.read_bytes()
    expected = model.predict(depthcli.read_image(path)).values
    with Image.open(path) as opened:
        ways: list[Any] = [
            path,
            str(path),
            data,
            bytearray(data),
            memoryview(data),
            BytesIO(data),
            PIXELS,
            PIXELS[..., ::-1].copy()[..., ::-1],  # as OpenCV's images come when they are turned
            np.asfortranarray(PIXELS),
            np.dstack([PIXELS, np.full((48, 64), 255, np.uint8)]),  # opaque
            depthcli.Frame(PIXELS),
            opened,
            Image.fromarray(PIXELS),
            Image.fromarray(PIXELS).convert("RGBA"),
        ]
        for way in ways:
            np.testing.assert_array_equal(model.predict(way).values, expected)
    floats = [model.predict((PIXELS / 255).astype(kind)).values for kind in ("f4", "f8")]
    np.testing.assert_array_equal(*floats)
    (streamed,) = model.predict_many([BytesIO(data)])
    np.testing.assert_array_equal(streamed.values, expected)


def test_a_path_is_never_fetched(model: depthcli.DepthModel) -> None:
    with pytest.raises(depthcli.InputError, match="cannot be reached"):
        model.predict("http://127.0.0.1:9/a.png")
    with pytest.raises(depthcli.InputError, match="no such file"):
        model.predict(Path("http://127.0.0.1:9/a.png"))


def test_white_can_be_below_the_maximum(model: depthcli.DepthModel, tmp_path: Path) -> None:
    low = np.random.default_rng(0).integers(0, 1024, (48, 64), np.uint16)
    path = tmp_path / "a.png"
    Image.fromarray(low).save(path)
    expected = model.predict(np.rint(low * (65535 / 1023)).astype(np.uint16))
    ways: list[Any] = [path, path.read_bytes(), low, Image.fromarray(low)]
    for way in ways:
        scaled = model.predict(way, white_level=1023)
        np.testing.assert_array_equal(scaled.values, expected.values)
    for scaled in model.predict_many(ways, white_level=1023):
        np.testing.assert_array_equal(scaled.values, expected.values)
    gray = np.asarray(low // 4, np.uint8)
    assert (model.predict(gray, white_level=9).values == model.predict(gray).values).all()
    read = depthcli.read_image(path, white_level=1023)
    np.testing.assert_array_equal(model.predict(read).values, expected.values)
    with pytest.raises(depthcli.UsageError):
        model.predict(read, white_level=1023)
    for use in (model.predict, model.predict_many):
        with pytest.raises(depthcli.UsageError):
            use([low], white_level=0)


def test_warnings_are_issued_at_the_caller(model: depthcli.DepthModel, tmp_path: Path) -> None:
    dark = np.random.default_rng(0).integers(0, 1000, (48, 64), np.uint16)
    path = tmp_path / "a.png"
    Image.fromarray(dark).save(path)
    advice = "of 65535.*white_level"
    for way in (path, dark):
        with pytest.warns(depthcli.DepthcliWarning, match=advice) as caught:
            model.predict(way)
        assert [warning.filename for warning in caught] == [__file__]
    with pytest.warns(depthcli.DepthcliWarning, match=advice) as caught:
        list(model.predict_many([path, dark], workers=2))
    assert [str(warning.message).partition(":")[0] for warning in caught] == [str(path), "an image"]
    assert {warning.filename for warning in caught} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict(dark, white_level=999)


def test_a_focal_length_that_scales_nothing_is_a_warning(tmp_path: Path) -> None:
    plain = depthcli.load_model(write_model(tmp_path / "plain"), provider="cpu", threads=1)
    for use in (plain.predict, lambda one, **options: next(plain.predict_many([one], **options))):
        with pytest.warns(depthcli.DepthcliWarning, match="does not scale depth") as caught:
            found = use(PIXELS, focal_px=80)
        assert [one.filename for one in caught] == [__file__]
        assert found.to_points().xyz_m.shape == (48 * 64, 3)
        assert found.focal_px == 80
    plain.predict(PIXELS, focal_px=80, anchors=[(3, 4, 2.0)])


@pytest.mark.parametrize(
    "image",
    [
        *("missing.png", b"", b"no image", None, 3.5, object(), StringIO("text")),
        *(PIXELS.astype(np.float64), PIXELS.astype(np.float32)),
        *(PIXELS.transpose(2, 0, 1), PIXELS[None], Image.new("I", (4, 4))),
    ],
)
def test_invalid_image_is_refused_in_one_line(image: Any, model: depthcli.DepthModel) -> None:
    with pytest.raises(depthcli.InputError) as caught:
        model.predict(image)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "options",
    [
        *({"focal_px": -400}, {"focal_px": 400, "hfov_deg": 60}, {"hfov_deg": 190}),
        *(
            {"anchors": anchors}
            for anchors in (
                *([(3, 4)], (), [(math.inf, 4, 2)], [(3, 4, "far")], [(3, 4, -2)], [(64, 4, 2)]),
                *(np.zeros((0, 3)), np.zeros((5, 4), int), np.zeros(3), np.ones((5, 4))),
                *(np.array([[np.nan, 4, 1]]), np.zeros((48, 64)), [(3, 4, 1e-300)]),
            )
        ),
    ],
)
def test_a_camera_or_anchors_without_sense_are_refused(
    options: dict[str, Any], model: depthcli.DepthModel
) -> None:
    refused = depthcli.UsageError, depthcli.InputError  # the latter may fit the next image
    with pytest.raises(refused):
        model.predict(PIXELS, **options)
    with pytest.raises(refused):
        list(model.predict_many([PIXELS], **options))


# Streams


def stream(count: int, alive: list[weakref.ref[Any]], most: list[int]) -> Iterator[np.ndarray]:
    """Gray images of growing brightness; counts those that are still held somewhere."""
    for level in range(count):
        pixels = np.full((12, 16), level, np.uint8)
        frame = depthcli.Frame(pixels)
        alive.append(weakref.ref(pixels))
        most.append(sum(ref() is not None for ref in alive))
        del pixels
        yield frame
        del frame


@pytest.mark.parametrize("options", [{}, {"batch_size": 3}, {"workers": 2}])
def test_a_stream_stays_in_order_and_in_constant_memory(
    options: dict[str, int], model: depthcli.DepthModel
) -> None:
    alive: list[weakref.ref[Any]] = []
    most: list[int] = []
    for level, depth in enumerate(model.predict_many(stream(60, alive, most), **options)):
        assert depth.values == pytest.approx(1 + 8 * level / 255, abs=1e-4)
        del depth
    assert len(alive) == 60
    assert max(most) <= 12


def test_a_live_camera_is_never_read_ahead(model: depthcli.DepthModel) -> None:
    taken = []

    def camera() -> Iterator[np.ndarray]:
        for level in range(5):
            taken.append(level)
            yield np.full((12, 16), level, np.uint8)

    depths = model.predict_many(camera())
    assert taken == []
    next(depths)
    assert taken == [0]


STREAM_OPTIONS = [{"workers": 2}, {"batch_size": 3}, {"batch_size": 3, "workers": 2}]


@pytest.mark.parametrize("options", STREAM_OPTIONS)
@pytest.mark.parametrize(
    ("bad", "why"),
    [
        ([b"no image"], "not an image"),
        ([np.zeros((2, 2), bool)], "bool"),
        ([PIXELS[:5, :5]], "outside"),
        ([], "the camera is gone"),
    ],
)
def test_maps_before_an_error_are_not_lost(
    bad: list[Any], why: str, options: dict[str, int], model: depthcli.DepthModel
) -> None:
    def images() -> Iterator[Any]:
        yield from [*[PIXELS] * 4, *bad]
        raise OSError("the camera is gone")

    folder = model.pipeline.session.model.path.parent
    model = depthcli.load_model(folder, provider="cpu")
    depths = model.predict_many(images(), anchors=[(60, 40, 2.0)], **options)
    for _ in range(4):
        next(depths)
    with pytest.raises((OSError, depthcli.DepthcliError), match=why):
        next(depths)


def test_damage_of_a_video_is_a_warning(tmp_path: Path) -> None:
    path = write_video(tmp_path / "walk.mkv", [PIXELS] * 20)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with depthcli.VideoSource(path) as video:
            assert len(list(video.frames())) == 20
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with depthcli.VideoSource(path) as video:
        with pytest.warns(depthcli.DepthcliWarning, match=r"walk\.mkv: it is truncated") as caught:
            assert len(list(video.frames())) < 20
        assert [warning.filename for warning in caught] == [__file__]
        with pytest.raises(depthcli.UsageError):
            next(video.frames())
    bright = encode(
        tmp_path / "hdr.mkv", [PIXELS] * 2, Fraction(25), "ffv1", "yuv420p", transfer=16
    )
    with pytest.warns(depthcli.DepthcliWarning, match=r"hdr\.mkv: .*high dynamic range") as caught:
        depthcli.VideoSource(bright).close()
    assert [warning.filename for warning in caught] == [__file__]


@pytest.mark.parametrize(("scale", "limit"), [(4000, 10), (-4000, 0.5)])
def test_a_model_in_another_unit_gives_a_warning(
    tmp_path: Path, scale: float, limit: float
) -> None:
    changed = write_model(tmp_path / "mm", output__scale=scale, output__shift=1.25 * scale)
    millimetres = depthcli.load_model(changed, provider="cpu")
    advice = f"100% of the pixels are at {limit:g} m, an end of the range of the model"
    with pytest.warns(depthcli.DepthcliWarning, match=advice):
        millimetres.predict(PIXELS)
    with pytest.warns(depthcli.DepthcliWarning, match=advice):
        list(millimetres.predict_many([PIXELS]))


def test_errors_name_parameters_of_python(tmp_path: Path) -> None:
    folder, large = write_model(tmp_path / "m"), np.zeros((400, 600), np.uint8)
    tight = depthcli.load_model(
        folder, provider="cpu", detail=depthcli.UpsamplingOptions(tile_px=2)
    )
    for use in (tight.predict, lambda one: list(tight.predict_many([one]))):
        with pytest.raises(depthcli.InputError) as error:
            use(large)
        assert "--" not in str(error.value)
    depth = depthcli.load_model(folder, provider="cpu").predict(PIXELS)
    with pytest.warns(depthcli.DepthcliWarning, match="give focal_px or hfov_deg"):
        depth.save(tmp_path / "a.glb")
    write_image(tmp_path / "a.png")
    with pytest.raises(depthcli.OutputError, match="path, or replace it with overwrite=True"):
        depth.save(tmp_path / "a.png")
    with pytest.raises(depthcli.UsageError):
        depthcli.load_model(folder, provider_options={"a": "b"})


# Facts


def test_a_map_tells_where_it_came_from(depth: depthcli.DepthMap) -> None:
    assert (depth.model, depth.focal_px, depth.anchors) == ("tiny", 80, ())
    assert repr(depth).startswith("<DepthMap 64×48, metric, ")
    assert len(repr(depth)) < 80
    assert np.shares_memory(np.asarray(depth), depth.values)


def test_models_and_frames_are_one_line_at_a_prompt(model: depthcli.DepthModel) -> None:
    assert repr(model) == "<DepthModel tiny 1.0.0, cpu>"
    gray = depthcli.Frame(np.zeros((3, 4), np.uint16), Path("a.png"))
    assert repr(gray) == "<Frame 4×3, gray uint16, a.png>"
    assert repr(depthcli.Frame(np.zeros((3, 4, 3), np.uint8))) == "<Frame 4×3, RGB uint8>"


def test_the_focal_length_scales_metres(model: depthcli.DepthModel) -> None:
    once, twice = (model.predict(PIXELS, focal_px=focal) for focal in (50, 100))
    assert twice.values == pytest.approx(2 * once.values, rel=1e-5)
    learned_px = 32 / math.tan(math.radians(30))
    assert model.predict(PIXELS, focal_px=learned_px).values == pytest.approx(
        model.predict(PIXELS, hfov_deg=60).values, rel=1e-5
    )


def test_anchors_are_fitted_and_kept(model: depthcli.DepthModel) -> None:
    points = [(8, 10, 3.0), (50, 20, 7.0)]
    depth = model.predict(PIXELS, anchors=points)
    listed = model.predict(PIXELS, anchors=np.array(points).tolist())
    np.testing.assert_array_equal(depth.values, listed.values)
    for x, y, depth_m in points:
        assert depth.values[y, x] == pytest.approx(depth_m, rel=0.1)
    assert depth.anchors == tuple(points)
    assert depth.frame is not None
    again = model.predict(PIXELS).fit_anchors([depthcli.Anchor(*point) for point in points])
    np.testing.assert_array_equal(again.values, depth.values)


def test_many_anchors_are_a_table_or_a_map(model: depthcli.DepthModel, tmp_path: Path) -> None:
    known_m = 2 * model.predict(PIXELS).values + 3
    sparse_m = np.where(np.arange(known_m.size).reshape(known_m.shape) % 7, 0, known_m)
    y, x = np.nonzero(sparse_m)
    np.save(tmp_path / "lidar.npy", sparse_m)
    table = np.stack([x, y, sparse_m[y, x]], 1)
    for anchors in (table, sparse_m, depthcli.read_depth(tmp_path / "lidar.npy")):
        depth = model.predict(PIXELS, anchors=anchors)
        np.testing.assert_allclose(depth.values, known_m, rtol=1e-4)
        residual_m = pytest.approx(0, abs=1e-4)
        assert depth.anchor_fit == depthcli.AnchorFit(len(x), len(x), residual_m, DepthFit.LOCAL)
        assert len(depth.anchors) == (len(x) if anchors is table else 0)
        (same,) = model.predict_many([PIXELS], anchors=anchors)
        np.testing.assert_array_equal(same.values, depth.values)
    for anchors in (table * (1, 1, 1000), sparse_m * 1000):
        with pytest.warns(depthcli.DepthcliWarning, match="another unit"):
            model.predict(PIXELS, anchors=anchors)
    gaps = np.concatenate([table, [[3, 4, np.nan], [5, 6, 0], [np.nan, 7, 2]]])
    with pytest.warns(depthcli.DepthcliWarning, match=f"3 of {len(gaps)}"):
        depth = model.predict(PIXELS, anchors=gaps)
    np.testing.assert_allclose(depth.values, known_m, rtol=1e-4)
    assert model.predict(PIXELS).anchor_fit is None
    relative = depthcli.DepthMap(known_m, depthcli.DepthKind.RELATIVE)
    with pytest.raises(depthcli.UsageError):
        model.predict(PIXELS, anchors=relative)


@pytest.mark.parametrize("options", [{}, *STREAM_OPTIONS])
def test_each_image_of_a_stream_has_its_own_anchors(
    options: dict[str, int], model: depthcli.DepthModel
) -> None:
    each = [[(8, 10, 3.0)], None, np.array([[8, 10, 7.0]])]
    depths = [*model.predict_many([PIXELS] * 3, anchors_each=iter(each), **options)]
    own_m = model.predict(PIXELS).values[10, 8]
    assert [depth.values[10, 8] for depth in depths] == pytest.approx([3, own_m, 7])
    with pytest.raises(ValueError, match="shorter"):
        list(model.predict_many([PIXELS] * 4, anchors_each=each, **options))
    with pytest.raises(depthcli.UsageError):
        model.predict_many([PIXELS], anchors=each[0], anchors_each=each)


def test_pixels_that_a_fit_erases_give_a_warning() -> None:
    values = np.float32([[math.nan, 1, 2, 3]])
    relative = depthcli.DepthMap(values, depthcli.DepthKind.RELATIVE)
    with pytest.warns(depthcli.DepthcliWarning, match=r"^1 pixels \(25 %\) are at or") as caught:
        depth = relative.fit_anchors([(2, 0, 1.0), (3, 0, 4.0)])
    assert caught[0].filename == __file__
    np.testing.assert_allclose(depth.values, [[math.nan, math.nan, 1, 4]], rtol=1e-6)


def test_files_read_have_nan_where_there_is_no_depth(tmp_path: Path) -> None:
    stored = [[0, -1, 2], [math.nan, math.inf, -math.inf]]
    np.save(tmp_path / "a.npy", np.float32(stored))
    metric(stored).save(tmp_path / "a.exr")
    for name in ("a.npy", "a.exr"):
        values = depthcli.read_depth(tmp_path / name).values
        np.testing.assert_array_equal(values, np.float32([[math.nan] * 2 + [2], [math.nan] * 3]))
    relative = depthcli.DepthMap(np.float32(stored), depthcli.DepthKind.RELATIVE)
    relative.save(tmp_path / "r.exr")
    values = depthcli.read_depth(tmp_path / "r.exr").values
    np.testing.assert_array_equal(values, np.float32([stored[0], [math.nan] * 3]))


def test_numbers_of_files_read_mean_what_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.full((2, 3), 512.0, np.float32))
    camera = {"png_scale": 256, "focal_px": 100, "baseline_m": 0.5}
    assert depthcli.read_depth(path, kind="disparity", **camera).values == pytest.approx(25)
    depth = depthcli.read_depth(path, kind="inverse", png_scale=1024)
    assert (depth.kind, depth.values.max()) == ("metric", 2)
    for words, error in (
        ({"kind": "nearness"}, depthcli.UsageError),
        ({"kind": "distance"}, depthcli.InputError),
    ):
        with pytest.raises(error):
            depthcli.read_depth(path, **words)


# Points


def test_points_by_another_camera() -> None:
    depth = metric([[2.0, 2.0]], focal_px=10.0)
    np.testing.assert_allclose(
        depth.to_points(focal_px=1, centre_px=(0, 0)).xyz_m, [[0, 0, 2], [2, 0, 2]]
    )
    np.testing.assert_allclose(
        depth.to_points(hfov_deg=90).xyz_m, [[-1, 0, 2], [1, 0, 2]], atol=1e-6
    )


def test_points_need_metres_and_a_camera() -> None:
    with pytest.raises(depthcli.UsageError):
        metric([[1.0]]).to_points()
    with pytest.raises(depthcli.UsageError):
        depthcli.DepthMap(np.ones((2, 2), np.float32), depthcli.DepthKind.INVERSE).to_points(
            focal_px=5
        )
    with pytest.raises(depthcli.UsageError):
        metric([[1.0]]).to_points(focal_px=5, hfov_deg=5)


# Files


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.npy", "A.EXR"])
def test_saved_map_is_read_back(name: str, depth: depthcli.DepthMap, tmp_path: Path) -> None:
    depth.save(tmp_path / "new" / name)
    read_back = depthcli.read_depth(str(tmp_path / "new" / name))
    assert read_back.values == pytest.approx(depth.values, abs=0.0005)
    if not name.endswith("npy"):
        assert (read_back.model, read_back.focal_px) == ("tiny", 80)


def points_of(path: Path) -> bytes:
    """The points of a PLY, without its header."""
    return path.read_bytes().partition(b"end_header\n")[2]


def test_bytes_and_open_files_hold_what_a_file_does(
    depth: depthcli.DepthMap, tmp_path: Path
) -> None:
    depth.save(tmp_path / "a.png", png_scale=256)
    expected = (tmp_path / "a.png").read_bytes()
    assert depth.to_bytes("png16", png_scale=256) == expected
    with (tmp_path / "b.png").open("wb") as file:
        depth.save(file, png_scale=256)
    assert (tmp_path / "b.png").read_bytes() == expected
    for use in (lambda: depth.save(BytesIO()), lambda: depth.to_bytes("jpeg")):
        with pytest.raises(depthcli.UsageError):
            use()


def test_options_of_a_file(depth: depthcli.DepthMap, tmp_path: Path) -> None:
    depth.save(tmp_path / "a.png", png_scale=256)
    assert read_metadata(tmp_path / "a.png")["scale"] == "256"
    depth.save(tmp_path / "a.exr", exr_channel="depth.Z", half=True)
    assert depthcli.read_depth(tmp_path / "a.exr").values == pytest.approx(depth.values, rel=1e-3)
    with pytest.warns(depthcli.DepthcliWarning):  # of pixels beyond
        depth.save(tmp_path / "a.png", png_inverse=True, vmin=0.5, vmax=4)
    assert read_metadata(tmp_path / "a.png")["range"] == "0.25 2"
    clouds = []
    for name, centre_px in (("c.ply", None), ("d.ply", (0.0, 0.0))):
        with warnings.catch_warnings():  # of the assumed camera
            warnings.simplefilter("ignore")
            depth.save(tmp_path / name, centre_px=centre_px)
        clouds.append(points_of(tmp_path / name))
    assert len(clouds[0]) == len(clouds[1])
    assert clouds[0] != clouds[1]
    depth.save(tmp_path / "e.png", centre_px=(0.0, 0.0))
    again = depthcli.read_depth(tmp_path / "e.png")
    assert (again.centre_px, depth.centre_px) == ((0, 0), None)
    np.testing.assert_array_equal(
        again.to_points(focal_px=9).xyz_m, again.to_points(focal_px=9, centre_px=(0, 0)).xyz_m
    )
    for name in ("f.png", "f.exr"):
        depth.save(tmp_path / name, hfov_deg=90)
        again = depthcli.read_depth(tmp_path / name)
        assert (again.focal_px, again.camera_source) == (depth.width / 2, "option")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing is assumed
        depth.save(tmp_path / "f.ply", focal_px=9)
        depth.save(tmp_path / "g.ply", focal_px=18)
    narrow, wide = (points_of(tmp_path / name) for name in ("g.ply", "f.ply"))
    assert (len(narrow) == len(wide), narrow != wide) == (True, True)
    with pytest.raises(depthcli.UsageError):
        depth.save(tmp_path / "b.npy", focal_px=9)
    with pytest.raises(depthcli.UsageError):
        depth.save(tmp_path / "b.png", focal_px=9, hfov_deg=60)
    with pytest.raises(depthcli.UsageError):
        depth.save(tmp_path / "b.png", half=True)
    with pytest.raises(depthcli.UsageError):
        depth.save(tmp_path / "b.png", vmin=0.5)
    with pytest.raises(depthcli.UsageError):
        depth.save(tmp_path / "b.jpg")
    assert not list(tmp_path.glob("b.*"))


def test_a_file_is_whole_or_not_there(depth: depthcli.DepthMap, tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file, no folder")
    with pytest.raises(depthcli.OutputError):
        depth.save(tmp_path / "a" / "b.png")
    relative = depthcli.DepthMap(depth.values, depthcli.DepthKind.RELATIVE)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(depthcli.DepthcliError, match="needs metres"):
        relative.save(tmp_path / "a.ply")
    assert sorted(tmp_path.iterdir()) == before


def test_the_image_itself_is_never_replaced(model: depthcli.DepthModel, tmp_path: Path) -> None:
    path = write_image(tmp_path / "room.png")
    data = path.read_bytes()
    with pytest.raises(depthcli.OutputError):
        model.predict(path).save(path, overwrite=True)
    of_memory = metric([[1.0, 2.0]])
    with pytest.raises(depthcli.OutputError):  # of another program
        of_memory.save(path)
    assert path.read_bytes() == data
    of_memory.save(path, overwrite=True)
    assert path.read_bytes() != data


def test_frames_of_a_depth_video_have_the_same_methods(tmp_path: Path) -> None:
    write_depth_video(tmp_path / "a.mkv", [np.full((4, 6), 1.5, np.float32)])
    (depth,) = depthcli.DepthVideo(tmp_path / "a.mkv")
    with pytest.raises(depthcli.InputError):
        depthcli.read_depth(tmp_path / "a.mkv")
    assert depth.to_points(focal_px=6).xyz_m[:, 2] == pytest.approx(1.5)


# Images for people


def test_colours_are_warm_where_it_is_near(depth: depthcli.DepthMap) -> None:
    colours = depth.colorize()
    assert (colours.shape, colours.dtype) == ((48, 64, 3), np.uint8)
    assert colours[:, 0].mean() > colours[:, -1].mean()
    assert depth.colorize("gray", near="black")[0, 0].mean() < 10
    assert depth.colorize(legend=True).shape[1] > 64
    with pytest.raises(depthcli.UsageError):
        depth.colorize("jet")
    with pytest.raises(depthcli.UsageError):
        depth.colorize("gray", near="cold")
    with pytest.raises(depthcli.UsageError):
        depth.save("a.stereo.png", stereo_layout="cold")


def test_save_types_each_option_of_the_formats() -> None:
    assert set(SaveOptions.__annotations__) == {*names_of(WriterOptions), *CAMERA}
