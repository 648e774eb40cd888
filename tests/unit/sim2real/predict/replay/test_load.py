"""A load that hangs on the vehicle: its swing along a measured flight, in predictions and in rollouts."""

from dataclasses import replace
from math import cos, sin, sqrt

import numpy as np
import pytest
import torch

from aerial_gym.errors import ShapeError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics import (
    EFFECTS,
    INTEGRATORS,
    Model,
    accelerations,
    advance_remembering,
    build_model,
    vehicle_from_config,
)
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.physics.memory import make_memory, replace_memory
from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.replay.load import STEP_S, LoadReplay
from aerial_gym.sim2real.predict.replay.load_swing import integrate_swing
from aerial_gym.sim2real.predict.scene import finding_on_absent_data
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, random_state
from tests.unit.sim2real.flat_flights import ROBOT, make_predictor
from tests.unit.sim2real.one_rollout import roll_out
from tests.unit.sim2real.predict.test_scene import RATE, hover

G = 9.81


def payload_effect() -> LoadEffect:
    return EFFECTS.get("slung_payload")


def make_model(*params: float) -> Model:
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=F64)
    return build_model(vehicle, [(payload_effect(), torch.tensor([params], dtype=F64))])


@pytest.mark.parametrize(("length", "damping"), [(0.4, 0.0), (1.5, 0.0), (0.8, 0.06)])
def test_a_load_below_a_held_origin_swings_like_a_pendulum(length: float, damping: float) -> None:
    """x'' = -g / l x - d / m x': damped cosine; order 4 over 4 s, for w dt = 0.1: 4 w t / 120 (w dt)^4 = 7e-5."""
    mass, angle, steps = 0.1, 1e-4, 200
    start = torch.tensor([[sin(angle), 0.0, -cos(angle), 0.0, 0.0, 0.0]], dtype=F64)
    still = torch.zeros(2 * steps + 1, 1, 3, dtype=F64)
    params = torch.tensor([mass, length, damping], dtype=F64)
    result = integrate_swing(payload_effect(), params, start, still, step=STEP_S, gravity=G)[0][:, 0, 0]
    decay = 0.5 * damping / mass
    omega = sqrt(G / length - decay**2)
    time = STEP_S * torch.arange(steps + 1, dtype=F64)
    expected = (-decay * time).exp() * ((omega * time).cos() + decay / omega * (omega * time).sin()) * angle
    bound = 4.0 * omega * time[-1].item() / 120.0 * (omega * STEP_S) ** 4 + 1e-6
    assert (result - expected).abs().max().item() < bound * angle


def test_a_load_on_a_cone_stays_on_it_and_pulls_with_its_weight_over_the_cosine() -> None:
    """Conical pendulum: W² = g / (l cos a), T = m g / cos a, at 0.8 rad. Order 4: (W dt)^4 W t / 120 = 1e-5."""
    mass, length, angle, steps = 0.1, 0.7, 0.8, 200
    turn = sqrt(G / (length * cos(angle)))
    start = torch.tensor([[sin(angle), 0.0, -cos(angle), 0.0, turn * sin(angle), 0.0]], dtype=F64)
    still = torch.zeros(2 * steps + 1, 1, 3, dtype=F64)
    params = torch.tensor([mass, length, 0.0], dtype=F64)
    load, force = integrate_swing(payload_effect(), params, start, still, step=STEP_S, gravity=G)
    phase = turn * STEP_S * torch.arange(steps + 1, dtype=F64)
    cone = torch.stack(
        (sin(angle) * phase.cos(), sin(angle) * phase.sin(), torch.full_like(phase, -cos(angle))), dim=-1
    )
    torch.testing.assert_close(load[:, 0, :3], cone, atol=1e-5, rtol=0)
    torch.testing.assert_close(force[:, 0], mass * G / cos(angle) * cone, atol=5e-5, rtol=0)


