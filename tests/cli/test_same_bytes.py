"""The same bytes, however the work is spread: with the models that ship, on this machine."""

import cv2
import pytest
from helpers.command_line import ROOT, Cli
from helpers.folders import contents, picture
from helpers.videos import write_mp4

NAMES = ("a.png", "b.png", "c.png")
"""Of two sizes, so that pictures of one can be given to the network together."""
WAYS = {
    "one at a time": ("batch", "in", "--workers", "1", "--threads", "1", "--batch-size", "1"),
    "several at a time": ("batch", "in", "--workers", "3", "--threads", "1", "--batch-size", "1"),
    "several threads": ("batch", "in", "--workers", "1", "--threads", "3", "--batch-size", "1"),
    "several in a batch": ("batch", "in", "--workers", "1", "--threads", "2", "--batch-size", "4"),
    "the other way round": ("batch", "in", "--files", "list.txt", "--workers", "2"),
    "pictures alone": ("predict", *(f"in/{name}" for name in NAMES), "--threads", "2"),
    "pictures in another order": ("predict", *(f"in/{name}" for name in NAMES[::-1])),
}


@pytest.mark.parametrize("model", ["default", "float"])
def test_no_byte_depends_on_how_the_work_is_spread(model: str, inside: Cli) -> None:
    room = cv2.imread(str(ROOT / "docs" / "room.jpg"))
    for name, size in zip(NAMES, ((120, 90), (120, 90), (100, 100)), strict=True):
        picture(inside, name, cv2.resize(room, size) // (1 + NAMES.index(name)))
    write_mp4(inside.folder / "in" / "d.mp4", [cv2.resize(room, (64, 48)) // n for n in (1, 2, 3)])
    (inside.folder / "list.txt").write_text("\n".join(["d.mp4", *NAMES[::-1]]))
    seen = {}
    for number, (way, words) in enumerate(WAYS.items()):
        own = ("--model", str(ROOT / "models" / model), "--format", "npy", "--format", "png16")
        done = inside(*words, "-o", f"{number}/", "--quiet", *own)
        assert done.returncode == 0, done.stderr
        files = contents(inside, str(number))
        seen[way] = {name: data for name, data in files.items() if name != "manifest.jsonl"}
    whole = seen["one at a time"]
    assert len(whole) == 2 * len(NAMES) + 4  # of the video one file and three pictures
    for way, files in seen.items():
        pictures = {name: whole[name] for name in whole if not name.startswith("d.")}
        assert files == (pictures if way.startswith("pictures") else whole), way
