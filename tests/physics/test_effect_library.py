"""Effects on rotors, inertia, air and sensors against closed forms, each with a sign.

The vehicle is tinyprop where nothing else is said: 0.373 kg, rotors at (+-0.16, +-0.16, 0) m in the plane of the centre of
mass, thrust along z. Rotors 1 to 4 are at (+,-), (-,-), (-,+), (+,+) and spin +, -, +, -.
"""

from dataclasses import replace
from math import cos, exp, sin

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, accelerations, advance, build_model, vehicle_from_config
from aerial_gym.physics.model import Model, check_effects
from aerial_gym.robots import ROBOTS
from tests.physics.test_effects import make_effects, rest_state
from tests.physics.test_rigid_body import SpeedControl
from tests.physics.vehicles import F64, asymmetric_robot, random_state

MASS, ARM, SPEED = 0.373, 0.16, 1600.0
INERTIA = (1.0e-3, 2.0e-3, 2.5e-3)
RADIUS = 0.04


def plain_robot() -> RobotCfg:
    """Return tinyprop with a diagonal inertia and a known propeller."""
    robot = ROBOTS.get("tinyprop")
    rows = tuple(tuple(INERTIA[i] if i == j else 0.0 for j in range(3)) for i in range(3))
    return replace(robot, body=replace(robot.body, inertia=rows), rotor=replace(robot.rotor, radius=RADIUS))


ROBOT = plain_robot()
THRUST = ROBOT.rotor.thrust_map[2] * SPEED**2
DRAG = 0.01 * THRUST


def make_model(values: dict[str, dict[str, float]], num_envs: int = 1, **options: float) -> Model:
    vehicle = vehicle_from_config(ROBOT, num_envs=num_envs, dtype=F64)
    return build_model(vehicle, make_effects(values, num_envs), **options)


def effect_wrench(values: dict[str, dict[str, float]], state: BodyState, **options: float) -> torch.Tensor:
    result = []
    for model in (make_model(values, **options), make_model({}, **options)):
        felt = accelerations(model, state)
        w = state.ang_vel
        inertia = model.vehicle.inertia[0]
        torque = inertia @ felt.ang_acc[0] + torch.linalg.cross(w[0], inertia @ w[0])
        result.append(torch.cat((felt.specific_force[0] * model.vehicle.mass[0], torque)))
    return result[0] - result[1]


def assert_wrench(results: torch.Tensor, expected: list[float], size: float = 1.0) -> None:
    torch.testing.assert_close(results, torch.tensor(expected, dtype=F64), atol=1e-11 * size, rtol=1e-9)


def hover_state(**changes: list[float]) -> BodyState:
    return rest_state(**{"rotor_speed": [SPEED] * 4, **changes})


def test_a_weak_motor_loses_thrust_and_drag_torque_where_it_is() -> None:
    """Rotor 2 at (-x, -y) with 80 %: F_z = -0.2 T, tau = r x F, and it no longer turns the body by +0.2 q (its spin is -1)."""
    result = effect_wrench({"weak_motor": {"motor": 2, "scale": 0.8}}, hover_state())
    lost = 0.2 * THRUST
    assert_wrench(result, [0.0, 0.0, -lost, ARM * lost, -ARM * lost, -0.2 * DRAG])


def test_a_torque_ratio_changes_yaw_alone() -> None:
    state = rest_state(rotor_speed=[SPEED, 0.0, SPEED, 0.0])
    assert_wrench(effect_wrench({"torque_ratio": {"scale": 1.3}}, state), [0, 0, 0, 0, 0, -0.3 * 2 * DRAG])


def test_a_payload_lowers_the_specific_force() -> None:
    for dm in (0.1, -0.1):
        result = accelerations(make_model({"payload_mass": {"dm": dm}}), hover_state())
        assert_wrench(result.specific_force[0], [0.0, 0.0, 4 * THRUST / (MASS + dm)])
        assert_wrench(result.ang_acc[0], [0.0, 0.0, 0.0], size=1e3)


def test_a_mass_taken_away_leaves_seven_tenths() -> None:
    result = accelerations(make_model({"payload_mass": {"dm": -5.0}}), hover_state())
    assert_wrench(result.specific_force[0], [0.0, 0.0, 4 * THRUST / (0.7 * MASS)])


