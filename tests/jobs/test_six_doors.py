"""One image through each door of the product: the same bytes and the same warnings."""

import json
import tarfile
import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from helpers.requests import predict_request, video_request
from helpers.tiny import synthetic_image

import depthcli
from depthcli.core.camera import Intrinsics
from depthcli.core.types import DepthKind, DepthMap
from depthcli.errors import InputError
from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.raster import Png16Writer
from depthcli.io.formats.table import Format
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions
from depthcli.jobs.predict import predict
from depthcli.jobs.serve import Asked, DepthServer, Limits
from depthcli.jobs.video.plan import VideoSettings
from depthcli.jobs.video.run import video
from depthcli.video.formats import VideoFormat

CAMERA = Intrinsics(40.0)
DARK = "of 65535, and depth may be flat"  # a part of the warning about the image
UNSCALED = "does not scale depth"  # a part of that about the camera


class Result(NamedTuple):
    npy: bytes
    warnings: tuple[str, ...]


def by_predict(image: Path, loader: SessionLoader, out: Path) -> Result:
    file = out.with_suffix(".npy")
    (done,) = predict(predict_request([image], file, model=loader, camera=CAMERA))
    return Result(file.read_bytes(), done.warnings)


def by_batch(image: Path, loader: SessionLoader, out: Path) -> Result:
    options = BatchOptions(formats=(Format.NPY,), camera=CAMERA)
    plan = plan_folder(str(image.parent), str(out))
    (done,) = Batch(BatchRequest(plan, options, loader))
    return Result((out / done.row.outputs[0].path).read_bytes(), done.row.warnings)


def by_archive(image: Path, loader: SessionLoader, out: Path) -> Result:
    shards = image.parent / "shards"
    shards.mkdir()
    with tarfile.open(shards / "a.tar", "w") as archive:
        archive.add(image, "a.png")
    options = BatchOptions(formats=(Format.NPY,), camera=CAMERA)
    (done,) = Batch(BatchRequest(plan_folder(str(shards), str(out)), options, loader))
    with tarfile.open(out / done.row.outputs[0].path) as archive:
        (member,) = archive.getmembers()
        file = archive.extractfile(member)
        assert file is not None
        return Result(file.read(), done.row.warnings)


def by_serve(image: Path, loader: SessionLoader, _out: Path) -> Result:
    asked = Asked(camera=CAMERA, format=Format.NPY)
    limits = Limits(workers=1, queue=1, timeout_s=60, max_bytes=10**6, max_pixels=10**6)
    server = DepthServer(loader.load(), lambda _query, _known: asked, limits)
    response = server._answer((), [("", image.read_bytes())])
    facts = json.loads(response.headers["Depth-Facts"])
    return Result(response.body, tuple(facts["warnings"]))


def by_python(image: Path, loader: SessionLoader, out: Path) -> Result:
    model = depthcli.load_model(loader.model, provider="cpu", threads=1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        (depth,) = model.predict_many([image], focal_px=CAMERA.focal_px, anchors_each=[None])
    depth.save(out.with_suffix(".npy"))
    return Result(out.with_suffix(".npy").read_bytes(), tuple(str(w.message) for w in caught))


def by_video(image: Path, loader: SessionLoader, out: Path) -> Result:
    image.rename(image.with_name("a_0000.png"))
    done = video(
        video_request(
            image.with_name("a_%04d.png"),
            f"{out}/",
            (VideoFormat.NPY,),
            settings=VideoSettings(camera=CAMERA, fps=Fraction(25)),
            model=loader,
        )
    )
    (file,) = out.rglob("*.npy")
    return Result(file.read_bytes(), done.warnings)


DOORS = (by_predict, by_batch, by_archive, by_serve, by_python, by_video)


@pytest.mark.parametrize("door", DOORS[1:])
def test_each_door_writes_the_bytes_of_predict_and_gives_its_warnings(
    door: Callable[[Path, SessionLoader, Path], Result], tmp_path: Path, loader: SessionLoader
) -> None:
    """Batches, videos and predict_many said nothing of a focal length that scales no depth."""
    pixels = cv2.imencode(".png", synthetic_image(24, 32).astype(np.uint16))[1].tobytes()
    results = []
    for number, each in enumerate((by_predict, door)):
        image = tmp_path / f"in{number}" / "a.png"
        image.parent.mkdir()
        image.write_bytes(pixels)
        results.append(each(image, loader, tmp_path / f"out{number}"))
    expected, result = results
    assert result.npy == expected.npy
    assert len(result.warnings) == len(expected.warnings) == 2
    for part in (DARK, UNSCALED):
        assert all(any(part in text for text in each.warnings) for each in results)


@pytest.mark.parametrize("door", DOORS)
def test_no_door_makes_depth_of_depth(
    door: Callable[[Path, SessionLoader, Path], Result], tmp_path: Path, loader: SessionLoader
) -> None:
    """``predict a.jpg -o depth.png`` and ``batch`` made depth.depth.png."""
    image = tmp_path / "in" / "a.png"
    image.parent.mkdir()
    Png16Writer().write(DepthMap(np.ones((24, 32), np.float32), DepthKind.METRIC), image)
    with pytest.raises((InputError, FileNotFoundError, IndexError)):  # or no output is there
        door(image, loader, tmp_path / "out")
    assert not [*tmp_path.rglob("*.npy")]
