"""A Morphy with a leg under the end of each arm, in whole simulations of two environments."""

from dataclasses import replace

import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.config.environment import ContactCfg, EnvironmentCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.env_manager import EnvManager
from tests.builders import simulation

FILE = """
extends: morphy
collision:
  spheres: [LEGS, {center: [0.0, 0.0, 0.0], radius: 0.03}]
  source: test
"""
LEGS = ", ".join(
    f"{{center: [{x}, {y}, -0.05], radius: 0.01, link: azimuth_{k}}}"
    for k, (x, y) in enumerate(((0.0895, -0.0815), (-0.0895, -0.0815), (-0.0895, 0.0815), (0.0895, 0.0815)), start=1)
)
STANDING = replace(ENVIRONMENTS.get("landing_env"), contact=ContactCfg(friction=0.7, crash_speed=2.0))


def build(robot: str | RobotCfg, env: EnvironmentCfg = STANDING, backend: str = "mujoco", **rest) -> EnvManager:
    return simulation(robot, env=env, backend=backend, **{"num_envs": 2} | rest)


def put(sim: EnvManager, place: torch.Tensor) -> None:
    """Put level robots with still rotors and joints at places (E, 3) or (3,) [m]."""
    for key in ("robot_linvel", "robot_body_angvel", "rotor_speed", "dof_position", "dof_velocity"):
        sim.gtd[key].zero_()
    sim.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    sim.gtd["robot_position"][:] = place


def let_go(sim: EnvManager, span: float) -> torch.Tensor:
    """Step with still rotors for a span [s]; return which robots crashed meanwhile, (E,)."""
    crashed = torch.zeros(sim.num_envs, dtype=torch.bool)
    for _ in range(round(span / sim.dt)):
        sim.step(torch.zeros_like(sim.gtd["robot_actions"]))
        crashed |= sim.gtd["crashes"]
    return crashed


def put_down(robot: str, height: float, span: float) -> tuple[EnvManager, torch.Tensor]:
    """Return robots with still rotors that fell from a height, and which crashed, (E,)."""
    sim = build(robot)
    put(sim, torch.tensor([0.0, 0.0, height]))
    return sim, let_go(sim, span)
