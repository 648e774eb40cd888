"""Commands on their way to the rotors in a replay of logs: lag, dead time and battery against closed forms."""

from dataclasses import replace
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import CubicSpline

from aerial_gym.config.robot import BatteryCfg, RobotCfg
from aerial_gym.errors import DataError, ShapeError
from aerial_gym.physics import EFFECTS, Model, build_model, vehicle_from_config
from aerial_gym.physics.effects import RotorSensorEffect
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.flight_replay import replay_flights
from aerial_gym.sim2real.identify.battery import robot_with_estimated_battery
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import fit_effects
from aerial_gym.sim2real.identify.stages import prepare_comparison
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.replay.rotor_lag import simulate_rotor_lag
from aerial_gym.sim2real.predict.replay.rotors import RotorReplay, replace_by_arriving_commands
from aerial_gym.sim2real.predict.rollout import WindowBatch
from aerial_gym.sim2real.predict.tolerances import Tolerances, VehicleForReplay, tolerances_after_move
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, uniform_flight
from tests.unit.sim2real.one_rollout import roll_out
from tests.unit.sim2real.predict.test_scene import RATE, hover

F64 = torch.float64
BATTERY = BatteryCfg(
    nominal_voltage=16.0, full_voltage=16.8, empty_voltage=13.2, internal_resistance=0.03, capacity=4000.0,
    source="test",
)  # fmt: skip
ROTOR_SPEEDS = [Channel(kind="rotor_speed", axis=str(number)) for number in (1, 2, 3, 4)]
POWERED = replace(ROBOT, battery=BATTERY)
TAU_UP, TAU_DOWN = 0.05, 0.03


def step_flight(folder: Path, *, rate: float, seconds: float, step_s: float = 0.5, high: float = 1100.0) -> Flight:
    """Return a flight whose command steps from 900 rad/s up at ``step_s`` and back half a second later, from rest at 900."""
    result = uniform_flight(flight(3, rate=rate, seconds=seconds), folder, f"{rate:g}")
    time = np.arange(result.num_rows) / rate
    command = np.where((time >= step_s - 1e-9) & (time < step_s + 0.5 - 1e-9), high, 900.0)[:, None].repeat(4, axis=1)
    return replace(result, rotor_command=command, rotor_speed=np.full_like(command, 900.0))


def up_and_down(time: np.ndarray, start: float, high: float = 1100.0) -> np.ndarray:
    """Return the speed [rad/s] of a step up from 900 at ``start`` and down half a second later, through the lag."""
    top = high + (900.0 - high) * np.exp(-0.5 / TAU_UP)
    rise = high + (900.0 - high) * np.exp(-np.maximum(time - start, 0.0) / TAU_UP)
    fall = 900.0 + (top - 900.0) * np.exp(-np.maximum(time - start - 0.5, 0.0) / TAU_DOWN)
    return np.where(time < start + 0.5, rise, fall)


def make_model(effects: dict[str, list[float]] | None = None, *, robot: RobotCfg = ROBOT) -> Model:
    rotor = replace(robot.rotor, time_constant_up=TAU_UP, time_constant_down=TAU_DOWN)
    vehicle = vehicle_from_config(replace(robot, rotor=rotor), num_envs=1, dtype=F64)
    return build_model(vehicle, [(EFFECTS.get(n), torch.tensor([p], dtype=F64)) for n, p in (effects or {}).items()])


def replay_speeds(results: Flight, model: Model) -> np.ndarray:
    return RotorReplay([results]).speeds(model, 0.0)[0]


def test_flights_of_several_rates_and_lengths_rise_and_fall_by_their_own_lag(tmp_path: Path) -> None:
    """``w_c + (w_0 - w_c) exp(-t / tau)`` with one constant up and another down; a flight without commands stays None."""
    flights = [step_flight(tmp_path, rate=rate, seconds=3.0 + rate / 200.0) for rate in (100.0, 200.0)]
    flights.insert(1, replace(flights[0], rotor_command=None))
    result = RotorReplay(flights).speeds(make_model(), 0.0)
    assert result[1] is None
    for number in (0, 2):
        speed, time = result[number], np.arange(flights[number].num_rows) / flights[number].rate
        assert speed.shape == (time.size, 4)
        np.testing.assert_allclose(speed[:, 3], up_and_down(time, 0.5), rtol=1e-12)


