"""What is said of EXR pictures that lose light or colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import OpenEXR
import pytest

from depthcli.io.exr_pictures import read_exr_picture

if TYPE_CHECKING:
    from pathlib import Path

REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
REC_601 = (0.63, 0.34, 0.31, 0.595, 0.155, 0.07, 0.3127, 0.3290)
REC_2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
OTHER = "its header states other primaries than those of Rec. 709"


def warnings_of(path: Path, *, colours: str = "RGB", share: float = 0, **header: Any) -> list[str]:
    """Those about a picture of which a share of the pixels is above 1, in blue or in Y."""
    light = np.ones((10, 20), np.float32)
    bright = light.copy()
    bright.ravel()[: round(share * light.size)] = 1.5
    header = {"type": OpenEXR.scanlineimage, **header}
    channels = dict.fromkeys(colours, light) | {colours[-1]: bright}
    OpenEXR.File(header, channels).write(str(path))
    return list(read_exr_picture(path).warnings)


@pytest.mark.parametrize("colours", ["RGB", "Y"])
def test_many_pixels_above_1_are_told(colours: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    assert warnings_of(path, colours=colours) == []
    assert warnings_of(path, colours=colours, share=0.29) == []
    (warning,) = warnings_of(path, colours=colours, share=0.3)
    assert warning.startswith("30% of its pixels are above 1 and become white; for better depth,")


def test_the_share_is_that_of_the_pixels_that_the_file_has(tmp_path: Path) -> None:
    wide = {"dataWindow": ((0, 0), (19, 9)), "displayWindow": ((0, 0), (99, 99))}
    (warning,) = warnings_of(tmp_path / "a.exr", share=0.5, **wide)
    assert warning.startswith("50% of its pixels")
    aside = wide | {"dataWindow": ((200, 0), (219, 9))}
    (warning,) = warnings_of(tmp_path / "a.exr", share=0.5, **aside)
    assert warning.startswith("50% of its pixels")


@pytest.mark.parametrize("stated", [REC_709, REC_601])
def test_primaries_of_screens_are_silent(stated: tuple[float, ...], tmp_path: Path) -> None:
    assert warnings_of(tmp_path / "a.exr", chromaticities=stated) == []


@pytest.mark.parametrize("stated", [REC_2020, ACES, (float("nan"), *REC_709[1:])])
def test_other_primaries_are_told(stated: tuple[float, ...], tmp_path: Path) -> None:
    (warning,) = warnings_of(tmp_path / "a.exr", chromaticities=stated)
    assert warning.startswith(OTHER)
    assert warnings_of(tmp_path / "a.exr", colours="Y", chromaticities=stated) == []


def test_primaries_of_another_type_count_as_not_stated(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    warnings_of(path, chromaticitie_="Rec. 2020")
    path.write_bytes(path.read_bytes().replace(b"chromaticitie_\0", b"chromaticities\0"))
    assert read_exr_picture(path).warnings == ()
