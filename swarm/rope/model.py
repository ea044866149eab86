"""A rope in MuJoCo: point masses on links of fixed length, which collide as capsules."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
import numpy.typing as npt

from swarm.geometry.catenary import STANDARD_GRAVITY
from swarm.geometry.lumped_mass import AIR_DENSITY, NORMAL_DRAG
from swarm.mission import Cable

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.intp]

STEP: Final = 0.002
"""Seconds; at 5 ms, strands passed through each other."""

TIGHTENING_STEP: Final = 0.0005
"""Seconds after the inner vehicles' release: rope that falls by three metres is faster."""

SAMPLE_INTERVAL: Final = 0.2
"""Seconds between samples; a strand swings with a period of one to two seconds."""

BESIDE_GRIP: Final = 0.3
"""Metres of rope in which stretch does not count. Held nodes are set to positions, and constraints
do not include their velocity: links beside them lag by their speed times two steps, some
millimetres."""

CONTACT_STEPS: Final = 2
"""Steps in which contacts and links respond, MuJoCo's minimum: a strand penetrates by its speed
times this time, and may leave on the other side."""

STIFF: Final = "0.99 0.999 0.001"
"""Impedance of links and contacts (MuJoCo's solimp): short links stretch by 3 % by default."""

FRICTION: Final = 0.3
"""Friction coefficient of rope on rope and on the floor: smooth polymer on itself."""

_DRAG_EVERY: Final = 5
"""Steps between updates of the drag: 10 ms, in which velocities hardly change."""
_CHECK_EVERY: Final = 5
"""Steps between checks of penetration, stretch and speed; contacts last for tens of steps."""


@dataclass(frozen=True, eq=False)
class Grips:
    """Grip points (k, n, 3) at increasing times (k,), seconds; linear between."""

    times: Floats
    places: Floats

    def at(self, times: Floats) -> Floats:
        """Return the grip points (m, n, 3) at times (m,)."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = (times - self.times[k]) / (self.times[k + 1] - self.times[k])
        before, after = self.places[k], self.places[k + 1]
        points: Floats = before + np.clip(share, 0.0, 1.0)[:, None, None] * (after - before)
        return points


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions of a simulation: self-contact, wind (3,) in m/s, and the time step in seconds."""

    contact: bool
    wind: Floats
    step: float = STEP


@dataclass
class Extremes:
    """Largest values of a simulation: metres, a share of a link's length, m/s, a number."""

    penetration: float = 0.0
    stretch: float = 0.0
    speed: float = 0.0
    contacts: int = 0