def test_rotors_without_lag_follow_at_once(tmp_path: Path) -> None:
    driven = step_flight(tmp_path, rate=100.0, seconds=3.0)
    model, none = make_model(), torch.zeros(1, 4, dtype=F64)
    quick = replace(model, vehicle=replace(model.vehicle, time_constant_up=none, time_constant_down=none))
    np.testing.assert_array_equal(replay_speeds(driven, quick)[1:], driven.rotor_command[:-1])


def test_tables_that_do_not_fit_are_refused() -> None:
    table, ends, one = torch.ones(5, 4, dtype=F64), torch.tensor([0, 6], dtype=torch.int32), torch.ones(1, dtype=F64)
    with pytest.raises(ShapeError, match=r"commands have shapes \(5, 4\) and \(5, 4\), expected \(6, 4\)"):
        simulate_rotor_lag(table[:1], table, table, one, ends=ends, step=one, tau_up=table[0], tau_down=table[0])


# commands in the unit of a rotor sensor


@pytest.mark.parametrize("by_speeds", [True, False])
def test_commands_that_measured_speeds_scale_share_the_error_of_their_sensors(by_speeds: bool, tmp_path: Path) -> None:
    """Scaled by readings of k w, the commands are k times the true ones: the readings of a linear lag hide k."""
    note = Finding("relative_commands_scaled", "", {"full": 2000.0, "unit": "rad/s", "by_speeds": by_speeds})
    driven = replace(step_flight(tmp_path, rate=100.0, seconds=3.0), notes=(note,))
    exact, scale = replay_speeds(driven, make_model()), 1.04
    model = make_model({"rotor_speed_scale": [scale]})
    read = RotorReplay([driven]).speeds(model, 0.0, model.effects[RotorSensorEffect])[0]
    hidden = np.allclose(read, exact, rtol=1e-12, atol=0.0)
    assert hidden == by_speeds
    off = VehicleForReplay(vehicle=make_model().vehicle, command_shift=0.0, joint_start=1.0)
    params = ModelParams(effects={"rotor_speed_scale": np.array([scale])})
    (arriving,) = replace_by_arriving_commands(off, [driven], params)
    true = driven.rotor_command / (scale if by_speeds else 1.0)
    np.testing.assert_allclose(arriving.rotor_command, true, rtol=1e-12)


def test_commands_share_only_the_mean_error_of_the_rotor_sensors(tmp_path: Path) -> None:
    """One line scales the commands of all rotors, so that one wrong sensor of four stays visible."""
    note = Finding("relative_commands_scaled", "", {"full": 2000.0, "unit": "rad/s", "by_speeds": True})
    driven = replace(step_flight(tmp_path, rate=100.0, seconds=3.0), notes=(note,))
    model = make_model({"tachometer_scale": [2.0, 1.04]})
    read = RotorReplay([driven]).speeds(model, 0.0, model.effects[RotorSensorEffect])[0]
    mean = (3.0 + 1.0 / 1.04) / 4.0
    np.testing.assert_allclose(read[45], 900.0 * mean * np.array([1.0, 1.04, 1.0, 1.0]), rtol=1e-4)


# dead time


@pytest.mark.parametrize("delay", [0.0, 0.0013, 0.005, 0.0132, 0.0999])
def test_a_delayed_step_arrives_that_much_later(delay: float, tmp_path: Path) -> None:
    """The closed form of the step, later: part of a row of 5 ms, one row, some rows and a part, and near the bound."""
    driven = step_flight(tmp_path, rate=200.0, seconds=4.0)
    speed = replay_speeds(driven, make_model({"actuation_delay": [delay]}))
    np.testing.assert_allclose(speed[:, 0], up_and_down(np.arange(800) / 200.0, 0.5 + delay), rtol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.0132])
