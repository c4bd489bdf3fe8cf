"""Bad images, files found by fuzzing, and variants of containers that programs write."""

import os
import shutil
import struct
import zlib
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from helpers import made
from helpers.bad_images import BAD, HEIGHT, JPEGS, PIXELS, WIDTH, encoded, reason, saved
from helpers.command_line import ROOT
from PIL import Image

from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.guard import is_own_image
from depthcli.io.images.opencv import IMAGE_SUFFIXES, can_round_trip
from depthcli.io.images.read import read_image
from depthcli.io.stored.depth import AS_STATED
from depthcli.lab.datasets.folders import read_image_rgb, read_truth
from robustness.fuzz import OF_LIBRARIES, file_of, problem
from robustness.fuzz_targets import TARGETS

FILES = {
    **JPEGS,
    "png": encoded(".png"),
    "tiff": encoded(".tiff"),
    "webp": encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80),
    "lossless webp": encoded(".webp"),
    "extended webp": saved("WEBP", exif=made.exif()),
    "avif": encoded(".avif"),
    "bmp": encoded(".bmp"),
    "gif": encoded(".gif"),
    "pnm": encoded(".ppm"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_image_is_refused_in_one_line(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert reason(BAD[name])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("share", [0.02, 0.2, 0.5, 0.8, 0.97])
def test_truncated_image_is_refused(
    name: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    assert reason(FILES[name][: int(len(FILES[name]) * share)])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", FILES)
def test_pixel_limit_holds_before_decoding(name: str) -> None:
    assert f"{WIDTH}×{HEIGHT}" in reason(FILES[name], max_pixels=WIDTH * HEIGHT - 1)
    assert read_image(None, FILES[name], max_pixels=WIDTH * HEIGHT).pixels.shape == PIXELS.shape


@pytest.mark.parametrize(
    ("name", "at", "form"),
    [("baseline", None, ">HH"), ("png", 16, ">II"), ("bmp", 18, "<II"), ("gif", 6, "<HH")],
)
def test_bombs_and_empty_images_are_refused(name: str, at: int | None, form: str) -> None:
    data = bytearray(FILES[name])
    at = data.index(b"\xff\xc0") + 5 if at is None else at
    struct.pack_into(form, data, at, 50_000, 50_000)
    assert "50000×50000" in reason(bytes(data))
    struct.pack_into(form, data, at, 0, 0)
    assert "0×0" in reason(bytes(data))


UNUSUAL = {
    "progressive restarts": saved("JPEG", restart_marker_rows=1, progressive=True),
    "several in one": saved("MPO", save_all=True, append_images=[Image.new("RGB", (8, 8))]),
    "padded before the end": JPEGS["baseline"][:-2] + b"padding" + b"\xff\xd9",
    "fill before a marker": b"\xff\xd8" + b"\xff" * 100_000 + JPEGS["baseline"][2:],
    "JPEG before other data": JPEGS["baseline"] + bytes(100_000),
    "JPEG with a thumbnail": made.jpeg_with_exif(JPEGS["baseline"], made.exif() + made.JPEG),
    "PNG before other data": encoded(".png") + bytes(100_000),
    **{
        f"TIFF of {coding}": saved("TIFF", compression=coding)
        for coding in ("tiff_lzw", "tiff_adobe_deflate", "tiff_deflate", "packbits", "jpeg")
    },
    "fax": saved("TIFF", "1", compression="group4"),
    "BigTIFF": saved("TIFF", big_tiff=True),
    **{
        f"PNM {kind} without a last line break": f"{kind} {WIDTH} {HEIGHT}{white}".encode()
        + b" 1" * (WIDTH * HEIGHT * channels)
        for kind, white, channels in (("P1", "", 1), ("P2", " 9", 1), ("P3", " 9", 3))
    },
    "unknown colour profile": saved("PNG", icc_profile=b"nothing that is known"),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_image_is_read_silently(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert read_image(None, UNUSUAL[name]).pixels.shape[:2] == (HEIGHT, WIDTH)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"quality": 30}])
def test_cmyk_jpeg_has_the_pixels_that_opencv_decodes(options: dict[str, object]) -> None:
    data = saved("JPEG", "CMYK", **options)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(read_image(None, data).pixels, expected)


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_opencv_reads_and_writes_each_format(suffix: str) -> None:
    assert can_round_trip(suffix)
    assert not can_round_trip(".none")


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/null", "/proc/kmsg", "/proc/self/status"])
def test_device_is_not_read(name: str) -> None:
    assert not is_own_image(name)
    with pytest.raises(InputError):
        read_image(name)


@pytest.mark.parametrize("name", ["a\0.png", "\ud800.png", "a" * 300])
def test_impossible_name_is_refused(name: str) -> None:
    assert not is_own_image(name)
    for read in (read_image, read_stored_depth):
        with pytest.raises(InputError):
            read(name)


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "a.png"
    os.mkfifo(pipe)
    assert not is_own_image(pipe)
    for read in (read_image, read_stored_depth):
        with pytest.raises(InputError):
            read(pipe)
    for read_pair in (read_image_rgb, lambda file: read_truth(file, AS_STATED)):
        with pytest.raises(DatasetError):
            read_pair(pipe)
    np.save(tmp_path / "a.npy", np.ones((4, 4), np.float32))
    os.mkfifo(tmp_path / "a.json")
    assert read_stored_depth(tmp_path / "a.npy").displayed.values.shape == (4, 4)


def test_hundred_megapixels_are_read(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    ok, data = cv2.imencode(".png", np.full((10_000, 10_000), 7, np.uint8))
    assert ok
    path.write_bytes(data.tobytes())
    frame = read_image(path)
    assert frame.pixels.shape == (10_000, 10_000)
    assert (frame.pixels[::999, ::999] == 7).all()


PALETTE = made.chunk(b"PLTE", bytes([255, 0, 0, 0, 255, 0, 10, 20, 30]))


def pixels(data: bytes) -> npt.NDArray[np.generic]:
    return read_image(None, data, ignore_alpha=True).pixels


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (made.png([b"\xa0"], 4, 1, 0), [[255, 0, 255, 0]]),
        (made.png([b"\x1b"], 4, 2, 0), [[0, 85, 170, 255]]),
        (made.png([b"\x0f\x70"], 4, 4, 0), [[0, 255, 119, 0]]),
        (made.png([b"\0\1\2"], 3, 8, 3, PALETTE), [[[255, 0, 0], [0, 255, 0], [10, 20, 30]]]),
        (
            made.png([b"\0\1\2"], 3, 8, 3, PALETTE, made.chunk(b"tRNS", b"\0\x80")),
            [[[255, 0, 0], [0, 255, 0], [10, 20, 30]]],
        ),
        (made.png([b"\x10\x00\x20\xff"], 2, 8, 4), [[[16] * 3, [32] * 3]]),
        (made.png([bytes([1, 2, 3, 0])], 1, 8, 6), [[[1, 2, 3]]]),
        (made.png([bytes(range(8))], 1, 16, 6), [[[0x0001, 0x0203, 0x0405]]]),
        (made.tiff(np.array([[0, 100, 255]], np.uint8), photometric=0), [[255, 155, 0]]),
    ],
)
def test_variants_decode_to_gray_or_rgb(data: bytes, expected: list[object]) -> None:
    np.testing.assert_array_equal(pixels(data), expected)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_tiff_stands_upright(dtype: type, channels: int, orientation: int) -> None:
    upright = np.arange(4 * 6 * channels).reshape(4, 6, channels)
    upright = (upright / 72).astype(dtype) if dtype is np.float32 else upright.astype(dtype)
    upright = upright[..., 0] if channels == 1 else upright
    frame = read_image(None, made.tiff(made.upright_to_stored(upright, orientation), orientation))
    np.testing.assert_array_equal(frame.pixels, upright)
    assert frame.orientation == orientation


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["PNG", "WEBP"])
def test_png_and_webp_stand_upright(kind: str, orientation: int, order: str) -> None:
    upright = np.random.default_rng(1).integers(0, 256, (4, 6, 3), np.uint8)
    stored = np.ascontiguousarray(made.upright_to_stored(upright, orientation))
    block = made.exif(orientation, focal_35mm=28, order=order)
    Image.fromarray(stored).save(file := BytesIO(), kind, lossless=True, exif=block)
    frame = read_image(None, file.getvalue())
    np.testing.assert_array_equal(frame.pixels, upright)
    assert (frame.orientation, frame.focal_35mm) == (orientation, 28)


