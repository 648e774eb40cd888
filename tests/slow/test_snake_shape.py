"""Snakes whose joints are told to keep the shape, flown as if they were stiff by a law that knows the inertia of that
shape. Their drives hold no more than 0.3 N m in roll. Four and five rods stay a polygon; six, or any whose drives are
told rates, give way while they hover: rods that twist by the differing thrusts of a yaw command turn the torque of six
about z around (docs/results/joints.md). Drives reach their limit only after that. Half the step gives way at the same
time: the vehicle causes it, not the method."""

from dataclasses import replace

import pytest
import torch

from aerial_gym import ROBOTS, SIMS
from tests.builders import simulation

pytestmark = pytest.mark.slow

BENT = 0.02  # Angle [rad] beyond which no shape is held; the drives are at their limit from 0.006 rad on


def bending_time(name: str, dt: float, seconds: float = 5.0) -> float:
    """Return when a joint is off by more than ``BENT`` [s]; infinite where none is."""
    robot = ROBOTS.get(name)
    sim = replace(SIMS.get("base_sim_2ms"), dt=dt)
    env = simulation(robot, "lee_position_control", sim=sim, env="empty_env_2ms", seed=1)
    env.reset()
    pose = torch.tensor([joint.reference for joint in robot.joints.layout])
    actions = torch.zeros(2, 4 + len(pose))
    actions[:, :3] = env.gtd["robot_position"]
    actions[1, 0] += 0.5  # one stays, one goes on by half a metre
    actions[:, 4:] = pose if name.endswith("position") else 0.0
    for step in range(round(seconds / env.dt)):
        env.step(actions)
        if float((env.gtd["dof_position"] - pose).abs().max()) > BENT:
            return step * env.dt
    return float("inf")


@pytest.mark.parametrize("name", ["snakey_position", "snakey5_position"])
def test_four_and_five_rods_told_angles_keep_their_shape(name: str) -> None:
    assert bending_time(name, 2e-3) == float("inf")


@pytest.mark.parametrize("name", ["snakey6_position", "snakey", "snakey5", "snakey6"])
def test_six_rods_or_rates_do_not(name: str) -> None:
    coarse, fine = bending_time(name, 2e-3), bending_time(name, 1e-3)
    print(f"\n{name}: bent after {coarse:.2f} s in steps of 2 ms, {fine:.2f} s in steps of 1 ms")
    assert coarse < 5.0
    assert fine == pytest.approx(coarse, rel=0.1)
