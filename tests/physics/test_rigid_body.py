"""The equations of motion against closed forms, conservation laws and orders of convergence."""

from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics import (
    EFFECTS,
    INTEGRATORS,
    BodyState,
    accelerations,
    advance,
    build_model,
    condition_in,
    effects_from_config,
    vehicle_from_config,
)
from aerial_gym.physics.integrators import to_body_state, to_mass_state
from aerial_gym.physics.model import Model
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, random_state


def make_model(num_envs: int, *, com: tuple[float, float, float] = (0.01, -0.02, 0.03), gravity: float = 9.81) -> Model:
    return build_model(vehicle_from_config(asymmetric_robot(com=com), num_envs=num_envs, dtype=F64), gravity=gravity)


def no_thrust(state: BodyState) -> BodyState:
    return replace(state, rotor_speed=torch.zeros_like(state.rotor_speed))


def run(model: Model, state: BodyState, command: torch.Tensor, name: str, dt: float, steps: int) -> BodyState:
    return advance(model, INTEGRATORS[name], SpeedControl(), state, command, dt, steps)


@pytest.mark.parametrize("name", list(INTEGRATORS))
def test_free_fall_is_a_parabola_of_the_centre_of_mass(name: str) -> None:
    """p_c = p + v t - g t²/2 e_z: exact for RK4, off by exactly g t dt / 2 for semi-implicit Euler."""
    model, state = make_model(8), no_thrust(random_state(8))
    dt, steps = 0.01, 50
    start, span = to_mass_state(model, state), 0.5
    end = to_mass_state(model, run(model, state, state.rotor_speed, name, dt, steps))
    drop = 0.5 * 9.81 * span**2 + (0.5 * 9.81 * span * dt if name == "euler" else 0.0)
    expected = start.position + span * start.lin_vel - torch.tensor([0.0, 0.0, drop], dtype=F64)
    torch.testing.assert_close(end.position, expected, atol=1e-11, rtol=0)


def tumble_errors(name: str, dt: float) -> tuple[float, float]:
    model, state = make_model(16, gravity=0.0), no_thrust(random_state(16, seed=3))
    end = run(model, state, state.rotor_speed, name, dt, round(1.0 / dt))
    inertia = model.vehicle.inertia

    def momentum(s: BodyState) -> torch.Tensor:
        return quat_rotate(s.attitude, (inertia @ s.ang_vel.unsqueeze(-1)).squeeze(-1))

    def energy(s: BodyState) -> torch.Tensor:
        return 0.5 * (s.ang_vel * (inertia @ s.ang_vel.unsqueeze(-1)).squeeze(-1)).sum(-1)

    drift = (momentum(end) - momentum(state)).norm(dim=-1) / momentum(state).norm(dim=-1)
    return drift.max().item(), ((energy(end) - energy(state)) / energy(state)).abs().max().item()


@pytest.mark.parametrize(("name", "order"), [("euler", 1), ("rk4", 4)])
def test_free_tumbling_conserves_momentum_and_energy_to_the_order_of_the_method(name: str, order: int) -> None:
    """Both errors fall by 2^order (within 15 %: RK4's energy error may fall by 2^5) when dt is halved."""
    coarse, fine = tumble_errors(name, 0.02), tumble_errors(name, 0.01)
    for a, b in zip(coarse, fine, strict=True):
        assert b < a / 2 ** (order - 0.2)
        assert b < 0.2 * 0.01**order * 10.0**order  # C dt^order with the rates |w| ~ 5 rad/s


@pytest.mark.parametrize(("name", "order"), [("euler", 1), ("rk4", 4)])
def test_order_of_convergence_in_powered_flight(name: str, order: int) -> None:
    """Position, attitude and rates converge with the declared order within 0.1, rotors rising and falling. The reference
    makes eight steps for each of the finest of rk4: its error is 1 / 8⁴ of that one's, 4e-4 of a slope."""
    model, state = make_model(8), random_state(8, seed=1)
    command = state.rotor_speed * torch.tensor([1.2, 0.8, 0.9, 1.1], dtype=F64)
    reference = run(model, state, command, "rk4", 0.4 / 512, 512)
    steps = (64, 128, 256) if name == "euler" else (16, 32, 64)
    errors = []
    for n in steps:
        end = run(model, state, command, name, 0.4 / n, n)
        parts = zip(end.tensors()[:4], reference.tensors()[:4], strict=True)
        errors.append(torch.cat([(a - b).flatten() for a, b in parts]).norm().item())
    slopes = [torch.log2(torch.tensor(a / b)).item() for a, b in pairwise(errors)]
    assert slopes[-1] == pytest.approx(order, abs=0.1), (errors, slopes)


def test_rotor_speed_does_not_depend_on_the_stepper_or_step() -> None:
    model, state = make_model(4), random_state(4)
    command = state.rotor_speed * 1.1
    ends = [run(model, state, command, name, 0.2 / n, n).rotor_speed for name in INTEGRATORS for n in (1, 10)]
    for end in ends[1:]:
        torch.testing.assert_close(end, ends[0], atol=0, rtol=1e-12)


def test_mass_state_and_body_state_are_inverse() -> None:
    model, state = make_model(32), random_state(32)
    back = to_body_state(model, to_mass_state(model, state))
    for a, b in zip(back.tensors(), state.tensors(), strict=True):
        torch.testing.assert_close(a, b, atol=1e-14, rtol=0)


def test_specific_force_is_the_measured_acceleration_of_the_origin() -> None:
    """f = R^T (dv/dt - g) and alpha = dw/dt, against central differences of an RK4 flight with drag, error O(h²)."""
    drag = (EFFECTS.get("rotor_drag"), torch.tensor([0.9, 0.7, 0.5], dtype=F64).expand(16, 3))
    vehicle = vehicle_from_config(asymmetric_robot(com=(0.1, -0.2, 0.3)), num_envs=16, dtype=F64)
    model, state = build_model(vehicle, [drag]), random_state(16, seed=2)
    h = 1e-5
    ahead = run(model, state, state.rotor_speed, "rk4", h, 1)
    behind = run(model, state, state.rotor_speed, "rk4", -h, 1)
    acc = (ahead.lin_vel - behind.lin_vel) / (2 * h)
    ang_acc = (ahead.ang_vel - behind.ang_vel) / (2 * h)
    result = accelerations(model, state)
    gravity = torch.tensor([0.0, 0.0, -9.81], dtype=F64)
    torch.testing.assert_close(
        result.specific_force, quat_rotate_inverse(state.attitude, acc - gravity), atol=1e-5, rtol=1e-6
    )
    torch.testing.assert_close(result.ang_acc, ang_acc, atol=1e-5, rtol=1e-6)


def test_what_effects_see_in_a_state_serves_all_models_of_the_vehicle() -> None:
    """The condition of the bare vehicle gives the accelerations of one with drag and inflow, bit for bit."""
    vehicle, state = vehicle_from_config(asymmetric_robot(), num_envs=6, dtype=F64), random_state(6)
    values = {"h_force_flapping": {"kh": 1e-5, "kf": 1e-6}, "axial_inflow": {"ka": 1e-4}}
    effects = effects_from_config(values, num_envs=6, device=torch.device("cpu"), dtype=F64)
    bare, model = build_model(vehicle), build_model(vehicle, effects)
    still = torch.zeros_like(state.rotor_speed)
    result, known = accelerations(model, state), accelerations(model, state, condition=condition_in(bare, state, still))
    assert torch.equal(result.specific_force, known.specific_force)
    assert torch.equal(result.ang_acc, known.ang_acc)