@pytest.mark.parametrize(("axis", "speeds", "torque"), [
    (0, [0.0, 0.0, SPEED, SPEED], 2 * ARM * THRUST),
    (1, [0.0, SPEED, SPEED, 0.0], 2 * ARM * THRUST),
    (2, [0.0, SPEED, 0.0, SPEED], 2 * DRAG),
])  # fmt: skip
def test_an_inertia_error_divides_each_angular_acceleration(axis: int, speeds: list[float], torque: float) -> None:
    scale = (1.5, 0.8, 1.2)
    model = make_model({"inertia_error": dict(zip(("sx", "sy", "sz"), scale, strict=True))})
    result = accelerations(model, rest_state(rotor_speed=speeds)).ang_acc[0]
    expected = torch.zeros(3, dtype=F64)
    expected[axis] = torque / (INERTIA[axis] * scale[axis])
    torch.testing.assert_close(result, expected, rtol=1e-9, atol=1e-9)


def test_an_inertia_error_keeps_the_inertia_positive_definite() -> None:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    values = {"inertia_error": {"sx": 0.1, "sy": 10.0, "sz": 0.1}}
    inertia = build_model(vehicle, make_effects(values, 1)).vehicle.inertia[0]
    assert torch.linalg.eigvalsh(inertia).min() > 0
    torch.testing.assert_close(
        inertia.diagonal(), vehicle.inertia[0].diagonal() * torch.tensor([0.1, 10.0, 0.1]).to(F64)
    )


def test_a_motor_tilt_turns_the_thrust_of_one_rotor() -> None:
    """Roll by +a about x turns z towards -y, pitch by +a about y turns it towards +x; rotor 4 is at (+x, +y)."""
    a = 0.1
    rolled = effect_wrench({"motor_tilt": {"motor": 4, "roll": a, "pitch": 0.0}}, hover_state())[:3]
    assert_wrench(rolled, [0.0, -THRUST * sin(a), THRUST * (cos(a) - 1.0)])
    pitched = effect_wrench({"motor_tilt": {"motor": 4, "roll": 0.0, "pitch": a}}, hover_state())
    forward = THRUST * sin(a)
    assert_wrench(pitched[:3], [forward, 0.0, THRUST * (cos(a) - 1.0)])
    # r x F of the sideways part on z is -y F; the reaction of spin -1 is +q along the turned axis
    assert_wrench(pitched[5:], [-ARM * forward + DRAG * (cos(a) - 1.0)])


@pytest.mark.parametrize(("start", "end", "tau"), [(500.0, 1500.0, 0.02), (1500.0, 500.0, 0.08)])
def test_motor_asymmetry_lags_by_direction(start: float, end: float, tau: float) -> None:
    model = make_model({"motor_asymmetry": {"tau_up": 0.02, "tau_down": 0.08}})
    command = torch.full((1, 4), end, dtype=F64)
    after = advance(model, INTEGRATORS["rk4"], SpeedControl(), rest_state(rotor_speed=[start] * 4), command, 0.01, 4)
    assert_wrench(after.rotor_speed[0], [end + (start - end) * exp(-0.04 / tau)] * 4, size=1e3)


def test_flapping_holds_back_and_lifts_the_nose() -> None:
    """Forward at v: F_x = -kh sum(w) v; the hub moment lifts the nose, which is negative about y (x forward, y left)."""
    result = effect_wrench({"h_force_flapping": {"kh": 1e-5, "kf": 2e-6}}, hover_state(lin_vel=[3.0, 0.0, 0.0]))
    assert_wrench(result, [-1e-5 * 4 * SPEED * 3.0, 0.0, 0.0, 0.0, -2e-6 * 4 * SPEED * 3.0, 0.0])
    left = effect_wrench({"h_force_flapping": {"kh": 1e-5, "kf": 2e-6}}, hover_state(lin_vel=[0.0, 3.0, 0.0]))
    assert_wrench(left, [0.0, -1e-5 * 4 * SPEED * 3.0, 0.0, 2e-6 * 4 * SPEED * 3.0, 0.0, 0.0])
    climbing = effect_wrench({"h_force_flapping": {"kh": 1e-5, "kf": 2e-6}}, hover_state(lin_vel=[0.0, 0.0, 3.0]))
    assert_wrench(climbing, [0.0] * 6)


