"""Small sharp pictures as inline SVG: a panel with two scales, on which dots, lines, bands and words are drawn.

All dots of one colour are one path of round pen strokes, about ten bytes a dot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from doe.report.page import Markup, element, joined
from identify.arrays import Floats

__all__ = ["AFTER", "BEFORE", "GREY", "INK", "Panel", "picture", "ticks", "words"]

BEFORE, AFTER, GREY, LINE, INK = "#c2603f", "#17708a", "#697178", "#dcdfe2", "#20262b"


@dataclass(frozen=True, eq=False)
class Panel:
    """A rectangle of a picture with a horizontal and a vertical scale.

    Attributes:
        left, top, width, height: Of the rectangle, px.
        x, y: Values at its left and right, and at its bottom and top end.
    """

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def px(self, values: Floats | float) -> Floats:
        """Horizontal place of values, px; what lies outside comes to the edge."""
        share = (np.asarray(values, dtype=np.float64) - self.x[0]) / (self.x[1] - self.x[0])
        return np.round(self.left + self.width * np.clip(share, 0, 1), 1)

    def py(self, values: Floats | float) -> Floats:
        """Vertical place of values, px."""
        share = (np.asarray(values, dtype=np.float64) - self.y[0]) / (self.y[1] - self.y[0])
        return np.round(self.top + self.height * (1 - np.clip(share, 0, 1)), 1)

    def dots(self, x: Floats, y: Floats, colour: str, *, size: float = 2.2, opacity: float = 0.4) -> Markup:
        """Round dots."""
        strokes = "".join(f"M{a:g} {b:g}h0" for a, b in zip(self.px(x), self.py(y), strict=True))
        return element("path", d=strokes, stroke=colour, stroke_width=size, stroke_linecap="round", opacity=opacity)

    def line(self, x: Floats, y: Floats, colour: str, *, width: float = 1.6, dashes: str | None = None) -> Markup:
        """A line through points."""
        strokes = "M" + "L".join(f"{a:g} {b:g}" for a, b in zip(self.px(x), self.py(y), strict=True))
        return element("path", d=strokes, fill="none", stroke=colour, stroke_width=width, stroke_dasharray=dashes)

    def band(self, x: Floats, low: Floats, high: Floats, colour: str) -> Markup:
        """An area between two lines."""
        there = zip(np.r_[self.px(x), self.px(x)[::-1]], np.r_[self.py(low), self.py(high)[::-1]], strict=True)
        return element("path", d="M" + "L".join(f"{a:g} {b:g}" for a, b in there) + "Z", fill=colour, opacity=0.18)

    def strokes(self, x: Floats, y: Floats, dx: Floats, dy: Floats, colour: str) -> Markup:
        """Short lines from points, px steps; the point is marked by a dot."""
        a, b = self.px(x), self.py(y)
        lines = "".join(f"M{p:g} {q:g}l{u:g} {v:g}" for p, q, u, v in zip(a, b, dx.round(1), dy.round(1), strict=True))
        starts = "".join(f"M{p:g} {q:g}h0" for p, q in zip(a, b, strict=True))
        return joined(
            element("path", d=starts, stroke=GREY, stroke_width=2.4, stroke_linecap="round", opacity=0.7),
            element("path", d=lines, fill="none", stroke=colour, stroke_width=1.3, opacity=0.85),
        )

    def frame(
        self, *, across: str | None = None, along: str | None = None, zero: bool = False, at: list[float] | None = None
    ) -> Markup:
        """Axes with ticks; ``along`` names the vertical one; no labels below (at ``at``) without ``across``."""
        bottom, right = self.top + self.height, self.left + self.width
        parts = []
        for tick in ticks(*self.y, max(5, round(self.height / 26))):
            place = float(self.py(tick))
            colour = GREY if zero and tick == 0 else LINE
            parts.append(element("path", d=f"M{self.left:g} {place:g}H{right:g}", stroke=colour, stroke_width=0.7))
            parts.append(words(self.left - 4, place + 3, plain(tick), anchor="end"))
        parts.append(element("path", d=f"M{self.left:g} {bottom:g}H{right:g}", stroke=GREY, stroke_width=0.8))
        if across is not None:
            for tick in ticks(*self.x, max(4, round(self.width / 70))) if at is None else at:
                place = float(self.px(tick))
                parts.append(element("path", d=f"M{place:g} {bottom:g}v3", stroke=GREY, stroke_width=0.8))
                parts.append(words(place, bottom + 13, plain(tick)))
            parts.append(words(self.left + self.width / 2, bottom + 26, across, colour=INK))
        if along is not None:
            parts.append(words(self.left + 4, self.top + 9, along, anchor="start", colour=INK))
        return joined(*parts)


def picture(width: float, height: float, *parts: object, title: str) -> Markup:
    """An SVG element with a title for those who cannot see it."""
    return element(
        "svg", element("title", title), *parts, viewBox=f"0 0 {width:g} {height:g}", role="img", font_size="10",
        style=f"max-width:{1.15 * width:.0f}px",
    )  # fmt: skip


def words(
    x: float, y: float, text: str, *, anchor: str = "middle", colour: str = GREY, size: float | None = None
) -> Markup:
    """Text in a picture."""
    return element("text", text, x=f"{x:g}", y=f"{y:g}", text_anchor=anchor, fill=colour, font_size=size)


def ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers within a range, about ``count`` of them."""
    span = high - low
    if not np.isfinite(span) or span <= 0:
        return []
    power = 10.0 ** np.floor(np.log10(span / count))
    step = next(size * power for size in (1.0, 2.0, 5.0, 10.0) if size * power * count >= span * 0.999)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{number * step:.12g}") for number in range(first, last + 1)]


def plain(value: float) -> str:
    """A tick as text."""
    return f"{value:g}".replace("-", "−")
