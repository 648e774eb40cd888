"""Rotors of all kinds against closed forms and an independent integrator: lag, maps, wrench."""

from dataclasses import replace
from math import exp, inf

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.control.allocation import Allocation, allocation_matrix
from aerial_gym.control.controllers import ThrustController
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, accelerations, advance, build_model, vehicle_from_config
from aerial_gym.physics.fused.dynamics import STAGES
from aerial_gym.physics.model import check_effects
from aerial_gym.physics.rotor_lag import CommandSwitch, DecayLag, follow_command, slew_limited_lag, stop_in_dead_band
from aerial_gym.physics.rotor_maps import POLYNOMIAL
from aerial_gym.physics.rotors import lag_speed, map_terms, rotor_thrust, rotor_torque, rotor_wrench, state_for_thrust
from aerial_gym.robots import ROBOTS
from tests.physics.rotor_types import FORCE, REVERSIBLE, three_type_robot, with_rotor
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, random_state, strong_effects

UP, DOWN, SLEW = 0.03, 0.05, 2e3


def step_lag(
    state: float, command: float, span: float, *, slew: float = SLEW, down: float = SLEW, steps: int = 1
) -> float:
    """Return the state after a span that is divided into steps."""
    x, c, *limits = (torch.full((1, 1), v, dtype=F64) for v in (state, command, UP, DOWN, slew, down))
    for _ in range(steps):
        x = slew_limited_lag(x, c, *limits, span / steps)
    return x.item()


def integrate_lag(state: float, command: float, span: float, *, slew: float, down: float) -> float:
    """Return the same from the differential equation, by an adaptive method that stops where the law has a kink."""

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        falls = x * (command - x) < 0.0
        most = np.where(falls, down, slew)
        return np.clip((command - x) / np.where(falls, DOWN, UP), -most, most)

    result = solve_ivp(rate, (0.0, span), [state], rtol=1e-10, atol=1e-9, max_step=span / 200.0)
    return float(result.y[0, -1])


@pytest.mark.parametrize(("slew", "down"), [(inf, inf), (4e3, 4e3), (300.0, 300.0), (inf, 2e3), (3e3, 900.0)])
@pytest.mark.parametrize(
    ("state", "command"), [(300.0, -400.0), (-50.0, 200.0), (-200.0, -20.0), (0.0, -90.0), (90.0, 0.0)]
)
def test_the_lag_solves_its_differential_equation(state: float, command: float, slew: float, down: float) -> None:
    """The closed form is what an adaptive integrator finds, to its tolerance across the kinks, and odd."""
    result = step_lag(state, command, 0.12, slew=slew, down=down)
    assert result == pytest.approx(
        integrate_lag(state, command, 0.12, slew=slew, down=down), abs=2e-4 * abs(command - state)
    )
    assert step_lag(-state, -command, 0.12, slew=slew, down=down) == pytest.approx(-result, rel=1e-12)


@pytest.mark.parametrize("span", [0.2, 0.003])
@pytest.mark.parametrize("command", [600.0, -250.0, 90.0, 300.0])
def test_the_lag_does_not_depend_on_the_division_into_steps(command: float, span: float) -> None:
    assert step_lag(350.0, command, span, steps=73) == pytest.approx(
        step_lag(350.0, command, span), rel=1e-12, abs=1e-10
    )


def test_gradients_pass_the_kinks() -> None:
    """Finite for a lag of zero, no slew limit, states and commands of every sign, and equal to differences elsewhere."""
    state = torch.tensor([[100.0, -40.0, 0.0, 70.0]], dtype=F64, requires_grad=True)
    command = torch.tensor([[-300.0, 500.0, 80.0, 70.0]], dtype=F64, requires_grad=True)
    up, down = torch.full((1, 4), UP, dtype=F64), torch.full((1, 4), DOWN, dtype=F64)
    slew = torch.tensor([[4e3, inf, 1e3, 1e3]], dtype=F64)
    slew_limited_lag(state, command, up * 0.0, down * 0.0, slew, slew, 0.01).sum().backward()
    assert state.grad.isfinite().all()
    assert command.grad.isfinite().all()
    inner = ((state[:, :3] + 5.0).detach().requires_grad_(), command[:, :3].detach().requires_grad_())
    limits = [rows[:, :3] for rows in (up, down, slew, 2.0 * slew)]
    assert torch.autograd.gradcheck(lambda x, c: slew_limited_lag(x, c, *limits, 0.013), inner)