def test_the_damping_of_a_followed_swing_acts_on_the_origin() -> None:
    """Force of the link and reaction ``d l n'``, across it; at the first instant."""
    start = torch.tensor([[0.0, 0.0, -1.0, 0.5, -0.2, 0.0]], dtype=F64)
    params = torch.tensor([0.1, 0.7, 0.3], dtype=F64)
    force = integrate_swing(payload_effect(), params, start, torch.zeros(3, 1, 3, dtype=F64), step=STEP_S, gravity=G)[1]
    pull = 0.1 * (G + 0.7 * (0.5**2 + 0.2**2))
    expected = torch.tensor([0.3 * 0.7 * 0.5, -0.3 * 0.7 * 0.2, -pull], dtype=F64)
    torch.testing.assert_close(force[0, 0], expected, atol=1e-12, rtol=0)


def test_a_swing_that_was_there_before_the_log_is_found_from_its_pull() -> None:
    """A held vehicle feels m g / M times the angles of the swing; what the weak prior takes is below 1e-3 of it."""
    mass, length = 0.15, 0.8
    time = np.arange(round(10.0 * RATE)) / RATE
    omega = sqrt(G / length)
    angles = np.column_stack((0.02 * np.cos(omega * time), -0.01 * np.sin(omega * time)))
    missed = np.column_stack((angles, np.full(time.size, -1.0))) * mass * G / 0.6
    place = np.zeros((time.size, 3))
    flight = replace(hover("a", 1.0), time=time, position=place, lin_vel=place)
    replay, model = LoadReplay([flight], [time]), make_model(mass, length, 0.0)
    result = replay.link_states(model, [missed]).numpy()
    np.testing.assert_allclose(result[:, :2], angles, atol=1e-4)
    np.testing.assert_allclose(replay.link_states(model)[:, :2], 0.0, atol=1e-9)


def test_a_load_that_does_not_show_is_taken_to_hang_still() -> None:
    time = np.arange(400) / RATE
    missed = np.tile([0.05, 0.0, 0.0], (400, 1))
    light = LoadReplay([hover("a", 1.0)], [time[:300]]).link_states(make_model(6e-4, 0.8, 0.0), [missed[:300]])
    assert light[:, :2].abs().max() < 0.1


def test_a_pendulum_that_steps_cannot_follow_has_no_direction() -> None:
    flight = hover("a", 1.0)
    start = np.tile([0.5, 0.0, 0.0], (flight.time.size, 1))
    shaken = replace(flight, lin_vel=start * np.sin(40.0 * flight.time)[:, None])
    load = LoadReplay([shaken], [flight.time[:300]]).link_states(make_model(0.05, 1e-6, 0.0))
    assert load.shape == (300, 6)
    assert load.isnan().all()


def test_swings_of_wrong_shape_and_effects_without_a_kernel_are_refused() -> None:
    params, start = torch.ones(3, dtype=F64), torch.zeros(2, 6, dtype=F64)
    for rows, origins in ((4, 2), (5, 3)):
        with pytest.raises(ShapeError, match="expected"):
            integrate_swing(
                payload_effect(), params, start, torch.zeros(rows, origins, 3, dtype=F64), step=STEP_S, gravity=G
            )


def test_a_load_follows_the_measured_motion_of_its_vehicle() -> None:
    """(X_load - X) / X = W² / (w² - W² + i W d / m) once settled, with w² = g / l and a vehicle that sways at W."""
    mass, length, damping, sway, size = 0.1, 1.0, 0.2, 2.0, 0.01
    time = np.arange(round(20.0 * RATE)) / RATE
    place, speed = np.zeros((time.size, 3)), np.zeros((time.size, 3))
    place[:, 0], speed[:, 0] = size * np.sin(sway * time), size * sway * np.cos(sway * time)
    flight = replace(hover("a", 1.0), time=time, position=place, lin_vel=speed)
    load = LoadReplay([flight], [time]).link_states(make_model(mass, length, damping))[:, 0].numpy()
    gain = sway**2 / (G / length - sway**2 + 1j * sway * damping / mass)
    expected = size / length * np.imag(gain * np.exp(1j * sway * time))
    late = time > 12.0  # the start has faded to exp(-12)
    np.testing.assert_allclose(load[late], expected[late], atol=2e-3 * size * abs(gain))


