"""A report as a single HTML file, with embedded style and figures and without scripts."""

import base64
from collections.abc import Sequence
from html import escape

from depthcli.evaluation.figures import Figure
from depthcli.evaluation.text import Page
from depthcli.io.depth.metadata import SOFTWARE

_STYLE = """\
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 80rem; padding: 0 1rem;
       color: #1c1c1c; background: #fff; }
h1 { font-size: 1.3rem; margin-bottom: 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; margin: 1.2rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
thead th { border-bottom: 2px solid #444; }
tbody tr:nth-child(even) { background: #f3f3f3; }
ul { padding-left: 1.2rem; color: #444; }
figure { margin: 2rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption { color: #444; }
footer { color: #444; font-size: .8rem; overflow-wrap: anywhere; }"""


def html_page(page: Page, figures: Sequence[Figure] = ()) -> str:
    """The content of the HTML file, with embedded figures."""
    lines = [
        "<!doctype html>",
        '<html lang="en">',
        '<head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(page.title)}</title>",
        f"<style>\n{_STYLE}\n</style></head>",
        "<body>",
        f"<h1>{escape(page.title)}</h1>",
        f"<p>{escape(page.subtitle)}</p>",
        *_table_lines(page.table),
        *_difference_lines(page),
        "<ul>",
        *(f"<li>{escape(note)}</li>" for note in page.notes),
        "</ul>",
        *(_figure(figure) for figure in figures),
        f"<footer>{'<br>'.join(map(escape, (SOFTWARE, *page.models)))}</footer>",
        "</body></html>",
    ]
    return "\n".join(lines) + "\n"


def _table_lines(table: Sequence[Sequence[str]]) -> list[str]:
    header, *rows = table
    return [
        '<div class="scroll"><table>',
        f"<thead><tr>{_tagged('th', header)}</tr></thead>",
        "<tbody>",
        *(f"<tr>{_tagged('td', row)}</tr>" for row in rows),
        "</tbody></table></div>",
    ]


def _difference_lines(page: Page) -> list[str]:
    if page.differences is None:
        return []
    title, table = page.differences
    return [f"<p>{escape(title)}</p>", *_table_lines(table)]


def _tagged(tag: str, texts: Sequence[str]) -> str:
    return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode("ascii")
    caption = escape(figure.caption)
    image = f'<img alt="{caption}" src="data:image/png;base64,{data}">'
    return f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
