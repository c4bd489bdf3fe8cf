"""Every bad picture is refused with one line; what is only unusual is read."""

from __future__ import annotations

import io
import os
import platform
import struct
import threading
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from helpers.bad_pictures import BAD, HEIGHT, JPEGS, PIXELS, WIDTH
from PIL import Image

from depthcli.datasets.folders import depth_shape, read_image_rgb
from depthcli.errors import DatasetError, InputError
from depthcli.io.depth.read import read_stored_depth
from depthcli.io.images import native_log as decoder_messages
from depthcli.io.images.decode import PICTURE_SUFFIXES, can_round_trip, decoded
from depthcli.io.images.native_log import WARNINGS, set_log_level
from depthcli.io.images.read import read_image
from depthcli.io.listing.own_outputs import is_own_picture
from depthcli.io.storage.paths import read_regular

if TYPE_CHECKING:
    from pathlib import Path

    from helpers.command_line import Cli

if platform.libc_ver()[0] != "glibc":
    pytest.skip("only glibc lets libjpeg's warnings be heard", allow_module_level=True)


@pytest.mark.parametrize("name", BAD)
def test_a_bad_picture_is_one_line(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    data, message = BAD[name]
    with pytest.raises(InputError) as caught:
        read_image(None, data)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def _saved(kind: str, mode: str = "RGB", **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(PIXELS).convert(mode).save(file, kind, **options)
    return file.getvalue()


UNUSUAL = {
    "Pillow": _saved("JPEG"),
    "worst": _saved("JPEG", quality=1),
    "best": _saved("JPEG", quality=100, subsampling=0),
    "progressive": _saved("JPEG", progressive=True),
    "restarts": _saved("JPEG", restart_marker_blocks=1),
    "progressive restarts": _saved("JPEG", restart_marker_rows=1, progressive=True),
    "gray": _saved("JPEG", "L", progressive=True),
    "CMYK": _saved("JPEG", "CMYK"),
    "several in one": _saved("MPO", save_all=True, append_images=[Image.new("RGB", (8, 8))]),
    "padded before the end": JPEGS["baseline"][:-2] + b"padding" + b"\xff\xd9",
    "fill before the end": JPEGS["baseline"][:-2] + b"\xff" * 100_000 + b"\xff\xd9",
    "fill before a marker": b"\xff\xd8" + b"\xff" * 100_000 + JPEGS["baseline"][2:],
    "TIFF of LZW": _saved("TIFF", compression="tiff_lzw"),
    "TIFF of Deflate": _saved("TIFF", compression="tiff_adobe_deflate"),
    "TIFF of old Deflate": _saved("TIFF", compression="tiff_deflate"),
    "TIFF of PackBits": _saved("TIFF", compression="packbits"),
    "TIFF of JPEG": _saved("TIFF", compression="jpeg"),
    "fax": _saved("TIFF", "1", compression="group4"),
    "BigTIFF": _saved("TIFF", big_tiff=True),
    "unknown colour profile": _saved("PNG", icc_profile=b"nothing that is known"),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_what_is_only_unusual_is_read(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    assert read_image(None, UNUSUAL[name]).pixels.shape[:2] == (HEIGHT, WIDTH)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "name", sorted(BAD.keys() & {"baseline cut at 50 %, closed", "TIFF of damaged LZW"})
)
def test_each_thread_hears_of_its_own_picture(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    damaged, _ = BAD[name]
    set_log_level(WARNINGS)
    wrong: list[bool] = []

    def decode_often(data: bytes, *, whole: bool) -> None:
        seen = [decoded(data, cv2.IMREAD_COLOR) is not None for _ in range(100)]
        wrong.extend(one for one in seen if one is not whole)

    threads = [
        threading.Thread(target=decode_often, args=(data,), kwargs={"whole": whole})
        for data, whole in [(damaged, False), (JPEGS["baseline"], True)] * 3
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert set_log_level(WARNINGS) == WARNINGS
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "name", sorted(BAD.keys() & {"baseline cut at 50 %, closed", "TIFF of damaged LZW"})
)
def test_a_new_listener_hears_decoders_too(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    decoder_messages._stderr.cache_clear()
    data = np.frombuffer(BAD[name][0], np.uint8)
    for _ in range(2):
        with decoder_messages.decoder_messages() as said:
            cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert said
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", PICTURE_SUFFIXES)
def test_this_build_knows_every_format(suffix: str) -> None:
    assert can_round_trip(suffix)
    assert not can_round_trip(".none")


def test_a_training_picture_with_lost_pixels_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(BAD["baseline without its middle"][0])
    with pytest.raises(DatasetError, match=r"a\.jpg cannot be decoded"):
        read_image_rgb(path)


def _animated() -> bytes:
    file = io.BytesIO()
    first, *others = (Image.fromarray(np.roll(PIXELS, by, 1)) for by in range(3))
    first.save(file, "AVIF", save_all=True, append_images=others, quality=50)
    return file.getvalue()


@pytest.mark.parametrize("kind", ["still", "with alpha", "animated"])
def test_an_avif_is_as_large_as_what_it_codes(kind: str) -> None:
    makers = {
        "still": lambda: _saved("AVIF"),
        "with alpha": lambda: _saved("AVIF", "RGBA"),
        "animated": _animated,
    }
    whole = makers[kind]()
    assert read_image(None, whole, max_pixels=WIDTH * HEIGHT).width == WIDTH
    claim = b"ispe" + struct.pack(">III", 0, WIDTH, HEIGHT)
    assert claim in whole
    lying = whole.replace(claim, b"ispe" + struct.pack(">III", 0, 8, 8))
    with pytest.raises(InputError, match=f"claims {WIDTH}×{HEIGHT} pixels"):
        read_image(None, lying, max_pixels=WIDTH * HEIGHT - 1)


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/null", "/proc/kmsg", "/proc/self/status"])
def test_what_has_no_end_is_not_read(name: str) -> None:
    assert not is_own_picture(name)
    with pytest.raises(InputError, match=r"pipe or a device|is empty"):
        read_image(name)


@pytest.mark.parametrize("name", ["a\0.png", "\ud800.png"])
def test_what_no_file_is_called_is_refused(name: str) -> None:
    assert not is_own_picture(name)
    for read in (read_image, read_stored_depth):
        with pytest.raises(InputError, match="cannot be read: no file has such a name"):
            read(name)


def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    pipe = tmp_path / "a.png"
    os.mkfifo(pipe)
    assert not is_own_picture(pipe)
    for read in (read_image, read_stored_depth):
        with pytest.raises(InputError, match=r"a\.png cannot be read: it is a pipe"):
            read(pipe)
    for read_pair in (read_image_rgb, depth_shape):
        with pytest.raises(DatasetError, match=r"cannot read .*a\.png: it is a pipe"):
            read_pair(pipe)


def test_a_pipe_is_no_sidecar(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((4, 4), np.float32))
    os.mkfifo(tmp_path / "a.json")
    assert read_stored_depth(tmp_path / "a.npy").displayed.values.shape == (4, 4)


def test_files_are_read_up_to_a_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, 4)


def test_each_bad_picture_costs_a_line_and_no_more(inside: Cli) -> None:
    folder = inside.folder / "in"
    folder.mkdir()
    for number, (data, _) in enumerate(BAD.values()):
        (folder / f"{number:03d}.bin").write_bytes(data)
    (folder / "good.jpg").write_bytes(JPEGS["progressive"])
    names = sorted(path.name for path in folder.iterdir())
    done = inside("predict", *(f"in/{name}" for name in names), "-o", "out/", "--format", "png16")
    assert done.returncode == 1
    assert [path.name for path in (inside.folder / "out").iterdir()] == ["good.depth.png"]
    *lines, total = done.stderr.decode().splitlines()
    assert total.startswith(f"{len(BAD)} of {len(BAD) + 1} inputs failed: ")
    assert len(lines) == len(BAD)
    for number, (line, (_, message)) in enumerate(zip(lines, BAD.values(), strict=True)):
        assert line.startswith(f"depthcli: error: in/{number:03d}.bin ")
        assert message in line
