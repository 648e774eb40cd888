"""The controller ``my_controller``: climb rate and body rates. Replace law, action and texts by your own.

Both backends run this code: no branch on the value of a tensor (docs/guides/own_law.md). Body x is forward, y left, z up.
"""

import torch

from aerial_gym import CONTROLLERS, SimBuilder
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROL_LAWS
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.math.quaternion import world_up


class MyController:
    """Climb rate [m/s] by thrust, and body rates [rad/s] by torque, both proportional to their errors. E: environments."""

    action_names = ("climb rate [m/s]", "p [rad/s]", "q [rad/s]", "r [rad/s]")
    trim = (
        "vz p q r"  # axes that it controls, of x y z roll pitch yaw vx vy vz p q r: `robot check` tests their stability
    )

    def __init__(self, cfg, vehicle, gravity, *, dt, control):
        """Compute the allocation of the declared vehicle."""
        self.allocation, self.gravity = Allocation(vehicle, gravity), gravity
        self.mass, self.inertia = vehicle.mass, vehicle.inertia

    def rotor_command(self, state, action):
        """Return rotor speeds [rad/s], (E, R), for an action, (E, 4)."""
        upward = self.gravity + 4.0 * (action[:, 0] - state.lin_vel[:, 2])  # [m/s²]
        thrust = self.mass * upward / world_up(state.attitude)[:, 2].clamp_min(0.5)
        wanted = 20.0 * (action[:, 1:] - state.ang_vel)  # [rad/s²]
        torque = (self.inertia * wanted.unsqueeze(1)).sum(-1)
        return self.allocation.speed_for_wrench(thrust_wrench(thrust, torque))


CONTROL_LAWS.register("my_controller", MyController)
CONTROLLERS.register(
    "my_controller", ControllerCfg(summary="climb rate [m/s], body rates [rad/s]", law="my_controller")
)


def fly(climb_rate: float) -> torch.Tensor:
    """Return the velocity [m/s] after 2 s at a commanded climb rate [m/s], world, (E, 3)."""
    names = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
    env = SimBuilder().build_env(**names, controller_name="my_controller", num_envs=2, device="cpu")
    env.reset()
    for _ in range(200):
        env.step(torch.tensor([[climb_rate, 0.0, 0.0, 0.0]]).expand(2, 4))
    return env.gtd["robot_linvel"].clone()


if __name__ == "__main__":
    print("velocity at a climb rate of 0.5 m/s:", fly(0.5))
