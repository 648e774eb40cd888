"""Torques of the Crazyflie's power distribution, by hand."""

import pytest
import torch

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie.distribution import rotor_signs, torque_per_count
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS


def test_torque_of_one_count_is_that_of_four_rotors_with_their_shares() -> None:
    """A count of thrust is 1/65535 of the largest; half a count acts at each arm about x and y, a whole one turns about z."""
    vehicle = vehicle_from_config(ROBOTS.get("crazyflie_2x_arpl"), num_envs=1, dtype=torch.float64)
    allocation = Allocation(vehicle, 9.81)
    torque = torque_per_count(vehicle, allocation, rotor_signs("position", vehicle, allocation, 9.81), 9.81)
    count = 0.1420 / 65535.0
    lateral = 4.0 * 0.028 * 0.5 * count
    assert torque.tolist() == pytest.approx([lateral, lateral, 4.0 * count * 1.45e-10 / 2.431e-8], rel=1e-3)
