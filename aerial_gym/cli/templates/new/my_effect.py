"""The effect ``my_effect``: a constant force along body x. Replace force, parameters and texts by your own.

Effects of other kinds: docs/guides/own_effect.md. Units are SI; body x is forward, y left, z up. E: environments.
"""

from dataclasses import replace

import torch

from aerial_gym import EFFECTS, ROBOTS, SimBuilder
from aerial_gym.physics.effects import LinearWrenchEffect, Parameter


class MyEffect(LinearWrenchEffect):
    """Constant force along body x: ``F = (force, 0, 0)``, through the centre of mass."""

    name = "my_effect"
    summary = "constant force along body x"
    # low and high bound a fit, scale is a usual size; 0 changes nothing
    parameters = (Parameter(name="force", unit="N", low=-5.0, high=5.0, scale=0.1, meaning="force, forward positive"),)
    excitation = "flights at several headings: at one heading a wind looks the same"  # motion that shows the effect
    confused_with = ("com_offset", "constant_wind")  # effects that look alike in some flights

    def regressor(self, condition):
        """Return force [N] and torque [N m], body axes, of a parameter of 1, (E, 6, 1)."""
        zero = torch.zeros_like(condition.up[:, :1])
        return torch.stack((zero + 1.0, zero, zero, zero, zero, zero), dim=1)


EFFECTS.register("my_effect", MyEffect())


def fly(force: float) -> torch.Tensor:
    """Return the velocity [m/s] after a fall of 0.1 s with a force [N], body axes, (3,)."""
    robot = replace(ROBOTS.get("base_quadrotor"), effects={"my_effect": {"force": force}})
    names = {"sim_name": "base_sim", "env_name": "empty_env", "controller_name": "no_control"}
    env = SimBuilder().build_env(**names, robot_name=robot, num_envs=1, device="cpu")
    env.reset()
    for _ in range(10):
        env.step(torch.zeros(1, 4))
    return env.gtd["robot_body_linvel"][0].clone()


if __name__ == "__main__":
    print("change of the velocity by 0.5 N [m/s]:", fly(0.5) - fly(0.0))
