"""Knot topology without lengths: codes, diagrams, grid diagrams, invariants, the catalogue."""
