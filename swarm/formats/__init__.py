"""Plans and flights in the file formats of other programs."""
