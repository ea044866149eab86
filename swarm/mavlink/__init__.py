"""Bytes and one vehicle: the ground station's side of MAVLink, sans-IO."""
