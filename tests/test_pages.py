"""The pages of the documentation lead to each other."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page.relative_to(ROOT)
    for place in ("*.md", "docs/**/*.md", "models/*.md")
    for page in ROOT.glob(place)
)
WORDS = 37_000
"""Most words of docs/*.md; for a new passage, shorten another.

Benchmark 1,500; server, view 400; known depth 550, its cards 200; requests 400; tour
350; models 4.0.0 500.
"""
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
    pages = (ROOT / page for page in PAGES if page.parent == Path("docs"))
    assert sum(len(page.read_text("utf-8").split()) for page in pages) <= WORDS
