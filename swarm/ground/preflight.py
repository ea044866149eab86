"""The decision before the go: audit of the vehicles, then confirmation by a person.

Both block, so they run in a thread beside the flight loop.
"""

import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from swarm.errors import SwarmError
from swarm.flight.clearance import Audit
from swarm.flight.conductor import Conductor
from swarm.flight.fleet_listener import position_quality
from swarm.flight.parameters import plan_requirements, stream_loss_findings, stream_loss_model
from swarm.ground.commissioning.audit import Auditor, save_parameters, wanted_fence
from swarm.ground.relay import Relay


@dataclass
class Preflight:
    """Audits the vehicles and obtains the confirmation.

    Without a ``relay`` the vehicles are not audited; without ``confirm`` an audit without errors
    is enough. Parameters are saved in ``folder``.
    """

    conductor: Conductor
    folder: Path
    confirm: Callable[[Audit], bool] | None = None
    relay: Relay | None = None
    started: bool = False
    _decision: "queue.SimpleQueue[Audit | str]" = field(default_factory=queue.SimpleQueue)

    def start(self, audit: Audit) -> None:
        """Start with the audit of the flight's preparation; at once if nothing blocks."""
        self.started = True
        if self.confirm is None and self.relay is None:
            self._run(audit)
        else:
            threading.Thread(target=self._run, args=(audit,), name="audit", daemon=True).start()

    def decision(self) -> Audit | str | None:
        """Return the audit to fly with, the reason for a refusal, or None while undecided."""
        with suppress(queue.Empty):
            return self._decision.get_nowait()
        return None

    def _run(self, audit: Audit) -> None:
        try:
            if self.relay is not None:
                audit = self._audit_vehicles(audit, self.relay)
            confirmed = not audit.passed or self.confirm is None or self.confirm(audit)
            self._decision.put(audit if confirmed else "not confirmed")
        except SwarmError as error:
            self._decision.put(str(error))
        except BaseException:
            self._decision.put("the question before the flight failed")
            raise

    def _audit_vehicles(self, audit: Audit, relay: Relay) -> Audit:
        """Return the audit with the findings on firmware, health, battery and parameters."""
        flyers = self.conductor.flyers
        names = {v.system: v.autopilot.name for v in flyers if v.autopilot is not None}
        plan, fleet = self.conductor.plan, self.conductor.fleet
        audits = Auditor(relay, names, plan_requirements(plan, fleet)).audit()
        with suppress(OSError):
            save_parameters(self.folder, audits)
        values = {vehicle.system: vehicle.parameters for vehicle in audits}
        flown = [(names[v.system], values[v.system]) for v in flyers if v.system in names]
        loss, loss_findings = stream_loss_findings(plan, stream_loss_model(flown, fleet.limits))
        duration = plan.flight_duration + loss.delay
        battery = 100.0 * duration / plan.mission.vehicles.endurance
        found = [finding for vehicle in audits for finding in vehicle.findings(battery)]
        if fleet.frame == "gps":
            tracking = plan.mission.vehicles.tracking
            found += [position_quality(f"system {v.system}", v, fleet, tracking) for v in flyers]
        wanted = wanted_fence(plan, flyers, fleet)
        if wanted is not None:
            found += [vehicle.fence_finding(wanted) for vehicle in audits]
        findings = (*audit.findings, *found, *loss_findings)
        return replace(audit, findings=findings, stream_loss=loss)
