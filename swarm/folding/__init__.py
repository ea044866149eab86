"""How the team gets to the knot: layout, path, schedule."""
