"""Outputs of listed files have the names that those of the whole folder have."""

from pathlib import Path

import pytest
from helpers.batches import outputs
from helpers.tiny import synthetic_picture, write_model, write_picture

from depthcli.inference.loading import SessionLoader
from depthcli.io.formats.table import Format
from depthcli.io.manifest import ManifestRow, Shard
from depthcli.jobs.batch.plan import plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.batch.tasks import BatchOptions


def listed(
    folder: Path, *words: str, formats: tuple[Format, ...] = (Format.PNG16,)
) -> BatchRequest:
    """A batch of some files of the folder ``in``."""
    plan = plan_files(words, "mine", str(folder / "in"), str(folder / "out"))
    loader = SessionLoader(write_model(folder / "model"), "cpu")
    return BatchRequest(plan, BatchOptions(formats), loader)


def rows(job: BatchRequest) -> dict[str, ManifestRow]:
    """Runs a batch; the row of each input."""
    return {result.row.input: result.row for result in Batch(job)}


def test_a_file_that_comes_later_replaces_no_output(tmp_path: Path) -> None:
    write_picture(tmp_path / "in" / "hall" / "a.jpg", synthetic_picture(24, 32))
    rows(listed(tmp_path, "hall/a.jpg"))
    before = outputs(tmp_path / "out")
    write_picture(tmp_path / "in" / "hall" / "a.png", synthetic_picture(24, 40))
    row = rows(listed(tmp_path, "hall/a.png"))["hall/a.png"]
    assert [file.path for file in row.outputs] == ["hall/a.png.depth.png"]
    assert before.items() < outputs(tmp_path / "out").items()


@pytest.mark.parametrize(
    "names",
    [
        ("a.jpg", "a.png"),
        ("a.jpg", "A.PNG", "b.png"),
        ("e\u0301.jpg", "\u00e9.png"),
        ("a.jpg", "a.depth.jpg", "a.jpg.png"),
        ("a.jpg", "a.txt", ".a.png"),
        ("hall/a.jpg", "a.png", "hall/a.mp4"),
    ],
)
def test_names_are_those_of_the_folder(tmp_path: Path, names: tuple[str, ...]) -> None:
    root, out = str(tmp_path / "in"), str(tmp_path / "out")
    for name in names:
        write_picture(tmp_path / "in" / "x.png").rename(_made(tmp_path / "in" / name))
    whole = plan_folder(root, out)
    for found in whole.inputs:
        for shard in (Shard(1, 2), Shard(2, 2)):
            one = plan_files([found.name], "mine", root, out, shard=shard)
            if one.inputs:
                assert one.names.base(found.name) == whole.names.base(found.name)


def _made(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    return path


def test_absolute_paths_have_one_name_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [write_picture(tmp_path / "in" / f"{name}.png") for name in "abcdef"]
    words, found = [*map(str, paths)], list[str]()
    for number, folder in ((1, tmp_path), (2, tmp_path / "in")):
        monkeypatch.chdir(folder)
        plan = plan_files(words, "mine", None, str(tmp_path / "out"), shard=Shard(number, 2))
        found += [file.name for file in plan.inputs]
    assert sorted(found) == [word.removeprefix("/") for word in words]
    plan = plan_files(["a.png", "../in/b.png"], "mine", None, str(tmp_path / "out"))
    assert [file.name for file in plan.inputs] == ["a.png", "b.png"]
