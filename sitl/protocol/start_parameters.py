"""Parameters that a world gives its emulated vehicles, beside the defaults of their autopilots."""

from collections.abc import Iterable

from sitl.protocol.parameters import REAL32
from sitl.protocol.vehicle import Vehicle
from sitl.world import WorldError


def start_with_given(vehicles: Iterable[Vehicle]) -> None:
    """Set the parameters of the world's vehicles, but those of real firmware, which reads them.

    Raises `WorldError` with every parameter that the emulated autopilot does not have, and every
    integer that is none.
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
                _set(vehicle, name, value)
            elif value == round(value):
                _set(vehicle, name, round(value))
            else:
                errors.append(f"{place}: expected an integer, got {value:g}")
    if errors:
        raise WorldError("\n".join(errors))


def _set(vehicle: Vehicle, name: str, value: float) -> None:
    vehicle.parameters.values[name] = value
    vehicle.autopilot.parameter_changed(name)
    if name.startswith("SIM_") and vehicle.on_sim_parameter is not None:
        vehicle.on_sim_parameter(name, vehicle.parameters.values)
