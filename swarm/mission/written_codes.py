"""Codes of knots as people write them: lists, or text with brackets, commas and spaces.

Each function returns what it cannot read unchanged; the validation of the key reports it.
"""

import re
from typing import Any

_INTEGER = re.compile(r"[-+]?\d+")
_GROUP = re.compile(r"[\[({]([^\[\](){}]*)[\])}]")


def dt_entries(code: Any) -> Any:
    """Return the entries of a DT code: ``4 6 2``, ``DT:[(4,6,2)]``, ``DTCode[4, 6, 2]``."""
    code = _unbraced(code)
    if not isinstance(code, str):
        return code
    return _integers(re.sub(r"^\s*DT(Code)?\s*:?", "", code, flags=re.IGNORECASE), code)


def pd_rows(code: Any) -> Any:
    """Return the crossings of a PD code such as ``PD[X[1,5,2,4],X[3,1,4,6],X[5,3,6,2]]``."""
    if not isinstance(code, str):
        return code
    return _groups(re.sub(r"PD|X_?", "", code, flags=re.IGNORECASE), 4, code)


def grid_columns(code: Any) -> Any:
    """Return the columns of a grid diagram such as ``[1,3] [2,4] [3,5] [1,4] [2,5]``."""
    return _groups(code, 2, code) if isinstance(code, str) else code


def gauss_text(code: Any) -> Any:
    """Return the text of a Gauss code that is a list, as ``GaussCode[-1, 2, -3, 1, -2, 3]`` is."""
    code = _unbraced(code)
    if isinstance(code, str) and (found := re.fullmatch(r"\s*GaussCode\s*(\[.*\])\s*", code)):
        code = _integers(found[1], code)
    if not isinstance(code, list | tuple) or any(isinstance(one, list | bool) for one in code):
        return code
    return " ".join(str(one) for one in code)


def _unbraced(code: Any) -> Any:
    """Return the entries of ``{4, 6, 2}``, which YAML reads as a mapping without values."""
    if isinstance(code, dict) and all(value is None for value in code.values()):
        return list(code)
    return code


def _integers(text: str, code: str) -> Any:
    """Return the integers of a text that has only integers, brackets, commas and spaces."""
    bare = re.sub(r"[\[\](){},;\s]+", " ", text.replace("−", "-")).split()
    if not bare or any(_INTEGER.fullmatch(each) is None for each in bare):
        return code
    return tuple(int(each) for each in bare)


def _groups(text: str, size: int, code: str) -> Any:
    """Return integers in groups: as the innermost brackets have them, or ``size`` at a time."""
    inner = _GROUP.findall(text)
    if len(inner) > 1:
        rest = _GROUP.sub("", text)
        groups = tuple(_integers(each, code) for each in inner)
        return code if re.sub(r"[\[\](){},;\s]", "", rest) else groups
    flat = _integers(text, code)
    if flat == code or len(flat) % size:
        return code
    return tuple(flat[k : k + size] for k in range(0, len(flat), size))
