"""Each effect against a closed form, with a sign; and what every effect must state."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.errors import ConfigError, ShapeError, UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics import (
    EFFECTS,
    INTEGRATORS,
    BodyState,
    accelerations,
    advance,
    build_model,
    effects_from_config,
    vehicle_from_config,
)
from aerial_gym.physics.effects import (
    CommandEffect,
    DelayEffect,
    Effect,
    FluidEffect,
    ImuEffect,
    LinkEffect,
    LinkFluidEffect,
    LinkWrenchEffect,
    LoadEffect,
    RotorEffect,
    RotorSensorEffect,
    VehicleEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.model import Model
from aerial_gym.robots import ROBOTS
from tests.physics.test_rigid_body import SpeedControl
from tests.physics.vehicles import BATTERY, CEILING, F64, ON_RIGID, asymmetric_robot, random_state

KINDS = (
    VehicleEffect,
    WindEffect,
    RotorEffect,
    WrenchEffect,
    FluidEffect,
    LinkEffect,
    LinkFluidEffect,
    LinkWrenchEffect,
    LoadEffect,
    DelayEffect,
    CommandEffect,
    ImuEffect,
    RotorSensorEffect,
)


def make_effects(values: dict[str, dict[str, float]], num_envs: int) -> list[tuple[Effect, torch.Tensor]]:
    return effects_from_config(values, num_envs=num_envs, device=torch.device("cpu"), dtype=F64)


def symmetric_model(values: dict[str, dict[str, float]], num_envs: int = 1, gravity: float = 9.81) -> Model:
    vehicle = vehicle_from_config(replace(ROBOTS.get("tinyprop"), battery=BATTERY), num_envs=num_envs, dtype=F64)
    return build_model(vehicle, make_effects(values, num_envs), gravity=gravity, ceiling_height=CEILING)


def rest_state(num_envs: int = 1, **changes: list[float]) -> BodyState:
    state = random_state(num_envs)
    values = {
        "position": [0.0] * 3,
        "attitude": [0.0, 0, 0, 1],
        "lin_vel": [0.0] * 3,
        "ang_vel": [0.0] * 3,
        "rotor_speed": [0.0] * 4,
    }
    for name, row in {**values, **changes}.items():
        getattr(state, name)[:] = torch.tensor(row, dtype=F64)
    return state


def fall(model: Model, state: BodyState, span: float, steps: int) -> BodyState:
    return advance(model, INTEGRATORS["rk4"], SpeedControl(), state, state.rotor_speed, span / steps, steps)


def test_rotor_drag_slows_exponentially_per_body_axis() -> None:
    """m v' = -d v: v = v_0 exp(-d t / m) along each axis of a level body without gravity."""
    model = symmetric_model({"rotor_drag": {"dx": 0.3, "dy": 0.2, "dz": 0.1}}, gravity=0.0)
    end = fall(model, rest_state(lin_vel=[1.0, -2.0, 3.0]), 1.0, 100)
    rates = torch.tensor([0.3, 0.2, 0.1], dtype=F64) / 0.373
    torch.testing.assert_close(
        end.lin_vel[0], torch.tensor([1.0, -2.0, 3.0], dtype=F64) * torch.exp(-rates), atol=1e-9, rtol=0
    )


def test_rotor_drag_acts_in_body_axes() -> None:
    """Yawed by 90 degrees, a velocity along world x is along body -y and meets dy: f_body = +dy v / m on y."""
    model = symmetric_model({"rotor_drag": {"dx": 0.3, "dy": 0.2, "dz": 0.1}})
    yawed = quat_from_euler(torch.tensor([0.0, 0.0, torch.pi / 2], dtype=F64)).tolist()
    force = accelerations(model, rest_state(attitude=yawed, lin_vel=[1.0, 0.0, 0.0])).specific_force
    torch.testing.assert_close(force, torch.tensor([[0.0, 0.2 / 0.373, 0.0]], dtype=F64), atol=1e-12, rtol=0)


