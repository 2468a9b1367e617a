"""Plots as inline SVG: light, without outside addresses, coloured by the style sheet of the page.

Points of one kind are a single path, so that thousands of them cost a few bytes each. Every text is
escaped. What is not finite is left out; a line breaks there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import ArrayLike, NDArray

from mobo_tuner.core.problem import Array
from mobo_tuner.core.units import raised

_SHAPES = {
    "dot": "h0",  # drawn by its round line cap
    "cross": "m-3-3l6 6m0-6l-6 6",
    "plus": "m-4 0h8m-4-4v8",
    "square": "m-3-3h6v6h-6z",
    "diamond": "m0-4l4 4l-4 4l-4-4z",
    "triangle": "m0-4l4 7h-8z",
}
_FARTHEST_END = 1e300  # of an axis


@dataclass(frozen=True)
class Axis:
    """One axis of a plot.

    Attributes:
        low, high: Its ends; they are widened if they are equal.
        label: What it shows, with its unit.
        integer: Whether only integers get a tick.
        named: Places of the only ticks, with their texts; empty = ticks at round numbers.
        log: Whether equal ratios are equally far apart; both ends are positive.
    """

    low: float
    high: float
    label: str = ""
    integer: bool = False
    named: Sequence[tuple[float, str]] = ()
    log: bool = False

    def __post_init__(self) -> None:
        """Keep the ends, and so their distance, finite."""
        for end in ("low", "high"):
            bounded = min(max(getattr(self, end), -_FARTHEST_END), _FARTHEST_END)
            object.__setattr__(self, end, bounded)

    @classmethod
    def around(
        cls,
        values: ArrayLike,
        label: str = "",
        *,
        margin: float = 0.05,
        integer: bool = False,
        log: bool = False,
    ) -> Axis:
        """Return an axis that shows all finite values, with a margin as a share of their range.

        If it is logarithmic, it shows the positive ones.
        """
        known = np.asarray(values, dtype=float).ravel()
        known = known[np.isfinite(known)]
        if log and (known > 0.0).any():
            ends = cls.around(np.log10(known[known > 0.0]), margin=margin)
            return cls(10.0**ends.low, 10.0**ends.high, label, log=True)
        if not len(known):
            return cls(0.0, 1.0, label, integer)
        low, high = float(known.min()), float(known.max())
        width = margin * (high - low) if high > low else 0.05 * abs(high) or 0.5
        return cls(low - width, high + width, label, integer)

    def ticks(self, count: int) -> tuple[list[tuple[float, str]], str]:
        """Return positions and texts of about `count` ticks, and the power of ten that they share."""
        if self.named:
            return list(self.named), ""
        if self.log:
            return self._log_ticks(count), ""
        low, high = self.low, self.high
        raw = (high - low) / max(count, 1)
        step = 10.0 ** math.floor(math.log10(raw)) if raw > 0.0 else 1.0
        step *= next((f for f in (1.0, 2.0, 5.0) if f * step >= raw * 0.999), 10.0)
        if self.integer:
            step = max(1.0, float(round(step)))
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        values = [index * step for index in range(first, min(last, first + 20) + 1)]
        largest = max((abs(v) for v in values), default=0.0)
        exponent = math.floor(math.log10(largest)) if largest > 0.0 else 0
        if -3 <= exponent < 5:
            exponent = 0
        power = f"×10{raised(exponent)}" if exponent else ""
        digits = max(0, exponent - math.floor(math.log10(step) + 1e-9))
        return [(v, _trimmed(v / 10.0**exponent, digits)) for v in values], power

    def _log_ticks(self, count: int) -> list[tuple[float, str]]:
        """Return ticks at powers of ten, and at 2 and 5 times these if there is room."""
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        step = max(1, math.ceil((last - first - 1) / max(count, 1)))
        for factors in ((1, 2, 5), (1, 3), (1,)):
            decades = range(first, last + 1, step if len(factors) == 1 else 1)
            values = [factor * 10.0**decade for decade in decades for factor in factors]
            inside = [v for v in values if self.low * (1 - 1e-9) <= v <= self.high * (1 + 1e-9)]
            if len(inside) <= count + 1:
                break
        return [(value, _power(value)) for value in inside]


@dataclass
class Plot:
    """A plot of one quantity against another, built layer by layer.

    Attributes:
        x, y: Axes.
        title: Text above it.
        size: Width and height in units of the view box.
        left: Width of the margin for the texts of the vertical axis.
        legend: Text, shape and style of what is drawn, as `render_legend` takes it.
    """

    x: Axis
    y: Axis
    title: str = ""
    size: tuple[int, int] = (330, 220)
    left: int = 58
    legend: list[tuple[str, str, str]] = field(default_factory=list)
    _layers: list[str] = field(default_factory=list)
    _outside: set[tuple[float, float]] = field(default_factory=set)

    def band(self, start: float, end: float, css: str) -> None:
        """Shade a range of the horizontal axis."""
        a, b = self._across(np.clip([start, end], self.x.low, self.x.high))
        self._layers.append(
            f'<rect class="{css}" x="{a:.1f}" y="{self._top}" width="{max(b - a, 0.0):.1f}" '
            f'height="{self._bottom - self._top}"/>'
        )

    def line(
        self, x: ArrayLike, y: ArrayLike, css: str, legend: str = "", *, step: bool = False
    ) -> None:
        """Draw a line through points, or steps that hold each value until the next point."""
        xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        if step and len(xs):
            xs, ys = np.repeat(xs, 2)[1:], np.repeat(ys, 2)[:-1]
        if len(xs) == 1:  # of which there is no line
            reach = 0.01 * (self.x.high - self.x.low)
            xs, ys = np.array([xs[0] - reach, xs[0] + reach]), np.repeat(ys, 2)
        path = _polyline(self._across(xs), self._up(ys))
        if path:
            self._layers.append(
                f'<path class="line {css}" clip-path="url(#{self._clip})" d="{path}"/>'
            )
            self._note(legend, "line", css)

    def level(self, y: float, css: str, legend: str = "") -> None:
        """Draw a horizontal line from end to end, if it is in view."""
        if self.y.low <= y <= self.y.high:
            self.line([self.x.low, self.x.high], [y, y], css, legend)

    def upright(self, x: float, css: str, legend: str = "") -> None:
        """Draw a vertical line from end to end, if it is in view."""
        if self.x.low <= x <= self.x.high:
            self.line([x, x], [self.y.low, self.y.high], css, legend)

    def spans(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, css: str) -> None:
        """Draw vertical error bars."""
        a, b, c = (np.asarray(values, dtype=float) for values in (x, low, high))
        known = np.isfinite(a) & np.isfinite(b) & np.isfinite(c)
        known &= (a >= self.x.low) & (a <= self.x.high) & (c >= self.y.low) & (b <= self.y.high)
        b, c = (np.clip(values, self.y.low, self.y.high) for values in (b, c))
        ends = zip(self._across(a[known]), self._up(b[known]), self._up(c[known]), strict=True)
        path = "".join(f"M{x:.1f} {low:.1f}V{high:.1f}" for x, low, high in ends)
        if path:
            self._layers.append(f'<path class="line {css}" d="{path}"/>')

    def marks(
        self,
        x: ArrayLike,
        y: ArrayLike,
        css: str,
        legend: str = "",
        *,
        shape: str = "dot",
        titles: Sequence[str] | None = None,
    ) -> None:
        """Draw points of one kind; with titles, each tells its own when the pointer rests on it.

        Points outside the axes are counted and not drawn.
        """
        xs, ys = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
        known = np.isfinite(xs) & np.isfinite(ys)
        inside = (xs >= self.x.low) & (xs <= self.x.high) & (ys >= self.y.low) & (ys <= self.y.high)
        self._outside |= {
            *zip(xs[known & ~inside].tolist(), ys[known & ~inside].tolist(), strict=True)
        }
        rows = np.flatnonzero(known & inside)
        if not len(rows):
            return
        mark = _SHAPES[shape]
        spots = [
            f"M{a:.1f} {b:.1f}{mark}"
            for a, b in zip(self._across(xs[rows]), self._up(ys[rows]), strict=True)
        ]
        kind = f'class="mark {shape} {css}"'
        if titles is None:
            self._layers.append(f'<path {kind} d="{"".join(spots)}"/>')
        else:
            self._layers += [
                f'<path {kind} d="{spot}"><title>{escape(titles[row])}</title></path>'
                for spot, row in zip(spots, rows.tolist(), strict=True)
            ]
        self._note(legend, shape, css)

    def render(self) -> Markup:
        """Return the plot as SVG."""
        parts = [
            f'<svg class="plot" viewBox="0 0 {self.size[0]} {self.size[1]}" role="img" '
            f'aria-label="{escape(self.title or self.y.label)}">'
            f'<clipPath id="{self._clip}"><rect x="{self.left}" y="{self._top}" '
            f'width="{self._right - self.left}" height="{self._bottom - self._top}"/></clipPath>'
        ]
        if self.title:
            parts.append(f'<text class="title" x="{self.left}" y="14">{escape(self.title)}</text>')
        parts += self._grid()
        parts += self._layers
        if self._outside:
            parts.append(
                f'<text class="note" x="{self._right}" y="{self._top - 4}" text-anchor="end">'
                f"{len(self._outside)} outside</text>"
            )
        parts.append("</svg>")
        return Markup("".join(parts))

    @property
    def _clip(self) -> str:
        """Id of the clip path, which is found in the whole page: equal ids have equal shapes."""
        return f"clip-{self.left}-{self._top}-{self._right}-{self._bottom}"

    @property
    def _top(self) -> int:
        return 24 if self.title else 14

    @property
    def _bottom(self) -> int:
        return self.size[1] - (38 if self.x.label else 22)

    @property
    def _right(self) -> int:
        return self.size[0] - 12

    def _across(self, x: ArrayLike) -> Array:
        return _scaled(x, self.x, self.left, self._right)

    def _up(self, y: ArrayLike) -> Array:
        return _scaled(y, self.y, self._bottom, self._top)

    def _note(self, legend: str, shape: str, css: str) -> None:
        entry = (legend, shape, css)
        if legend and entry not in self.legend:
            self.legend.append(entry)

    def _grid(self) -> Iterable[str]:
        """Yield grid, ticks and labels."""
        across, x_power = self.x.ticks(max(2, (self._right - self.left) // 55))
        up, y_power = self.y.ticks(max(2, (self._bottom - self._top) // 30))
        lines = [f"M{self._across(v):.1f} {self._top}V{self._bottom}" for v, _ in across]
        lines += [f"M{self.left} {self._up(v):.1f}H{self._right}" for v, _ in up]
        yield f'<path class="mesh" d="{"".join(lines)}"/>'
        for value, text in across:
            yield (
                f'<text class="tick" x="{self._across(value):.1f}" y="{self._bottom + 14}" '
                f'text-anchor="middle">{text}</text>'
            )
        for value, text in up:
            yield (
                f'<text class="tick" x="{self.left - 5}" y="{self._up(value) + 4:.1f}" '
                f'text-anchor="end">{text}</text>'
            )
        middle = (self.left + self._right) / 2
        yield from _label(self.x.label, x_power, f'x="{middle:.0f}" y="{self.size[1] - 6}"')
        center = (self._top + self._bottom) / 2
        place = f'transform="translate(13 {center:.0f}) rotate(-90)"'
        yield from _label(self.y.label, y_power, place)


def render_legend(plots: Sequence[Plot]) -> Markup:
    """Return one legend for several plots, as HTML."""
    entries = dict.fromkeys(entry for plot in plots for entry in plot.legend)
    return Markup(f'<p class="legend">{"".join(_legend_entry(*e) for e in entries)}</p>')


@dataclass
class ParallelAxes:
    """Parallel coordinates: one upright axis per quantity, one line per point.

    Attributes:
        axes: Axes from left to right; a value outside is drawn at the end that is near.
        spacing: Distance of two axes.
        height: Height in units of the view box.
    """

    axes: Sequence[Axis]
    spacing: int = 84
    height: int = 300
    _layers: list[str] = field(default_factory=list)

    def lines(self, values: Array, css: str, titles: Sequence[str] | None = None) -> None:
        """Draw one line for each row of values ``(n, number of axes)``; it breaks at a NaN."""
        if not len(values):
            return
        xs = np.array([self._place(j) for j in range(len(self.axes))], dtype=float)
        columns = [
            _scaled(np.clip(column, axis.low, axis.high), axis, self.height - 34, 40)
            for column, axis in zip(values.T, self.axes, strict=True)
        ]
        paths = [_polyline(xs, row) for row in np.column_stack(columns)]
        if titles is None:
            self._layers.append(f'<path class="line {css}" d="{"".join(paths)}"/>')
        else:
            self._layers += [
                f'<path class="line {css}" d="{path}"><title>{escape(title)}</title></path>'
                for path, title in zip(paths, titles, strict=True)
            ]

    def render(self) -> Markup:
        """Return the plot as SVG."""
        width = self.spacing * len(self.axes)
        parts = [
            f'<svg class="plot parallel" style="min-width:{round(0.8 * width)}px;max-width:{round(1.4 * width)}px" '
            f'viewBox="0 0 {width} {self.height}" role="img" aria-label="parallel coordinates">',
            *self._layers,
        ]
        for j, axis in enumerate(self.axes):
            x = self._place(j)
            name, _, unit = axis.label.partition(" [")
            parts.append(f'<path class="axis" d="M{x} 40V{self.height - 34}"/>')
            for text, y, css in (
                (name, 12, "title"),
                (f"[{unit}" if unit else "", 24, "tick"),
                (_short(axis.high), 36, "tick"),
                (_short(axis.low), self.height - 20, "tick"),
            ):
                parts.append(
                    f'<text class="{css}" x="{x}" y="{y}" text-anchor="middle">{escape(text)}</text>'
                )
        parts.append("</svg>")
        return Markup("".join(parts))

    def _place(self, j: int) -> int:
        return self.spacing // 2 + self.spacing * j


def _scaled(values: ArrayLike, axis: Axis, start: float, end: float) -> Array:
    """Return places between `start` and `end`, where the axis has its low and its high end."""
    numbers, low, high = np.asarray(values, dtype=float), axis.low, axis.high
    if axis.log:
        numbers = np.log10(np.where(numbers > 0.0, numbers, np.nan))
        low, high = math.log10(low), math.log10(high)
    shares = (numbers - low) / (high - low if high > low else 1.0)
    places: NDArray[np.float64] = start + shares * (end - start)
    return places


def _polyline(x: Array, y: Array) -> str:
    """Return the path through points, broken where one is not finite."""
    path, pen = [], "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(a) and math.isfinite(b):
            # Far outside, browsers draw wrongly; a clip path hides it in any case.
            path.append(f"{pen}{min(max(a, -1e4), 1e4):.1f} {min(max(b, -1e4), 1e4):.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(path)


def _power(value: float) -> str:
    """Return a number with one digit, as a power of ten if it is large or small."""
    exponent = math.floor(math.log10(value) + 1e-9)
    if -3 <= exponent < 5:
        return f"{value:.1g}" if exponent < 0 else f"{value:.0f}"
    digit = round(value / 10.0**exponent)
    return f"10{raised(exponent)}" if digit == 1 else f"{digit}×10{raised(exponent)}"


def _trimmed(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return "0" if float(text) == 0.0 else text.replace("-", "−")


def _short(value: float) -> str:
    return f"{value:.4g}".replace("-", "−")


def _label(label: str, power: str, place: str) -> Iterable[str]:
    text = " ".join(part for part in (label, power) if part)
    if text:
        yield f'<text class="label" text-anchor="middle" {place}>{escape(text)}</text>'


def _legend_entry(text: str, shape: str, css: str) -> str:
    if shape == "line":
        drawing = f'<path class="line {css}" d="M1 6H21"/>'
    else:
        drawing = f'<path class="mark {shape} {css}" d="M11 6{_SHAPES[shape]}"/>'
    return f'<span><svg viewBox="0 0 22 12">{drawing}</svg>{escape(text)}</span>'
