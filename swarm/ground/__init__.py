"""Everything that touches the world: sockets, clocks, processes, files of a flight."""
