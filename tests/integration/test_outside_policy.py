"""A policy that others trained in a simulator of theirs flies vehicles of this one."""

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "outside_policy.py"


@pytest.mark.parametrize("robot", ["base_quadrotor", "x500", "crazyflie_21"])
def test_a_foundation_policy_hovers(robot: str) -> None:
    """Axes, signs, order of the rotors and steps are those that it knows; x500 counts its rotors in another order."""
    errors = runpy.run_path(str(EXAMPLE))["hover_errors"](robot, num_envs=16, seconds=6.0)
    assert errors.shape == (16,)
    assert float(np.max(errors)) < 0.05


def test_a_foundation_policy_loses_a_vehicle_of_little_thrust() -> None:
    """It keeps 41 % of 64 of ``tinyprop`` (thrust to weight 1.31); fewer than 1 % of draws of 16 are out of bounds."""
    errors = runpy.run_path(str(EXAMPLE))["hover_errors"]("tinyprop", num_envs=16, seconds=6.0)
    assert 0.31 < float(np.isinf(errors).mean()) < 0.88