def test_exif_after_other_segments_is_found() -> None:
    data = made.jpeg_with_exif(made.JPEG, made.exif(6, 50, ">"))
    xmp = b"\xff\xe1" + struct.pack(">H", 40) + b"http://ns.adobe.com/xap/1.0/\0".ljust(38)
    frame = read_image(None, data[:2] + xmp + data[2:])
    assert (frame.orientation, frame.focal_35mm) == (6, 50)


@pytest.mark.parametrize("orientation", [0, 9, 65535])
def test_orientations_that_do_not_exist_count_as_upright(orientation: int) -> None:
    assert read_image(None, saved("PNG", exif=made.exif(orientation))).orientation == 1


def test_orientation_survives_a_damaged_inner_directory() -> None:
    block = made.exif(8, focal_35mm=35)[:-10]
    frame = read_image(None, made.jpeg_with_exif(made.JPEG, block))
    assert (frame.orientation, frame.focal_35mm) == (8, None)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"P5 3 1 100\n\0\x32\x64", [[0, 128, 255]]),
        (b"P5 3 1 100\n\0\x32\xff", [[0, 128, 255]]),
        (b"P6 # red\n1 1\n# white\n15\n\x0f\0\1", [[[255, 0, 17]]]),
        (b"P5 2 1 1023\n\3\xff\0\1", [[65535, 64]]),
        (b"P2 2 1 1023\n1023 1\n", [[65535, 64]]),
        (b"P2 2 1 100\n100 50\n", [[255, 127]]),
        (b"P5 2 1 65535\n\3\xff\0\1", [[1023, 1]]),
        (b"P4 8 1\n\x0f", [[255] * 4 + [0] * 4]),
        (b"P5\r\n2 1\r\n65535\r\n\3\xff\0\1", [[1023, 1]]),
        (b"P6\r\n1 1\r\n255\r\n\x0d\x0a\1", [[[13, 10, 1]]]),
        (b"P4 16 1\n7 ", [[255, 255, 0, 0, 255, 0, 0, 0, 255, 255, 0, 255, 255, 255, 255, 255]]),
    ],
)
def test_netpbm_is_as_bright_as_it_says(data: bytes, expected: list[object]) -> None:
    np.testing.assert_array_equal(pixels(data), expected)