def test_a_reversed_rotor_pulls_and_turns_the_other_way() -> None:
    """T(-w) = -(c1 w + c2 w²) with the reverse map; drag torque -0.015 T; the power torque times speed stays positive."""
    vehicle = vehicle_from_config(with_rotor(asymmetric_robot(), REVERSIBLE), num_envs=1, dtype=F64)
    speed = torch.tensor([[500.0, -500.0, -1.0, 0.0]], dtype=F64)
    thrust = rotor_thrust(vehicle, speed)
    expected = torch.tensor([[0.75, -(1e-4 * 500.0 + 2e-6 * 500.0**2), -(1e-4 + 2e-6), 0.0]], dtype=F64)
    torch.testing.assert_close(thrust, expected, rtol=1e-13, atol=0.0)
    torch.testing.assert_close(rotor_torque(vehicle, speed), 0.015 * expected, rtol=1e-13, atol=0.0)
    assert ((rotor_torque(vehicle, speed) * speed)[:, :3] > 0.0).all()
    torch.testing.assert_close(state_for_thrust(vehicle, thrust), speed, rtol=1e-12, atol=0.0)


def test_a_reversed_rotor_is_one_whose_axis_points_the_other_way() -> None:
    """With equal maps both ways, -w along +z accelerates the body as w along -z does, with every law that allows it."""
    rotor = replace(REVERSIBLE, reverse_thrust_map=None, dead_band=0.0, slew_rate=None)
    robot = with_rotor(asymmetric_robot(), rotor)
    flipped = tuple(replace(m, axis=tuple(-a for a in m.axis)) for m in robot.mounts.layout)
    turned = replace(robot, mounts=replace(robot.mounts, layout=flipped))
    names = [name for name in EFFECTS.names() if {"reversible"} <= set(EFFECTS.get(name).rotors)]
    assert {"axial_inflow", "h_force_flapping", "rotor_inertia"} <= set(names)
    state = random_state(8)
    backwards = replace(state, rotor_speed=-state.rotor_speed)
    spin_up = torch.full_like(state.rotor_speed, 30.0)
    wrenches = ("axial_inflow", "h_force_flapping", "rotor_inertia", "rotor_drag", "motor_tilt", "torque_ratio")
    for name in (*wrenches, "ground_effect", "ceiling_effect"):
        rows = [] if name == "motor_tilt" else strong_effects([name], robot, 8)  # a tilt turns with the axis
        here, there = (
            build_model(vehicle_from_config(r, num_envs=8, dtype=F64), rows, ceiling_height=1.0)
            for r in (robot, turned)
        )
        reverse, upside = accelerations(here, backwards, -spin_up), accelerations(there, state, spin_up)
        for one, other in zip(vars(reverse).values(), vars(upside).values(), strict=True):
            torch.testing.assert_close(
                one, other, rtol=1e-10, atol=1e-10, msg=lambda text, name=name: f"{name}: {text}"
            )


def test_force_mode_follows_its_thrust_with_its_own_lag() -> None:
    """Thrust towards 2 N: at 60 N/s until 1.2 N are left, then exp(-t / 0.02 s); the body feels just that along its axes."""
    robot = with_rotor(asymmetric_robot(com=(0.0, 0.0, 0.0)), FORCE)
    model = build_model(vehicle_from_config(robot, num_envs=1, dtype=F64))
    state = replace(random_state(1), rotor_speed=torch.zeros(1, 4, dtype=F64))
    control = ThrustController(model.vehicle, 9.81, ControlCfg())
    dt, steps = 0.001, 30
    after = advance(model, INTEGRATORS["euler"], control, state, torch.full((1, 4), 2.0, dtype=F64), dt, steps)
    corner = (2.0 - 60.0 * 0.02) / 60.0
    expected = 2.0 - 1.2 * exp(-(dt * steps - corner) / 0.02)
    torch.testing.assert_close(after.rotor_speed, torch.full((1, 4), expected, dtype=F64), rtol=1e-12, atol=0.0)
    felt = accelerations(model, after).specific_force * model.vehicle.mass
    axes = (model.vehicle.rotor_axis * expected).sum(1)
    torch.testing.assert_close(felt, axes, rtol=1e-12, atol=1e-12)


