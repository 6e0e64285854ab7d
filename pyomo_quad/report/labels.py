"""Placement of text labels in a figure so that they cover few curves and few other labels."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from pyomo_quad.arrays import FloatArray
from pyomo_quad.report.style import INK

_FONT_SIZE = 7.0  # points
# Mean width and height of a letter, relative to the font size.
_WIDTH, _HEIGHT = 0.62, 1.25
_GAP = 4.0  # points between a label and its point
_POINTS_PER_INCH = 72.0
# Cost of a label's place: per curve point that the label covers, per label or marker that it
# covers, and for text outside the axes. Covering a label costs more than any number of points.
_ON_CURVE, _ON_LABEL, _OUTSIDE = 1.0, 1e4, 1e5
_HALO = withStroke(linewidth=1.6, foreground="white")


@dataclass(frozen=True, kw_only=True)
class Label:
    """Text label for a point of a figure. The function `write_labels` places it beside the point.

    Attributes
    ----------
    text : str
        Text of the label.
    x, y : float
        Data coordinates of the point.
    color : str
        Colour of the text.
    is_centred : bool
        Whether the label may also be placed on the point, like a zone's name inside the zone.
    """

    text: str
    x: float
    y: float
    color: str = INK
    is_centred: bool = False


def write_labels(axes: Axes, labels: Sequence[Label]) -> None:
    """Print labels into a panel, each beside its point, so that they hide as little as possible.

    All curves must be drawn already. The caller must not change the limits of the axes afterwards.
    """
    axes.apply_aspect()
    per_inch = _POINTS_PER_INCH / axes.figure.dpi
    to_points = axes.transData.transform
    room = axes.bbox.get_points() * per_inch
    curves = _curves(axes) * per_inch
    at = to_points([(label.x, label.y) for label in labels]).reshape(-1, 2) * per_inch
    taken = [
        np.array([place - _GAP / 2, place + _GAP / 2])
        for place, label in zip(at, labels, strict=True)
        if not label.is_centred
    ]
    for label, place in zip(labels, at, strict=True):
        size = np.array([_WIDTH * len(label.text), _HEIGHT]) * _FONT_SIZE
        shifts = [np.zeros(2)] if label.is_centred else []
        shifts += list(_shifts(size))
        boxes = [np.array([place + shift - size / 2, place + shift + size / 2]) for shift in shifts]
        costs = [_cost(box, curves, taken, room) for box in boxes]
        best = int(np.argmin(costs))
        taken.append(boxes[best])
        axes.annotate(
            label.text,
            (label.x, label.y),
            xytext=(float(shifts[best][0]), float(shifts[best][1])),
            textcoords="offset points",
            ha="center",
            va="center",
            color=label.color,
            fontsize=_FONT_SIZE,
            annotation_clip=True,
            path_effects=[_HALO],
            zorder=5,
        )


def _shifts(size: FloatArray) -> Iterable[FloatArray]:
    """Yield ten offsets (right, up) from a point to the middle of its label, best first.

    `size` holds width and height of the label. All lengths are in typographic points (1/72 inch).
    """
    half = size / 2 + _GAP
    for across, up in ((0.0, 1.0), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, 1), (1, -1), (-1, -1)):
        yield np.array([across, up]) * half
    for up in (2.6, -2.6):
        yield np.array([0.0, up * half[1]])


def _curves(axes: Axes) -> FloatArray:
    """Return the points of the curves in a panel, in pixels, shape (n, 2).

    Lines with at most two points are left out.
    """
    points = [np.empty((0, 2))]
    for line in axes.get_lines():
        held = np.asarray(line.get_xydata(), dtype=float)
        if len(held) > 2 and line.get_transform() == axes.transData:
            points.append(axes.transData.transform(held))
    return np.concatenate(points)


def _cost(
    box: FloatArray, curves: FloatArray, taken: Sequence[FloatArray], room: FloatArray
) -> float:
    low, high = box
    on_curve = np.count_nonzero(np.all((low <= curves) & (curves <= high), axis=1))
    on_label = sum(bool(np.all(low < other[1]) and np.all(other[0] < high)) for other in taken)
    is_outside = bool(np.any(low < room[0]) or np.any(high > room[1]))
    return _ON_CURVE * on_curve + _ON_LABEL * on_label + _OUTSIDE * is_outside
