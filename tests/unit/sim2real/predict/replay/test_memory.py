"""Effects with memory along measured flights: soft arms against closed forms, and one that only this file knows."""

from dataclasses import replace
from math import cos, hypot, pi
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from aerial_gym.physics import EFFECTS, vehicle_from_config
from aerial_gym.physics.effects.base import relax
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects, params_from_robot
from aerial_gym.sim2real.predict.replay.rotors import make_flight_track
from aerial_gym.sim2real.predict.rollout import WindowBatch
from aerial_gym.sim2real.predict.tolerances import Tolerances
from benchmarks.undeclared import make_case
from benchmarks.undeclared.sensors import NOISELESS
from tests.unit.sim2real.flat_flights import ROBOT, load_flight, make_predictor
from tests.unit.sim2real.one_rollout import roll_out
from tests.unit.sim2real.predict.test_scene import RATE, hover

Array = NDArray[np.float64]

G, THRUST, ARM = 9.81, 0.6 * 9.81 / 4.0, hypot(0.1, 0.1)
"""Gravity [m/s²], thrust of a rotor at hover [N] and distance of the hubs from the axis [m] of ``ROBOT``."""


@pytest.mark.parametrize("tau", [0.004, 0.05, 3.0])
def test_elements_are_followed_exactly_between_rows(tau: float) -> None:
    step, rng = 0.01, np.random.default_rng(0)
    rest = rng.normal(size=(120, 2))
    time = step * np.arange(120)
    start = np.array([0.3, -0.2])
    result = relax(rest, start, tau=tau, step=step)
    np.testing.assert_allclose(result[0], start, atol=1e-14)
    for column in range(2):
        course = [start[column]]
        for row in range(119):

            def motion(t: float, h: Array, row: int = row, column: int = column) -> Array:
                share = (t - time[row]) / step
                return ((1.0 - share) * rest[row, column] + share * rest[row + 1, column] - h) / tau

            solved = solve_ivp(motion, (time[row], time[row + 1]), [course[-1]], rtol=1e-9, atol=1e-12)
            course.append(solved.y[0, -1])
        np.testing.assert_allclose(result[:, column], course, atol=1e-6)


@pytest.mark.parametrize(("name", "tau"), [("joint_spring", 0.1), ("joint_creep", 0.8)])
def test_predictions_follow_the_arms(name: str, tau: float) -> None:
    """Rotors 1 and 2 on the right push 1 + 0.3 sin W t: their arms bend ``C l f0 (1 + 0.3 sin(W t - d) / sqrt(1 + W² tau²))``,
    ``tan d = W tau``, and push the vehicle to the left by ``f sin h / sqrt(2)`` each. Straight lines between rows: 3e-4."""
    compliance, hinge, turn = 0.5, 0.25, 2.0 * pi
    flight = hover("a", 5.0)
    time, sway = flight.time, np.zeros((400, 4))
    sway[:, :2] = 0.3
    flight = replace(flight, rotor_speed=flight.rotor_speed * np.sqrt(1.0 + sway * np.sin(turn * time)[:, None]))
    flights = [flight]
    predictor = make_predictor(flights)
    params = ModelParams(effects={name: np.array([compliance, tau, hinge])})
    result, rigid = (predictor.predict(p)[0][:, 1] for p in (params, ModelParams()))
    lag, less = np.arctan(turn * tau), 1.0 / hypot(1.0, turn * tau)
    at = predictor.times[0]
    rest = compliance * (1.0 - hinge) * ARM * THRUST
    push, still = THRUST * (1.0 + 0.3 * np.sin(turn * at)), THRUST * np.sin(rest)
    begun = less * np.sin(lag)  # off the steady course: whole turns have no mean
    bent = rest * (1.0 + 0.3 * (less * np.sin(turn * at - lag) + begun * np.exp(-at / tau)))
    expected = 2.0 * (push * np.sin(bent) - still) / np.sqrt(2.0) / 0.6
    np.testing.assert_allclose(result - rigid, expected, atol=3e-3 * np.abs(expected).max())


