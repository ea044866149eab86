"""Mission and fleet files: text in, validated frozen values out."""

from swarm.mission.mission import Mission, mission_for_knot, mission_schema, parse_mission
from swarm.mission.sections import Cable, Clearance, Formation, Layout, Vehicles

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
