"""Everything that touches the world: sockets, clocks, processes, files of a flight."""

from swarm.ground.fly import fly

__all__ = ["fly"]
