"""Labels of the folded cable in space: numbers of vehicles and distances at crossings."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.transforms import Bbox

from swarm.planning import KnotLayout
from swarm.reports import scene

Floats = npt.NDArray[np.float64]
Axes = Any

_ASIDE: Final = 3.0
"""Points between a label and its place: half of a dot, and a gap."""

_PADDING: Final = 1.0
"""Points around a label that belong to it."""

_SIDES: Final = ((1, 1), (-1, 1), (1, -1), (-1, -1))
"""Sides of a place on which a label may be, the preferred one first: right and above."""


def label_fold(axes: Axes, layout: KnotLayout, colour: str) -> None:
    """Write numbers and distances beside a fold in space (:func:`plots.draw_fold`).

    To be called when nothing else of the figure changes: places are compared as they are printed. A
    label is written where it covers no other label and no vehicle. A distance without such a place
    is left out; smaller distances come first. Numbers are always written.
    """
    figure = axes.figure
    figure.draw_without_rendering()
    taken = [_around(_printed(axes, corner), axes) for corner in layout.corners]
    for number, corner in enumerate(layout.corners, 1):
        _write(axes, str(number), [corner], taken, {"color": colour, "zorder": 8})
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.85, "lw": 0}
    style = {"color": colour, "zorder": 9, "bbox": box}
    for crossing in sorted(scene.crossings(layout), key=lambda one: one.distance):
        places = [crossing.upper, 0.5 * (crossing.upper + crossing.lower), crossing.lower]
        _write(axes, f"{crossing.distance:.2f} m", places, taken, style, needed=False)


def _write(
    axes: Axes,
    words: str,
    places: Sequence[Floats],
    taken: list[Bbox],
    style: dict[str, Any],
    *,
    needed: bool = True,
) -> None:
    """Write a label beside the first of some places where it covers nothing ``taken``.

    Where there is none, the first place is taken for a label that is ``needed``.
    """
    text = axes.annotate(
        words,
        (0.0, 0.0),
        xytext=(0.0, 0.0),
        textcoords="offset points",
        fontsize=7,
        annotation_clip=False,
        **style,
    )
    text.set_in_layout(False)
    extent = text.get_window_extent(axes.figure.canvas.get_renderer())
    pixels = axes.figure.dpi / 72.0
    size = np.array([extent.width, extent.height]) + 2.0 * _PADDING * pixels
    aside = _ASIDE * pixels
    found = None
    for place in places:
        for side in _SIDES:
            middle = _printed(axes, place) + np.array(side) * (aside + 0.5 * size)
            box = Bbox([middle - 0.5 * size, middle + 0.5 * size])
            if found is None and not any(box.overlaps(other) for other in taken):
                found = place, side, box
    if found is None and not needed:
        text.remove()
        return
    place, side = found[:2] if found else (places[0], _SIDES[0])
    text.xy = _projected(axes, place)
    text.set_position((_ASIDE * side[0], _ASIDE * side[1]))
    text.set(ha="left" if side[0] > 0 else "right", va="bottom" if side[1] > 0 else "top")
    if found:
        taken.append(found[2])


def _printed(axes: Axes, place: Floats) -> Floats:
    """Return where a place (3,) is printed (2,), in pixels."""
    printed: Floats = axes.transData.transform(_projected(axes, place))
    return printed


def _projected(axes: Axes, place: Floats) -> Floats:
    """Return a place (3,) in the coordinates of the axes' plane (2,)."""
    x, y, _, scale = axes.get_proj() @ np.append(place, 1.0)
    projected: Floats = np.array([x, y]) / scale
    return projected


def _around(middle: Floats, axes: Axes) -> Bbox:
    """Return the box of a dot with a middle (2,) in pixels."""
    half = 0.5 * _ASIDE * axes.figure.dpi / 72.0
    return Bbox([middle - half, middle + half])
