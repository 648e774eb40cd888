"""Step time of a user's effect, law and rotor map in plain torch, against a built-in one of the same size.

Each pair has the same formula. The user's class stands here as a user would write it. On a GPU the steps are a CUDA graph;
``pytest -m slow -s tests/integration/test_own_code_speed.py`` prints the ratios.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import CONTROLLERS, EFFECTS, ROBOTS, ROTOR_MAPS
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROL_LAWS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import make_gains
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.physics import (
    BodyState,
    RotorMap,
    WarpBackend,
    build_model,
    effects_from_config,
    state_at_rest,
    vehicle_from_config,
)
from aerial_gym.physics.effects import LinearWrenchEffect, Parameter
from aerial_gym.physics.effects.drag import QuadraticDrag
from aerial_gym.workloads.measure import make_batch, wait_for_device

DT, SUBSTEPS = 0.002, 10
ROUNDS, STEPS = 15, 20
LIMIT = 1.1  # largest ratio of the median step times


class OwnDrag(LinearWrenchEffect):
    """``F_i = -d_i |v| v_i``."""

    name = "own_drag"
    summary = "quadratic drag"
    parameters = tuple(Parameter(name=p.name, unit=p.unit, low=0.0, high=10.0, scale=0.05, meaning=p.meaning)
                       for p in QuadraticDrag.parameters)  # fmt: skip
    excitation = "several speeds"

    def regressor(self, condition: Any) -> Tensor:
        v = condition.air_velocity
        force = -torch.diag_embed(((v * v).sum(-1, keepdim=True) + 1e-12).sqrt() * v)
        return torch.cat((force, torch.zeros_like(force)), dim=1)


class OwnRates:
    """Thrust above the weight [weights] and body rates [rad/s]."""

    action_names = ("thrust - 1 [weights]", "p [rad/s]", "q [rad/s]", "r [rad/s]")
    trim = "p q r"

    def __init__(self, cfg: ControllerCfg, vehicle: Any, gravity: float, *, dt: float, control: Any) -> None:
        self.allocation = Allocation(vehicle, gravity)
        self.gains = make_gains(replace(cfg, law="rates"), control, vehicle, self.allocation, gravity=gravity, dt=dt)
        self.vehicle, self.gravity = vehicle, gravity

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        damping = self.gains.rate * (action[:, 1:] - state.ang_vel)
        momentum = (self.vehicle.inertia * state.ang_vel.unsqueeze(1)).sum(-1)
        torque = damping + torch.linalg.cross(state.ang_vel, momentum)
        thrust = (action[:, 0] + 1.0) * self.vehicle.mass * self.gravity
        return self.allocation.speed_for_wrench(thrust_wrench(thrust, torque))


class OwnPolynomial(RotorMap):
    """``c0 + c1 w + c2 w²``."""

    name = "own_polynomial"
    summary = "polynomial"

    def terms(self, speed: Tensor) -> tuple[Tensor, ...]:
        return torch.ones_like(speed), speed, speed * speed

    def speed_for_thrust(self, coefficients: Tensor, thrust: Tensor) -> Tensor:
        c0, c1, c2 = coefficients.unbind(-1)
        return ((c1 * c1 + 4.0 * c2 * (thrust - c0)).clamp_min(1e-12).sqrt() - c1) / (2.0 * c2)


@pytest.fixture
def own_code(own_registries: None) -> None:
    EFFECTS.register("own_drag", OwnDrag())
    CONTROL_LAWS.register("own_rates", OwnRates)
    CONTROLLERS.register("own_rates", ControllerCfg(summary="rates", law="own_rates"))
    ROTOR_MAPS.register("own_polynomial", OwnPolynomial())


PAIRS = {
    "effect": ({"effect": "quadratic_drag"}, {"effect": "own_drag"}),
    "law": ({"law": "lee_rates_control"}, {"law": "own_rates"}),
    "rotor map": ({"rotor_map": "polynomial"}, {"rotor_map": "own_polynomial"}),
}
"""Built-in and own code of each kind."""


def make_steps(
    device: torch.device, num_envs: int, *, effect: str = "", law: str = "lee_rates_control", rotor_map: str = "polynomial"
) -> tuple[BodyState, Callable[[], None]]:  # fmt: skip
    """Return a state in flight and a function of ``STEPS`` steps of it, captured on a GPU."""
    robot = ROBOTS.get("base_quadrotor")
    robot = replace(robot, rotor=replace(robot.the_rotor("the test"), rotor_map=rotor_map))
    vehicle = vehicle_from_config(robot, num_envs=num_envs, device=device)
    drag = {effect: {"dx": 0.02, "dy": 0.03, "dz": 0.01}} if effect else {}
    model = build_model(vehicle, effects_from_config(drag, num_envs=num_envs, device=device, dtype=torch.float32))
    control = make_controller(CONTROLLERS.get(law), vehicle, 9.81, dt=DT, control=robot.control)
    backend = WarpBackend()
    backend.allocate(model, control, integrator="euler")
    state = state_at_rest(num_envs, 4, device=device, dtype=torch.float32)
    share = torch.linspace(-1.0, 1.0, num_envs, device=device).unsqueeze(-1)
    state.lin_vel[:] = share * torch.tensor([3.0, -2.0, 1.0], device=device)
    state.ang_vel[:] = share * torch.tensor([1.0, 2.0, -1.0], device=device)
    state.rotor_speed.fill_(0.5 * float(vehicle.speed_high[0, 0]))
    action = torch.zeros(num_envs, 4, device=device)
    start = [rows.clone() for rows in state.tensors()]
    steps = make_batch(lambda: backend.step(state, action, DT, SUBSTEPS), STEPS, device)
    for rows, first in zip(state.tensors(), start, strict=True):
        rows.copy_(first)
    return state, steps


@pytest.mark.parametrize("kind", PAIRS)
def test_own_code_flies_as_the_built_in_one(own_code: None, kind: str, device: torch.device) -> None:
    ends = []
    for options in PAIRS[kind]:
        state, steps = make_steps(device, 64, **options)
        steps()
        ends.append(state)
    for name, rows in vars(ends[0]).items():
        torch.testing.assert_close(getattr(ends[1], name), rows, rtol=2e-4, atol=2e-4, msg=f"{kind}: {name}")


@pytest.mark.slow
@pytest.mark.skipif(not torch.cuda.is_available(), reason="the limit is that of a GPU")
@pytest.mark.parametrize("num_envs", [4_096, 65_536, 1_048_576])
@pytest.mark.parametrize("kind", PAIRS)
def test_own_code_is_as_fast_as_the_built_in_one(own_code: None, kind: str, num_envs: int) -> None:
    device = torch.device("cuda:0")
    built_in, own = (make_steps(device, num_envs, **options)[1] for options in PAIRS[kind])
    ratios = [second / first for first, second in alternate_times(built_in, own, device)]
    ratio = statistics.median(ratios)
    print(f"\n{kind}, {num_envs} environments: {ratio:.3f} ({min(ratios):.3f} to {max(ratios):.3f}), at most {LIMIT}")
    assert ratio <= LIMIT


def alternate_times(
    first: Callable[[], None], second: Callable[[], None], device: torch.device
) -> Iterator[tuple[float, float]]:
    """Yield the times [s] of both, in turn, after a round without measurement."""
    for number in range(ROUNDS + 1):
        times = []
        for steps in (first, second):
            wait_for_device(device)
            begin = time.perf_counter()
            for _ in range(5):
                steps()
            wait_for_device(device)
            times.append(time.perf_counter() - begin)
        if number:
            yield times[0], times[1]
