"""Inputs of a batch: folders, lists, tables, and the patterns that choose among them."""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from depthcli.errors import UsageError
from depthcli.io.images.png import encode_png
from depthcli.io.listing import (
    EXCLUDED,
    NOT_INCLUDED,
    InputFile,
    NameFilter,
    Skipped,
    column_texts,
    conversion_hint,
    list_folder,
    listed_inputs,
    parse_list,
    read_list,
    skip_summary,
    why_skipped,
)


def touch(root: Path, *names: str) -> None:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()


def test_media_of_a_tree_in_the_order_of_their_names(tmp_path: Path) -> None:
    touch(tmp_path, "b/z.PNG", "b/a/c.mp4", "a.jpeg", "c.txt", ".hidden.jpg", ".git/x.png", "b.gif")
    listing = list_folder(str(tmp_path))
    assert [file.name for file in listing.media] == ["a.jpeg", "b.gif", "b/z.PNG", "b/a/c.mp4"]
    assert [file.path for file in listing.media][2] == str(tmp_path / "b/z.PNG")
    assert listing.skipped == [(".hidden.jpg", "hidden"), ("c.txt", ".txt")]
    assert listing.loops == []


def test_links_are_followed_but_not_round_in_circles(tmp_path: Path) -> None:
    touch(tmp_path, "in/hall/a.png", "far/b.png")
    (tmp_path / "in" / "hall" / "up").symlink_to("..")
    (tmp_path / "in" / "far").symlink_to("../far")
    (tmp_path / "in" / "broken.png").symlink_to("nowhere")
    (tmp_path / "in" / "itself.png").symlink_to("itself.png")
    listing = list_folder(str(tmp_path / "in"))
    assert [file.name for file in listing.media] == [
        *("broken.png", "itself.png", "far/b.png", "hall/a.png")
    ]
    assert listing.loops == ["hall/up"]


def test_folders_that_are_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "in/out/a.png", "in/thumbs/b.png", "in/c.png")
    (tmp_path / "in" / "other-name").symlink_to("out")
    listing = list_folder(
        str(tmp_path / "in"), leave_out=str(tmp_path / "in" / "out"), skip=lambda n: n == "thumbs"
    )
    assert [file.name for file in listing.media] == ["c.png"]


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path) -> None:
    (entry,) = list_folder(str(tmp_path / "missing")).media
    assert "cannot be listed" in entry.problem
    assert entry.name == "."


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


def test_a_list_redirected_by_windows_powershell_is_refused() -> None:
    with pytest.raises(UsageError, match="UTF-16"):
        parse_list("a.png\r\n".encode("utf-16"))


def test_listed_paths_are_named_from_the_folder() -> None:
    words = ["z.png", "./a.png", "hall/../b.png", "/far/c.png", "/base/d.png", "../e.png"]
    paths = {f.name: f.path for f in listed_inputs(words, "/base")}
    assert paths == {
        "a.png": "/base/./a.png",
        "b.png": "/base/hall/../b.png",
        "d.png": "/base/d.png",
        "e.png": "/base/../e.png",
        "far/c.png": "/far/c.png",
        "z.png": "/base/z.png",
    }
    assert [file.name for file in listed_inputs(["a.png", "./a.png"], "/base")] == ["a.png"] * 2


def test_skipped_files_are_counted_by_reason() -> None:
    reasons = {"hidden": 3, ".heic": 2, "excluded": 2, ".dng": 1, ".a": 1, ".b": 1}
    skipped = [Skipped("x", reason) for reason, count in reasons.items() for _ in range(count)]
    assert skip_summary(skipped) == (
        "10 files skipped (3 hidden, 2 .heic, 2 excluded, 1 .dng, 1 .a, 1 .b)"
    )
    more = [*skipped, Skipped("y", ".c"), Skipped("y", ".d")]
    assert skip_summary(more).endswith("1 .a, 1 .b, 2 others)")
    assert skip_summary(skipped[:1]) == "1 file skipped (1 hidden)"
    assert (conversion_hint(skipped) or "").endswith("'depthcli[heif]'")
    assert ".heic" in (conversion_hint(skipped[3:4]) or "")
    assert (conversion_hint(skipped[7:8]) or "").endswith("; convert to JPEG, PNG or TIFF")
    assert conversion_hint(skipped[:3]) is None


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        *((name, "written by depthcli") for name in ("a.depth.mkv", "a.preview.MP4")),
        *(
            (f"a{ending}", "written by depthcli")
            for ending in (".depth.png", ".depth.01.png", ".png")
        ),
        *((name, None) for name in ("a.mkv", "mine.depth.png", "mine.png")),
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


