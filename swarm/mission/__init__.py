"""Mission and fleet files: text in, validated frozen values out."""

from swarm.mission.mission import (
    Cable,
    Clearance,
    Formation,
    Layout,
    Mission,
    Vehicles,
    mission_for_knot,
    mission_schema,
    parse_mission,
)

__all__ = [
    "Cable",
    "Clearance",
    "Formation",
    "Layout",
    "Mission",
    "Vehicles",
    "mission_for_knot",
    "mission_schema",
    "parse_mission",
]
