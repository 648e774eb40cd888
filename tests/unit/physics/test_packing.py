"""Numbers that the fused kernel reads from memory, and Warp functions traced from torch functions of one environment."""

from dataclasses import replace
from functools import partial
from math import nan
from types import SimpleNamespace

import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError
from aerial_gym.interop.warp_start import start_warp
from aerial_gym.math.random import uniform_draws
from aerial_gym.math.rows import apply_by_element, choose
from aerial_gym.physics import BodyState, TorchBackend, Vehicle, WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.fused.torch_trace import trace_to_warp
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


MATRIX = wp.types.matrix(shape=(2, 3), dtype=wp.float32)


@wp.struct
class Body:
    velocity: wp.vec3
    axes: MATRIX
    mass: float


def push(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    along = (body.axes * body.velocity.unsqueeze(1)).sum(-1)
    force = torch.linalg.cross(body.axes[:, 0], body.velocity) / body.mass.unsqueeze(-1)
    size = 1.0 / body.velocity.norm(dim=-1)
    return force * factor.unsqueeze(-1) + torch.diag_embed(body.velocity)[:, 0], along.clamp(-1.0, 0.5).sum(-1) * size


INPUTS, OUTPUTS = {"body": Body, "factor": float}, (wp.vec3, float)
trace_push = partial(trace_to_warp, "push", INPUTS, push, OUTPUTS)


def run(function: wp.Function, velocity: Tensor, axes: Tensor, mass: Tensor, factor: Tensor) -> tuple[Tensor, Tensor]:
    start_warp()

    @wp.kernel(module="unique")
    def kernel(
        velocity: wp.array[wp.vec3], axes: wp.array[MATRIX], mass: wp.array[float], factor: wp.array[float],
        force: wp.array[wp.vec3], number: wp.array[float],
    ):  # fmt: skip
        i = wp.tid()
        body = Body()
        body.velocity = velocity[i]
        body.axes = axes[i]
        body.mass = mass[i]
        pushed, share = function(body, factor[i])
        force[i] = pushed
        number[i] = share

    force, number = torch.full_like(velocity, nan), torch.full_like(mass, nan)
    given = [(velocity, wp.vec3), (axes, MATRIX), (mass, wp.float32), (factor, wp.float32)]
    given += [(force, wp.vec3), (number, wp.float32)]
    wp.launch(kernel, dim=len(mass), inputs=[wp.from_torch(rows, dtype=kind) for rows, kind in given], device="cpu")
    return force, number


@pytest.mark.parametrize("known", [False, True])
def test_traced_function_equals_torch(known: bool) -> None:
    generator = torch.Generator().manual_seed(3)
    velocity, axes, mass, factor = (torch.randn(50, *shape, generator=generator) for shape in ((3,), (2, 3), (), ()))
    if known:
        axes[:] = torch.tensor([[0.0, 0.0, 1.0], [-1.0, 0.0, 1.0]])
    function = trace_push(constants={"body.axes": axes[0]} if known else None)
    expected = push(SimpleNamespace(velocity=velocity, axes=axes, mass=mass), factor)
    for actual, wanted in zip(run(function, velocity, axes, mass, factor), expected, strict=True):
        torch.testing.assert_close(actual, wanted, rtol=1e-5, atol=1e-5)


def test_partly_known_constants_keep_other_entries() -> None:
    function = trace_push(constants={"body.axes": torch.tensor([[0.0, 0.0, nan], [1.0, nan, 0.0]])})
    axes = torch.tensor([[[0.0, 0.0, 2.0], [1.0, 3.0, 0.0]]])
    velocity, one = torch.tensor([[0.3, -0.2, 0.1]]), torch.ones(1)
    expected = push(SimpleNamespace(velocity=velocity, axes=axes, mass=one), one)
    for actual, wanted in zip(run(function, velocity, axes, one, one), expected, strict=True):
        torch.testing.assert_close(actual, wanted)


def branch(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows by a branch on a value, which no kernel can have."""
    return (body.velocity if factor[0] > 0.0 else -body.velocity), factor


def test_untraceable_code_is_named_with_its_line_and_a_way_out() -> None:
    with pytest.raises(CapabilityError, match=r"branch: .*test_packing\.py:\d+ .*factor\[0\] > 0\.0.*torch\.where"):
        trace_to_warp("branch", INPUTS, branch, OUTPUTS)


def search(x: Tensor, y: Tensor) -> Tensor:
    """Return a number by a loop that runs where x > 0 only."""

    def halve(high: Tensor) -> Tensor:
        for _ in range(3):
            high = torch.where(high > 1.0, 0.5 * high, high + 1.0)
        return high

    return y * choose(x > 0.0, halve, y, x + 1.0)


def element_function(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
    """Return rows by a function of elements, and a number by bits, a small exponential and a choice of columns."""
    state = (1000.0 * factor).to(torch.int64)
    noise = uniform_draws(state, 3, 3, dtype=torch.float32) - 0.5
    chosen = body.velocity.index_select(1, torch.tensor([2, 0, 0]))
    return apply_by_element(search, body.velocity, body.mass.unsqueeze(-1)) + noise, torch.expm1(1e-4 * chosen).sum(-1)


def test_functions_of_elements_and_integers_equal_torch() -> None:
    generator = torch.Generator().manual_seed(4)
    velocity, axes, mass, factor = (torch.randn(50, *shape, generator=generator) for shape in ((3,), (2, 3), (), ()))
    function = trace_to_warp("elements", INPUTS, element_function, OUTPUTS, constants={})
    expected = element_function(SimpleNamespace(velocity=velocity, mass=mass), factor)
    for actual, wanted in zip(run(function, velocity, axes, mass, factor), expected, strict=True):
        torch.testing.assert_close(actual, wanted, rtol=2e-6, atol=1e-9)


def test_function_of_elements_that_reads_other_numbers_is_refused() -> None:
    def closure(body: SimpleNamespace, factor: Tensor) -> tuple[Tensor, Tensor]:
        return apply_by_element(lambda v: v * body.mass, body.velocity), factor

    with pytest.raises(CapabilityError, match="not among its arguments"):
        trace_to_warp("closure", INPUTS, closure, OUTPUTS, constants={})