def test_quadratic_drag_scales_with_the_norm_of_the_velocity() -> None:
    """F_x = -d_x |v| v_x with v = (3, 4, 0): |v| = 5."""
    model = symmetric_model({"quadratic_drag": {"dx": 0.01, "dy": 0.02, "dz": 0.05}})
    force = accelerations(model, rest_state(lin_vel=[3.0, 4.0, 0.0])).specific_force * 0.373
    torch.testing.assert_close(force, torch.tensor([[-0.15, -0.4, 0.0]], dtype=F64), atol=1e-12, rtol=0)


def test_quadratic_drag_has_a_finite_gradient_at_rest() -> None:
    velocity = torch.zeros(1, 3, dtype=F64, requires_grad=True)
    model = symmetric_model({"quadratic_drag": {"dx": 0.01, "dy": 0.02, "dz": 0.05}})
    accelerations(model, replace(rest_state(), lin_vel=velocity)).specific_force.sum().backward()
    assert torch.isfinite(velocity.grad).all()


def test_thrust_coefficient_scales_thrust_and_drag_torque() -> None:
    speed = [1500.0, 1600.0, 1700.0, 1500.0]
    declared = accelerations(symmetric_model({}), rest_state(rotor_speed=speed))
    scaled = accelerations(symmetric_model({"thrust_coefficient": {"scale": 1.05}}), rest_state(rotor_speed=speed))
    torch.testing.assert_close(scaled.specific_force, 1.05 * declared.specific_force, atol=1e-12, rtol=0)
    torch.testing.assert_close(scaled.ang_acc, 1.05 * declared.ang_acc, atol=1e-9, rtol=1e-12)


def test_com_offset_forward_pitches_the_nose_down() -> None:
    """Centre of mass at +x: equal thrusts T push up behind it, nose down is +y: tau_y = +x T (r_y = -x, tau = r x F)."""
    offset, speed = 0.006, 1600.0
    robot = replace(
        ROBOTS.get("tinyprop"),
        body=replace(ROBOTS.get("tinyprop").body, inertia=((1e-3, 0, 0), (0, 2e-3, 0), (0, 0, 2.5e-3))),
    )
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, make_effects({"com_offset": {"x": offset, "y": 0.0, "z": 0.0}}, 1))
    thrust = 4 * robot.rotor.thrust_map[2] * speed**2
    result = accelerations(model, rest_state(rotor_speed=[speed] * 4))
    alpha = offset * thrust / 2e-3
    torch.testing.assert_close(result.ang_acc, torch.tensor([[0.0, alpha, 0.0]], dtype=F64), atol=1e-9, rtol=1e-9)
    lift = thrust / 0.373 + alpha * offset  # f_o = F/m - alpha x c, and (0, a, 0) x (c, 0, 0) = (0, 0, -a c)
    torch.testing.assert_close(result.specific_force, torch.tensor([[0.0, 0.0, lift]], dtype=F64), atol=1e-9, rtol=0)


def test_com_offset_is_the_same_as_a_vehicle_declared_with_that_centre() -> None:
    state = random_state(16)
    offset = {"com_offset": {"x": 0.01, "y": -0.02, "z": 0.03}}
    shifted = build_model(
        vehicle_from_config(asymmetric_robot(com=(0.0, 0.0, 0.0)), num_envs=16, dtype=F64), make_effects(offset, 16)
    )
    declared = build_model(vehicle_from_config(asymmetric_robot(), num_envs=16, dtype=F64))
    a, b = accelerations(shifted, state), accelerations(declared, state)
    torch.testing.assert_close(a.specific_force, b.specific_force, atol=1e-12, rtol=1e-12)
    torch.testing.assert_close(a.ang_acc, b.ang_acc, atol=1e-10, rtol=1e-12)


@pytest.mark.parametrize(("start", "end"), [(500.0, 1500.0), (1500.0, 500.0)])
def test_motor_time_constant_holds_for_rise_and_fall(start: float, end: float) -> None:
    model = symmetric_model({"motor_time_constant": {"tau": 0.08}})
    state, command = rest_state(rotor_speed=[start] * 4), torch.full((1, 4), end, dtype=F64)
    after = advance(model, INTEGRATORS["euler"], SpeedControl(), state, command, 0.01, 8)
    expected = end + (start - end) * torch.exp(torch.tensor(-1.0, dtype=F64))
    torch.testing.assert_close(after.rotor_speed, expected.expand(1, 4), atol=0, rtol=1e-12)


