"""The tuner against closed forms, against the sampled loop that is flown, and against a flight with lag and dead time."""

from dataclasses import replace
from math import pi, sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.control.tuner import Tuning, rotor_response, tune_attitude, tune_loop, tune_position
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import euler_from_quat
from aerial_gym.physics import EFFECTS, TorchBackend, Vehicle, build_model, state_at_rest, vehicle_from_config
from aerial_gym.robots import ROBOTS

F64 = torch.float64
X500 = ROBOTS.get("x500")


def vehicles() -> Vehicle:
    vehicle = vehicle_from_config(X500, num_envs=4, dtype=F64)
    turn, slow = torch.tensor([1.0, 2.0, 1.0, 0.7], dtype=F64), torch.tensor([1.0, 1.0, 1.6, 0.5], dtype=F64)
    lag = slow.unsqueeze(-1) * vehicle.time_constant_down
    return replace(vehicle, inertia=turn[:, None, None] * vehicle.inertia, time_constant_up=lag, time_constant_down=lag)


@pytest.mark.parametrize("damping", [0.5, 0.7, 1.0])
def test_without_lag_it_is_the_second_order_formula(damping: float) -> None:
    """Bandwidth over natural frequency: sqrt(1 - 2 z² + sqrt((1 - 2 z²)² + 1))."""
    none = torch.zeros(2, 3, dtype=F64)
    result = tune_loop(rotor_response(none, 0.0), none, bandwidth=5.0, damping=damping, loop_name="a")
    square = 1.0 - 2.0 * damping**2
    natural = 5.0 / sqrt(square + sqrt(square**2 + 1.0))
    torch.testing.assert_close(result.natural_frequency, torch.full_like(none, natural), rtol=1e-5, atol=0)
    torch.testing.assert_close(result.damping, torch.full_like(none, damping), rtol=1e-5, atol=0)


def residual(results: Tuning, damping: float) -> Tensor:
    """Return the characteristic polynomial at the pair, over s²."""
    s = results.frequency * complex(-damping, sqrt(1.0 - damping**2))
    return (s.square() + (results.proportional + results.derivative * s) * results.inner(s)) / s.square()


def test_poles_and_bandwidth_are_met_with_lag_and_dead_time_in_every_environment() -> None:
    attitude = tune_attitude(vehicles(), bandwidth=5.0, damping=0.7, delay=0.01, dt=0.004)
    position = tune_position(attitude, bandwidth=(0.5, 0.7, 1.2), damping=0.8)
    asked = torch.tensor([[5.0] * 3, [0.5, 0.7, 1.2]], dtype=F64)
    for result, bandwidth, damping in ((attitude, asked[0], 0.7), (position, asked[1], 0.8)):
        assert float(residual(result, damping).abs().max()) < 1e-12
        s = torch.complex(torch.zeros(4, 3, dtype=F64), bandwidth.expand(4, 3))
        torch.testing.assert_close(result.closed(s).abs(), torch.full((4, 3), sqrt(0.5), dtype=F64), rtol=1e-9, atol=0)
    assert len(set(attitude.proportional[:, 0].tolist())) == 3  # inertia is not in it, lag is


