"""swarm: a ground station that makes a team of quadrotors tie a knot in a cable in mid-air."""

from swarm.version import __version__

__all__ = ["__version__"]
