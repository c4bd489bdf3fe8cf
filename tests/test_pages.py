"""Pages of the documentation, and what they say of Python and reliability."""

import re
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from helpers.tiny import synthetic_image, write_image
from helpers.videos import write_mp4

import depthcli
from depthcli._version import __version__

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page.relative_to(ROOT)
    for place in ("*.md", "docs/**/*.md", "models/*.md")
    for page in ROOT.glob(place)
    if "node_modules" not in page.parts
)
WORDS = 34_800
"""Most words of the pages in docs/ that are written by hand; for a new passage, shorten another."""
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)")


def headings(page: Path) -> set[str]:
    """The anchors of a page, as forges make them of its headings."""
    lines = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).strip().replace(" ", "-") for line in lines}


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_link_leads_somewhere(page: Path) -> None:
    for path, heading in LINK.findall((ROOT / page).read_text("utf-8")):
        target = ((ROOT / page).parent / path) if path else ROOT / page
        assert target.exists(), path
        assert not heading or heading in headings(target), f"{path}#{heading}"


def test_the_index_has_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    linked = {(index.parent / path).resolve() for path, _ in LINK.findall(index.read_text("utf-8"))}
    pages = {(ROOT / page).resolve() for page in PAGES}
    assert pages - linked == {index, ROOT / "README.md"}


def test_pages_stay_within_their_budget_of_words() -> None:
    pages = (ROOT / page for page in PAGES if page.parent == Path("docs") and page.name != "cli.md")
    assert sum(len(page.read_text("utf-8").split()) for page in pages) <= WORDS


def test_rows_that_commands_compare_are_models_as_they_name_them() -> None:
    pages = [(ROOT / page).read_text("utf-8") for page in PAGES]
    command = re.compile(r"^depthcli eval .*--model [\w.].*--against .*$", re.MULTILINE)
    commands = command.findall("\n".join(pages))
    assert commands
    for words in map(str.split, commands):
        row = words[words.index("--against") + 1]
        assert ("--model", row) in pairwise(words)


def test_the_citation_states_this_version_and_its_date() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    (date,) = re.findall(rf"^## {__version__} \((.+)\)$", changes, re.MULTILINE)
    cited = (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\nversion: {__version__}\ndate-released: {date}\n" in cited


DOCS = ROOT / "docs"
EXAMPLE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(DOCS)
    shutil.copy(DOCS / "room.jpg", tmp_path)
    write_mp4(tmp_path / "walk.mp4", [synthetic_image(480, 640)] * 2)
    for name in ("a.jpg", "b.jpg"):
        write_image(tmp_path / "images" / name)
    for page in ("README.md", "docs/python.md"):
        names: dict[str, Any] = {}
        for code in EXAMPLE.findall((ROOT / page).read_text("utf-8")):
            exec(compile(code, page, "exec"), names)  # noqa: S102 - our own page
        assert names["depth"].values.shape == (480, 640)
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


def test_every_stable_name_is_on_a_page() -> None:
    text = "".join(page.read_text("utf-8") for page in DOCS.glob("*.md"))
    assert not [name for name in depthcli.__all__ if not re.search(rf"\b{name}\b", text)]


TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs" / "reliability.md").read_text("utf-8")
REPORTS = (TESTS / "reports.md").read_text("utf-8")
NAMED = sorted(set(re.findall(r"`((?:\w+/)*test_\w+\.py)`", PAGE + REPORTS)))
COMMANDS = re.findall(r"`(\w+\.py)`", PAGE.split("## Robustness tests")[1].split("\n## ")[0])


@pytest.mark.parametrize("file", NAMED)
def test_every_test_named_in_the_docs_exists(file: str) -> None:
    assert (TESTS / file).is_file()


def test_every_promise_has_a_test() -> None:
    promises = PAGE.split("## Promises")[1].split("\n## ")[0].splitlines()[4:-1]
    assert len(promises) > 20
    assert all(re.search(r"\.py`|\(#", line.split("|")[2]) for line in promises)


def test_the_long_commands_are_there() -> None:
    assert COMMANDS
    assert all((TESTS.parent / "robustness" / name).is_file() for name in COMMANDS)
