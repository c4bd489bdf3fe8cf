"""Pixels that a decoder did not write: a damaged file is refused, or read the same in every run."""

import ctypes
import random
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from helpers import made
from helpers.bad_images import HEIGHT, JPEGS, PIXELS, WIDTH, encoded, reason, saved
from helpers.command_line import ROOT
from helpers.heifs import heic

from depthcli.errors import InputError
from depthcli.io.images.read import _CONTAINERS, read_image
from depthcli.video.source import open_frames
from robustness.mutants import mutant

pytest.importorskip("OpenImageIO")

WORDS = PIXELS.astype(np.uint16) * 257
_MALLOC_PERTURB = -6  # M_PERTURB of glibc: the byte that fills memory as it is allocated
_MUTANTS = 500


def written(folder: Path, suffix: str, pixels: Any = PIXELS, **facts: Any) -> bytes:
    """An image that OpenImageIO writes."""
    return made.written_by_oiio(folder / f"a{suffix}", pixels, **facts)


def exr(compression: Any, pixels: Any) -> bytes:
    file = BytesIO()
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels}).write(file)
    return file.getvalue()


def files(folder: Path) -> dict[str, list[bytes]]:
    """Whole files by container; those of one are read by the same decoder."""
    planes = {"planarconfig": "separate"}
    deflated = {"compression": "zip"}
    halves = (PIXELS / 255).astype(np.float16)
    return {
        "jpeg": [JPEGS["baseline"], JPEGS["restarts"], saved("JPEG", "CMYK")],
        "jpeg, progressive": [JPEGS["progressive"], saved("JPEG", "L", progressive=True)],
        "jpeg, odd sampling": [
            (ROOT / "tests" / "corpus" / "jpeg" / "odd-sampling.jpg").read_bytes()
        ],
        "png": [encoded(".png"), saved("PNG", "P"), saved("PNG", "RGBA")],
        "png, 16 bits": [cv2.imencode(".png", WORDS)[1].tobytes()],
        "tiff, strips": [
            *(saved("TIFF", compression=c) for c in (None, "tiff_lzw", "packbits", "jpeg")),
            *(written(folder, ".tif", pixels, **deflated) for pixels in (PIXELS, WORDS)),
        ],
        "tiff, tiles": [
            written(folder, ".tif", pixels, tile=(16, 16), **facts)
            for pixels in (PIXELS, WORDS)
            for facts in ({}, deflated)
        ],
        "tiff, planes": [
            written(folder, ".tif", pixels, **planes, **facts)
            for pixels in (PIXELS, WORDS)
            for facts in ({}, deflated, {"tile": (16, 16)})
        ],
        "webp": [encoded(".webp"), encoded(".webp", cv2.IMWRITE_WEBP_QUALITY, 80)],
        "avif": [encoded(".avif"), saved("AVIF", "RGBA")],
        "heif": [heic(PIXELS)],
        "gif": [saved("GIF")],
        "bmp": [encoded(".bmp"), saved("BMP", "P")],
        "netpbm": [encoded(".ppm")],
        "openimageio": [written(folder, suffix) for suffix in (".jp2", ".dpx", ".tga", ".hdr")],
        "exr": [
            exr(compression, halves)
            for compression in (OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION)
        ],
    }


KINDS = (
    *("jpeg", "jpeg, progressive", "jpeg, odd sampling", "png", "png, 16 bits"),
    *("tiff, strips", "tiff, tiles", "tiff, planes", "webp", "avif", "heif", "gif", "bmp"),
    *("netpbm", "openimageio", "exr"),
)


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[bytes]]:
    return files(tmp_path_factory.mktemp("whole"))


def damaged(seeds: list[bytes], kind: str) -> Iterator[bytes]:
    """Cut and changed files, in turn."""
    for number in range(_MUTANTS):
        key = f"{kind} {number}"
        chance = random.Random(key)  # noqa: S311 - not a secret
        seed = chance.choice(seeds)
        yield mutant(seeds, key) if number % 2 else seed[: chance.randrange(2, len(seed))]