def test_flapping_damps_a_yaw_rate() -> None:
    """The hubs move by r_z x l: tau_z = -kh sum(w) (x² + y²) r."""
    result = effect_wrench({"h_force_flapping": {"kh": 1e-5, "kf": 0.0}}, hover_state(ang_vel=[0.0, 0.0, 2.0]))
    assert_wrench(result, [0.0, 0.0, 0.0, 0.0, 0.0, -1e-5 * 4 * SPEED * 2 * ARM**2 * 2.0])


def test_axial_inflow_takes_thrust_in_a_climb_and_damps_a_roll() -> None:
    ka = 2e-5
    climb = effect_wrench({"axial_inflow": {"ka": ka}}, hover_state(lin_vel=[1.0, -1.0, 3.0]))
    assert_wrench(climb, [0.0, 0.0, -ka * 4 * SPEED * 3.0, 0.0, 0.0, 0.0])
    roll = effect_wrench({"axial_inflow": {"ka": ka}}, hover_state(ang_vel=[2.0, 0.0, 0.0]))
    assert_wrench(roll, [0.0, 0.0, 0.0, -ka * 4 * SPEED * ARM**2 * 2.0, 0.0, 0.0])


def test_wind_from_below_adds_thrust() -> None:
    """Rising air, wind +z: the rotors move down through it."""
    result = effect_wrench(
        {"axial_inflow": {"ka": 2e-5}, "constant_wind": {"x": 0.0, "y": 0.0, "z": 2.0}}, hover_state()
    )
    assert_wrench(result, [0.0, 0.0, 2e-5 * 4 * SPEED * 2.0, 0.0, 0.0, 0.0])


def test_translational_lift_grows_with_the_square_of_the_sideways_speed() -> None:
    for velocity in ([3.0, 4.0, 0.0], [-3.0, -4.0, 2.0]):
        result = effect_wrench({"translational_lift": {"kt": 0.005}}, hover_state(lin_vel=velocity))
        assert_wrench(result, [0.0, 0.0, 4 * 0.005 * 25.0, 0.0, 0.0, 0.0])


def test_ground_effect_is_cheeseman_and_bennett() -> None:
    """One radius above the ground, k = 1: T / T_0 = 1 / (1 - 1/16) = 16/15."""
    result = effect_wrench({"ground_effect": {"k": 1.0}}, hover_state(position=[0.0, 0.0, RADIUS]))
    assert_wrench(result, [0.0, 0.0, 4 * THRUST / 15.0, 0.0, 0.0, 0.0])
    raised = effect_wrench(
        {"ground_effect": {"k": 1.0}}, hover_state(position=[0.0, 0.0, 2.0 + RADIUS]), ground_height=2.0
    )
    assert_wrench(raised, [0.0, 0.0, 4 * THRUST / 15.0, 0.0, 0.0, 0.0])


def test_ground_effect_stops_growing_half_a_radius_above_the_ground() -> None:
    for height in (0.5 * RADIUS, 0.0, -0.1):
        result = effect_wrench({"ground_effect": {"k": 1.0}}, hover_state(position=[0.0, 0.0, height]))
        assert_wrench(result[2:3], [4 * THRUST / 3.0])


def test_ground_effect_doubles_the_thrust_at_most() -> None:
    """For k = 30 at one radius the formula would have k (R / 4 h)² = 1.875, past its pole; the gain is one thrust more."""
    result = effect_wrench({"ground_effect": {"k": 30.0}}, hover_state(position=[0.0, 0.0, RADIUS]))
    assert_wrench(result[2:3], [4 * THRUST])


def test_ground_effect_raises_the_lower_side() -> None:
    """Rolled by +a the side at -y is lower; more thrust there rights it: tau_x < 0."""
    attitude = quat_from_euler(torch.tensor([0.2, 0.0, 0.0], dtype=F64)).tolist()
    result = effect_wrench({"ground_effect": {"k": 1.0}}, hover_state(position=[0.0, 0.0, 0.1], attitude=attitude))
    share = [(RADIUS / (4 * (0.1 + y * sin(0.2)))) ** 2 for y in (-ARM, ARM)]
    gains = [s / (1 - s) for s in share]
    assert_wrench(result[3:4], [2 * THRUST * ARM * (gains[1] - gains[0])])
    assert result[3] < 0