def test_a_difference_of_microseconds_is_the_derivative_by_the_delay(delay: float, tmp_path: Path) -> None:
    """dw / d(delay) = (w_0 - w_c) / tau exp(-(t - t_0 - delay) / tau), forward by 10 us: error 1e-5 / 2 tau = 1e-4 of it."""
    driven = step_flight(tmp_path, rate=200.0, seconds=4.0)
    here, there = (
        replay_speeds(driven, make_model({"actuation_delay": [d]}))[105:195, 0] for d in (delay, delay + 1e-5)
    )
    time = np.arange(105, 195) / 200.0
    slope = -200.0 / TAU_UP * np.exp(-(time - 0.5 - delay) / TAU_UP)
    np.testing.assert_allclose((there - here) / 1e-5, slope, rtol=2e-4)


# battery


def test_a_falling_voltage_drags_the_speed_behind_it(tmp_path: Path) -> None:
    """Speeds u_k that fall by s each row, through the lag: ``w_k = u_k + e_k``, ``e_k = (1 - a^k) s / (1 - a)``."""
    still = step_flight(tmp_path, rate=200.0, seconds=4.0, high=900.0)
    voltage, gain = np.linspace(16.0, 14.0, still.num_rows), 0.6
    speed = replay_speeds(replace(still, battery=voltage), make_model({"battery_sag": [gain]}, robot=POWERED))
    target = 900.0 * (1.0 - gain * (1.0 - voltage / 16.0))
    fall, kept = target[0] - target[1], np.exp(-0.005 / TAU_DOWN)
    lead = fall * (1.0 - kept ** np.arange(still.num_rows)) / (1.0 - kept)
    np.testing.assert_allclose(speed[:, 2], target + lead, rtol=1e-12)


def test_the_voltage_acts_on_commands_when_they_arrive(tmp_path: Path) -> None:
    """A voltage that halves at 1.5 s acts at once, also where commands come 50 ms late: 900 to 450 through the lag."""
    still = step_flight(tmp_path, rate=200.0, seconds=4.0, high=900.0)
    time = np.arange(still.num_rows) / 200.0
    halved = replace(still, battery=np.where(time < 1.5 - 1e-9, 16.0, 8.0))
    speed = replay_speeds(halved, make_model({"actuation_delay": [0.05], "battery_sag": [1.0]}, robot=POWERED))
    expected = 450.0 + 450.0 * np.exp(-np.maximum(time - 1.5, 0.0) / TAU_DOWN)
    np.testing.assert_allclose(speed[:, 1], expected, rtol=1e-12)


def test_what_logs_lack_for_the_battery_is_said(tmp_path: Path) -> None:
    bare = step_flight(tmp_path, rate=100.0, seconds=3.0)
    flat = replace(bare, battery=np.full(bare.num_rows, 15.8))
    falling = replace(bare, battery=np.linspace(15.8, 15.0, bare.num_rows))
    refused = finding_on_untestable_effect("battery_sag", ROBOT, [falling])
    assert "the robot file must give battery" in refused.values["error"]
    without = Finding("logs_lack", "battery_sag", {"flights": "100", "need": "battery"})
    assert finding_on_untestable_effect("battery_sag", POWERED, [falling], [bare]) == without
    assert finding_on_untestable_effect("battery_sag", POWERED, [flat, flat]) == Finding(
        "voltage_too_steady", "battery_sag", {"share": 0.0}
    )
    assert finding_on_untestable_effect("battery_sag", POWERED, [flat, falling], [flat]) is None
    assert finding_on_untestable_effect("actuation_delay", ROBOT, [bare]) is None
    declared = replace(POWERED, effects={"battery_sag": {"gain": 0.3}})
    with pytest.raises(DataError, match="battery_sag: 100: without battery voltage"):
        replay_flights(declared, [bare], bandwidth=10.0)


# flights


def drain_battery(time: np.ndarray, speed: np.ndarray, full: float) -> np.ndarray:
    """Return the voltage under load: 0.05 Ohm, 1 mV per A s, ``V = E - r I`` and ``V I = P`` with the power of ROBOT."""
    power = (0.015 * 1.2e-6 * speed**3).sum(axis=1)
    open_voltage, voltage = full, np.empty(time.size)
    for row, watt in enumerate(power):
        voltage[row] = 0.5 * (open_voltage + np.sqrt(open_voltage**2 - 4.0 * 0.05 * watt))
        open_voltage -= 1e-3 * watt / voltage[row] * (time[1] - time[0])
    return voltage