def test_constant_wind_carries_a_drifting_body() -> None:
    """At rest in wind w the drag is +d w; a body moving with the wind feels none."""
    values = {"rotor_drag": {"dx": 0.3, "dy": 0.2, "dz": 0.1}, "constant_wind": {"x": 2.0, "y": -1.0, "z": 0.5}}
    model = symmetric_model(values)
    at_rest = accelerations(model, rest_state()).specific_force * 0.373
    torch.testing.assert_close(at_rest, torch.tensor([[0.6, -0.2, 0.05]], dtype=F64), atol=1e-12, rtol=0)
    drifting = accelerations(model, rest_state(lin_vel=[2.0, -1.0, 0.5])).specific_force
    torch.testing.assert_close(drifting, torch.zeros(1, 3, dtype=F64), atol=1e-12, rtol=0)


def test_wind_without_drag_changes_nothing() -> None:
    state = random_state(8)
    a = accelerations(symmetric_model({"constant_wind": {"x": 5.0, "y": 0.0, "z": 0.0}}, 8), state)
    torch.testing.assert_close(a.specific_force, accelerations(symmetric_model({}, 8), state).specific_force)


def test_effects_differ_between_environments() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=2, dtype=F64)
    effect = EFFECTS.get("rotor_drag")
    params = torch.tensor([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], dtype=F64)
    force = accelerations(build_model(vehicle, [(effect, params)]), rest_state(2, lin_vel=[1.0, 0, 0])).specific_force
    torch.testing.assert_close(force[:, 0] * 0.373, torch.tensor([-0.1, -0.2], dtype=F64))


@pytest.mark.parametrize("name", EFFECTS.names())
def test_every_effect_states_what_it_is(name: str) -> None:
    effect = EFFECTS.get(name)
    assert effect.name == name
    assert effect.summary
    assert effect.excitation
    assert isinstance(effect, KINDS)
    neutral = effect.neutral(ROBOTS.get("tinyprop"))
    assert len(neutral) == len(effect.parameters)
    for value, parameter in zip(neutral, effect.parameters, strict=True):
        assert parameter.low <= value <= parameter.high
        assert parameter.unit
        assert parameter.scale > 0


@pytest.mark.parametrize("name", ON_RIGID)
def test_neutral_parameters_leave_a_symmetric_rotor_vehicle_as_declared(name: str) -> None:
    robot, state = ROBOTS.get("tinyprop"), random_state(16)
    effect = EFFECTS.get(name)
    values = dict(zip([p.name for p in effect.parameters], effect.neutral(robot), strict=True))
    with_effect, without = symmetric_model({name: values}, 16), symmetric_model({}, 16)
    command = state.rotor_speed * 1.1
    a, b = (advance(m, INTEGRATORS["rk4"], SpeedControl(), state, command, 0.01, 5) for m in (with_effect, without))
    for x, y in zip(a.tensors(), b.tensors(), strict=True):
        torch.testing.assert_close(x, y, atol=1e-12, rtol=1e-12)


def test_unknown_and_impossible_parameters_are_named() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'rotor_drag'"):
        make_effects({"rotor_drg": {}}, 1)
    with pytest.raises(ConfigError, match=r"rotor_drag: parameters \['dx'\] given, needs exactly \['dx', 'dy', 'dz'\]"):
        make_effects({"rotor_drag": {"dx": 0.1}}, 1)
    with pytest.raises(ConfigError, match=r"rotor_drag.dx = -1.0: must lie in \[0, 10\] N s/m"):
        make_effects({"rotor_drag": {"dx": -1.0, "dy": 0.0, "dz": 0.0}}, 1)
    with pytest.raises(ConfigError, match="nan"):
        make_effects({"rotor_drag": {"dx": float("nan"), "dy": 0.0, "dz": 0.0}}, 1)
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1, dtype=F64)
    with pytest.raises(ShapeError, match=r"shape \(2, 3\), expected \(1, 3\)"):
        build_model(vehicle, [(EFFECTS.get("rotor_drag"), torch.zeros(2, 3, dtype=F64))])
