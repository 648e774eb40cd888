"""Every registered controller holds a robot at rest; ``tests/cross/test_batch_size.py`` has other motions, in batches."""

import pytest
import torch

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.physics import TorchBackend, build_model, state_at_rest, vehicle_from_config
from aerial_gym.physics.model import robot_effects
from aerial_gym.robots import ROBOTS
from benchmarks.control.control_flights import GRAVITY, MEANT_FOR
from tests.physics.vehicles import F64
from tests.repetitions import thin_values


@pytest.mark.parametrize("controller", thin_values(CONTROLLERS, 3))
def test_a_robot_at_rest_stays_there(controller: str) -> None:
    sideways = controller == "fully_actuated_control"
    name = "omnidirectional_octarotor" if sideways else MEANT_FOR.get(controller.partition("_")[0], "x500")
    robot, cpu = ROBOTS.get(name), torch.device("cpu")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    law = make_controller(CONTROLLERS.get(controller), vehicle, GRAVITY, dt=0.01, control=robot.control)
    effects = robot_effects(robot, num_envs=1, device=cpu, dtype=F64)
    backend = TorchBackend()
    backend.allocate(build_model(vehicle, effects, gravity=GRAVITY), law, integrator="euler")
    weight, allocation = torch.zeros(1, 6, dtype=F64), Allocation(vehicle, GRAVITY)
    weight[:, 2] = robot.body.mass * GRAVITY - robot.control.buoyancy
    speed = allocation.speed_for_wrench(weight)
    hover = {"no_control": allocation.allot(weight).thrust, "rotor_speed_control": speed}
    state = state_at_rest(1, vehicle.num_rotors, device=cpu, dtype=F64)
    state.rotor_speed.copy_(speed)
    rest = [tensor.clone() for tensor in state.tensors()]
    backend.step(state, hover.get(controller, torch.zeros(1, len(law.action_names), dtype=F64)), 0.01, 15)
    for tensor, expected in zip(state.tensors(), rest, strict=True):
        torch.testing.assert_close(tensor, expected, atol=1e-9, rtol=1e-9)
