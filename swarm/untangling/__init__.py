"""Motions from a folded knot to the straight line that follow no common path."""
