"""How the mesh was refined, and the mesh that was good enough."""

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyomo_quad.collocation import Mesh, MeshRecord

__all__ = ["draw_mesh"]

_ERROR_FLOOR = 1e-16  # keeps an error of zero on the logarithmic axis


def draw_mesh(
    history: "Sequence[MeshRecord]", mesh: "Mesh", tolerance: float, duration: float
) -> Figure:
    """Draw the error estimate from mesh to mesh, and the last mesh over time.

    Parameters
    ----------
    history : sequence of MeshRecord
        The meshes solved on, in order.
    mesh : Mesh
        The last one.
    tolerance : float
        Error estimate asked for, relative.
    duration : float
        End of the flight, s.

    Returns
    -------
    Figure
        Two panels.
    """
    height = 2.6
    figure = Figure(figsize=(FULL_WIDTH, height))
    errors, elements = figure.subplots(1, 2)
    figure.subplots_adjust(
        left=0.09, right=0.985, top=1 - 0.3 / height, bottom=0.5 / height, wspace=0.24
    )
    _draw_errors(errors, history, tolerance)
    _draw_elements(elements, mesh, duration)
    return figure


def _draw_errors(axes: Axes, history: "Sequence[MeshRecord]", tolerance: float) -> None:
    estimated = [record for record in history if isfinite(record.error)]
    meshes = range(len(estimated))
    sizes = [max(record.error, _ERROR_FLOOR) for record in estimated]
    style = SERIES_STYLES[0]
    axes.plot(meshes, sizes, marker=style.marker, markersize=4.5, **style.line)
    axes.axhline(tolerance, color=MUTED, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.annotate(
        f"tolerance {tolerance:.3g}",
        (0.02, tolerance),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        color=INK,
    )
    axes.set_yscale("log")
    axes.set_ylim(min([*sizes, tolerance]) / 5, max([*sizes, tolerance]) * 5)
    axes.set_xticks(meshes, [str(record.points) for record in estimated])
    axes.set_xlim(-0.6, len(estimated) - 0.4)
    axes.tick_params(axis="y", which="minor", length=0)
    axes.set(title="Error estimate (relative)", xlabel="Collocation points of each mesh")


def _draw_elements(axes: Axes, mesh: "Mesh", duration: float) -> None:
    boundaries = np.asarray(mesh.breakpoints) * duration
    axes.step(boundaries[:-1], mesh.degrees, where="post", **SERIES_STYLES[0].line)
    axes.hlines(mesh.degrees[-1], boundaries[-2], boundaries[-1], **SERIES_STYLES[0].line)
    axes.plot(boundaries, np.zeros_like(boundaries), "|", color=INK, markersize=9, clip_on=False)
    axes.set_ylim(0, max(mesh.degrees) * 1.15)
    axes.set_xlim(0, duration)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set(
        title=f"Degree of the polynomials in {mesh.elements} elements",
        xlabel="Time (s), with the boundaries of the elements",
    )
