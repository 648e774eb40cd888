"""A motor that fails at a moment: when it does, and the torque that follows. Speeds and resets are in ``test_failures.py``."""

import pytest
import torch

from aerial_gym.physics import EFFECTS, Model, accelerations, build_model
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.test_effects import rest_state
from tests.physics.vehicles import F64, asymmetric_robot

TOLD = 900.0
"""Commanded speed [rad/s]."""


def make_model(rows: list[tuple[float, ...]], dtype: torch.dtype = F64) -> Model:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=len(rows), dtype=dtype)
    return build_model(vehicle, [(EFFECTS.get("motor_failure"), torch.tensor(rows, dtype=dtype))])


@pytest.mark.parametrize(("moment", "last_whole"), [(0.0124, 2), (0.0126, 3)])
def test_it_fails_at_the_boundary_between_substeps_that_is_nearest(moment: float, last_whole: int) -> None:
    dt, model = 0.005, make_model([(1.0, 0.0, moment)])
    memory, state, whole = make_memory(model, dt), rest_state(rotor_speed=[TOLD] * 4), 0
    for _ in range(6):
        state, memory = fly_remembering(model, memory, state, [torch.full((1, 4), TOLD, dtype=F64)], dt)
        whole += int(state.rotor_speed[0, 0] == TOLD)
    assert whole == last_whole


def test_a_lost_rotor_turns_the_vehicle_to_its_side() -> None:
    """Rotor 1 stands ahead on the right: without it the vehicle falls to +x roll (right) and +y pitch (nose down). At rest
    with half of the command it has a quarter of the thrust: the torque about x is ``y (4 - 1/4 - 3) T`` of it."""
    robot = ROBOTS.get("base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, [(EFFECTS.get("motor_failure"), torch.tensor([(1.0, 0.5, 0.0)], dtype=F64))])
    told = torch.full((1, 4), 1000.0, dtype=F64)
    start = rest_state(rotor_speed=[1000.0] * 4)
    end, _ = fly_remembering(model, make_memory(model, 0.01), start, [told] * 200, 0.01)
    still_again = rest_state(rotor_speed=end.rotor_speed[0].tolist())
    turn = accelerations(build_model(vehicle), still_again).ang_acc[0]
    lost = 0.75 * 3.485449e-7 * 1000.0**2
    expected = torch.tensor([0.13 * lost / 4.225e-4, 0.13 * lost / 4.225e-4], dtype=F64)
    torch.testing.assert_close(turn[:2], expected, rtol=1e-9, atol=0.0)
    assert abs(turn[2].item()) == pytest.approx(0.01 * lost / 8.45e-4, rel=1e-9)
