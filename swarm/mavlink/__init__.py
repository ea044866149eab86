"""The ground station's side of MAVLink, sans-IO: packets, and the state of one vehicle."""
