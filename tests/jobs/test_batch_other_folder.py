"""Outputs of a file of the same name in another folder are not replaced."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.batches import outputs, request
from helpers.tiny import synthetic_picture, write_picture
from helpers.videos import write_video

from depthcli.errors import UsageError
from depthcli.io.formats.table import Format
from depthcli.io.manifest import known_rows
from depthcli.jobs.batch.plan import plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest, dry_run
from depthcli.jobs.batch.tasks import BatchOptions


def request_of(folder: Path, inputs: str) -> BatchRequest:
    plan = plan_folder(str(folder / inputs), str(folder / "out"))
    return replace(request(folder), plan=plan)


def made_from_in(folder: Path) -> dict[str, bytes]:
    """The outputs for the folder ``in``."""
    write_picture(folder / "in" / "a.png", synthetic_picture(24, 32))
    list(Batch(request(folder)))
    return outputs(folder / "out")


@pytest.mark.parametrize("formats", [("png16",), ("png16", "preview"), ("npy",)])
def test_input_of_another_folder_stops_the_batch(tmp_path: Path, formats: tuple[str, ...]) -> None:
    before = made_from_in(tmp_path)
    other = write_picture(tmp_path / "other" / "a.png", synthetic_picture(24, 40))
    options = BatchOptions(tuple(map(Format, formats)))
    asked = replace(request_of(tmp_path, "other"), options=options)
    with pytest.raises(UsageError):
        list(dry_run(asked, asked.model.load()))
    for _ in range(2):  # nor does the second attempt
        with pytest.raises(UsageError) as refused:
            list(Batch(asked))
        assert str(tmp_path / "in" / "a.png") in str(refused.value)
        assert str(other) in str(refused.value)
    assert outputs(tmp_path / "out") == before
    assert all(result.is_kept for result in Batch(request(tmp_path)))


def test_the_manifest_has_the_full_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_picture(tmp_path / "in" / "a.png")
    (tmp_path / "in" / "b.png").touch()
    plan = plan_folder("in", "out")
    list(Batch(replace(request(tmp_path), plan=plan)))
    paths = {row.input_path for row in known_rows(tmp_path / "out")}
    assert paths == {str(tmp_path / "in" / name) for name in ("a.png", "b.png")}


def test_a_copy_of_the_folder_resumes(tmp_path: Path) -> None:
    made_from_in(tmp_path)
    shutil.copytree(tmp_path / "in", tmp_path / "copy")
    assert all(result.is_kept for result in Batch(request_of(tmp_path, "copy")))


def test_a_folder_that_is_gone_is_no_reason(tmp_path: Path) -> None:
    before = made_from_in(tmp_path)
    write_picture(tmp_path / "other" / "a.png", synthetic_picture(24, 40))
    asked = request_of(tmp_path, "other")
    shutil.rmtree(tmp_path / "in")
    (result,) = Batch(asked)
    assert result.row.error is None
    assert outputs(tmp_path / "out") != before


def test_neither_is_a_link_to_the_folder(tmp_path: Path) -> None:
    made_from_in(tmp_path)
    (tmp_path / "link").symlink_to("in")
    write_picture(tmp_path / "in" / "a.png", synthetic_picture(24, 40))
    (result,) = Batch(request_of(tmp_path, "link"))
    assert (result.is_kept, result.row.error) == (False, None)


def test_videos_are_not_replaced_either(tmp_path: Path) -> None:
    for folder, level in (("in", 40), ("other", 200)):
        (tmp_path / folder).mkdir()
        write_video(tmp_path / folder / "clip.mkv", [np.full((24, 32, 3), level, np.uint8)] * 2)
    list(Batch(request(tmp_path)))
    before = outputs(tmp_path / "out")
    with pytest.raises(UsageError):
        list(Batch(request_of(tmp_path, "other")))
    assert outputs(tmp_path / "out") == before