def test_a_load_starts_along_the_apparent_gravity_and_stays_there() -> None:
    rows = np.arange(400) / RATE
    flight = replace(hover("a", 1.0), lin_vel=np.column_stack((3.0 * rows, np.zeros(400), np.zeros(400))))
    load = LoadReplay([flight], [rows[:300]]).link_states(make_model(0.1, 0.7, 0.0)).numpy()
    lean = np.array([-3.0, 0.0, -G]) / np.hypot(3.0, G)
    np.testing.assert_allclose(load[:, :3], np.tile(lean, (300, 1)), atol=2e-3)


def test_a_still_load_is_felt_as_thrust_over_both_masses() -> None:
    """Rotors that carry M g with a load m below: f = M g / (M + m) on z, and no torque about a centre of mass above it."""
    flights = [hover("a", 1.0)]
    predictor = make_predictor(flights)
    result = predictor.predict(ModelParams(effects={"slung_payload": np.array([0.15, 0.8, 0.0])}))[0]
    np.testing.assert_allclose(result[:, :3], np.tile([0.0, 0.0, 0.6 * G / 0.75], (len(result), 1)), atol=1e-6)
    np.testing.assert_allclose(result[:, 3:6], 0.0, atol=1e-9)


def test_a_load_in_accelerations_is_that_of_the_simulator() -> None:
    """Against the change of velocity over 1e-5 s of the coupled motion that it integrates: error of order 1e-5 of 100 /s."""
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=8, dtype=F64)
    params = torch.tensor([0.3, 0.4, 0.02], dtype=F64).expand(8, -1)
    model, state = build_model(vehicle, [(payload_effect(), params)]), random_state(8)
    generator = torch.Generator().manual_seed(1)
    direction = torch.nn.functional.normalize(torch.randn(8, 3, dtype=F64, generator=generator), dim=-1)
    rate = torch.randn(8, 3, dtype=F64, generator=generator)
    load = torch.cat((direction, rate - (rate * direction).sum(-1, keepdim=True) * direction), dim=-1)
    result = accelerations(model, state, load=load)
    dt, law = 1e-5, SpeedControl()
    memory = replace_memory(model, make_memory(model, dt), {"slung_payload": load})
    after, _ = advance_remembering(model, INTEGRATORS["rk4"], law, state, state.rotor_speed, dt, 1, memory)
    turning = (after.ang_vel - state.ang_vel) / dt
    torch.testing.assert_close(result.ang_acc, turning, atol=2e-2, rtol=1e-3)
    felt = (after.lin_vel - state.lin_vel) / dt + torch.tensor([0.0, 0.0, G], dtype=F64)
    torch.testing.assert_close(result.specific_force, quat_rotate_inverse(state.attitude, felt), atol=2e-2, rtol=1e-3)


def test_a_rollout_carries_the_load_that_swings_in_the_flight() -> None:
    """Rotors that carry vehicle and load: it stays; without the load it would rise by g m / M t² / 2."""
    still = hover("a", 1.0)
    lifted = replace(still, rotor_speed=still.rotor_speed * sqrt(0.75 / 0.6))
    flights = [replace(lifted, name=name) for name in "ab"]
    carried = ModelParams(effects={"slung_payload": np.array([0.15, 0.8, 0.0])})
    errors = [roll_out(ROBOT, flights, params, horizons=(0.5,)).position for params in (carried, ModelParams())]
    assert errors[1] is not None
    assert errors[0].max() < 1e-6
    np.testing.assert_allclose(errors[1], G * 0.25 * 0.5**2 / 2.0, rtol=1e-6)