def flight_from_commands(
    folder: Path, *, delay: float, gain: float, seed: int = 3, full: float = 0.0, volt_noise: float = 0.0
) -> Flight:
    """Return an exact flight at 400 rows per second with the commands that lead to its speeds. Inverted: ``c = (w + tau
    w') / factor`` at the middle of the span for which a command holds, ``delay`` after its row. The voltage is a
    made-up curve, or with ``full`` [V] that of a battery that is drained."""
    result = uniform_flight(flight(seed, rate=400.0, seconds=8.0), folder, f"flown{seed}")
    assert result.rotor_speed is not None
    arrives = result.time + delay + 0.5 / 400.0
    curve = CubicSpline(result.time, result.rotor_speed)
    wanted = curve(arrives) + 0.04 * curve(arrives, 1)
    own = 15.8 - 0.1 * result.time + 0.2 * np.sin(3.0 * result.time)
    volts = CubicSpline(result.time, drain_battery(result.time, result.rotor_speed, full) if full else own)
    noise = volt_noise * np.random.default_rng(seed).standard_normal(result.num_rows)
    factor = 1.0 - gain * (1.0 - volts(arrives) / 16.0)
    return replace(result, rotor_command=wanted / factor[:, None], battery=volts(result.time) + noise)


def test_a_replay_finds_delay_and_gain_under_noise_of_the_voltage(tmp_path: Path) -> None:
    """8.7 ms and 0.5, both at once, from neutral, with 20 mV on the voltage: to 0.05 ms and 1 %. Beside the tolerances,
    of which the hold of a command and a late rotor log make the same as a delay, to half a millisecond."""
    flights = [flight_from_commands(tmp_path, delay=0.0087, gain=0.5, seed=seed, volt_noise=0.02) for seed in (3, 4)]
    predictor = make_predictor(flights, POWERED, channels=ROTOR_SPEEDS)
    start = ModelParams(effects={"actuation_delay": np.zeros(1), "battery_sag": np.zeros(1)})
    tolerance = tolerance_jacobian(predictor, start)
    for tolerated, within in (([part[:, :, :0] for part in tolerance], 5e-5), (tolerance, 5e-4)):
        beside = NuisanceSums(predictor.times, [[part] for part in tolerated], np.ones(4))
        fit, _, _ = fit_effects(predictor, ("actuation_delay", "battery_sag"), start, beside)
        assert fit.params.effects["actuation_delay"][0] == pytest.approx(0.0087, abs=within)
        assert fit.params.effects["battery_sag"][0] == pytest.approx(0.5, rel=0.01)


def test_sensors_that_are_all_late_are_a_delay_of_the_commands(tmp_path: Path) -> None:
    """7.5 ms of one and of the other, three rows, between which no held command tells them apart: to 1e-3 of the
    change. Of rows that are thinned to the band too: a spline through these missed 2 %."""
    predictor = make_predictor([flight_from_commands(tmp_path, delay=0.0, gain=0.0)], channels=ROTOR_SPEEDS)
    all_late = np.array([2.5 * name.startswith("sensor_delay") for name in Tolerances().names(4)])
    delay = ModelParams(effects={"actuation_delay": np.array([0.0075])})
    models = (ModelParams(), ModelParams(deviation=all_late), delay)
    on_time, late, delayed = (predictor.predict(params)[0] for params in models)
    assert np.abs(late - on_time).max() > 1.0
    np.testing.assert_allclose(late, delayed, rtol=0.0, atol=1e-3 * np.abs(late - on_time).max())


