"""Parameters that a world gives its emulated vehicles, beside the defaults of their autopilots."""

from collections.abc import Iterable

from sitl.protocol.parameter_protocol import set_parameter
from sitl.protocol.parameters import REAL32
from sitl.protocol.vehicle import Vehicle
from sitl.world import WorldError


def start_with_given(vehicles: Iterable[Vehicle]) -> None:
    """Set the parameters of the world's vehicles, but those of real firmware, which reads them.

    Raises `WorldError` with every parameter that the emulated autopilot does not have, and every
    value with a fraction for an integer parameter.
    """
    errors: list[str] = []
    for vehicle in vehicles:
        for name, value in ({} if vehicle.frozen else vehicle.spec.parameters).items():
            place = f"vehicle {vehicle.system}: parameters.{name}"
            if name not in vehicle.parameters.values:
                kind = vehicle.spec.autopilot
                errors.append(
                    f"{place}: expected a parameter of the emulated {kind}, got an unknown one"
                )
            elif vehicle.parameters.kinds[name] == REAL32:
                set_parameter(vehicle, name, value)
            elif value == round(value):
                set_parameter(vehicle, name, round(value))
            else:
                errors.append(f"{place}: expected an integer, got {value:g}")
    if errors:
        raise WorldError("\n".join(errors))
