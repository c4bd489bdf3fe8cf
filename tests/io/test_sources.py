"""Folders and lists of inputs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
import pytest

from depthcli.io.images.png import encode_png
from depthcli.io.listing.folder import (
    Skipped,
    conversion_hint,
    is_media,
    is_video,
    list_folder,
    skip_summary,
    why_skipped,
)
from depthcli.io.listing.path_list import listed_inputs, parse_list, read_list

if TYPE_CHECKING:
    from pathlib import Path


def touch(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()


def test_media_of_a_tree_in_the_order_of_their_names(tmp_path: Path) -> None:
    touch(tmp_path, "b/z.PNG", "b/a/c.mp4", "a.jpeg", "c.txt", ".hidden.jpg", ".git/x.png", "b.gif")
    listing = list_folder(str(tmp_path))
    assert [found.name for found in listing.media] == ["a.jpeg", "b.gif", "b/z.PNG", "b/a/c.mp4"]
    assert [found.path for found in listing.media][2] == str(tmp_path / "b/z.PNG")
    assert listing.skipped == [(".hidden.jpg", "hidden"), ("c.txt", ".txt")]
    assert listing.loops == []


def test_links_are_followed_but_not_round_in_circles(tmp_path: Path) -> None:
    touch(tmp_path, "in/hall/a.png", "far/b.png")
    (tmp_path / "in" / "hall" / "up").symlink_to("..")
    (tmp_path / "in" / "far").symlink_to("../far")
    (tmp_path / "in" / "broken.png").symlink_to("nowhere")
    (tmp_path / "in" / "itself.png").symlink_to("itself.png")
    listing = list_folder(str(tmp_path / "in"))
    assert [found.name for found in listing.media] == [
        *("broken.png", "itself.png", "far/b.png", "hall/a.png"),
    ]
    assert listing.loops == ["hall/up"]


def test_folders_that_are_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "in/out/a.png", "in/thumbs/b.png", "in/c.png")
    (tmp_path / "in" / "other-name").symlink_to("out")
    listing = list_folder(
        str(tmp_path / "in"), leave_out=str(tmp_path / "in" / "out"), skip=lambda n: n == "thumbs"
    )
    assert [found.name for found in listing.media] == ["c.png"]


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path) -> None:
    (found,) = list_folder(str(tmp_path / "missing")).media
    assert found.problem is not None
    assert "cannot be listed" in found.problem
    assert found.name == "."


@pytest.mark.parametrize(
    ("name", "media", "video"),
    [
        ("a.jpg", True, False),
        ("a.MKV", True, True),
        ("a.mxf", True, True),
        (".a.jpg", False, False),
        ("a", False, False),
    ],
)
def test_suffix_tells_images_and_videos(name: str, media: bool, video: bool) -> None:
    assert (is_media(name), is_video(name)) == (media, video)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", []),
        (b"a\nb\n", ["a", "b"]),
        (b"a\r\nb", ["a", "b"]),
        (b"b\n\na\nb\n", ["b", "a", "b"]),
        (b"new\nline\0b\0", ["new\nline", "b"]),
        (b" a b \n", [" a b "]),
        (b"caf\xe9\n", [os.fsdecode(b"caf\xe9")]),
    ],
)
def test_lists(data: bytes, words: list[str]) -> None:
    assert parse_list(data) == words


def test_listed_paths_are_named_from_the_folder() -> None:
    words = ["z.png", "./a.png", "hall/../b.png", "/far/c.png", "/base/d.png", "../e.png"]
    found = {f.name: f.path for f in listed_inputs(words, "/base")}
    assert found == {
        "a.png": "/base/./a.png",
        "b.png": "/base/hall/../b.png",
        "d.png": "/base/d.png",
        "e.png": "/base/../e.png",
        "far/c.png": "/far/c.png",
        "z.png": "/base/z.png",
    }
    assert [one.name for one in listed_inputs(["a.png", "./a.png"], "/base")] == ["a.png"] * 2


def test_skipped_files_are_counted_by_reason() -> None:
    reasons = {"hidden": 3, ".heic": 2, "excluded": 2, ".dng": 1, ".a": 1, ".b": 1}
    skipped = [Skipped("x", reason) for reason, count in reasons.items() for _ in range(count)]
    assert skip_summary(skipped) == (
        "10 files skipped (3 hidden, 2 .heic, 2 excluded, 1 .dng, 1 .a, 1 .b)"
    )
    more = [*skipped, Skipped("y", ".c"), Skipped("y", ".d")]
    assert skip_summary(more).endswith("1 .a, 1 .b, 2 others)")
    assert skip_summary(skipped[:1]) == "1 file skipped (1 hidden)"
    assert (conversion_hint(skipped) or "").endswith("'.[heif]'")
    assert ".heic" in (conversion_hint(skipped[3:4]) or "")
    assert (conversion_hint(skipped[7:8]) or "").endswith("; convert to JPEG, PNG or TIFF")
    assert conversion_hint(skipped[:3]) is None


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *((name, "written by depthcli") for name in ("a.depth.mkv", "a.preview.MP4")),
        *((f"a{ending}", "written by depthcli") for ending in (".depth.png", ".depth.000001.png")),
        *((name, None) for name in ("a.png", "a.mkv", "mine.depth.png", "a.depth.01.png")),
        *((".a.png", "hidden"), ("a.txt", ".txt"), ("a", "without suffix"), (".b/a.JPEG", None)),
    ],
)
def test_why_a_file_is_no_input(name: str, reason: str | None, tmp_path: Path) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    texts = {} if name.startswith("mine") else {"depthcli:software": "depthcli 1"}
    path.write_bytes(encode_png(np.zeros((1, 1), np.uint8), texts))
    assert why_skipped(str(path)) == reason
    if reason == "written by depthcli" and name.endswith("png"):
        path.unlink()
        assert why_skipped(str(path)) is None


def test_listed_paths_may_be_of_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    touch(tmp_path, "in/a.png", "in/b.png", "in/in/b.png")
    monkeypatch.chdir(tmp_path)
    found = {f.name: f.path for f in listed_inputs(["in/a.png", "in/b.png"], "in")}
    assert found == {"a.png": "in/a.png", "b.png": "in/b.png"}
    found = {f.name: f.path for f in listed_inputs(["a.png", "in/b.png"], "in")}
    assert found == {"a.png": "in/a.png", "in/b.png": "in/in/b.png"}


def test_listed_uris_are_named_from_the_folder() -> None:
    words = ["s3://b/k/x/a.png", "s3://b/c.png", "gs://b/k/d.png", "ftp://h/e.png", "s3:///f.png"]
    found = list(listed_inputs(words, "s3://b/k"))
    assert [one.name for one in found] == [
        *("x/a.png", "b/c.png", "b/k/d.png", "ftp/h/e.png", "s3//f.png"),
    ]
    assert [one.path for one in found] == words
    problems = [one.problem or "" for one in found]
    assert problems[:3] == [""] * 3
    assert "unknown scheme ftp://" in problems[3]
    assert "has no bucket" in problems[4]
    (local,) = listed_inputs(["s3://b/k/a.png"], "/here")
    assert local.name == "b/k/a.png"


def test_folders_of_storage_systems_are_skipped_and_counted(tmp_path: Path) -> None:
    """Synology keeps thumbnails in @eaDir beside every image."""
    touch(tmp_path, "a.jpg", "@eaDir/a.jpg/SYNOPHOTO_THUMB_M.jpg", "b/@eaDir/c.jpg")
    listing = list_folder(str(tmp_path))
    assert [found.name for found in listing.media] == ["a.jpg"]
    assert skip_summary(listing.skipped) == "2 files skipped (2 @eaDir)"


def test_csv_list_without_a_first_line_keeps_its_first_image(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("./a.png\nb.png\n")
    assert list(read_list(str(path))) == ["./a.png", "b.png"]
    path.write_text("image\na.png\n")
    assert list(read_list(str(path))) == ["a.png"]