def test_a_clock_of_moved_commands_is_a_delay_of_the_commands(tmp_path: Path) -> None:
    """A move of 10 ms, wrong by three quarters, does what 7.5 ms of dead time do, so that neither has evidence of its own."""
    lead = {"lead_ms": -10.0, "half_width_ms": 0.3}
    notes = [Finding("rotor_log_moved", "", {**lead, "with_commands": True})]
    moved = tolerances_after_move(Tolerances(), notes)
    assert moved == Tolerances(command_clock=0.01)
    alone = [Finding("rotor_log_moved", "", {**lead, "with_commands": False})]
    assert tolerances_after_move(Tolerances(), alone) == Tolerances()
    flights = [replace(flight_from_commands(tmp_path, delay=0.0, gain=0.0), notes=tuple(notes))]
    predictor = prepare_comparison(POWERED, flights, flights, bandwidth=10.0, tolerances=Tolerances()).train
    assert predictor.tolerances == moved
    predictor = make_predictor(flights, channels=ROTOR_SPEEDS, tolerances=moved)
    clock = np.array([0.75 * (name == "command_clock") for name in moved.names(4)])
    delay = ModelParams(effects={"actuation_delay": np.array([0.0075])})
    on_time, late, delayed = (predictor.predict(one)[0] for one in (ModelParams(), ModelParams(deviation=clock), delay))
    np.testing.assert_allclose(late, delayed, rtol=0.0, atol=1e-3 * np.abs(late - on_time).max())


def flight_with_scaled_commands(folder: Path, *, by_speeds: bool) -> Flight:
    """Return an exact flight whose commands were shares of the largest, scaled by the speeds or by the thrust."""
    note = Finding("relative_commands_scaled", "", {"full": 900.0, "unit": "rad/s", "by_speeds": by_speeds})
    flown = replace(flight_from_commands(folder, delay=0.0, gain=0.0), notes=(note,))
    return flown if by_speeds else replace(flown, rotor_speed=None)


def command_gain(factor: float) -> ModelParams:
    """Return the declared model with a factor on the commands."""
    return ModelParams(
        deviation=np.array([(name == "command_gain") * (factor - 1.0) / 0.15 for name in Tolerances().names(4)])
    )


@pytest.mark.parametrize("by_speeds", [False, True])
def test_commands_scaled_by_measurements_have_an_unknown_gain(by_speeds: bool, tmp_path: Path) -> None:
    flights = [flight_with_scaled_commands(tmp_path, by_speeds=by_speeds)]
    named = [replace(flights[0], notes=())]
    for part, std in ((flights, 0.15), (named, 0.0)):
        comparison = prepare_comparison(POWERED, part, part, bandwidth=10.0, tolerances=Tolerances())
        assert comparison.train.tolerances.command_gain == std


def test_a_gain_of_commands_without_rotor_speeds_is_a_thrust_coefficient(tmp_path: Path) -> None:
    """Neither has evidence of its own: 10 % more thrust at a speed, or at the root of 1.1 times the speed."""
    flights = [flight_with_scaled_commands(tmp_path, by_speeds=False)]
    predictor = prepare_comparison(POWERED, flights, flights, bandwidth=10.0, tolerances=Tolerances()).train
    models = (ModelParams(), command_gain(sqrt(1.1)), ModelParams(effects={"thrust_coefficient": np.array([1.1])}))
    as_declared, scaled, known = (predictor.predict(one)[0] for one in models)
    assert np.abs(known - as_declared).max() > 0.5
    np.testing.assert_allclose(scaled, known, atol=1e-6)


def test_a_gain_of_commands_beside_rotor_speeds_scales_their_prediction_alone(tmp_path: Path) -> None:
    """By 1 % from the start on, but for the first speed, which is measured and forgotten after 0.5 s of a lag of 0.04 s."""
    flights = [flight_with_scaled_commands(tmp_path, by_speeds=True)]
    predictor = prepare_comparison(POWERED, flights, flights, bandwidth=10.0, tolerances=Tolerances()).train
    as_declared, scaled = (predictor.predict(one)[0] for one in (ModelParams(), command_gain(1.01)))
    speeds = np.array([channel.kind == "rotor_speed" for channel in predictor.channels])
    assert speeds.sum() == 4
    np.testing.assert_allclose(scaled[:, speeds], 1.01 * as_declared[:, speeds], rtol=1e-5)
    np.testing.assert_array_equal(scaled[:, ~speeds], as_declared[:, ~speeds])


