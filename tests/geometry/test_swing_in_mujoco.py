"""Swinging strands against MuJoCo: a chain of rigid rods on ball joints, in reduced coordinates.

It shares nothing with the lumped masses but the motion of its ends: other masses (rods instead of
points), other coordinates (angles instead of places), another integrator, links that are exactly
rigid by construction instead of by constraint forces.
"""

from collections.abc import Iterable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from swarm.geometry.catenary import STANDARD_GRAVITY, solve_catenaries
from swarm.geometry.lumped_mass import SwingModel
from tests.geometry.swinging import stray, swing

mujoco = pytest.importorskip("mujoco")

LENGTH, RODS = 3.4, 24
START, END = np.array([0.0, 0.0, 9.0]), np.array([2.4, 0.0, 9.4])
STEP, EVERY = 0.001, 100
"""Seconds of a step, and steps between compared moments."""
STIFF = 'solref="0.002 1" solimp="0.9999 0.9999 0.001"'
"""Constraints that hold the chain's ends within 6 mm of their motion, which passes 1.5 m/s."""


def smooth(time: np.ndarray, begin: float) -> np.ndarray:
    share = np.clip((time - begin) / 1.5, 0.0, 1.0)[:, None]
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def ends(time: np.ndarray) -> np.ndarray:
    """Both ends are moved aside by about a metre within two seconds, one after the other."""
    one = START + smooth(time, 0.0) * np.array([0.0, 1.2, 0.0])
    other = END + smooth(time, 0.5) * np.array([0.1, 1.0, -0.3])
    return np.stack([one, other], axis=1)


def numbers(vector: Iterable[float]) -> str:
    return " ".join(f"{value:.12g}" for value in vector)


def description(points: np.ndarray) -> str:
    """The chain in MuJoCo's XML: each rod is the child of the one before."""
    steps = np.diff(points, axis=0)
    size, turn, rods = 0.0, Rotation.identity(), ""
    for k, step in enumerate(steps):
        next_turn = Rotation.align_vectors([step], [[1.0, 0.0, 0.0]])[0]
        x, y, z, w = (turn.inv() * next_turn).as_quat()
        place = points[0] if k == 0 else np.array([size, 0.0, 0.0])
        size, turn = float(np.linalg.norm(step)), next_turn
        joint = "<freejoint/>" if k == 0 else '<joint type="ball"/>'
        rods += (
            f'<body name="rod{k}" pos="{numbers(place)}" quat="{numbers([w, x, y, z])}">{joint}'
            f'<geom type="capsule" size="0.003" fromto="0 0 0 {numbers([size, 0.0, 0.0])}" '
            f'mass="{0.012 * size:.12g}" contype="0" conaffinity="0"/>'
        )
    return f"""<mujoco><compiler boundinertia="1e-12"/>
      <option timestep="{STEP}" integrator="implicitfast" gravity="0 0 {-STANDARD_GRAVITY}"/>
      <worldbody>
        <body name="a" mocap="true" pos="{numbers(points[0])}"/>
        <body name="b" mocap="true" pos="{numbers(points[-1])}"/>
        {rods}{"</body>" * len(steps)}
      </worldbody>
      <equality>
        <connect body1="rod0" body2="a" anchor="0 0 0" {STIFF}/>
        <connect body1="rod{len(steps) - 1}" body2="b" anchor="{numbers([size, 0.0, 0.0])}" {STIFF}/>
      </equality></mujoco>"""


def in_mujoco(duration: float) -> np.ndarray:
    """Return the ends of the rods (k, RODS + 1, 3) every EVERY steps."""
    still = solve_catenaries(START, END, LENGTH).points(np.linspace(0.0, 1.0, RODS + 1))
    model = mujoco.MjModel.from_xml_string(description(still))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    way = ends(STEP * np.arange(round(duration / STEP) + 1))
    found = []
    for k in range(round(duration / STEP)):
        if k % EVERY == 0:
            found.append(np.vstack([data.xpos[-RODS:], way[k, 1]]))
        data.mocap_pos[:] = way[k + 1]
        mujoco.mj_step(model, data)
    return np.array(found)


def test_a_strand_swings_as_a_chain_of_rods_in_mujoco() -> None:
    # no air: what swings in four seconds is not lost
    duration, lengths, model = 4.0, np.array([LENGTH]), SwingModel(48, 0.005, 0.0)
    time = np.arange(0.0, duration, model.step)
    way, every = ends(time), round(EVERY * STEP / model.step)
    found = stray(swing(way, lengths, model, every), way[::every], lengths)[:, 0]
    rods = in_mujoco(duration)
    expected = stray(rods[:, None], way[::every], lengths)[:, 0]
    assert expected.max() > 0.5, "it swings, m"
    assert np.abs(found - expected).max() < 0.01
    # the links and the step of the certificate
    model = SwingModel(24, 0.02, 0.0)
    way, every = ends(np.arange(0.0, duration, model.step)), round(EVERY * STEP / model.step)
    coarse = stray(swing(way, lengths, model, every), way[::every], lengths)[:, 0]
    assert np.abs(coarse - expected).max() < 0.015