def test_the_sampled_loop_has_the_placed_poles() -> None:
    """Its eigenvalues ``exp(s dt)``: half a step of holding is all but what sampling does, to the square of the time step."""
    quick = replace(X500, rotor=replace(X500.rotor, time_constant_up=0.02, time_constant_down=0.02))
    vehicle, missed = vehicle_from_config(quick, num_envs=1, dtype=F64), []
    for dt in (0.008, 0.004):
        attitude = tune_attitude(vehicle, bandwidth=8.0, damping=0.7, delay=0.0, dt=dt)
        position = tune_position(attitude, bandwidth=1.0, damping=0.8)
        loops = {"attitude": attitude, "position": position}
        numbers = {
            f"{name}_{kind}": tuple(getattr(result, "natural_frequency" if kind == "frequency" else kind)[0].tolist())
            for name, result in loops.items()
            for kind in ("frequency", "damping")
        }
        loop = ClosedLoop(
            replace(quick, control=ControlCfg(**numbers)),
            CONTROLLERS.get("lee_position_control"), gravity=9.81, integrator="rk4", names=("x500", "lee_position_control"),
        )  # fmt: skip
        poles = torch.log(loop.modes(dt)) / dt
        yaw, sideways, up = (attitude, 2, 0.7), (position, 0, 0.8), (position, 2, 0.8)
        for result, axis, damping in (yaw, sideways, up):
            placed = complex(result.frequency[0, axis]) * complex(-damping, sqrt(1.0 - damping**2))
            missed.append(float((poles - placed).abs().min()) / abs(placed))
    assert max(missed[:3]) < 0.01
    for coarse, fine in zip(missed[:3], missed[3:], strict=True):
        assert fine < 0.3 * coarse


def test_a_flight_with_lag_and_dead_time_has_the_bandwidth() -> None:
    """Every vehicle told to roll by a sine at it gives ``sqrt 1/2`` of it, within 1 %; dead time of 3.5 steps."""
    bandwidth, vehicle, amplitude = 5.0, vehicles(), 0.02
    dt = 2.0 * pi / bandwidth / 150.0
    delay = 3.5 * dt
    result = tune_attitude(vehicle, bandwidth=bandwidth, damping=0.7, delay=delay, dt=dt)
    law = make_controller(CONTROLLERS.get("lee_attitude_control"), vehicle, 9.81, dt=dt)
    inertia = vehicle.inertia.diagonal(dim1=1, dim2=2)
    law.gains = replace(law.gains, attitude=inertia * result.proportional, rate=inertia * result.derivative)
    late = (EFFECTS.get("actuation_delay"), torch.full((4, 1), delay, dtype=F64))
    backend, state = TorchBackend(), state_at_rest(4, 4, device=torch.device("cpu"), dtype=F64)
    backend.allocate(build_model(vehicle, [late]), law, integrator="rk4")
    state.rotor_speed.fill_(X500.rotor.speed_for_thrust(X500.body.mass * 9.81 / 4))
    rolls, times = [], []
    for step in range(600):
        time = torch.tensor(step * dt, dtype=F64)
        action = torch.zeros(4, 4, dtype=F64)
        action[:, 1] = amplitude * torch.sin(bandwidth * time)
        backend.step(state, action, dt, 1)
        if step >= 450:  # a period, three after the start
            rolls.append(euler_from_quat(state.attitude.clone())[:, 0])
            times.append((step + 1) * dt)
    wave = torch.tensor(times, dtype=F64) * bandwidth
    roll = torch.stack(rolls)
    part = torch.stack(((roll.T * torch.sin(wave)).mean(-1), (roll.T * torch.cos(wave)).mean(-1)))
    gain = 2.0 * part.square().sum(0).sqrt() / amplitude
    torch.testing.assert_close(gain, torch.full((4,), sqrt(0.5), dtype=F64), rtol=0.01, atol=0)


def test_more_than_the_lag_allows_is_refused_with_what_it_does() -> None:
    with pytest.raises(ConfigError, match=r"attitude loop: a bandwidth of 60.0 rad/s .* at most (\S+), ") as refused:
        tune_attitude(vehicles(), bandwidth=60.0, damping=0.7, delay=0.01, dt=0.004)
    most = float(str(refused.value).split("at most ")[1].split(",")[0])
    tune_attitude(vehicles(), bandwidth=0.999 * most, damping=0.7, delay=0.01, dt=0.004)
    with pytest.raises(ConfigError, match="damping = 0.1: must be from 0.3 to 1.0"):
        tune_attitude(vehicles(), bandwidth=5.0, damping=0.1, delay=0.0, dt=0.004)
    with pytest.raises(ConfigError, match="bandwidth = -1.0 rad/s: must be > 0"):
        tune_attitude(vehicles(), bandwidth=-1.0, damping=0.7, delay=0.0, dt=0.004)
