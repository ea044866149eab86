"""Behaviour that is kept as files: see README.md beside this file."""

import os

# Before NumPy is imported: where several threads share a sum, it is rounded otherwise, and the
# planner's optimiser takes another path. The processes that are started from here inherit it.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