def test_commands_in_the_dead_band_stop_a_rotor() -> None:
    vehicle = vehicle_from_config(three_type_robot(), num_envs=1, dtype=F64)
    command = torch.tensor([[59.0, 59.0, 0.01, -59.9]], dtype=F64)
    assert stop_in_dead_band(vehicle, command).tolist() == [[0.0, 59.0, 0.01, 0.0]]
    assert stop_in_dead_band(vehicle, 1.1 * command)[0, 3].item() == pytest.approx(-65.89)


@pytest.mark.parametrize(
    ("name", "rotor", "words"),
    [("translational_lift", REVERSIBLE, "reversible"), ("axial_inflow", FORCE, "force mode")],
)
def test_an_effect_refuses_rotors_by_name(name: str, rotor, words: str) -> None:
    """Where the robot is checked, and where a model is built of vehicle and effects."""
    robot = with_rotor(asymmetric_robot(), rotor)
    effect = EFFECTS.get(name)
    values = {p.name: max(p.low, 0.01) for p in effect.parameters}
    with pytest.raises(ConfigError, match=f"effect {name}: its law does not hold for .*{words}"):
        check_effects(replace(robot, effects={name: values}, effects_source="test"))
    params = torch.tensor([list(values.values())], dtype=F64)
    with pytest.raises(ConfigError, match=words):
        build_model(vehicle_from_config(robot, num_envs=1, dtype=F64), [(effect, params)])


def test_a_robot_file_names_a_rotor_type_for_each_mount(tmp_path) -> None:
    """Written and read again it is the same; rows of the vehicle are those of the mounts' types."""
    robot = three_type_robot()
    (tmp_path / "robot.yaml").write_text(dump_yaml(robot))
    assert load_robot(tmp_path / "robot.yaml") == robot
    vehicle = vehicle_from_config(robot, num_envs=3, dtype=F64)
    assert vehicle.slew_rate[1].tolist() == [2e4, inf, 60.0, 2e4]
    assert vehicle.thrust_map[2, :, 1].tolist() == [0.0, 1e-4, 1.0, 0.0]
    assert vehicle.speed_low[0, 2].item() == -4.0
    assert vehicle.traits == {"reversible", "force", "slew", "dead_band"}
    assert not vehicle.plain
    assert vehicle_from_config(asymmetric_robot(), num_envs=1).plain


