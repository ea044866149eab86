"""Sockets, clocks, processes and the files of a flight record."""
