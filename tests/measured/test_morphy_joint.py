"""The simulated arm of Morphy against the record of a release (Aerial Gym Simulator, ``morphy_joint_step.csv``)."""

from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.interpolate import CubicHermiteSpline

from aerial_gym import ENVIRONMENTS, ROBOTS, SIMS
from aerial_gym.config.joint import CreepCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.teststand.joints.record import (
    LAWS,
    ReleaseRecord,
    alternate_blocks,
    creep_elements,
    fit_curve_of_law,
)
from tests.builders import simulation

RECORD = Path(__file__).parents[2].parent / "shared" / "data" / "bench" / "morphy_joint_step.csv"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not RECORD.is_file(), reason=f"the record is not on this machine: {RECORD}"),
]

INERTIA = 0.01625 * 0.07**2  # Of a point mass at the rotor about the hinge [kg m²]

ELEMENTS, POWER = "linear spring, 3 creep elements", "linear spring, power-law creep"

SHOWN_S = 0.002  # Between two simulated angles, among which a spline goes through angles and rates [s]


def let_go(robot: RobotCfg, start: float, time: np.ndarray, *, dt: float) -> np.ndarray:
    """Return the first elevation [rad] at times [s] after the base's arms were let go at ``start``, in steps of ``dt`` [s]."""
    substeps = round(SHOWN_S / dt)
    sim, place = replace(SIMS.get("base_sim_2ms"), dt=dt), ENVIRONMENTS.get("empty_env_2ms")
    env = simulation(robot, sim=sim, env=replace(place, physics_steps_per_env_step=substeps), num_envs=1)
    env.reset()
    env.gtd["dof_position"].zero_()
    env.gtd["dof_velocity"].zero_()
    env.gtd["rotor_speed"].zero_()  # a reset lets them hover, and what is left of that kicks the arms
    env.gtd["dof_position"][:, ::2] = start
    angle, rate = [start], [0.0]
    for _ in range(int(time[-1] / SHOWN_S) + 1):
        env.step(torch.zeros(1, 4))
        angle.append(float(env.gtd["dof_position"][0, 0]))
        rate.append(float(env.gtd["dof_velocity"][0, 0]))
    return CubicHermiteSpline(SHOWN_S * np.arange(len(angle)), angle, rate)(time)


def with_elevations(spring: SpringCfg) -> RobotCfg:
    """Return Morphy on a stand, whose arms may be let go beyond their ends."""
    robot = ROBOTS.get("morphy_fixed_base")
    layout = tuple(
        replace(joint, ends=None, spring=spring) if joint.name.startswith("elevation") else joint
        for joint in robot.joints.layout
    )
    return replace(robot, joints=replace(robot.joints, layout=layout))


def law_spring(law: dict[str, float]) -> SpringCfg:
    """Return a law per unit of inertia as the spring of Morphy's elevations, which holds their weight at rest."""
    stiffness, times = creep_elements(law)
    return SpringCfg(
        stiffness=law["stiffness"] * INERTIA,
        damping=law["damping"] * INERTIA,
        rest=law["rest"],
        preload=float(-0.01625 * 9.81 * 0.07 * np.cos(law["rest"])),
        creep=tuple(CreepCfg(stiffness=k * INERTIA, time=t) for k, t in zip(stiffness, times, strict=True)),
    )


def degrees_off(wrong: np.ndarray, rows: np.ndarray) -> float:
    """Return the root of the mean square of errors [rad] in some rows [deg]."""
    return float(np.degrees(np.sqrt(np.mean(wrong[rows] ** 2))))


@pytest.mark.parametrize(("dt", "law_held", "early_bound"), [(0.00025, POWER, 0.1), (0.002, ELEMENTS, 0.2)])
def test_a_law_found_in_half_of_a_record_holds_in_the_other(dt: float, law_held: str, early_bound: float) -> None:
    """Fitted to every second swing of 60 ms, or to the first half of the record, and simulated from the release on. The
    published law is 0.5 degrees off; ours at most 0.1 where no fit has seen the record, the first second included. In
    its first second alone short steps are that near, and by power-law creep only."""
    table = pd.read_csv(RECORD)
    time, angle = table["t"].to_numpy(), table["elevation_rad"].to_numpy()
    start, after = float(angle[time < 0.0].mean()), time >= 0.0
    record = ReleaseRecord(path=str(RECORD), time=time[after], angle=angle[after], start=start)
    early, late, odd = record.time < 1.0, record.time > 0.5 * record.time[-1], alternate_blocks(record) == 1
    robot = ROBOTS.get("morphy_fixed_base")
    published = robot.joints.layout[0].spring
    assert published is not None
    wrong = let_go(with_elevations(published), start, record.time, dt=dt) - record.angle
    shares = [degrees_off(wrong, rows) for rows in (~late, late, early, early | ~early)]
    text = "published {:.3f}, {:.3f}, first second {:.3f}, all {:.3f}".format(*shares)
    print(f"steps of {1e3 * dt:g} ms, degrees: {text}")
    assert shares[3] > 0.45
    for fitted, left in (("even swings", odd), ("odd swings", ~odd), ("first half", late)):
        for name in (ELEMENTS, POWER):
            params = fit_curve_of_law(name, record, ~left).params.tolist()
            law = dict(zip(("release", *LAWS[name]), params, strict=True))
            since = np.maximum(record.time - law["release"], 0.0)
            wrong = let_go(with_elevations(law_spring(law)), start, since, dt=dt) - record.angle
            result = degrees_off(wrong, left)
            first = degrees_off(wrong, left & early) if (left & early).any() else nan
            print(f"{name}, fitted to {fitted}: held out {result:.3f}, first second of it {first:.3f}", end="")
            print(f"; fitted {degrees_off(wrong, ~left):.3f}, first second {degrees_off(wrong, ~left & early):.3f}")
            if name == law_held:
                assert result < 0.1
                assert not first > early_bound