@pytest.mark.parametrize("speeds", ["measured", "commanded"])
def test_rollouts_begin_with_arms_as_the_log_bends_them(speeds: str) -> None:
    """In level hover arms rest bent, however slow: every window falls by ``g (1 - cos h) t²/2``, not only late ones."""
    flight = hover("a", 5.0)
    if speeds == "commanded":
        flight = replace(flight, rotor_command=flight.rotor_speed, rotor_speed=None)
    rest = 0.8 * 0.6 * ARM * THRUST
    params = ModelParams(effects={"joint_creep": np.array([0.8, 20.0, 0.4])})
    errors = roll_out(ROBOT, [flight], params, horizons=(0.5,))
    np.testing.assert_allclose(errors.velocity, G * (1.0 - cos(rest)) * 0.5, rtol=1e-6)


def test_rollouts_begin_with_arms_that_are_as_far_from_rest_as_a_deviation_says() -> None:
    """Unbent when the log begins, ``joint_rest`` off by -1 / 0.3; in hover ``h = rest (1 - exp(-t / tau))``. Thrust
    falls by ``1 - cos h``; the arms of a substep of 5 ms are those of its end."""
    flight, tau = hover("a", 1.0), 2.0
    names = Tolerances().names(4)
    unbent = np.zeros(len(names))
    unbent[names.index("joint_rest")] = -1.0 / Tolerances().joint_rest
    params = ModelParams(effects={"joint_creep": np.array([0.8, tau, 0.4])}, deviation=unbent)
    errors = roll_out(ROBOT, [flight], params, horizons=(0.1,))
    for late, sign in ((0.0, 1.0), (0.005, -1.0)):
        time = errors.windows.row[:, None] / RATE + np.linspace(0.0, 0.1, 201) + late
        angle = 0.8 * 0.6 * ARM * THRUST * (1.0 - np.exp(-time / tau))
        assert (sign * (errors.velocity[:, 0] - G * (1.0 - np.cos(angle)).mean(axis=1) * 0.1) > 0.0).all()


def test_rollouts_begin_with_arms_as_they_are_at_their_row() -> None:
    """Arms that creep up after a step of thrust at 1 s: ``1 - cos h`` of it is lost, h in the middle of each 0.1 s. In
    straight lines between rows the step comes half a row early, 5 ms of tau = 2 s: 0.3 % of the loss."""
    flight = hover("a", 5.0)
    more = np.where(flight.time >= 1.0, 1.44, 1.0)
    flight = replace(flight, rotor_speed=flight.rotor_speed * np.sqrt(more)[:, None])
    params, tau = ModelParams(effects={"joint_creep": np.array([0.8, 2.0, 0.4])}), 2.0
    errors = roll_out(ROBOT, [flight], params, horizons=(0.1,))
    bare = roll_out(ROBOT, [flight], ModelParams(), horizons=(0.1,))
    start = errors.windows.row / RATE
    late = start >= 1.0
    rest = 0.8 * 0.6 * ARM * THRUST
    angle = rest * (1.44 - 0.44 * np.exp(-(start + 0.05 - 1.0) / tau))
    lost = (bare.velocity - errors.velocity)[late, 0]  # both rise: 0.44 g more than the weight
    np.testing.assert_allclose(lost, 1.44 * G * (1.0 - np.cos(angle[late])) * 0.1, rtol=4e-3)


def test_arms_of_a_vehicle_that_stands_at_first_are_not_bent_by_its_flight() -> None:
    flight = hover("a", 5.0)
    on_ground = flight.time < 1.0
    speed = torch.from_numpy(np.where(on_ground, 0.2, 1.0)[:, None] * flight.rotor_speed)
    creep, vehicle = EFFECTS.get("joint_creep"), vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64)
    params = torch.tensor([[0.8, 2.0, 0.4]], dtype=torch.float64)
    rest = 0.8 * 0.6 * ARM * THRUST
    for stands, share in ((on_ground, 0.04), (None, 1.0)):
        result = creep.replay(make_flight_track(replace(flight, on_ground=stands), vehicle, speed, 1.0 / RATE), params)
        np.testing.assert_allclose(result[0], share * rest, rtol=1e-12)


