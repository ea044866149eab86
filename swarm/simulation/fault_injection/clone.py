"""A copy of a whole flight in mid-air: objects that share memory share it in the copy, too."""

import copy
import copyreg
import functools
import struct
import types
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

# A decoder's compiled layouts cannot be copied; they are created again.
copyreg.pickle(struct.Struct, lambda one: (struct.Struct, (one.format,)))


def branch(root: T, shared: Iterable[object] = ()) -> T:
    """Return a deep copy of ``root``; ``shared`` objects, which never change, are not copied.

    ``copy.deepcopy`` makes an array of its own of every view. Here a view of an array, and a
    memoryview, becomes the same view of that array's copy.
    """
    memo: dict[int, Any] = {id(one): one for one in shared}
    arrays = [one for one in _parts(root, set(memo)) if isinstance(one, np.ndarray | memoryview)]
    owners: dict[int, Any] = {}
    for one in arrays:
        owner = _owner(one)
        if owner is one:
            continue
        if id(owner) not in owners:
            owners[id(owner)] = memo.setdefault(id(owner), owner.copy(order="K"))
        memo[id(one)] = _same_view(one, owner, owners[id(owner)])
    return copy.deepcopy(root, memo)


def _owner(one: Any) -> Any:
    """Return the array that owns the memory of a view, or of an array itself."""
    if isinstance(one, memoryview):
        one = one.obj
    while isinstance(getattr(one, "base", None), np.ndarray):
        one = one.base
    return one


def _same_view(view: Any, owner: Any, copied: Any) -> Any:
    """Return the view of ``copied`` that corresponds to ``view`` of ``owner``."""
    if isinstance(view, memoryview):
        return memoryview(copied).cast(view.format)  # type: ignore[call-overload]
    offset = view.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
    flat = np.ndarray(copied.nbytes, np.uint8, copied)
    return np.ndarray(view.shape, view.dtype, flat.data, offset, view.strides)


def _parts(root: object, seen: set[int]) -> Iterator[object]:
    """Yield all objects that a deep copy of an object copies, once."""
    waiting = [root]
    while waiting:
        one = waiting.pop()
        if id(one) in seen or isinstance(one, _ATOMS):
            continue
        seen.add(id(one))
        yield one
        if isinstance(one, dict):
            waiting += one.keys()
            waiting += one.values()
        elif isinstance(one, list | tuple | set | frozenset | deque):
            waiting += one
        elif isinstance(one, types.MethodType):
            waiting.append(one.__self__)
        elif isinstance(one, functools.partial):
            waiting += [one.func, one.args, one.keywords]
        elif not isinstance(one, np.ndarray | memoryview):
            waiting += list(getattr(one, "__dict__", {}).values())
            slots = (name for kind in type(one).__mro__ for name in getattr(kind, "__slots__", ()))
            waiting += [getattr(one, name) for name in slots if hasattr(one, name)]


_ATOMS = (type, types.ModuleType, types.FunctionType, str, bytes, int, float, type(None))
