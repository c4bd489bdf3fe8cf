"""What the long command found once, and a small sample of what it tries."""

import shutil
from pathlib import Path

import pytest
from helpers.command_line import ROOT

from robustness.fuzz import OF_LIBRARIES, file_of, problem
from robustness.fuzz_targets import TARGETS

CORPUS = ROOT / "tests" / "corpus"
_SLOW = {"manifest", "checkpoint", "video", "model"}


def _found() -> list[str]:
    files = CORPUS.rglob("*")
    return sorted(path.relative_to(CORPUS).as_posix() for path in files if path.is_file())


@pytest.mark.parametrize("name", _found())
def test_files_of_the_corpus_are_read_or_refused(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    target = name.partition("/")[0]
    path = tmp_path / TARGETS[target].file
    shutil.copyfile(CORPUS / name, path)
    assert problem(target, path) is None
    said = capfd.readouterr()
    assert said.out == ""
    assert all(OF_LIBRARIES.match(line.encode()) for line in said.err.splitlines())


@pytest.mark.parametrize("target", TARGETS)
def test_a_few_mutants_are_refused_or_read(target: str, tmp_path: Path) -> None:
    for number in range(2 if target in _SLOW else 10):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert problem(target, file_of(target, number, folder)) is None, number
