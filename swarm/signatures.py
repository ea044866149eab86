"""Argument types of compiled functions, read from their annotations.

A compiled function that Python calls annotates its arguments with the arrays below, so that its
machine code can be made, or loaded, before its first call. Functions that only compiled ones call
need no such annotations: their types follow from their callers'.
"""

import inspect
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
from numba import types

_f, _i, _b = types.float64, types.int64, types.boolean

Floats1 = Annotated[npt.NDArray[np.float64], _f[::1]]
Floats2 = Annotated[npt.NDArray[np.float64], _f[:, ::1]]
Floats3 = Annotated[npt.NDArray[np.float64], _f[:, :, ::1]]
Floats4 = Annotated[npt.NDArray[np.float64], _f[:, :, :, ::1]]
Floats5 = Annotated[npt.NDArray[np.float64], _f[:, :, :, :, ::1]]
Floats6 = Annotated[npt.NDArray[np.float64], _f[:, :, :, :, :, ::1]]
"""Contiguous arrays of one to six axes."""
Ints1 = Annotated[npt.NDArray[np.int64], _i[::1]]
Ints2 = Annotated[npt.NDArray[np.int64], _i[:, ::1]]
Bools1 = Annotated[npt.NDArray[np.bool_], _b[::1]]
Bools2 = Annotated[npt.NDArray[np.bool_], _b[:, ::1]]
Signs1 = Annotated[npt.NDArray[np.int8], types.int8[::1]]
Signs2 = Annotated[npt.NDArray[np.int8], types.int8[:, ::1]]
Signs3 = Annotated[npt.NDArray[np.int8], types.int8[:, :, ::1]]
Singles2 = Annotated[npt.NDArray[np.float32], types.float32[:, ::1]]
Shorts2 = Annotated[npt.NDArray[np.int16], types.int16[:, ::1]]
Bytes2 = Annotated[npt.NDArray[np.uint8], types.uint8[:, ::1]]
Bytes3 = Annotated[npt.NDArray[np.uint8], types.uint8[:, :, ::1]]
Columns2 = Annotated[npt.NDArray[np.float64], _f[:, :]]
"""Parts of larger arrays, with gaps between their rows."""

Contents = TypeVar("Contents", bound=np.generic)


def contiguous(array: npt.NDArray[Contents]) -> npt.NDArray[Contents]:
    """Return the array, or a copy where it has gaps or cannot be written: as declared above."""
    # The question alone: most arrays are so, and np.require takes longer than the kernels of few.
    if array.flags.c_contiguous and array.flags.writeable:
        return array
    return np.require(array, requirements=["C", "W"])


_SCALARS = {
    float: types.float64,
    int: types.int64,
    bool: types.boolean,
    bytes: types.Bytes(types.uint8, 1, "C", readonly=True),
}


def signature(function: Callable[..., Any]) -> tuple[types.Type, ...] | None:
    """Return the argument types of a function; None if an annotation does not determine its type.

    Floats, ints, bools and bytes, the arrays above, tuples and named tuples of these do.
    """
    hints = get_type_hints(function, include_extras=True)
    kinds = [_numba_type(hints.get(name)) for name in inspect.signature(function).parameters]
    return None if None in kinds else tuple(kinds)


def record(kind: type, *parts: Any) -> types.Type:
    """Return the type of a named tuple whose fields have other types than its annotations."""
    return types.BaseTuple.from_types([_numba_type(part) for part in parts], kind)


def _numba_type(annotation: Any) -> types.Type | None:
    """Return the type that compiled code sees for an annotation; None where it does not tell."""
    if annotation in _SCALARS:
        return _SCALARS[annotation]
    if get_origin(annotation) is Annotated:
        return next((item for item in get_args(annotation) if isinstance(item, types.Type)), None)
    if get_origin(annotation) is tuple:
        parts: tuple[Any, ...] = get_args(annotation)
        kind: Any = tuple
    elif isinstance(annotation, type) and hasattr(annotation, "_fields"):
        hints = get_type_hints(annotation, include_extras=True)
        kind, parts = annotation, tuple(hints[name] for name in annotation._fields)
    else:
        return None
    members = [_numba_type(part) for part in parts]
    return None if None in members else types.BaseTuple.from_types(members, kind)