def test_ground_effect_asks_for_the_radius() -> None:
    robot = replace(ROBOTS.get("tinyprop"), effects={"ground_effect": {"k": 1.0}})
    robot = replace(robot, rotor=replace(robot.rotor, radius=None))
    with pytest.raises(ConfigError, match=r"ground_effect: the robot file must give rotor.radius"):
        check_effects(robot)


@pytest.mark.parametrize("motor", [0, 5, 1.5])
def test_a_rotor_that_is_not_there_is_refused(motor: float) -> None:
    robot = replace(ROBOTS.get("tinyprop"), effects={"weak_motor": {"motor": motor, "scale": 0.9}})
    with pytest.raises(ConfigError, match=r"weak_motor.motor = "):
        check_effects(robot)


def momentum(model: Model, state: BodyState, jr: float) -> torch.Tensor:
    """Return the angular momentum of body and rotors, world, (E, 3)."""
    axis = model.vehicle.rotor_spin.unsqueeze(-1) * model.vehicle.rotor_axis
    own = (model.vehicle.inertia @ state.ang_vel.unsqueeze(-1)).squeeze(-1)
    return quat_rotate(state.attitude, own + jr * (state.rotor_speed.unsqueeze(-1) * axis).sum(1))


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1.0), ("rk4", 4.0)])
def test_rotor_inertia_conserves_angular_momentum(integrator: str, order: float) -> None:
    """Rotors without thrust and drag that change speed in a tumbling body: the error falls with the method's order."""
    jr, robot = 2e-6, asymmetric_robot()
    still_air = replace(
        robot.rotor, thrust_map=(0.0, 0.0, 1e-30), torque_map=(0.0, 0.0, 0.0), thrust_range=(0.0, 1e-24)
    )
    vehicle = vehicle_from_config(replace(robot, rotor=still_air), num_envs=8, dtype=F64)
    model = build_model(vehicle, make_effects({"rotor_inertia": {"jr": jr}}, 8), gravity=0.0)
    start = random_state(8)
    command = start.rotor_speed * torch.tensor([1.5, 0.4, 1.2, 0.8], dtype=F64)
    errors = []
    for steps in (32, 64):
        end = advance(model, INTEGRATORS[integrator], SpeedControl(), start, command, 0.2 / steps, steps)
        errors.append(float((momentum(model, end, jr) - momentum(model, start, jr)).norm(dim=1).max()))
    assert 0.75 * 2**order < errors[0] / errors[1] < 1.5 * 2**order
    assert errors[1] < 1e-2 * float(momentum(model, start, jr).norm(dim=1).max())


def test_speeding_up_a_rotor_turns_the_body_the_other_way() -> None:
    """Rotors 1 and 3 (spin +1) faster: the body turns negatively about z, by what they gain, whatever the lag."""
    for integrator in ("euler", "rk4"):
        model = make_model({"rotor_inertia": {"jr": 1e-6}, "torque_ratio": {"scale": 0.1}}, gravity=0.0)
        silent = replace(model, vehicle=replace(model.vehicle, torque_map=0.0 * model.vehicle.torque_map))
        command = torch.tensor([[SPEED + 100.0, SPEED, SPEED + 100.0, SPEED]], dtype=F64)
        end = advance(silent, INTEGRATORS[integrator], SpeedControl(), hover_state(), command, 0.002, 10)
        gained = float((end.rotor_speed[0, 0] - SPEED) * 2 * 1e-6)
        # Runge-Kutta integrates an exponential: relative error (dt / tau)^4 / 2880 of Simpson's rule
        torch.testing.assert_close(end.ang_vel[0, 2], torch.tensor(-gained / INERTIA[2], dtype=F64), rtol=1e-8, atol=0)


def test_a_rotor_without_lag_reacts_over_one_step() -> None:
    model = make_model({"rotor_inertia": {"jr": 1e-6}})
    zero = torch.zeros_like(model.vehicle.time_constant_up)
    vehicle = replace(
        model.vehicle, time_constant_up=zero, time_constant_down=zero, torque_map=0.0 * model.vehicle.torque_map
    )
    command = torch.tensor([[SPEED + 100.0, SPEED, SPEED + 100.0, SPEED]], dtype=F64)
    for integrator in ("euler", "rk4"):
        end = advance(
            replace(model, vehicle=vehicle), INTEGRATORS[integrator], SpeedControl(), hover_state(), command, 0.01, 1
        )
        assert_wrench(end.ang_vel[0, 2:], [-200.0 * 1e-6 / INERTIA[2]])


