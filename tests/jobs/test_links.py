"""Outputs that reach inputs through links replace none, and no listed file is lost unseen."""

from pathlib import Path

import pytest
from helpers.requests import predict_request
from helpers.tiny import synthetic_picture, write_model, write_picture

from depthcli.errors import UsageError
from depthcli.inference.loading import SessionLoader
from depthcli.jobs.batch.plan import BatchPlan, plan_files, plan_folder
from depthcli.jobs.batch.run import Batch, BatchRequest
from depthcli.jobs.predict import predict


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two pictures, of which one lies where the other's depth goes."""
    folder = tmp_path / "in" / "hall"
    one = write_picture(folder / "a.png", synthetic_picture(24, 32))
    return one, write_picture(folder / "a.depth.png", synthetic_picture(24, 33))


def batch(plan: BatchPlan, folder: Path) -> Batch:
    """A batch of a plan with the tiny model."""
    return Batch(BatchRequest(plan, model=SessionLoader(write_model(folder / "model"), "cpu")))


def test_predict_into_a_linked_folder(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    (tmp_path / "out").symlink_to(pair[0].parent)
    names, out = tuple(map(str, pair)), f"{tmp_path / 'out'}/"
    loader = SessionLoader(write_model(tmp_path / "model"), "cpu")
    with pytest.raises(UsageError):
        predict(predict_request(names, out, model=loader))


def test_predict_over_what_a_linked_input_leads_to(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    link = tmp_path / "link.png"
    link.symlink_to(pair[1])
    loader = SessionLoader(write_model(tmp_path / "model"), "cpu")
    with pytest.raises(UsageError):
        predict(predict_request([pair[0], link], f"{pair[0].parent}/", model=loader))


def test_a_batch_whose_folder_leads_to_inputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "hall").symlink_to(pair[0].parent)
    before = pair[1].read_bytes()
    words = ["hall/a.png", "hall/a.depth.png"]
    plan = plan_files(words, "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    with pytest.raises(UsageError):
        batch(plan, tmp_path)
    assert pair[1].read_bytes() == before


def test_a_batch_whose_input_links_to_its_outputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    out = tmp_path / "out"
    (out / "hall").mkdir(parents=True)
    pair[1].rename(out / "hall" / "a.depth.png")
    (tmp_path / "in" / "link.png").symlink_to(out / "hall" / "a.depth.png")
    with pytest.raises(UsageError):
        batch(plan_folder(str(tmp_path / "in"), str(out)), tmp_path)


def test_a_link_to_another_disk_has_the_outputs(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    pair[1].unlink()
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "hall").symlink_to(tmp_path / "disk")
    assert len(list(batch(plan_folder(str(tmp_path / "in"), str(tmp_path / "out")), tmp_path))) == 1
    assert (tmp_path / "disk" / "a.depth.png").is_file()


def test_entries_of_a_list_that_are_one_are_told(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    words = ["hall/a.png", "hall/a.png", "./hall/a.png", "hall/../hall/a.png", str(pair[0])]
    plan = plan_files(words, "mine", str(tmp_path / "in"), str(tmp_path / "out"))
    assert [file.name for file in plan.inputs] == ["hall/a.png"]
    assert [(file.name, file.reason) for file in plan.skipped] == [("hall/a.png", "listed twice")]


def test_two_files_with_one_name_are_refused(tmp_path: Path) -> None:
    """One outside the folder is named by all its folders, and there may be such ones inside."""
    root, outside = tmp_path / "in", write_picture(tmp_path / "a.png")
    inside = write_picture(root / str(outside).lstrip("/"), synthetic_picture(24, 40))
    with pytest.raises(UsageError):
        plan_files([str(outside), str(inside)], "mine", str(root), str(tmp_path / "out"))