def test_a_robot_file_with_delay_and_battery_predicts_and_rolls_out(tmp_path: Path) -> None:
    """Open loop for 1 s from the commands: millimetres with the effects declared, far more without them."""
    result = flight_from_commands(tmp_path, delay=0.03, gain=1.0)
    robot = replace(POWERED, effects={"actuation_delay": {"delay": 0.03}, "battery_sag": {"gain": 1.0}})
    models = params_from_robot(robot), ModelParams()
    with_effects, without = (roll_out(robot, [result], params, horizons=(0.5, 1.0)) for params in models)
    assert with_effects.driven_by == "commands"
    assert with_effects.position.max() < 0.005
    assert np.median(without.position[:, 1]) > 20.0 * np.median(with_effects.position[:, 1])
    result = replay_flights(robot, [result], bandwidth=10.0)
    rms = {c.name: r.value for c, r in zip(result.evaluation.channels, result.evaluation.residual, strict=True)}
    assert max(value for name, value in rms.items() if name.startswith("rotor_speed")) < 0.5


def test_without_measured_rotor_speeds_the_delay_shows_in_the_forces(tmp_path: Path) -> None:
    result = replace(flight_from_commands(tmp_path, delay=0.03, gain=0.0), rotor_speed=None)
    predictor = make_predictor([result], POWERED)
    assert "rotor_speed" not in {channel.kind for channel in predictor.channels}
    left = [predictor.residuals(ModelParams(effects={"actuation_delay": np.array([d])}))[0] for d in (0.0, 0.03)]
    sizes = [np.sqrt((values[:, 2:5] ** 2).mean(axis=0)) for values in left]  # force z, angular acceleration x and y
    assert np.all(sizes[1] < 0.1 * sizes[0])


def test_a_battery_is_estimated_from_flights_that_drain_it(tmp_path: Path) -> None:
    """Resistance, fall per charge and nominal voltage of the battery that was flown, with 20 mV on the voltage. The
    nominal voltage to five times what that noise leaves in a mean of 9600 rows, 0.2 mV."""
    flights = [
        flight_from_commands(tmp_path, delay=0.0, gain=0.3, seed=seed, full=full, volt_noise=0.02)
        for seed, full in ((3, 16.6), (4, 16.3), (5, 16.1))
    ]
    battery = robot_with_estimated_battery(ROBOT, flights).battery
    slope = (battery.full_voltage - battery.empty_voltage) / battery.capacity
    assert battery.internal_resistance == pytest.approx(0.05, rel=0.1)
    assert slope == pytest.approx(1e-3, rel=0.1)
    assert battery.full_voltage == pytest.approx(16.6, abs=0.02)
    assert battery.nominal_voltage == pytest.approx(16.0, abs=0.001)
    assert "from the flights" in battery.source


def test_no_battery_is_made_up(tmp_path: Path) -> None:
    result = flight_from_commands(tmp_path, delay=0.0, gain=0.0)
    assert robot_with_estimated_battery(POWERED, [result]) == POWERED
    for poor in (replace(result, battery=None), replace(result, battery=np.full(result.num_rows, 16.0))):
        assert robot_with_estimated_battery(ROBOT, [result, poor] if poor.battery is None else [poor]) == ROBOT
    assert robot_with_estimated_battery(ROBOT, [replace(result, rotor_command=None)]) == ROBOT


def test_the_nominal_voltage_is_the_highest_seen_where_speeds_do_not_follow_it(tmp_path: Path) -> None:
    result = flight_from_commands(tmp_path, delay=0.0, gain=0.0)
    for flown in (result, replace(result, rotor_speed=None)):
        battery = robot_with_estimated_battery(ROBOT, [flown]).battery
        assert battery.nominal_voltage == pytest.approx(result.battery.reshape(16, 200).mean(axis=1).max(), rel=1e-5)
        assert "highest voltage seen" in battery.source


def test_commands_that_thrust_scales_reach_their_speed_at_the_mean_voltage(tmp_path: Path) -> None:
    """The scale is that of the mean thrust, so that a sag about the highest voltage would make the whole level wrong."""
    note = Finding("relative_commands_scaled", "", {"full": 2000.0, "unit": "rad/s", "by_speeds": False})
    flown = replace(flight_from_commands(tmp_path, delay=0.0, gain=0.3), rotor_speed=None, notes=(note,))
    battery = robot_with_estimated_battery(ROBOT, [flown]).battery
    assert battery.nominal_voltage == pytest.approx(flown.battery.mean(), rel=1e-5)