def test_wind_shear_grows_by_its_power_over_the_ground() -> None:
    """At four times the height of reference and exponent 1/2 the wind is twice as strong; below the ground there is none."""
    values = {
        "rotor_drag": {"dx": 0.3, "dy": 0.2, "dz": 0.1},
        "wind_shear": {"x": 2.0, "y": -1.0, "z_ref": 2.0, "exponent": 0.5},
    }
    for height, gain in ((2.0, 1.0), (8.0, 2.0), (-1.0, 0.0)):
        force = accelerations(make_model(values), rest_state(position=[0.0, 0.0, height])).specific_force[0] * MASS
        assert_wrench(force, [gain * 0.3 * 2.0, gain * 0.2 * -1.0, 0.0])


def test_imu_bias_adds_to_both_sensors() -> None:
    effect = EFFECTS.get("imu_bias")
    params = torch.tensor([[0.1, -0.2, 0.3, 0.01, -0.02, 0.03]], dtype=F64)
    force, rate = effect.measure(torch.tensor([[1.0, 2.0, 9.81]], dtype=F64), torch.zeros(1, 3, dtype=F64), params)
    assert_wrench(force[0], [1.1, 1.8, 10.11])
    assert_wrench(rate[0], [0.01, -0.02, 0.03])


def test_an_imu_that_is_rolled_left_side_up_feels_gravity_on_its_y() -> None:
    """Sensors rolled by +a: their y axis points up by sin a, and so reads +g sin a at rest; yawed by +90°, x is body y."""
    effect, rest = EFFECTS.get("imu_misalignment"), torch.tensor([[0.0, 0.0, 9.81]], dtype=F64)
    force, _ = effect.measure(rest, rest, torch.tensor([[0.1, 0.0, 0.0]], dtype=F64))
    assert_wrench(force[0], [0.0, 9.81 * sin(0.1), 9.81 * cos(0.1)])
    force, rate = effect.measure(
        rest, torch.tensor([[1.0, 2.0, 3.0]], dtype=F64), torch.tensor([[0.0, 0.1, 0.0]], dtype=F64)
    )
    assert_wrench(force[0], [-9.81 * sin(0.1), 0.0, 9.81 * cos(0.1)])
    assert_wrench(rate[0], [cos(0.1) - 3 * sin(0.1), 2.0, sin(0.1) + 3 * cos(0.1)])
    _, rate = effect.measure(
        rest, torch.tensor([[0.0, 1.0, 0.0]], dtype=F64), torch.tensor([[0.0, 0.0, 0.5]], dtype=F64)
    )
    assert_wrench(rate[0], [sin(0.5), cos(0.5), 0.0])


def test_a_rotor_speed_scale_is_undone() -> None:
    effect, speed = EFFECTS.get("rotor_speed_scale"), torch.tensor([[100.0, 200.0]], dtype=F64)
    params = torch.tensor([[7.0]], dtype=F64)
    assert_wrench(effect.measure(speed, params)[0], [700.0, 1400.0], size=1e3)
    assert_wrench(effect.true_speed(effect.measure(speed, params), params)[0], [100.0, 200.0], size=1e3)


def test_a_motor_tilt_is_a_rotation_of_any_axis() -> None:
    """R = R_y(pitch) R_x(roll), as the quaternion of these Euler angles turns it."""
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    tilted = build_model(vehicle, make_effects({"motor_tilt": {"motor": 1, "roll": 0.3, "pitch": -0.4}}, 1)).vehicle
    turn = quat_from_euler(torch.tensor([[0.3, -0.4, 0.0]], dtype=F64))
    torch.testing.assert_close(tilted.rotor_axis[:, 0], quat_rotate(turn, vehicle.rotor_axis[:, 0]))
    torch.testing.assert_close(tilted.rotor_axis[:, 1:], vehicle.rotor_axis[:, 1:])
