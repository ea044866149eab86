"""Topology only, no metres: codes, diagrams, grid diagrams, invariants, the catalogue."""
