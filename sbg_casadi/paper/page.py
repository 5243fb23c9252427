"""The document of a run as one HTML page that needs nothing else: figures inside, tables sorted by its own script."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from sbg_casadi.paper.gallery import Picture
from sbg_casadi.paper.markdown import TITLE, introduction
from sbg_casadi.paper.row import VERDICTS
from sbg_casadi.paper.tables import TextTable, text_tables, verdict_table

# Nothing may be fetched, from wherever the page is opened.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 80rem; padding: 0 1rem; color: #1a1a1a; }
h1 { font-size: 1.6rem; } h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; } figure { margin: 1.5rem 0; }
img { max-width: 100%; height: auto; } figcaption { color: #555; font-size: .9rem; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .82rem; }
th, td { border: 1px solid #ddd; padding: .25rem .45rem; text-align: left; vertical-align: top; }
th { background: #f3f3f3; position: sticky; top: 0; padding: 0; }
th button { all: unset; cursor: pointer; font-weight: 600; padding: .3rem .45rem; display: block; }
th button:focus-visible { outline: 2px solid #1b5e9e; }
th[aria-sort=ascending] button::after { content: " \\25B2"; }
th[aria-sort=descending] button::after { content: " \\25BC"; }
.verdict { font-weight: 600; white-space: nowrap; } .reproduced { color: #11632f; } .matched { color: #1b4f9e; }
.contradicted { color: #a1260d; } .not { color: #555; } .failed { color: #a1260d; font-weight: 600; }
nav a { margin-right: 1rem; } label { margin-right: 1rem; }
"""

_SCRIPT = """
function key(cell) {
  const text = cell.textContent.trim(), number = parseFloat(text.replace(/,/g, ""));
  return [isNaN(number) || !/^[+-]?[.0-9]/.test(text) ? null : number, text];
}
function order(a, b) {
  if (a[0] !== null && b[0] !== null && a[0] !== b[0]) return a[0] - b[0];
  if ((a[0] === null) !== (b[0] === null)) return a[0] === null ? 1 : -1;
  return a[1].localeCompare(b[1]);
}
document.querySelectorAll("table.sortable").forEach(table => {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    const rows = [...body.rows].map(row => [key(row.cells[column]), row]);
    rows.sort((a, b) => up ? order(a[0], b[0]) : order(b[0], a[0]));
    rows.forEach(row => body.appendChild(row[1]));
    heads.forEach(other => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
  }));
});
document.querySelectorAll("input[data-verdict]").forEach(box => box.addEventListener("change", () => {
  document.querySelectorAll("#table-of-scoreboard tr[data-verdict]").forEach(row => {
    if (row.dataset.verdict === box.dataset.verdict) row.hidden = !box.checked;
  });
}));
"""


def page(document: Mapping[str, Any], pictures: Sequence[Picture]) -> str:
    """Return the text of the HTML page.

    Parameters
    ----------
    document : mapping
        Of :func:`~sbg_casadi.paper.document.paper_document`.
    pictures : sequence of Picture
    """
    tables = text_tables(document)
    parts = [f"<h1>{escape(TITLE)}</h1>", *(f"<p>{escape(text)}</p>" for text in introduction(document))]
    parts += [f'<p class="failed">Not computed: {escape(text)}</p>' for text in document["failures"]]
    links = {"verdicts": "Verdicts", **{t.name: t.title.partition(":")[0] for t in tables},
             "learned": "What the engineer learns", "figures": "Figures"}  # fmt: skip
    parts.append("<nav>" + "".join(f'<a href="#{n}">{escape(t)}</a>' for n, t in links.items()) + "</nav>")
    parts += [_table(verdict_table(document)), *(_table(t) for t in tables), '<h2 id="learned">']
    parts.append("What the engineer learns</h2>")
    for case, sentences in document["learned"].items():
        parts.append(f"<h3>{escape(case)}</h3><p>{escape(' '.join(sentences))}</p>")
        parts += [_figure(p) for p in pictures if p.case == case and p.name.endswith("overview.png")]
    parts.append('<h2 id="figures">Figures</h2>')
    parts += [_figure(p) for p in pictures if not p.name.endswith("overview.png")]
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width">'
        f'<link rel="icon" href="data:,"><title>{escape(TITLE)}</title><style>{_STYLE}</style>'
    )
    body = "\n".join(parts)
    start = f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head>\n<body>\n'
    return f"{start}{body}\n<script>{_SCRIPT}</script>\n</body></html>\n"


def _figure(picture: Picture) -> str:
    text, data = escape(picture.heading), base64.b64encode(picture.data).decode("ascii")
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return f'<figure id="{picture.name}">{image}<figcaption>{text}</figcaption></figure>'


def _table(table: TextTable) -> str:
    """Return a table with a button in every heading, which sorts by its column."""
    heads = "".join(f'<th scope="col"><button type="button">{escape(h)}</button></th>' for h in table.heads)
    column = table.heads.index("verdict") if "verdict" in table.heads else None
    rows = "\n".join(_row(row, column) for row in table.rows)
    boxes = ""
    if table.name == "scoreboard":
        boxes = "<p>Show " + "".join(
            f'<label><input type="checkbox" checked data-verdict="{v}"> {v}</label>' for v in VERDICTS
        ) + "</p>"  # fmt: skip
    return (
        f'<h2 id="{table.name}">{escape(table.title)}</h2>{boxes}<div class="wide"><table class="sortable" '
        f'id="table-of-{table.name}"><thead><tr>{heads}</tr></thead><tbody>\n{rows}\n</tbody></table></div>'
        + "".join(f"<p>{escape(text)}</p>" for text in table.remarks)
    )


def _row(row: Sequence[str], column: int | None) -> str:
    cells = []
    for i, text in enumerate(row):
        kind = f' class="verdict {text.split()[0]}"' if i == column else ""
        cells.append(f"<td{kind}>{escape(text)}</td>")
    mark = "" if column is None else f' data-verdict="{escape(row[column])}"'
    return f"<tr{mark}>{''.join(cells)}</tr>"
