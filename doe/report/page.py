"""HTML from plain Python: elements, tables, and the page with its style.

Whatever comes from a file is text and is escaped; only what was made here is markup. The page needs nothing from
outside: no script, no link, no font, and a policy that forbids browsers to load any.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

__all__ = ["Markup", "element", "joined", "page", "table"]


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def joined(*parts: object) -> Markup:
    """Markup as it is and everything else escaped, one after another; None is left out."""
    kept = (part for part in parts if part is not None)
    return Markup("".join(part if isinstance(part, Markup) else escape(str(part)) for part in kept))


def element(name: str, *content: object, **attributes: object) -> Markup:
    """An element; ``class_`` stands for ``class`` and ``_`` in names for ``-``.

    Args:
        name: Its tag.
        content: Markup or text (which is escaped).
        attributes: Its attributes; None is left out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Markup(f"<{name}{written}>{joined(*content)}</{name}>")


def table(header: Sequence[object], rows: Iterable[Sequence[object]], *, words: Sequence[int] = (0,)) -> Markup:
    """A table.

    Args:
        header: Texts of the head.
        rows: Cells, Markup or text.
        words: Columns that hold words and stand to the left; all others hold numbers.
    """

    def line(tag: str, cells: Sequence[object]) -> Markup:
        return element("tr", *(element(tag, cell, class_=None if i in words else "n") for i, cell in enumerate(cells)))

    return element(
        "div",
        element("table", element("thead", line("th", header)), element("tbody", *(line("td", row) for row in rows))),
        class_="wide",
    )


def page(title: str, *body: Markup) -> str:
    """The whole file."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta http-equiv="Content-Security-Policy" '
        "content=\"default-src 'none'; style-src 'unsafe-inline'; img-src data:\">\n"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"{MADE_BY}\n<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )


#: Tells a report of ours from any other file of its name.
MADE_BY = '<meta name="generator" content="elastocal report">'

STYLE = """
:root{--ink:#20262b;--grey:#697178;--line:#dcdfe2;--pale:#f4f5f6;--before:#c2603f;--after:#17708a;--state:#697178}
*{box-sizing:border-box}
body{margin:0;background:#fff;color:var(--ink);font:15px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans",
"DejaVu Sans",sans-serif}
main{max-width:1020px;margin:0 auto;padding:28px 24px 60px}
h1{font-size:25px;line-height:1.3;margin:4px 0 8px;font-weight:650}
h2{font-size:19px;margin:44px 0 10px;padding-top:12px;border-top:2px solid var(--ink);font-weight:650}
h3{font-size:15px;margin:26px 0 6px;font-weight:650}
p{margin:6px 0 10px;max-width:78ch}
.top{color:var(--grey);font-size:13px;margin:0}
h1+p{max-width:none;margin:0 0 4px}
.verdict{border-left:7px solid var(--state);background:var(--pale);padding:14px 20px 10px;margin:10px 0 18px}
.verdict .label{color:var(--state);font-weight:700;text-transform:uppercase;letter-spacing:.06em;font-size:12.5px}
.adequate{--state:#3c7d4e}.cause_found{--state:#17708a}.ambiguous{--state:#b57a06}.unexplained{--state:#b3372c}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:12px;margin:16px 0}
.card{border:1px solid var(--line);padding:8px 14px 10px}
.card b{display:block;font-size:18.5px;white-space:nowrap;font-weight:600;font-variant-numeric:tabular-nums}
.card span{color:var(--grey);font-size:12.5px;display:block;line-height:1.35}
.grid2{display:grid;grid-template-columns:repeat(2,1fr);gap:10px 18px;align-items:start}
.grid3{display:grid;grid-template-columns:repeat(3,1fr);gap:10px 14px}
figure{margin:8px 0}figcaption{color:var(--grey);font-size:13px;max-width:90ch}
svg{display:block;width:100%;height:auto;font-family:inherit}
.wide{overflow-x:auto;margin:8px 0 14px}
table{border-collapse:collapse;font-size:13.5px;font-variant-numeric:tabular-nums}
th{font-weight:600;color:var(--grey);border-bottom:1px solid var(--ink);text-align:left;vertical-align:bottom}
td{border-bottom:1px solid var(--line);vertical-align:top}
th,td{padding:3px 16px 3px 0}
.n{text-align:right}
.bar{width:150px;min-width:110px}
.bar i{display:block;height:6px;margin:3px 0}
.bar i.b{background:var(--before)}.bar i.a{background:var(--after)}
.b{color:var(--before)}.a{color:var(--after)}
.cause{border:1px solid var(--line);border-left:5px solid var(--after);padding:4px 18px 8px;margin:14px 0}
.cause h3{margin-top:8px}
.warn{color:#b3372c;font-weight:600}
.quiet{color:var(--grey);font-size:13px}
code,pre{font-family:ui-monospace,"SF Mono",Menlo,Consolas,"DejaVu Sans Mono",monospace;font-size:12.5px}
pre{background:var(--pale);padding:10px 14px;white-space:pre-wrap;overflow-wrap:anywhere}
td code{overflow-wrap:anywhere}
ul{margin:6px 0 10px;padding-left:20px}
@media (max-width:720px){.grid2,.grid3{grid-template-columns:1fr}}
@page{margin:14mm}
@media print{body{font-size:10.5pt}main{max-width:none;padding:0}h2,h3{break-after:avoid}
figure,.cause,.card,.verdict,tr{break-inside:avoid}*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""
