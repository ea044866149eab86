"""Numbers as people read them, the same on screens, in pictures and in reports."""

import math

import numpy as np
import numpy.typing as npt


def metres(value: float) -> str:
    """Return a length in metres with two decimals; a dash where it is unknown."""
    return f"{value:.2f} m" if math.isfinite(value) else "–"


def seconds(value: float) -> str:
    """Return a time in seconds with one decimal; a dash where it is unknown."""
    return f"{value:.1f} s" if math.isfinite(value) else "–"


def clock(value: float) -> str:
    """Return seconds as minutes and seconds (``1:05.2``), with a sign before zero."""
    tenths = round(abs(value) * 10)
    sign = "-" if value < 0 and tenths else ""
    return f"{sign}{tenths // 600}:{tenths % 600 / 10:04.1f}"


def clip_rows(
    errors: npt.NDArray[np.float64], link_age: npt.NDArray[np.float64], most: int
) -> list[int]:
    """Return which vehicles to list when there is room for ``most``, in order along the cable.

    Those not heard for longest go first, then those with the largest errors.
    """
    if len(errors) <= most:
        return list(range(len(errors)))
    silent = np.where(link_age <= 1.0, 0.0, np.nan_to_num(link_age, nan=np.inf))
    order = np.lexsort((np.nan_to_num(errors, nan=np.inf), silent))[::-1]
    return sorted(int(i) for i in order[: most - 1])
