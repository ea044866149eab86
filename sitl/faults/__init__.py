"""Faults: the scenario file, their injection, their names over MAVLink, and link errors."""
