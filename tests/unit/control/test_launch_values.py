"""What the fused laws compute of an action once a launch."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import make_controller
from aerial_gym.control.laws import LAWS
from aerial_gym.physics import BodyState, WarpBackend, build_model, vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import random_state

ENVS, SUBSTEPS, DT = 16, 5, 0.004


@pytest.mark.parametrize("name", LAWS)
def test_a_launch_of_many_substeps_is_as_many_launches(name: str) -> None:
    """An action that is prepared once for five substeps gives, bit for bit, the flight of one that is prepared for
    each. Actions are to both sides of the limits of inclination and yaw rate, and turn all ways."""
    robot = ROBOTS.get("omnidirectional_octarotor" if name == "pose" else "base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=ENVS)
    law = make_controller(ControllerCfg(summary="", law=name), vehicle, 9.81, dt=DT)
    backend = WarpBackend()
    backend.allocate(build_model(vehicle), law, integrator="euler")
    actions = 6.0 * (torch.rand(ENVS, len(law.action_names), generator=torch.Generator().manual_seed(1)) - 0.5)
    start = random_state(ENVS, seed=2, rotor_speed=400.0)
    start = replace(start, rotor_speed=start.rotor_speed[:, :1].expand(-1, vehicle.num_rotors))
    start = replace(start, **{key: value.float() for key, value in vars(start).items()})
    once, each = (BodyState(**{key: value.clone() for key, value in vars(start).items()}) for _ in range(2))
    backend.step(once, actions, DT, SUBSTEPS)
    for _ in range(SUBSTEPS):
        backend.step(each, actions, DT, 1)
    for key, value in vars(once).items():
        torch.testing.assert_close(value, getattr(each, key), rtol=0.0, atol=0.0)
        assert value.isfinite().all()