def test_listed_uris_are_named_from_the_folder() -> None:
    words = ["s3://b/k/x/a.png", "s3://b/c.png", "gs://b/k/d.png", "ftp://h/e.png", "s3:///f.png"]
    files = list(listed_inputs(words, "s3://b/k"))
    assert [file.name for file in files] == [
        *("x/a.png", "b/c.png", "b/k/d.png", "ftp/h/e.png", "s3//f.png")
    ]
    assert [file.path for file in files] == words
    problems = [file.problem or "" for file in files]
    assert problems[:3] == [""] * 3
    assert "unknown scheme ftp://" in problems[3]
    assert "has no bucket" in problems[4]
    (local,) = listed_inputs(["s3://b/k/a.png"], "/here")
    assert local.name == "b/k/a.png"


def test_folders_of_storage_systems_are_skipped_and_counted(tmp_path: Path) -> None:
    """Synology keeps thumbnails in @eaDir beside every image."""
    touch(tmp_path, "a.jpg", "@eaDir/a.jpg/SYNOPHOTO_THUMB_M.jpg", "b/@eaDir/c.jpg")
    listing = list_folder(str(tmp_path))
    assert [file.name for file in listing.media] == ["a.jpg"]
    assert skip_summary(listing.skipped) == "2 files skipped (2 @eaDir)"


