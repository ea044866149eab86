"""The group in flight: one mission clock, gates, holds and failures (sans-IO)."""
