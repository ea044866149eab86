"""swarm: a ground station that makes a team of quadrotors tie a knot in a cable in mid-air."""

__version__ = "0.1.0"