def test_csv_list_without_a_first_line_keeps_its_first_image(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("./a.png\nb.png\n")
    assert list(read_list(str(path))) == ["./a.png", "b.png"]
    path.write_text("image\na.png\n")
    assert list(read_list(str(path))) == ["a.png"]


WORDS = ["hall/a.png", "s3://bucket/b c,d.jpg", "é.png"]


def parquet(path: Path, /, **columns: list[Any]) -> Path:
    pq.write_table(pa.table(columns), path, row_group_size=2)
    return path


def csv(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_paths_of_a_list_of_a_store_are_not_those_of_local_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.jpg").touch()
    monkeypatch.chdir(tmp_path)
    assert list(listed_inputs(["a.jpg"], "s3://photos/in")) == [
        InputFile("a.jpg", "s3://photos/in/a.jpg")
    ]


@pytest.mark.parametrize(
    ("write", "column"),
    [
        (lambda f: parquet(f / "l.parquet", path=WORDS, size=[1, 2, 3]), None),
        (lambda f: parquet(f / "l.parquet", uri=WORDS, path=["", "", ""]), "uri"),
        (lambda f: parquet(f / "l.PARQUET", uri=WORDS), None),
        (lambda f: csv(f / "l.txt", "\ufeff" + "\r\n".join(WORDS)), None),
        (lambda f: parquet(f / "l.parquet", uri=pa.array(WORDS).dictionary_encode()), None),
        (lambda f: parquet(f / "l.parquet", uri=[WORDS[0], None, *WORDS[1:], ""]), None),
        (
            lambda f: csv(f / "l.csv", 'n,path\n1,hall/a.png\n2,"s3://bucket/b c,d.jpg"\n3,é.png'),
            None,
        ),
        (
            lambda f: csv(f / "l.tsv", "\ufeffuri\nhall/a.png\ns3://bucket/b c,d.jpg\né.png\n\n"),
            None,
        ),
    ],
)
def test_a_column_of_paths(
    tmp_path: Path, write: Callable[[Path], Path], column: str | None
) -> None:
    assert list(read_list(str(write(tmp_path)), column)) == WORDS


def test_a_folder_of_parquet_files_is_read_in_the_order_of_names(tmp_path: Path) -> None:
    folder = tmp_path / "set.parquet"
    folder.mkdir()
    parquet(folder / "part-1.parquet", path=WORDS[2:])
    parquet(folder / "part-0.parquet", path=WORDS[:2])
    assert list(read_list(str(folder))) == WORDS


@pytest.mark.parametrize(
    ("write", "column"),
    [
        (lambda f: parquet(f / "l.parquet", a=["x"], b=["y"]), None),
        (lambda f: parquet(f / "l.parquet", a=["x"]), "b"),
        (lambda f: parquet(f / "l.parquet", a=[{"x": 1}]), None),
        (lambda f: csv(f / "l.parquet", ""), None),
        (lambda f: csv(f / "l.parquet", "PAR1"), None),
        (lambda f: csv(f / "l.csv", ""), None),
        (lambda f: csv(f / "l.csv", "a,b\n1,2\n"), "c"),
        (lambda f: csv(f / "l.csv", "path,depth\na.png,2,35\n"), None),
        (lambda f: csv(f / "l.csv", f"a\nb.png\n{'c' * 200_000}\nd.png\n"), None),
        (lambda f: csv(f / "l.txt", "a.png\n"), "c"),
        (lambda f: f / "missing.parquet", None),
        (lambda f: f / "missing.csv", None),
    ],
)
def test_lists_that_cannot_be_used(
    tmp_path: Path, write: Callable[[Path], Path], column: str | None
) -> None:
    with pytest.raises(UsageError):
        list(read_list(str(write(tmp_path)), column))


def test_without_pyarrow_one_line_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = parquet(tmp_path / "l.parquet", path=WORDS)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError):
        list(read_list(str(path)))


def test_a_file_uri_is_the_path_that_it_names(tmp_path: Path) -> None:
    plain = tmp_path / "in" / "a b.png"
    uri = plain.as_uri()
    assert uri.startswith("file:///")
    as_uri, as_path = (next(iter(listed_inputs([w], str(tmp_path)))) for w in (uri, str(plain)))
    assert as_uri == as_path
    assert as_uri.name == "in/a b.png"


def test_a_folder_without_tables(tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        list(column_texts(tmp_path, None))
    with pytest.raises(FileNotFoundError):
        list(column_texts(tmp_path / "none.parquet", None))


@pytest.mark.parametrize(
    ("pattern", "name", "matches"),
    [
        *(("*.jpg", name, True) for name in ("a.jpg", "hall/deep/a.jpg")),
        *(("*.jpg", name, False) for name in ("a.jpg.png", "a.JPG")),
        *(("?.png", "a.png", True), ("?.png", "ab.png", False), ("a.png", "axpng", False)),
        *(("[ab].png", "b.png", True), ("[!ab].png", "b.png", False), ("[!ab].png", "c.png", True)),
        *(("[a-c]*", "hall/box.png", True), ("[]].png", "].png", True), ("[.png", "[.png", True)),
        *(("a+(b).png", "a+(b).png", True), ("new*line.png", "new\nline.png", True)),
        ("hall/*.jpg", "hall/a.jpg", True),
        *(("hall/*.jpg", f"{folders}/a.jpg", False) for folders in ("hall/deep", "deep/hall")),
        ("hall/**", "hall/deep/a.jpg", True),
        *(("hall/**/a.jpg", f"hall/{name}", True) for name in ("a.jpg", "x/y/a.jpg")),
        *(("**/a.jpg", name, True) for name in ("a.jpg", "x/y/a.jpg")),
        *(("./hall/a.jpg", "hall/a.jpg", True), ("/a.jpg", "a.jpg", True)),
        ("/a.jpg", "hall/a.jpg", False),
    ],
)
def test_pattern_matches_names(pattern: str, name: str, matches: bool) -> None:
    assert NameFilter.of([pattern], []).refusal(name) is (None if matches else NOT_INCLUDED)
    assert NameFilter.of([], [pattern]).excludes(name) is matches


@pytest.mark.parametrize(
    ("pattern", "name"),
    [
        ("thumbs", "hall/thumbs/a.jpg"),
        ("thumbs/", "thumbs/deep/a.jpg"),
        ("hall/thumbs", "hall/thumbs/a.jpg"),
        ("t*", "hall/thumbs/a.jpg"),
    ],
)
def test_an_excluded_folder_takes_all_that_is_in_it_along(pattern: str, name: str) -> None:
    assert NameFilter.of(["*.jpg"], [pattern]).refusal(name) == EXCLUDED


@pytest.mark.parametrize("pattern", ["[]", "[z-a]"])
def test_invalid_pattern_is_refused(pattern: str) -> None:
    with pytest.raises(UsageError):
        NameFilter.of([pattern], [])
