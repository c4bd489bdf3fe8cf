"""Depth videos of other programs, at names that depthcli chose for its own."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from helpers.batches import request
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_mp4, write_video

from depthcli.errors import OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.video.plan import VideoRequest
from depthcli.jobs.video.run import video
from depthcli.video.formats import VideoFormat

if TYPE_CHECKING:
    from pathlib import Path

    from helpers.stores import Bucket, Faults

BOTH = (VideoFormat.MKV, VideoFormat.MP4)


@pytest.fixture
def loader(tmp_path: Path) -> SessionLoader:
    return SessionLoader(write_model(tmp_path / "model"), "cpu")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a clip and a video of another program."""
    write_mp4(tmp_path / "in" / "clip.mp4", flat_frames(range(3)))
    write_video(tmp_path / "in" / "clip.depth.mkv", flat_frames(range(9)))
    return tmp_path / "in"


@pytest.mark.parametrize(
    ("output", "formats"),
    [(None, ()), ("clip.depth.mkv", ()), ("clip.mkv", BOTH), ("clip.preview.mp4", BOTH)],
)
def test_it_is_not_replaced(
    output: str | None, formats: tuple[VideoFormat, ...], folder: Path, loader: SessionLoader
) -> None:
    place = folder / "clip.depth.mkv"
    before = place.read_bytes()
    asked = None if output is None else f"{folder}/{output}"
    request = VideoRequest(str(folder / "clip.mp4"), asked, formats, model=loader)
    with pytest.raises(OutputError, match=str(place)):
        video(request)
    assert {path.name for path in folder.iterdir()} == {"clip.mp4", "clip.depth.mkv"}
    assert place.read_bytes() == before
    assert video(replace(request, overwrite=True)).frames == 3
    whole = place.read_bytes()
    place.write_bytes(whole[: len(whole) // 2])
    assert video(request).frames == 3
    assert place.read_bytes() == whole


def test_it_is_not_replaced_in_a_bucket(
    folder: Path, loader: SessionLoader, bucket: Bucket
) -> None:
    sensor = (folder / "clip.depth.mkv").read_bytes()
    name = bucket.put("clip.depth.mkv", sensor)
    request = VideoRequest(str(folder / "clip.mp4"), bucket.uri(), model=loader)
    with pytest.raises(OutputError, match=f"^{name} exists and was not written by depthcli"):
        video(request)
    assert bucket.objects() == {"clip.depth.mkv": sensor}
    bucket.client.delete_object(Bucket=bucket.name, Key="clip.depth.mkv")
    for _ in range(2):  # its own is replaced
        assert video(request).frames == 3
    assert len(bucket.names()) == 2


def test_a_store_that_does_not_answer_gets_no_video(
    folder: Path, loader: SessionLoader, bucket: Bucket, faults: Faults
) -> None:
    request = VideoRequest(str(folder / "clip.mp4"), bucket.uri(), (VideoFormat.MKV,), model=loader)
    for answer, is_written in (("500 InternalError", False), ("403 AccessDenied", True)):
        faults.fault = lambda method, path, _, answer=answer: (
            answer if method == "GET" and path.endswith(".mkv") else None
        )
        if is_written:
            assert video(request).frames == 3
        else:
            with pytest.raises(OutputError, match=r"cannot write .*clip\.depth\.mkv"):
                video(request)
        assert bool(bucket.names()) is is_written


def test_a_batch_does_not_replace_it_in_any_run(folder: Path) -> None:
    place = folder.parent / "out" / "clip.depth.mkv"
    place.parent.mkdir()
    (folder / "clip.depth.mkv").rename(place)
    before = place.read_bytes()
    asked = request(folder.parent)
    for _ in range(2):
        (result,) = Batch(asked)
        assert result.row.error is not None
        assert "was not written by depthcli" in result.row.error
        (would,) = dry_run(asked, asked.model.load())
        assert (would.would, would.error) == ("fail", result.row.error)
    assert place.read_bytes() == before
    place.unlink()
    for is_kept in (False, True):
        (result,) = Batch(asked)
        assert (result.row.error, result.is_kept) == (None, is_kept)


def test_a_pipe_is_refused_without_reading_it(folder: Path, loader: SessionLoader) -> None:
    place = folder / "clip.depth.mkv"
    place.unlink()
    os.mkfifo(place)
    with pytest.raises(OutputError, match="is a device or a pipe and is not replaced"):
        video(VideoRequest(str(folder / "clip.mp4"), model=loader))
