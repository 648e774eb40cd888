"""Which numbers of an environment of its own the fused kernel reads from memory."""

from dataclasses import replace

import torch

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.physics import BodyState, TorchBackend, Vehicle, WarpBackend, build_model, vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.vehicles import random_state

ENVS, DT = 8, 0.004


def test_what_follows_from_other_numbers_takes_no_rows() -> None:
    """Mass 1, inertia and its inverse 6 each, squares of thrust and torque 4 each, lags 4, as they rise so they fall."""
    drawn = RandomizeCfg(each_rotor=True, low=0.9, high=1.1)
    randomize = {"body.mass": RandomizeCfg(low=0.9, high=1.1), "rotor.thrust_map": drawn, "rotor.time_constant": drawn}
    backend = simulation("base_quadrotor", "lee_velocity_control", randomize=randomize).robot_manager.backend
    assert [rows.shape for rows in backend.parameter_targets()] == [(2, 1 + 12 + 8 + 4)]


def test_lags_that_rise_and_fall_apart_take_rows_of_their_own() -> None:
    ends = []
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=ENVS)
        lag = 0.02 * torch.linspace(0.5, 2.0, 4 * ENVS).view(ENVS, 4)
        one = replace(vehicle, time_constant_up=lag, time_constant_down=lag)
        apart = replace(one, time_constant_down=3.0 * lag)
        law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81, dt=DT)
        backend.allocate(build_model(one), law, integrator="euler")
        start = random_state(ENVS, seed=4, rotor_speed=400.0)
        state = BodyState(**{name: value.float() for name, value in vars(start).items()})
        for model, width in ((one, 4), (apart, 8)):
            backend.set_model(build_model(model))
            for speed in (450.0, 350.0):
                backend.step(state, torch.full((ENVS, 4), speed), DT, 2)
                ends.append(state.rotor_speed.clone())
            if isinstance(backend, WarpBackend):
                assert [rows.shape for rows in backend.parameter_targets()] == [(ENVS, width)]
    for torch_end, warp_end in zip(ends[:4], ends[4:], strict=True):
        torch.testing.assert_close(warp_end, torch_end, rtol=2e-6, atol=0.0)


def test_maps_and_inertias_of_any_kind_arrive_whole() -> None:
    ends = []
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=ENVS)
        factor = torch.linspace(0.8, 1.2, ENVS)
        inertia = vehicle.inertia + 1e-4 * torch.tensor([[0.0, 1.0, 2.0], [1.0, 0.0, -3.0], [2.0, -3.0, 0.0]])
        first = vehicle.with_scaled_maps(thrust=factor[:, None].expand(-1, 4), torque=factor[:, None].expand(-1, 4))
        first = replace(first, inertia=factor[:, None, None] * inertia)
        law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81, dt=DT)
        backend.allocate(build_model(first), law, integrator="euler")
        start = random_state(ENVS, seed=4, rotor_speed=400.0)
        state = BodyState(**{name: value.float() for name, value in vars(start).items()})
        command = torch.full((ENVS, 4), 450.0)
        backend.step(state, command, DT, 5)
        ends.append(torch.cat(state.tensors(), dim=-1))
        backend.set_model(build_model(with_linear_terms(first)))
        backend.step(state, command, DT, 5)
        ends.append(torch.cat(state.tensors(), dim=-1))
    for torch_end, warp_end in zip(ends[:2], ends[2:], strict=True):
        torch.testing.assert_close(warp_end, torch_end, rtol=2e-5, atol=2e-5)
    assert (ends[0] - ends[1]).abs().max() > 0.01


def with_linear_terms(vehicle: Vehicle) -> Vehicle:
    more = vehicle.thrust_map.clone()
    more[..., 0], more[..., 1] = 0.1, 1e-3
    return replace(vehicle, thrust_map=more)
