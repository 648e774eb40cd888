"""Rotor lag, maps and wrench against closed forms."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import evaluate_map, lag_speed, rotor_wrench, speed_for_thrust, state_for_thrust
from tests.physics.vehicles import asymmetric_robot

F64 = torch.float64


@pytest.mark.parametrize("steps", [1, 7, 100])
@pytest.mark.parametrize(("start", "end"), [(0.0, 900.0), (900.0, 100.0)])
def test_lag_follows_the_exponential_with_its_own_time_constant(steps: int, start: float, end: float) -> None:
    """w(t) = w_c + (w_0 - w_c) exp(-t / tau), tau by rise or fall, however many steps lead to t."""
    up, down, span = 0.05, 0.02, 0.1
    speed, command = torch.full((1, 4), start, dtype=F64), torch.full((1, 4), end, dtype=F64)
    for _ in range(steps):
        speed = lag_speed(
            speed, command, torch.full((1, 4), up, dtype=F64), torch.full((1, 4), down, dtype=F64), span / steps
        )
    tau = up if end > start else down
    expected = end + (start - end) * torch.exp(torch.tensor(-span / tau, dtype=F64))
    torch.testing.assert_close(speed, expected.expand(1, 4), atol=0.0, rtol=1e-12)


def test_lag_without_time_constant_follows_at_once() -> None:
    zero = torch.zeros(1, 1, dtype=F64)
    out = lag_speed(torch.full((1, 1), 3.0, dtype=F64), torch.full((1, 1), 7.0, dtype=F64), zero, zero, 0.01)
    assert out.item() == 7.0


def test_speed_for_thrust_inverts_the_map() -> None:
    coefficients = torch.tensor([0.1, -2e-4, 3e-6], dtype=F64).expand(1, 5, 3)
    speed = torch.linspace(100.0, 2000.0, 5, dtype=F64).unsqueeze(0)
    thrust = evaluate_map(coefficients, speed)
    torch.testing.assert_close(thrust, 0.1 - 2e-4 * speed + 3e-6 * speed**2, atol=1e-12, rtol=0)
    torch.testing.assert_close(speed_for_thrust(coefficients, thrust), speed, atol=0, rtol=1e-12)


def test_thrust_below_the_vertex_gives_the_vertex_and_no_nan() -> None:
    coefficients = torch.tensor([0.0, -2e-4, 3e-6], dtype=F64).expand(1, 1, 3)
    speed = speed_for_thrust(coefficients, torch.full((1, 1), -5.0, dtype=F64))
    torch.testing.assert_close(speed, torch.full((1, 1), 2e-4 / 6e-6, dtype=F64))


@pytest.mark.parametrize("traits", [frozenset(), frozenset({"reversible"})])
def test_a_thrust_that_no_rotor_gives_has_no_slope_and_no_nan(traits: frozenset[str]) -> None:
    """The root of 0 has an infinite slope, times the 0 of a limit NaN: one such rotor takes the gradient of its whole row."""
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    vehicle = replace(vehicle, traits=traits, thrust_map=torch.tensor([0.0, 0.0, 3e-6], dtype=F64).expand(1, 4, 3))
    thrust = torch.tensor([[0.0, -1.0, 0.5, 1.0]], dtype=F64, requires_grad=True)
    (slope,) = torch.autograd.grad(state_for_thrust(vehicle, thrust).sum(), thrust)
    assert slope[0, :2].tolist() == [0.0, 0.0]
    assert bool((slope[0, 2:] > 0.0).all())


def test_front_right_rotor_alone_rolls_left_side_up_pitches_nose_up_and_yaws_against_its_spin() -> None:
    """Rotor at +x, -y with thrust up: r x F = (y F, -x F): Mx = -0.1 F (right side up), My = -0.2 F (nose up)."""
    vehicle = vehicle_from_config(asymmetric_robot(com=(0.0, 0.0, 0.0)), num_envs=1, dtype=F64)
    hub = torch.tensor([[0.2, -0.1, 0.0]], dtype=F64)
    axis = torch.tensor([[0.0, 0.0, 1.0]], dtype=F64)
    vehicle.rotor_position[0], vehicle.rotor_axis[0], vehicle.rotor_spin[0] = hub, axis, 1.0
    thrust, torque = torch.tensor([[2.0, 0, 0, 0]], dtype=F64), torch.tensor([[0.3, 0, 0, 0]], dtype=F64)
    force, moment = rotor_wrench(vehicle, thrust, torque)
    torch.testing.assert_close(force, torch.tensor([[0.0, 0.0, 2.0]], dtype=F64))
    torch.testing.assert_close(moment, torch.tensor([[-0.2, -0.4, -0.3]], dtype=F64))
