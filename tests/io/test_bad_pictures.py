"""Every bad image is refused with one line before it costs anything; the only unusual is read."""

import io
import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers import made
from helpers.bad_pictures import BAD, HEIGHT, JPEGS, PIXELS, WIDTH, encoded
from helpers.command_line import Cli
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from depthcli.datasets.folders import read_image_rgb, read_truth
from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.read import AS_STATED, read_stored_depth
from depthcli.io.images.opencv import IMAGE_SUFFIXES, can_round_trip
from depthcli.io.images.read import image_size, read_image
from depthcli.io.listing.folder import is_own_picture

FILES = {
    **JPEGS,
    "png": encoded(".png"),
    "tiff": encoded(".tiff"),
    "webp": encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80),
    "lossless webp": encoded(".webp"),
    "extended webp": made.webp_with_exif(encoded(".webp"), made.exif(), WIDTH, HEIGHT),
    "avif": encoded(".avif"),
    "bmp": encoded(".bmp"),
    "gif": encoded(".gif"),
    "pnm": encoded(".ppm"),
}


def reason(data: bytes, **options: int) -> str:
    with pytest.raises(InputError) as caught:
        read_image(None, data, **options)
    text = str(caught.value)
    assert "\n" not in text
    return text


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
    assert image_size(FILES[name]) == (WIDTH, HEIGHT)
    assert f"{WIDTH}×{HEIGHT}" in reason(FILES[name], max_pixels=WIDTH * HEIGHT - 1)
    assert read_image(None, FILES[name], max_pixels=WIDTH * HEIGHT).pixels.shape == PIXELS.shape


@pytest.mark.parametrize(
    ("name", "at", "form"),
    [("baseline", None, ">HH"), ("png", 16, ">II"), ("bmp", 18, "<II"), ("gif", 6, "<HH")],
)
def test_decompression_bomb_and_empty_image_are_refused(
    name: str, at: int | None, form: str
) -> None:
    data = bytearray(FILES[name])
    at = data.index(b"\xff\xc0") + 5 if at is None else at
    struct.pack_into(form, data, at, 50_000, 50_000)
    assert "50000×50000" in reason(bytes(data))
    struct.pack_into(form, data, at, 0, 0)
    assert "0×0" in reason(bytes(data))


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(FILES)), st.data())
def test_damage_is_an_error_or_an_image(name: str, draw: st.DataObject) -> None:
    data = bytearray(FILES[name])
    for at in draw.draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=4)):
        data[at] = draw.draw(st.integers(0, 255))
    try:
        frame = read_image(None, bytes(data), max_pixels=100_000)
    except InputError:
        return
    assert frame.pixels.ndim in (2, 3)


def _saved(kind: str, mode: str = "RGB", **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(PIXELS).convert(mode).save(file, kind, **options)
    return file.getvalue()


UNUSUAL = {
    "progressive restarts": _saved("JPEG", restart_marker_rows=1, progressive=True),
    "several in one": _saved("MPO", save_all=True, append_images=[Image.new("RGB", (8, 8))]),
    "padded before the end": JPEGS["baseline"][:-2] + b"padding" + b"\xff\xd9",
    "fill before a marker": b"\xff\xd8" + b"\xff" * 100_000 + JPEGS["baseline"][2:],
    "JPEG before other data": JPEGS["baseline"] + bytes(100_000),
    "JPEG with a thumbnail": made.jpeg_with_exif(
        JPEGS["baseline"], made.exif() + made.jpeg([[128]])
    ),
    "PNG before other data": encoded(".png") + bytes(100_000),
    **{
        f"TIFF of {coding}": _saved("TIFF", compression=coding)
        for coding in ("tiff_lzw", "tiff_adobe_deflate", "tiff_deflate", "packbits", "jpeg")
    },
    "fax": _saved("TIFF", "1", compression="group4"),
    "BigTIFF": _saved("TIFF", big_tiff=True),
    **{
        f"PNM {kind} without a last line break": f"{kind} {WIDTH} {HEIGHT}{white}".encode()
        + b" 1" * (WIDTH * HEIGHT * channels)
        for kind, white, channels in (("P1", "", 1), ("P2", " 9", 1), ("P3", " 9", 3))
    },
    "unknown colour profile": _saved("PNG", icc_profile=b"nothing that is known"),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_unusual_image_is_read_silently(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert read_image(None, UNUSUAL[name]).pixels.shape[:2] == (HEIGHT, WIDTH)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("sampling", [0x411111, 0x211111, 0x221111, 0x121111, 0x111111])
@pytest.mark.parametrize("shape", [(1, 1), (7, 1), (15, 17), (99, 101, 3), (64, 96, 3)])
def test_jpeg_has_the_pixels_that_opencv_decodes(shape: tuple[int, ...], sampling: int) -> None:
    pixels = np.resize(PIXELS, shape)
    ok, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling])
    assert ok
    expected = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    found = read_image(None, data.tobytes()).pixels
    np.testing.assert_array_equal(found, expected[..., ::-1] if expected.ndim == 3 else expected)


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"quality": 30}])
def test_cmyk_jpeg_has_the_pixels_that_opencv_decodes(options: dict[str, object]) -> None:
    data = _saved("JPEG", "CMYK", **options)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(read_image(None, data).pixels, expected)


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_opencv_reads_and_writes_each_format(suffix: str) -> None:
    assert can_round_trip(suffix)
    assert not can_round_trip(".none")


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/null", "/proc/kmsg", "/proc/self/status"])
def test_device_is_not_read(name: str) -> None:
    assert not is_own_picture(name)
    with pytest.raises(InputError):
        read_image(name)


@pytest.mark.parametrize("name", ["a\0.png", "\ud800.png", "a" * 300])
def test_impossible_name_is_refused(name: str) -> None:
    assert not is_own_picture(name)
    for read in (read_image, read_stored_depth):
        with pytest.raises(InputError):
            read(name)


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "a.png"
    os.mkfifo(pipe)
    assert not is_own_picture(pipe)
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


def test_each_bad_image_costs_a_line_and_no_more(inside: Cli) -> None:
    folder = inside.folder / "in"
    folder.mkdir()
    for number, data in enumerate(BAD.values()):
        (folder / f"{number:03d}.bin").write_bytes(data)
    (folder / "good.jpg").write_bytes(JPEGS["progressive"])
    names = sorted(path.name for path in folder.iterdir())
    done = inside("predict", *(f"in/{name}" for name in names), "-o", "out/", "--format", "png16")
    assert done.returncode == 1
    assert [path.name for path in (inside.folder / "out").iterdir()] == ["good.depth.png"]
    *lines, total = done.stderr.decode().splitlines()
    assert total.startswith(f"{len(BAD)} of {len(BAD) + 1} inputs failed: ")
    for number, line in enumerate(lines):
        assert line.startswith(f"depthcli: error: in/{number:03d}.bin ")
    assert len(lines) == len(BAD)
