"""Folders and lists of inputs."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from depthcli.io.listing.folder import is_media, is_video, list_folder
from depthcli.io.listing.path_list import listed_inputs, parse_list

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
    assert listing.skipped == ((".hidden.jpg", "hidden"), ("c.txt", ".txt"))
    assert listing.loops == ()


def test_links_are_followed_but_not_round_in_circles(tmp_path: Path) -> None:
    touch(tmp_path, "in/hall/a.png", "far/b.png")
    (tmp_path / "in" / "hall" / "up").symlink_to("..")
    (tmp_path / "in" / "far").symlink_to("../far")
    (tmp_path / "in" / "broken.png").symlink_to("nowhere")
    listing = list_folder(str(tmp_path / "in"))
    assert [found.name for found in listing.media] == ["broken.png", "far/b.png", "hall/a.png"]
    assert listing.loops == ("hall/up",)


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


@pytest.mark.parametrize(
    ("name", "media", "video"),
    [("a.jpg", True, False), ("a.MKV", True, True), (".a.jpg", False, False), ("a", False, False)],
)
def test_what_a_name_says(name: str, media: bool, video: bool) -> None:
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
