"""Plans and flights in Rerun: live, recorded and as screenshots."""
