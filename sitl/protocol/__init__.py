"""MAVLink of one vehicle: frames, links, parameters, missions, fences and its state."""
