"""Motion of vehicles: dynamics and control, wind and downwash, landing, collisions, geodesy."""
