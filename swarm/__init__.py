"""swarm: a ground station that makes a team of quadrotors tie a knot in a cable in mid-air.

::

    mission = swarm.load("missions/overhand.yaml")   # or swarm.Mission.for_knot("3_1")
    plan = swarm.plan(mission)                       # raises Refused with every reason
    certificate = swarm.certify(plan)                # cleared or not, with all margins
    flight = swarm.simulate(plan, certificate)       # in virtual time, against the emulator

Lengths are in metres, times in seconds, positions in ENU (x east, y north, z up), arrays (n, 3)
float64. Errors are :class:`Refused` (the checks have errors), :class:`InputError` (a file or an
argument is wrong; every problem at once) and :class:`SwarmError`, the base class of both.

Names are loaded at their first use: ``import swarm`` itself imports none of the libraries.
"""

from typing import TYPE_CHECKING

from swarm.version import __version__

if TYPE_CHECKING:
    from swarm.certification.certificate import Certificate
    from swarm.certification.distances import Tightest
    from swarm.certification.findings import Finding
    from swarm.errors import InputError, Refused, SwarmError, VehicleError
    from swarm.flight.trace import Trace
    from swarm.front.certificates import Cable, Motion, certify
    from swarm.front.files import load, load_fleet
    from swarm.front.flights import Flight, simulate, verify
    from swarm.front.knots import identify
    from swarm.front.plans import NotCleared, Plan, load_plan, plan
    from swarm.front.recordings import Recording
    from swarm.front.trials import Trials, load_scenario, monte_carlo
    from swarm.ground.record_verification import VerifiedRecord
    from swarm.mission import Mission
    from swarm.mission.fleet import Fleet
    from swarm.simulation.spread import Spread
    from swarm.simulation.trials import Trial
else:
    _HOMES = {
        "swarm.errors": ("InputError", "Refused", "SwarmError", "VehicleError"),
        "swarm.flight.trace": ("Trace",),
        "swarm.front.certificates": ("Cable", "Motion", "certify"),
        "swarm.front.files": ("load", "load_fleet"),
        "swarm.front.flights": ("Flight", "simulate", "verify"),
        "swarm.ground.record_verification": ("VerifiedRecord",),
        "swarm.front.knots": ("identify",),
        "swarm.front.plans": ("NotCleared", "Plan", "load_plan", "plan"),
        "swarm.front.recordings": ("Recording",),
        "swarm.front.trials": ("Trials", "load_scenario", "monte_carlo"),
        "swarm.mission": ("Mission",),
        "swarm.mission.fleet": ("Fleet",),
        "swarm.certification.certificate": ("Certificate",),
        "swarm.certification.distances": ("Tightest",),
        "swarm.certification.findings": ("Finding",),
        "swarm.simulation.spread": ("Spread",),
        "swarm.simulation.trials": ("Trial",),
    }
    _HOME = {name: home for home, names in _HOMES.items() for name in names}

    def __getattr__(name):
        """Load a public name from its module (PEP 562)."""
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module  # noqa: PLC0415 - loaded at the first use

        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value

    def __dir__():
        """List the public names, loaded or not."""
        return sorted({*globals(), *__all__})


__all__ = [
    "Cable",
    "Certificate",
    "Finding",
    "Fleet",
    "Flight",
    "InputError",
    "Mission",
    "Motion",
    "NotCleared",
    "Plan",
    "Recording",
    "Refused",
    "Spread",
    "SwarmError",
    "Tightest",
    "Trace",
    "Trial",
    "Trials",
    "VehicleError",
    "VerifiedRecord",
    "__version__",
    "certify",
    "identify",
    "load",
    "load_fleet",
    "load_plan",
    "load_scenario",
    "monte_carlo",
    "plan",
    "simulate",
    "verify",
]
