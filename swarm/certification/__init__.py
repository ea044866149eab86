"""Proof before flight: a plan's findings, its certificate and its limits."""
