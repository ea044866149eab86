"""Analyses beyond the certificate: a simulated rope, and moving apart after a release."""
