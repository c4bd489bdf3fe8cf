"""Depth videos of other programs, at names that depthcli chose for its own."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.batches import request
from helpers.requests import video_request
from helpers.tiny import write_model
from helpers.videos import flat_frames, write_mp4, write_video

from depthcli.errors import OutputError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.run import Batch, dry_run
from depthcli.jobs.video.run import video
from depthcli.video.formats import VideoFormat

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
    request = video_request(folder / "clip.mp4", asked, formats, model=loader)
    with pytest.raises(OutputError, match=str(place)):
        video(request)
    assert {path.name for path in folder.iterdir()} == {"clip.mp4", "clip.depth.mkv"}
    assert place.read_bytes() == before
    assert video(replace(request, overwrite=True)).frames == 3
    whole = place.read_bytes()
    place.write_bytes(whole[: len(whole) // 2])
    assert video(request).frames == 3
    assert place.read_bytes() == whole


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
