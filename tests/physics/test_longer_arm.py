"""A vehicle whose arm is another than the robot file says, with an autopilot that knows it and one that does not."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.vehicles import F64


@pytest.mark.parametrize(
    ("backend", "tolerance"), [pytest.param("torch", 1e-6, marks=pytest.mark.slow), ("warp", 2e-5)]
)
@pytest.mark.parametrize("effectiveness", ["actual", "nominal"])
def test_a_longer_arm_tilts_only_an_autopilot_that_does_not_know_it(
    backend: str, tolerance: float, effectiveness: str
) -> None:
    """A hub d further forward gives the torque ``-d T`` more about y. Unknown, flight settles where the attitude law asks for
    as much against it: with T = m g / 4 + i M, its entry i = -1 / (4 l) of the nominal inverse and the commanded torque M,
    ``M = d T`` gives ``-K sin pitch = M = (d m g / 4) / (1 + d / (4 l))``. Known, it settles level."""
    ends = {"how": "offset", "low": (-0.015, 0.0, 0.0), "high": (0.015, 0.0, 0.0)}
    robot = replace(ROBOTS.get("base_quadrotor_doubled_inertia"), control=ControlCfg(effectiveness=effectiveness))
    env = simulation(
        robot, "lee_attitude_control", num_envs=5, seed=1, randomize={"mounts.1.position": RandomizeCfg(**ends)},
        differentiable=backend == "torch", dtype=F64 if backend == "torch" else torch.float32, backend=backend,
    )  # fmt: skip
    env.reset()
    with torch.no_grad():
        for _ in range(700):
            env.step(torch.zeros(5, 4))
    further, weight = env.draws()["mounts.1.position"][:, 0].double(), robot.body.mass * 9.81
    torque = further * weight / 4.0 / (1.0 + further / (4.0 * 0.13))
    stiffness = env.robot_manager.controller.gains.attitude[:, 1].double()
    pitch = torch.zeros(5, dtype=F64) if effectiveness == "actual" else torch.asin(-torque / stiffness)
    result = (
        env.gradient_tensors["robot_euler_angles"] if backend == "torch" else env.gtd["robot_euler_angles"].double()
    )
    assert further.abs().max() > 0.01
    torch.testing.assert_close(result[:, 1], pitch, atol=tolerance, rtol=tolerance)
    torch.testing.assert_close(result[:, 0], 0.0 * pitch, atol=tolerance, rtol=0)