def test_arms_that_have_only_begun_to_creep_are_a_deviation_within_the_tolerances() -> None:
    """Two thirds of the rest are missing at first, and fade with tau: so much thrust more is felt, ``g (cos h - cos h_f)``."""
    flights, tau, rest = [hover("a", 5.0)], 1.5, 0.8 * 0.6 * ARM * THRUST
    tolerances = Tolerances(joint_rest=1.0 / 3.0)
    predictor = make_predictor(flights, tolerances=tolerances)
    params = ModelParams(effects={"joint_creep": np.array([0.8, tau, 0.4])})
    deviation = np.zeros(predictor.num_tolerances)
    deviation[tolerances.names(4).index("joint_rest")] = -2.0
    begun, rested = (predictor.predict(p)[0][:, 2] for p in (replace(params, deviation=deviation), params))
    angle = rest * (1.0 - np.exp(-predictor.times[0] / tau) * 2.0 / 3.0)
    np.testing.assert_allclose(begun - rested, G * (np.cos(angle) - cos(rest)), atol=2e-3 * G * (1.0 - cos(rest)))
    rigid = [predictor.predict(ModelParams(deviation=moved))[0] for moved in (deviation, np.zeros_like(deviation))]
    np.testing.assert_array_equal(*rigid)


@pytest.mark.slow
def test_predictions_are_those_of_the_independent_plant(tmp_path: Path) -> None:
    """A flight without noise: of the specific force that rigid arms miss, rows and band leave less than 0.3 %."""
    hidden = {"joint_spring": {"compliance": 1.6, "tau": 0.04, "hinge": 0.4}}
    files = make_case(tmp_path, effects=hidden, seed=410, num_train=1, num_test=0, duration_s=2.0, noise=NOISELESS)
    robot = robot_by_name(files.robot)
    flights = [load_flight(files.train[0], robot, mapping=None, bandwidth=10.0)]
    predictor = make_predictor(flights, robot)
    declared = params_from_robot(robot)
    soft = declared.with_effect("joint_spring", np.array([1.6, 0.04, 0.4]))
    missed, left = (np.sqrt((predictor.residuals(p)[0][:, :6] ** 2).mean(axis=0)) for p in (declared, soft))
    assert (left[:3] < 0.003 * missed[:3]).all(), (left / missed).round(5)


@pytest.mark.parametrize("compliance", [0.4, 0.8])
def test_windows_of_one_batch_begin_each_with_the_arms_of_its_flight(compliance: float) -> None:
    """Two flights, one with twice the thrust in rotors 1 and 3 as in 2 and 4. After 0.1 s each has lost ``1 - cos h``
    of the thrust of each rotor."""
    still = hover("a", 5.0)
    uneven = np.array([4.0, 2.0, 4.0, 2.0]) / 3.0
    flights = [still, replace(still, name="b", rotor_speed=np.sqrt(uneven) * still.rotor_speed)]
    params = ModelParams(effects={"joint_creep": np.array([compliance, 30.0, 0.4])})
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64)
    windows = np.array([0, 0, 1, 1]), np.array([100, 200, 100, 200])
    run = WindowBatch(vehicle, expand_effects(params, 4), flights, *windows)
    ((_, state, _),) = run.simulate_steps(run.state_of_flight(0), {run.num_steps(0.1)})
    push = np.stack([np.ones(4), np.ones(4), uneven, uneven])
    angle = compliance * 0.6 * ARM * THRUST * push
    lost = (push * (1.0 - np.cos(angle))).mean(axis=1)
    np.testing.assert_allclose(state.lin_vel[:, 2], -0.1 * G * lost, rtol=1e-6)


def test_rollouts_take_the_errors_of_rotor_sensors_out_of_the_thrust() -> None:
    """Speeds that read 10 % too high bend no arm further."""
    flight = hover("a", 5.0)
    flight = replace(flight, rotor_speed=1.1 * flight.rotor_speed)
    effects = {"joint_creep": np.array([0.8, 20.0, 0.4]), "rotor_speed_scale": np.array([1.1])}
    errors = roll_out(ROBOT, [flight], ModelParams(effects=effects), horizons=(0.5,))
    np.testing.assert_allclose(errors.velocity, G * (1.0 - cos(0.8 * 0.6 * ARM * THRUST)) * 0.5, rtol=1e-6)