class Rope:
    """A rope in MuJoCo: a one-dimensional flex whose held nodes follow given positions."""

    def __init__(
        self,
        cable: Cable,
        nodes: Floats,
        held: Ints,
        conditions: Conditions,
        extremes: Extremes,
        velocities: Floats | None = None,
    ) -> None:
        """Start with nodes (m, 3), of which those with indices ``held`` follow the grips.

        ``extremes`` is updated. Nodes start with ``velocities`` (m, 3), or at rest.
        """
        self._step, self._extremes = conditions.step, extremes
        links = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
        mass = cable.mass_per_length * float(links.mean())
        self._model = mujoco.MjModel.from_xml_string(
            _description(nodes, set(held.tolist()), 0.5 * cable.diameter, mass, conditions)
        )
        self._data = mujoco.MjData(self._model)
        self._start = nodes
        self._free = np.setdiff1d(np.arange(len(nodes)), held)
        self._held = held
        if velocities is not None:
            self._data.qvel[:] = velocities[self._free].ravel()
        mujoco.mj_forward(self._model, self._data)
        self._rest = self._model.flexedge_length0.copy()
        arc = np.append(0.0, np.cumsum(links))
        middles = 0.5 * (arc[1:] + arc[:-1])
        self._away = np.abs(middles[:, None] - arc[held]).min(axis=1) > BESIDE_GRIP
        self._load = 0.5 * AIR_DENSITY * NORMAL_DRAG * cable.diameter
        self._wind = conditions.wind
        self._held_velocity = np.zeros((len(held), 3))

    def nodes(self) -> Floats:
        """Return the nodes (m, 3)."""
        return np.array(self._data.flexvert_xpos)

    def velocities(self) -> Floats:
        """Return the nodes' velocities (m, 3)."""
        velocity = np.zeros((len(self._start), 3))
        velocity[self._free] = self._data.qvel.reshape(-1, 3)
        velocity[self._held] = self._held_velocity
        return velocity

    def run(self, grips: Grips) -> Iterator[tuple[float, Floats]]:
        """Step through the motion; yield time and grip points (n, 3) every SAMPLE_INTERVAL."""
        model, data = self._model, self._data
        step = self._step
        steps = round(float(grips.times[-1] - grips.times[0]) / step)
        every = round(SAMPLE_INTERVAL / step)
        for begin in range(0, steps, every):
            count = min(every, steps - begin)
            times = grips.times[0] + step * np.arange(begin, begin + count + 1)
            places = grips.at(times)
            for k in range(count):
                self._held_velocity = (places[k + 1] - places[k]) / step
                data.mocap_pos[:] = places[k + 1]
                if k % _DRAG_EVERY == 0:
                    self._apply_drag()
                mujoco.mj_step(model, data)
                if k % _CHECK_EVERY == 0:
                    self._update_extremes()
            yield float(times[-1]), places[-1]

    def _apply_drag(self) -> None:
        """Apply the drag of a cylinder across the flow (Morison) to each node's share of rope."""
        nodes, velocity = self._data.flexvert_xpos, self.velocities()
        along = np.empty_like(nodes)
        along[1:-1] = nodes[2:] - nodes[:-2]
        along[0], along[-1] = nodes[1] - nodes[0], nodes[-1] - nodes[-2]
        size = np.sqrt(np.einsum("ij,ij->i", along, along))
        along /= size[:, None]
        air = self._wind - velocity
        air -= np.einsum("ij,ij->i", air, along)[:, None] * along
        flow = np.sqrt(np.einsum("ij,ij->i", air, air))
        force = (0.5 * self._load * size * flow)[:, None] * air
        self._data.qfrc_applied[:] = force[self._free].ravel()

    def _update_extremes(self) -> None:
        data, extremes = self._data, self._extremes
        stretch = data.flexedge_length / self._rest - 1.0
        extremes.stretch = max(extremes.stretch, float(stretch[self._away].max(initial=0.0)))
        velocity = data.qvel.reshape(-1, 3)
        extremes.speed = max(
            extremes.speed, float(np.sqrt(np.einsum("ij,ij->i", velocity, velocity).max()))
        )
        if data.ncon:
            depth = -data.contact.dist[data.contact.flex[:, 0] == data.contact.flex[:, 1]]
            extremes.contacts = max(extremes.contacts, len(depth))
            extremes.penetration = max(extremes.penetration, float(depth.max(initial=0.0)))


def _description(
    nodes: Floats, held: set[int], radius: float, mass: float, conditions: Conditions
) -> str:
    """Return the rope as MuJoCo's XML: point masses that slide freely, and held ones."""
    response = CONTACT_STEPS * conditions.step
    bodies = []
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    point = f'<inertial pos="0 0 0" mass="{mass:.9g}" diaginertia="1e-9 1e-9 1e-9"/>'
    for k, place in enumerate(nodes):
        at = " ".join(f"{value:.12g}" for value in place)
        inner = "" if k in held else slides + point
        mocap = ' mocap="true"' if k in held else ""
        bodies.append(f'<body name="n{k}" pos="{at}"{mocap}>{inner}</body>')
    names = " ".join(f"n{k}" for k in range(len(nodes)))
    links = " ".join(f"{k} {k + 1}" for k in range(len(nodes) - 1))
    collide = "auto" if conditions.contact else "none"
    floor = (
        f'<geom type="plane" size="500 500 1" friction="{FRICTION}" solref="{response} 1"/>'
        if conditions.contact
        else ""
    )
    return f"""<mujoco>
  <compiler boundinertia="1e-12"/>
  <option timestep="{conditions.step}" integrator="implicitfast" solver="Newton" jacobian="sparse"
    gravity="0 0 {-STANDARD_GRAVITY}"/>
  <size memory="256M"/>
  <worldbody>{floor}{"".join(bodies)}</worldbody>
  <deformable>
    <flex name="rope" dim="1" radius="{radius:.9g}" body="{names}"
      vertex="{" ".join(["0 0 0"] * len(nodes))}" element="{links}">
      <contact selfcollide="{collide}" condim="3" solref="{response} 1" solimp="{STIFF}"
        friction="{FRICTION} 0.005 0.0001"/>
    </flex>
  </deformable>
  <equality><flex flex="rope" solref="{response} 1" solimp="{STIFF}"/></equality>
</mujoco>"""
