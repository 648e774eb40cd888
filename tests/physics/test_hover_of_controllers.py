"""Every registered controller holds a robot at rest, and flies each environment as if it were alone: 1, 2 and 5 of
them. In float64 with the torch backend; the fused kernel, which runs an environment a thread, in
``test_alone_in_the_fused_kernel``."""

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.math.quaternion import quat_exp
from aerial_gym.physics import BodyState, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.model import robot_effects
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import MEANT_FOR
from tests.repetitions import thin_values

F64 = torch.float64
DT, STEPS = 0.01, 15
GRAVITY = 9.81

ROUND_OFF = 1e-12
"""Of a flight of 15 steps: matrix products of several rows round otherwise than those of one."""


def pick_robot(controller: str) -> RobotCfg:
    if controller == "fully_actuated_control":
        return ROBOTS.get("omnidirectional_octarotor")
    return ROBOTS.get(MEANT_FOR.get(controller.partition("_")[0], "x500"))


def rows(vehicle: Vehicle, robot: RobotCfg) -> tuple[Tensor, Tensor]:
    weight = torch.zeros(vehicle.num_envs, 6, dtype=F64)
    weight[:, 2] = robot.body.mass * GRAVITY - robot.control.buoyancy
    allocation = Allocation(vehicle, GRAVITY)
    return allocation.allot(weight).thrust, allocation.speed_for_wrench(weight)


def start(speed: Tensor, first: int) -> BodyState:
    share = torch.arange(first, first + len(speed), dtype=F64).unsqueeze(-1)
    direction = torch.tensor([[0.3, -0.2, 0.1]], dtype=F64)
    return BodyState(
        position=share * direction, attitude=quat_exp(0.3 * share * direction.roll(1)),
        lin_vel=share * direction.roll(2), ang_vel=-share * direction, rotor_speed=speed.clone(),
    )  # fmt: skip


def fly(controller: str, num_envs: int, first: int) -> BodyState:
    robot = pick_robot(controller)
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    law = make_controller(CONTROLLERS.get(controller), vehicle, GRAVITY, dt=DT, control=robot.control)
    effects = robot_effects(robot, num_envs=num_envs, device=torch.device("cpu"), dtype=F64)
    backend = TorchBackend()
    backend.allocate(build_model(vehicle, effects, gravity=GRAVITY), law, integrator="euler")
    thrust, speed = rows(vehicle, robot)
    told = {"no_control": thrust, "rotor_speed_control": speed}
    state = start(speed, first)
    backend.step(state, told.get(controller, torch.zeros(num_envs, len(law.action_names), dtype=F64)), DT, STEPS)
    return state


@pytest.mark.parametrize("controller", thin_values(CONTROLLERS, 3))
def test_hover_is_the_same_alone_and_among_others(controller: str) -> None:
    five, two = fly(controller, 5, 0), fly(controller, 2, 0)
    alone = {first: fly(controller, 1, first) for first in (0, 1, 4)}
    rest = start(five.rotor_speed, 0)
    for name, result in vars(five).items():
        torch.testing.assert_close(getattr(two, name), result[:2], atol=ROUND_OFF, rtol=ROUND_OFF)
        for first, one in alone.items():
            torch.testing.assert_close(getattr(one, name)[0], result[first], atol=ROUND_OFF, rtol=ROUND_OFF)
        torch.testing.assert_close(result[0], getattr(rest, name)[0], atol=1e-9, rtol=1e-9)
    assert float((five.lin_vel[1] - rest.lin_vel[1]).norm()) > 1e-3