def test_a_rollout_starts_with_the_swing_of_its_row() -> None:
    """Beside a vehicle that speeds up at 3 m/s² the link leans back from the first step on, and pulls: -m a on x."""
    rows = np.arange(400) / RATE
    fast = np.column_stack((3.0 * rows, np.zeros(400), np.zeros(400)))
    flight = replace(hover("a", 1.0), lin_vel=fast, position=np.column_stack((1.5 * rows**2, 0 * rows, 0 * rows)))
    params = ModelParams(effects={"slung_payload": np.array([0.15, 0.8, 0.0])})
    errors = roll_out(ROBOT, [flight], params, horizons=(0.1,), given_attitude=True)
    lean = np.array([-3.0, 0.0, -G]) / np.hypot(3.0, G)
    # M a = F + M g + n m n . (g - a), and F = M g upwards: the load begins without a rate.
    force = np.array([0.0, 0.0, 0.6 * G])
    acc = np.linalg.solve(0.6 * np.eye(3) + 0.15 * np.outer(lean, lean), force) - np.array([0.0, 0.0, G])
    expected = np.linalg.norm(acc - np.array([3.0, 0.0, 0.0])) * 0.1
    np.testing.assert_allclose(errors.velocity[:, 0], expected, rtol=0.02)


def test_fits_of_a_load_start_at_several_lengths_and_those_of_a_rotor_at_each() -> None:
    robot = ROBOTS.get("tinyprop")
    lengths = [start[1] for start in payload_effect().starts(robot)]
    assert lengths == sorted(lengths)
    assert lengths[-1] / lengths[0] > 5.0
    assert [start[0] for start in EFFECTS.get("weak_motor").starts(robot)] == [1.0, 2.0, 3.0, 4.0]
    assert EFFECTS.get("gusts").starts(robot) == [EFFECTS.get("gusts").neutral(robot)]
    for start in payload_effect().starts(robot):
        assert all(low < value < high for value, (low, high) in zip(start, payload_effect().bounds(robot), strict=True))


def test_a_load_cannot_be_followed_without_velocity() -> None:
    bare = replace(hover("a", 1.0), lin_vel=None)
    expected = Finding("logs_lack", "slung_payload", {"flights": "a", "need": "lin_vel"})
    assert finding_on_absent_data("slung_payload", payload_effect().needs, [bare]) == expected


def test_a_rollout_starts_with_the_swing_that_the_log_shows() -> None:
    """A free vehicle M above a swinging m: ``x'' = m / M g b``, ``b = A cos w t``, ``w² = g / l (1 + m / M)``, in small
    angles. Rotors carry both weights, without torque. Terms of second order are A² = 4e-4 of g; the start is found to
    its prior."""
    mass, length, angle, vehicle = 0.15, 0.8, 0.02, 0.6
    omega = sqrt(G / length * (1.0 + mass / vehicle))
    time, zero = np.arange(round(8.0 * RATE)) / RATE, np.zeros(round(8.0 * RATE))
    pull = mass / vehicle * G * angle
    still = hover("a", 1.0)
    flight = replace(
        still,
        time=time,
        attitude=np.tile(still.attitude[:1], (time.size, 1)),
        ang_vel=np.tile(zero[:, None], 3),
        position=np.column_stack((pull / omega**2 * (1.0 - np.cos(omega * time)), zero, zero)),
        lin_vel=np.column_stack((pull / omega * np.sin(omega * time), zero, zero)),
        specific_force=np.column_stack((pull * np.cos(omega * time), zero, zero + G)),
        rotor_speed=np.tile(still.rotor_speed[:1], (time.size, 1)) * sqrt(0.75 / 0.6),
    )
    flights = [flight]
    predictor = make_predictor(flights)
    params = ModelParams(effects={"slung_payload": np.array([mass, length, 0.0])})
    links = predictor.load_links(params)
    assert predictor.load_links(ModelParams()) is None
    np.testing.assert_allclose(links[0].interpolate_state(time)[:, 0], angle * np.cos(omega * time), atol=0.05 * angle)
    errors = [roll_out(ROBOT, flights, params, links=result, horizons=(0.5,)).velocity for result in (links, None)]
    assert np.sqrt(np.mean(errors[0] ** 2)) < 0.1 * np.sqrt(np.mean(errors[1] ** 2))