def test_windows_without_measured_speeds_begin_as_the_commands_have_led_the_rotors() -> None:
    """After a step at 1 s: ``w1 + (w0 - w1) exp(-t / tau)``, with each of two lags."""
    still = hover("a", 5.0)
    low, high = float(still.rotor_speed[0, 0]), 1.1 * float(still.rotor_speed[0, 0])
    command = np.where(still.time[:, None] >= 1.0, high, np.full((1, 4), low))
    flights = [replace(still, rotor_speed=None, rotor_command=command)]
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64)
    rows = np.array([100, 105, 120])
    for factor in (1.0, 2.0):
        lagging = replace(vehicle, time_constant_up=factor * vehicle.time_constant_up)
        run = WindowBatch(lagging, [], flights, np.zeros(3, dtype=int), rows)
        expected = high + (low - high) * np.exp(-(rows - 100) / RATE / (factor * 0.04))
        np.testing.assert_allclose(run.state_of_flight(0).rotor_speed, np.tile(expected[:, None], 4), rtol=1e-12)


def test_rollouts_hold_commands_as_a_deviation_says(tmp_path: Path) -> None:
    """``command_hold`` off by 1 / 0.3: every command holds a row earlier, as if its column were moved up by one."""
    result = flight_from_commands(tmp_path, delay=0.0, gain=0.0)
    early = replace(result, rotor_command=np.concatenate((result.rotor_command[1:], result.rotor_command[-1:])))
    names = Tolerances().names(4)
    shifted = np.zeros(len(names))
    shifted[names.index("command_hold")] = 1.0 / Tolerances().command_hold
    params = params_from_robot(ROBOT)
    cases = ((result, replace(params, deviation=shifted)), (early, params), (result, params))
    deviated, moved, held = (roll_out(ROBOT, [log], model, horizons=(0.5,)).velocity for log, model in cases)
    np.testing.assert_allclose(deviated, moved, rtol=1e-9)
    assert not np.allclose(deviated, held, rtol=1e-3)


def test_slew_rates_limit_the_replayed_speeds(tmp_path: Path) -> None:
    """A step of 200 rad/s: up at 1000 rad/s² until 50 are left, then exponentially; down at 500 rad/s² to the end."""
    driven = step_flight(tmp_path, rate=100.0, seconds=2.0)
    lag = {"time_constant_up": TAU_UP, "time_constant_down": TAU_DOWN}
    rotor = replace(ROBOT.rotor, **lag, slew_rate=1000.0, slew_rate_down=500.0)
    model = build_model(vehicle_from_config(replace(ROBOT, rotor=rotor), num_envs=1, dtype=F64))
    speed = replay_speeds(driven, model)[:, 2]
    assert speed[60] == pytest.approx(1000.0, rel=1e-12)
    assert speed[65] == pytest.approx(1050.0, rel=1e-12)
    assert speed[90] == pytest.approx(1100.0 - 50.0 * np.exp(-0.25 / TAU_UP), rel=1e-12)
    assert speed[110] == pytest.approx(speed[100] - 50.0, rel=1e-12)
    down = 0.5 - (speed[100] - 915.0) / 500.0
    assert speed[150] == pytest.approx(900.0 + 15.0 * np.exp(-down / TAU_DOWN), rel=1e-12)
    assert finding_on_untestable_effect("actuation_delay", replace(ROBOT, rotor=rotor), [driven]) is None


def test_commands_in_the_dead_band_stop_replayed_rotors(tmp_path: Path) -> None:
    """Below 1000 rad/s the command is no command: from 900 the rotors run down, and up again while it is 1100."""
    driven = step_flight(tmp_path, rate=100.0, seconds=2.0)
    rotor = replace(ROBOT.rotor, time_constant_up=TAU_UP, time_constant_down=TAU_DOWN, dead_band=1000.0)
    vehicle = vehicle_from_config(replace(ROBOT, rotor=rotor), num_envs=1, dtype=F64)
    speed = replay_speeds(driven, build_model(vehicle))[:, 0]
    assert speed[40] == pytest.approx(900.0 * np.exp(-0.4 / TAU_DOWN), rel=1e-10)
    assert speed[99] > 1090.0