@contextmanager
def memory_full_of(filling: int) -> Iterator[None]:
    """Fill memory with a byte as it is allocated, which only glibc does."""
    if sys.platform != "linux":
        pytest.skip("only glibc fills memory with a byte")
    libc = ctypes.CDLL(None)
    libc.mallopt(_MALLOC_PERTURB, filling)
    try:
        yield
    finally:
        libc.mallopt(_MALLOC_PERTURB, 0)


def outcome(data: bytes, filling: int) -> bytes | None:
    """The pixels that are read where memory was full of a byte; None if the file is refused."""
    with memory_full_of(filling), suppress(InputError):
        return read_image(None, data, max_pixels=1_000_000).pixels.tobytes()
    return None


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_image_is_refused_or_the_same_whatever_memory_holds(
    kind: str, whole_files: dict[str, list[bytes]]
) -> None:
    """simplejpeg returned arrays that libjpeg had not filled: images of the client before."""
    seeds = whole_files[kind]
    for seed in seeds:
        assert outcome(seed, 0x55) is not None
    for number, data in enumerate(damaged(seeds, kind)):
        assert outcome(data, 0x55) == outcome(data, 0xAA), number


def test_every_container_is_damaged_here() -> None:
    assert {container.kind for container in _CONTAINERS} <= {
        kind.partition(",")[0] for kind in KINDS
    }


def test_a_damaged_frame_of_a_video_is_the_same_whatever_memory_holds() -> None:
    """FFmpeg's frame threads concealed damage with memory that nobody had written."""
    path = ROOT / "tests" / "corpus" / "video" / "concealed-damage.mp4"
    frames = []
    for filling in (0x55, 0xAA) * 4:
        with memory_full_of(filling), open_frames(path) as source:
            frames.append([frame.pixels.tobytes() for frame in source.frames()])
    assert frames == frames[:1] * 8


def test_a_jpeg_cut_within_a_table_is_damaged() -> None:
    """After a warning libjpeg fails with a message that a list of bad ones did not hold."""
    data = JPEGS["progressive"]
    table = data.index(b"\xff\xc4", data.index(b"\xff\xda"))
    for length in range(5, 25):
        assert "is damaged" in reason(data[: table + length])


@pytest.mark.parametrize(
    "flaw",
    {
        "padding before the end, as of cameras": (b"\xff\xd9", b"padding\xff\xd9"),
        "another revision of JFIF": (b"JFIF\0\1", b"JFIF\0\2"),
        # OpenImageIO #2837: of phones of Samsung.
        "no end of the spectrum": (b"\3\x11\0\x3f\0", b"\3\x11\0\0\0"),
    }.values(),
)
def test_a_harmless_flaw_of_a_jpeg_costs_nothing_and_hides_no_damage(
    flaw: tuple[bytes, bytes],
) -> None:
    whole = JPEGS["baseline"]
    assert whole.count(flaw[0]) == 1
    flawed = whole.replace(*flaw)
    np.testing.assert_array_equal(read_image(None, flawed).pixels, read_image(None, whole).pixels)
    middle = len(whole) // 2
    assert "is damaged" in reason((whole[:middle] + whole[middle + 400 :]).replace(*flaw))


def test_deflated_strips_of_a_tiff_have_to_match_their_checksum(
    whole_files: dict[str, list[bytes]],
) -> None:
    data = bytearray(whole_files["tiff, strips"][4])
    data[len(data) // 2] ^= 0x10
    assert "damaged" in reason(bytes(data))


def test_an_avif_is_as_large_as_it_claims() -> None:
    """libavif decodes what the AV1 sequence header states: 3.4 GB of a file of 3 kB."""
    data = encoded(".avif")
    claim = b"ispe" + struct.pack(">III", 0, WIDTH, HEIGHT)
    assert data.count(claim) == 1
    small = data.replace(claim, b"ispe" + struct.pack(">III", 0, 16, 16))
    assert "is damaged" in reason(small, max_pixels=1000)


def test_a_tiff_of_colours_in_a_single_channel_is_refused() -> None:
    """OpenCV left two thirds of a TIFF without its tag of channels as memory of other images."""
    with pytest.raises(InputError, match="colours in 1 channels"):
        read_image(None, made.tiff(WORDS[..., 0], photometric=2))
