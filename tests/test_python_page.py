"""The examples of docs/python.md and README.md, run one after the other as a reader would."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from helpers.tiny import synthetic_picture, write_picture
from helpers.videos import write_mp4

DOCS = Path(__file__).resolve().parents[1] / "docs"
EXAMPLE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(DOCS / "room.jpg", tmp_path)
    write_mp4(tmp_path / "walk.mp4", [synthetic_picture(480, 640)] * 2)
    for name in ("a.jpg", "b.jpg"):
        write_picture(tmp_path / "images" / name)
    names: dict[str, Any] = {}
    for code in EXAMPLE.findall((DOCS / "python.md").read_text("utf-8")):
        exec(compile(code, "docs/python.md", "exec"), names)  # noqa: S102 - our own page
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert written >= {
        "room.exr",
        "room.ply",
        "kitti.png",
        "room.preview.png",
        "out/a.png",
        "depth/manifest.jsonl",
        "walk.mkv",
    }


def test_the_example_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(DOCS)
    (code,) = EXAMPLE.findall((DOCS.parent / "README.md").read_text("utf-8"))
    names: dict[str, Any] = {}
    exec(compile(code, "README.md", "exec"), names)  # noqa: S102 - our own page
    assert names["depth"].values.shape == (480, 640)
    assert (tmp_path / "room.exr").is_file()