@pytest.mark.parametrize("bits", [10, 12])
def test_avif_of_many_bits_is_as_bright_as_it_says(bits: int) -> None:
    gray = np.full((16, 16, 3), (1 << bits) // 2, np.uint16)
    ok, data = cv2.imencode(".avif", gray, [cv2.IMWRITE_AVIF_DEPTH, bits])
    assert ok
    assert abs(pixels(data.tobytes()).mean() - 32768) < 300


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32, np.uint32])
def test_integers_that_are_no_image_are_refused(dtype: type) -> None:
    with pytest.raises(InputError, match=r"8 or 16 bits|cannot be decoded"):
        pixels(made.tiff(np.ones((2, 2), dtype)))


def test_doubles_are_an_image() -> None:
    np.testing.assert_array_equal(pixels(made.tiff(np.array([[0.25, 1.0]]))), [[0.25, 1.0]])
    colours = np.arange(16).reshape(2, 2, 4) / 16
    for channels in (3, 4):
        image = pixels(made.tiff(colours[..., :channels]))
        np.testing.assert_array_equal(image, colours[..., :3])


def test_floats_in_another_unit_are_refused() -> None:
    for values, limits in (([0, 128, 255], "from 0 to 255"), ([-1, 0.5, 0.5], "from -1 to 0.5")):
        with pytest.raises(InputError, match=f"{limits}; scale them"):
            pixels(made.tiff(np.array([values], np.float32)))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("kind", [0, 1, 2])
def test_alpha_of_a_tiff_is_dropped_and_not_multiplied(dtype: type, kind: int) -> None:
    colours = np.arange(24).reshape(2, 3, 4).astype(dtype) * 10
    image = pixels(made.tiff(colours, extra=(kind,)))
    np.testing.assert_array_equal(image, colours[..., :3])


@pytest.mark.parametrize("channels", [3, 4])
def test_colours_of_floats_may_be_declared_gray(channels: int) -> None:
    """As GDAL does by default."""
    colours = np.arange(6 * channels).reshape(2, 3, channels).astype(np.float32) / 30
    image = pixels(made.tiff(colours, photometric=1, extra=(0,) * (channels - 1)))
    np.testing.assert_array_equal(image, colours[..., :3])


@pytest.mark.parametrize("frames", [0, 2])
def test_of_an_animated_png_the_still_image_is_read(frames: int) -> None:
    control = made.chunk(b"acTL", struct.pack(">II", 2, 0))
    frame = made.chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 2, 1, 0, 0, 1, 1, 0, 0))
    black = made.chunk(b"fdAT", struct.pack(">I", 1) + zlib.compress(bytes(3)))
    data = made.png([b"\x10\x20"], 2, 8, 0, control)
    end = data.rindex(b"IEND") - 4
    assert pixels(data[:end] + (frame + black) * frames + data[end:]).tolist() == [[16, 32]]


CORPUS = ROOT / "tests" / "corpus"
_SLOW = {"manifest", "checkpoint", "video", "model"}


@pytest.mark.parametrize(
    "name", sorted(file.relative_to(CORPUS).as_posix() for file in CORPUS.glob("*/*"))
)
def test_files_of_the_corpus_are_read_or_refused(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = name.partition("/")[0]
    path = tmp_path / TARGETS[target].file
    shutil.copyfile(CORPUS / name, path)
    assert problem(target, path) is None
    captured = capfd.readouterr()
    assert captured.out == ""
    assert all(OF_LIBRARIES.match(line.encode()) for line in captured.err.splitlines())


@pytest.mark.parametrize("target", TARGETS)
def test_a_few_mutants_are_refused_or_read(target: str, tmp_path: Path) -> None:
    for number in range(2 if target in _SLOW else 10):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert problem(target, file_of(target, number, folder)) is None, number
