"""Small SVG charts: curves, and bars of either sign."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: Size of a chart, and its margins: left, top, right, bottom.
WIDTH, HEIGHT = 560.0, 240.0
MARGINS = (74.0, 12.0, 14.0, 40.0)
#: Approximate number of marks on an axis.
MARKS = 5


@dataclass(frozen=True)
class Curve:
    """One curve of a chart: its label and points."""

    label: str
    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Mark:
    """A position on an axis and its text."""

    at: float
    text: str


@dataclass(frozen=True)
class Lines:
    """A chart of curves in pixels; ``curves`` are labels and the ``points`` of polylines."""

    title: str
    x_title: str
    x_marks: tuple[Mark, ...]
    y_marks: tuple[Mark, ...]
    curves: tuple[tuple[str, str], ...]

    width, height = WIDTH, HEIGHT
    left, top = MARGINS[:2]
    right, bottom = WIDTH - MARGINS[2], HEIGHT - MARGINS[3]


def lines(
    title: str, x_title: str, curves: Sequence[Curve], *, logarithmic: bool = False
) -> Lines | None:
    """A chart of curves; None if there is nothing to draw.

    Parameters
    ----------
    logarithmic : whether the y axis is; points that are not positive are left out
    """
    shown = []
    for curve in curves:
        points = [
            (float(x), float(y))
            for x, y in zip(curve.x, curve.y, strict=True)
            if math.isfinite(x) and math.isfinite(y) and not (logarithmic and y <= 0.0)
        ]
        if len(points) > 1:
            shown.append((curve.label, points))
    if not shown:
        return None
    left, top, right, bottom = MARGINS
    xs = _Axis([x for _, points in shown for x, _ in points], left, WIDTH - right)
    ys = _Axis([y for _, points in shown for _, y in points], HEIGHT - bottom, top, logarithmic)
    return Lines(
        title=title,
        x_title=x_title,
        x_marks=xs.marks,
        y_marks=ys.marks,
        curves=tuple(
            (label, " ".join(f"{xs(x):.1f},{ys(y):.1f}" for x, y in points))
            for label, points in shown
        ),
    )


class _Axis:
    """Maps numbers to positions between two ends."""

    def __init__(
        self, values: Sequence[float], start: float, end: float, logarithmic: bool = False
    ) -> None:
        self._start, self._end = start, end
        self._logarithmic = logarithmic
        scaled = [self._scale(value) for value in values]
        low, high = min(scaled), max(scaled)
        if high - low <= 1e-12 * max(abs(low), abs(high), 1e-300):
            pad = 0.5 if logarithmic else 0.5 * abs(low) or 0.5
            low, high = low - pad, high + pad
        self._low, self._high = low, high

    def __call__(self, value: float) -> float:
        share = (self._scale(value) - self._low) / (self._high - self._low)
        return self._start + share * (self._end - self._start)

    def _scale(self, value: float) -> float:
        return math.log10(value) if self._logarithmic else value

    @property
    def marks(self) -> tuple[Mark, ...]:
        """Round numbers within the axis; powers of ten if it is logarithmic."""
        span = self._high - self._low
        if self._logarithmic:
            stride = max(1, math.ceil(span / MARKS))
            within = range(math.ceil(self._low), math.floor(self._high) + 1)
            powers = [power for power in within if power % stride == 0]
            if powers:
                return tuple(Mark(self(10.0**power), f"1e{power}") for power in powers)
            ends = (10.0**self._low, 10.0**self._high)
            return tuple(Mark(self(value), f"{value:.3g}") for value in ends)
        step = _round_step(span, MARKS)
        first, last = math.ceil(self._low / step), math.floor(self._high / step)
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        form = f",.{decimals}f" if decimals <= 6 and abs(last * step) < 1e7 else ".3g"
        return tuple(Mark(self(k * step), f"{k * step:{form}}") for k in range(first, last + 1))


@dataclass(frozen=True)
class Bar:
    """A number as a bar from zero; ``x`` and ``width`` are in percent of the chart."""

    x: float
    width: float
    text: str
    label: str


@dataclass(frozen=True)
class Bars:
    """Bars below one another from ``zero``, in percent of the chart."""

    zero: float
    bars: tuple[Bar, ...]


def bars(values: Sequence[float], labels: Sequence[str], form: str = ".3g") -> Bars:
    """Bars for numbers of either sign."""
    low, high = min(0.0, *values), max(0.0, *values)
    span = high - low or 1.0
    zero = -100.0 * low / span
    drawn = []
    for value, label in zip(values, labels, strict=True):
        end = 100.0 * (value - low) / span
        drawn.append(Bar(min(zero, end), abs(end - zero), f"{value:{form}}", label))
    return Bars(zero, tuple(drawn))


def histogram(values: Sequence[float], unit: str, bins: int = 12) -> Bars | None:
    """Counts of positive numbers in ranges of a round width; None if there is nothing to count."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return None
    step = _round_step(max(finite), bins)
    # A value that rounding puts just below a mark is at the mark.
    places = [math.floor(value / step + 1e-9) for value in finite]
    counts = [places.count(k) for k in range(max(places) + 1)]
    labels = [f"{k * step:.6g} to {(k + 1) * step:.6g} {unit}" for k in range(len(counts))]
    return bars(list(map(float, counts)), labels, ",.0f")


def _round_step(span: float, marks: int) -> float:
    """1, 2 or 5 times a power of ten, of which at most ``marks`` fit into the span."""
    if not span > 0.0:
        return 1.0
    unit = 10.0 ** math.floor(math.log10(span / marks))
    return next(k * unit for k in (1, 2, 5, 10) if span / (k * unit) <= marks)