def test_the_octarotor_pushes_and_turns_alike_in_every_direction() -> None:
    """A A^T is 8/3 of the unit matrix for forces, and a multiple of it for torques, as Brescianini and D'Andrea designed it."""
    vehicle = vehicle_from_config(ROBOTS.get("omnidirectional_octarotor"), num_envs=1, dtype=F64)
    both = allocation_matrix(vehicle, 9.81)[0]
    product = both @ both.T
    torch.testing.assert_close(product[:3, :3], 8.0 / 3.0 * torch.eye(3, dtype=F64), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(product[3:, 3:], product[3, 3] * torch.eye(3, dtype=F64), atol=1e-6, rtol=0.0)


@pytest.mark.parametrize("axis", ["x", "z"])
def test_the_octarotor_hovers_in_any_attitude(axis: str) -> None:
    """On its side or upside down it carries its weight: half of its rotors push backwards."""
    turn = {"x": [1.0, 0.0, 0.0, 1.0], "z": [1.0, 0.0, 0.0, 0.0]}[axis]
    attitude = torch.tensor([turn], dtype=F64)
    attitude = attitude / attitude.norm()
    vehicle = vehicle_from_config(ROBOTS.get("omnidirectional_octarotor"), num_envs=1, dtype=F64)
    allocation, zero = Allocation(vehicle, 9.81), torch.zeros(1, 3, dtype=F64)
    force = quat_rotate_inverse(attitude, torch.tensor([[0.0, 0.0, 1.1 * 9.81]], dtype=F64))
    thrust = allocation.speed(allocation.thrust(torch.cat((force, zero), dim=-1)))
    assert (thrust < 0.0).sum() == 4
    start = BodyState(position=zero, attitude=attitude, lin_vel=zero, ang_vel=zero, rotor_speed=thrust)
    end = advance(build_model(vehicle), INTEGRATORS["rk4"], SpeedControl(), start, thrust, 0.01, 50)
    torch.testing.assert_close(end.position, zero, atol=1e-4, rtol=0.0)  # axes are given to six digits


@pytest.mark.parametrize("robot", [asymmetric_robot(), three_type_robot(), with_rotor(asymmetric_robot(), REVERSIBLE)])
def test_terms_times_coefficients_are_thrusts_and_drag_torques(robot: RobotCfg) -> None:
    vehicle = vehicle_from_config(robot, num_envs=7, dtype=F64)
    state = torch.linspace(-600.0, 800.0, 7 * vehicle.num_rotors, dtype=F64).view(7, -1)
    terms = map_terms(vehicle, state)
    assert len(terms) == (6 if "reversible" in vehicle.traits else 3)
    for law, name in ((rotor_thrust, "thrust_map"), (rotor_torque, "torque_map")):
        both = torch.cat((getattr(vehicle, name), getattr(vehicle, f"reverse_{name}")), dim=2)[..., : len(terms)]
        torch.testing.assert_close((terms.permute(1, 2, 0) * both).sum(2), law(vehicle, state), rtol=1e-12, atol=1e-12)


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


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_rotors_of_a_kernel_follow_the_exponential_at_a_late_command(integrator: str) -> None:
    """Speeds under a command that changes 1.3 ms after the start of a substep of 2 ms, rising and falling."""
    start, earlier, later, up, down, change, dt = 400.0, 900.0, 300.0, 0.05, 0.02, 1.3e-3, 2e-3
    stage = STAGES[integrator] * dt
    lag = DecayLag(*(torch.full((1, 1), exp(-stage / tau), dtype=F64) for tau in (up, down)))
    state, first, second, time = (
        torch.full((1, 1), value, dtype=F64) for value in (start, earlier, later, change / stage)
    )
    middle = earlier + (start - earlier) * exp(-change / up)
    expected = later + (middle - later) * exp(-(dt - change) / down)
    command = CommandSwitch(earlier=first, later=second, change=time)
    after = follow_command(lag, state, command, dt / stage)
    assert after.item() == pytest.approx(expected, rel=1e-13)
    assert lag.rate(state, first, first - state, dt / stage).item() / stage == pytest.approx(500.0 / up, rel=1e-12)
    assert lag.rate(state, second, second - state, dt / stage).item() / stage == pytest.approx(-100.0 / down, rel=1e-12)


def test_lag_without_time_constant_follows_at_once() -> None:
    zero = torch.zeros(1, 1, dtype=F64)
    seven, three = torch.full((1, 1), 7.0, dtype=F64), torch.full((1, 1), 3.0, dtype=F64)
    at_once = DecayLag(zero, zero)
    assert at_once.follow(three, seven, 2.0).item() == 7.0
    assert at_once.rate(three, seven, seven - three, 2.0).item() == 2.0
    out = lag_speed(torch.full((1, 1), 3.0, dtype=F64), torch.full((1, 1), 7.0, dtype=F64), zero, zero, 0.01)
    assert out.item() == 7.0


def test_speed_for_thrust_inverts_the_map() -> None:
    coefficients = torch.tensor([0.1, -2e-4, 3e-6], dtype=F64).expand(1, 5, 3)
    speed = torch.linspace(100.0, 2000.0, 5, dtype=F64).unsqueeze(0)
    thrust = POLYNOMIAL.evaluate(coefficients, speed)
    torch.testing.assert_close(thrust, 0.1 - 2e-4 * speed + 3e-6 * speed**2, atol=1e-12, rtol=0)
    torch.testing.assert_close(POLYNOMIAL.speed_for_thrust(coefficients, thrust), speed, atol=0, rtol=1e-12)


def test_thrust_below_the_vertex_gives_the_vertex_and_no_nan() -> None:
    coefficients = torch.tensor([0.0, -2e-4, 3e-6], dtype=F64).expand(1, 1, 3)
    speed = POLYNOMIAL.speed_for_thrust(coefficients, torch.full((1, 1), -5.0, dtype=F64))
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
