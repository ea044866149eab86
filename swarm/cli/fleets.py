"""Fleet files as commands are given them."""

from pathlib import Path

from swarm.cli.inputs import read_text
from swarm.mission.fleet import Fleet, parse_fleet


def load_fleet(path: Path) -> Fleet:
    """Read a fleet file; a key file that it names lies beside it, unless its path is whole."""
    fleet = parse_fleet(read_text(path), str(path))
    if fleet.signing_key is None:
        return fleet
    return fleet.model_copy(update={"signing_key": str(path.parent / fleet.signing_key)})
