"""Gains of controllers with memory that a reset draws; those of others stand in ``test_randomized``."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from tests.builders import simulation

STILL = {f"{name}_{end}": (0.0, 0.0, 0.0) for name in ("euler", "lin_vel", "ang_vel") for end in ("low", "high")}


def make(randomize: dict[str, RandomizeCfg], backend: str = "warp") -> EnvManager:
    robot = replace(ROBOTS.get("base_quadrotor"), initial_state=InitialStateCfg(**STILL))
    options = {"num_envs": 6, "seed": 4, "backend": backend, "randomize": randomize}
    env = simulation(robot, "pid_velocity_control", **options)
    env.reset()
    return env


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_gains_over_a_rate_loop_are_drawn(backend: str) -> None:
    """From one start, the larger the gain on the velocity error the faster after 0.1 s."""
    env = make({"gains.velocity": RandomizeCfg(low=0.5, high=1.0)}, backend)
    gains, factor = env.robot_manager.controller.gains_by_name["velocity"], env.draws()["gains.velocity"]
    torch.testing.assert_close(gains, factor * make({}, backend).robot_manager.controller.gains_by_name["velocity"])
    for _ in range(10):
        env.step(torch.tensor([[0.5, 0.0, 0.0, 0.0]]).expand(6, 4))
    assert torch.equal(env.gtd["robot_linvel"][:, 0].argsort(), factor[:, 0].argsort())


def test_a_unit_gain_is_not_to_be_drawn() -> None:
    """Over a rate loop the law's gain on the rate is 1: its torque is the body rates that it wants."""
    with pytest.raises(ConfigError, match=r"no quantity 'gains.rate'"):
        make({"gains.rate": RandomizeCfg(low=0.9, high=1.1)})
