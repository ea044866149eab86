"""What the last bits of floating-point numbers depend on beside this project's own code."""

import functools
import platform
import re
from importlib.metadata import version

import llvmlite.binding
import numba
import numpy as np

_PACKAGES = ("numpy", "scipy", "numba", "llvmlite")
_LINE = re.compile(r'environment"?: "?(?P<words>[^"\n]+)')


@functools.cache
def environment() -> str:
    """Return one line: library versions, the C library, and the CPU as LLVM and NumPy see it.

    NumPy, OpenBLAS and LLVM choose other kernels on another CPU, and the C library supplies sines
    and exponentials: each may round the last bit in another direction.
    """
    packages = [f"{name} {version(name)}" for name in _PACKAGES]
    c_library = " ".join(platform.libc_ver()) or platform.system()
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    widest = found[-1] if found else "baseline"
    compiled_for = numba.config.CPU_NAME or llvmlite.binding.get_host_cpu_name()
    cpu = f"{platform.machine()} {compiled_for} ({widest})"
    return " · ".join([*packages, c_library, cpu])


def environment_of(golden: str) -> str:
    """Return the environment line of a golden file's text."""
    found = _LINE.search(golden)
    return found["words"] if found else "unknown"
