"""Predictions, rollouts and noise floors on exact flights from differential flatness."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from threading import current_thread

import numpy as np
import pandas as pd
import pytest
import torch
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.interop import one_thread
from aerial_gym.physics import vehicle_from_config
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import linearise_at_params, normal_equations_without_prior
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import Channel, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.noise_floor import mean_square_of_rounding, noise_floor, simulate_rounding
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import FARTHEST, find_windows, rollout_errors_of_models
from aerial_gym.sim2real.predict.rows.band_response import BandResponse, Columns
from aerial_gym.sim2real.predict.rows.batches import group_flights
from aerial_gym.sim2real.predict.rows.dataset import row_stride
from aerial_gym.sim2real.predict.rows.flight_batch import FlightBatch
from aerial_gym.sim2real.predict.tolerances import (
    Tolerances,
    sensor_errors,
    vehicle_for_replay,
    vehicle_with_deviations,
)
from tests.physics.vehicles import BATTERY
from tests.repetitions import frequent_values
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor, uniform_flight
from tests.unit.sim2real.one_rollout import roll_out
from tests.unit.sim2real.predict.test_scene import hover

BAND = 10.0


def load(folder: Path, **options: float) -> Flight:
    return uniform_flight(flight(3, **options), folder)


def residual(result: Flight, params: ModelParams) -> np.ndarray:
    return make_predictor([result]).residuals(params)[0]


@pytest.mark.parametrize(("flown", "effects"), [
    ({}, {}),
    ({"drag": 0.25}, {"rotor_drag": np.full(3, 0.25)}),
    ({"thrust_scale": 1.07}, {"thrust_coefficient": np.array([1.07])}),
])  # fmt: skip
def test_an_exact_flight_is_predicted_exactly_by_the_effect_that_was_flown(flown, effects, tmp_path) -> None:
    """Forces to 2e-3 of g, angular acceleration to 0.5 % of its size: what the filters leave at the ends."""
    results = load(tmp_path, **flown)
    left, without = (residual(results, ModelParams(effects=params)) for params in (effects, {}))
    assert np.abs(left[:, :3]).max() < 0.02
    assert np.abs(left[:, 3:]).max() < 0.05
    assert bool(effects) == (np.sqrt((without[:, :3] ** 2).mean(axis=0)).max() > 0.2)


def test_a_known_wind_is_flown_through_in_residuals_and_rollouts(tmp_path: Path) -> None:
    """Drag in a wind of 4 m/s: nothing is left where the wind is known; where not, a push of d |wind| / m and its path."""
    wind, drag = np.array([-3.2, 2.4, 0.0]), 0.15
    blind = load(tmp_path, drag=drag, wind=tuple(wind))
    told = replace(blind, wind=tuple(wind))
    params = params_from_robot(ROBOT).with_effect("rotor_drag", np.full(3, drag))
    assert np.abs(residual(told, params)[:, :3]).max() < 0.02
    push = drag * np.linalg.norm(wind) / ROBOT.body.mass
    left = np.linalg.norm(residual(blind, params)[:, :3], axis=1)
    np.testing.assert_allclose(left, push, atol=0.03)
    still = load(tmp_path)  # the wind of one flight is not that of another
    both = make_predictor([still, told])
    np.testing.assert_allclose(both.residuals(params)[1], residual(told, params), atol=1e-9)
    known, unknown = (roll_out(ROBOT, [f], params, horizons=(1.0,), given_attitude=True) for f in (told, blind))
    assert known.position.max() < 0.02
    rate = drag / ROBOT.body.mass
    expected = push / rate**2 * (rate + np.exp(-rate) - 1.0)  # of a push against linear drag, after 1 s
    np.testing.assert_allclose(unknown.position[:, 0], expected, atol=0.03)


def test_rows_on_the_ground_are_not_compared_nor_rolled_out(tmp_path: Path) -> None:
    """Rows within two periods of the band of a touch are left out, and windows of 1 s clear of it; others are as they were."""
    results = load(tmp_path)
    on_ground = np.zeros(results.num_rows, dtype=bool)
    on_ground[1000:1100] = True
    touched = replace(results, on_ground=on_ground)
    one, other = (make_predictor([f], channels=find_channels([results])) for f in (results, touched))
    near = 2.0 / BAND + 0.005  # and one row
    clear = (one.times[0] < 5.0 - near - 1e-9) | (one.times[0] > 5.495 + near + 1e-9)
    np.testing.assert_allclose(other.times[0], one.times[0][clear])
    np.testing.assert_allclose(other.residuals(ModelParams())[0], one.residuals(ModelParams())[0][clear], atol=1e-12)
    start = find_windows([touched], 1.0).row / results.rate
    assert not np.any((start > 3.99) & (start < 5.49))
    assert {4.6, 5.1} <= set((find_windows([results], 1.0).row / results.rate).tolist())


def test_the_noise_floor_is_that_of_flight_between_touches(tmp_path: Path) -> None:
    """A jolt in rows on the ground would raise it."""
    results = load(tmp_path, noise=1.0, seconds=20.0)
    on_ground = np.zeros(results.num_rows, dtype=bool)
    on_ground[1000:1050] = True
    jolted = results.specific_force.copy()
    jolted[on_ground] += np.random.default_rng(0).normal(0.0, 20.0, (50, 3))
    channels = find_channels([results])
    floors = {}
    cases = {"clean": (results.specific_force, None), "masked": (jolted, on_ground), "all": (jolted, None)}
    for name, (force, mask) in cases.items():
        flown = replace(results, specific_force=force, on_ground=mask)
        floors[name] = noise_floor(ROBOT, [flown], ModelParams(), channels, bandwidth=BAND)[:3]
    np.testing.assert_allclose(floors["masked"], floors["clean"], rtol=0.25)
    assert (floors["all"] > 3.0 * floors["clean"]).all()


def test_without_a_position_there_is_no_ground_nearby(tmp_path: Path) -> None:
    robot = replace(ROBOT, rotor=replace(ROBOT.rotor, radius=0.06))
    lost = replace(load(tmp_path), position=None)
    predictor = make_predictor([lost], robot)
    near = predictor.predict(ModelParams(effects={"ground_effect": np.array([3.0])}))[0]
    np.testing.assert_allclose(near, predictor.predict(ModelParams())[0], atol=1e-6)


def test_a_shifted_centre_of_mass_feels_the_measured_turning(tmp_path: Path) -> None:
    """Against ``f - alpha x c - w x (w x c)`` and ``J^-1 (r - c) x f`` with numbers of the log, c small."""
    results = load(tmp_path)
    shift = np.array([0.004, -0.003, 0.002])
    predictor = make_predictor([results])
    change = predictor.predict(ModelParams(effects={"com_offset": shift}))[0] - predictor.predict(ModelParams())[0]
    rows = np.round(predictor.times[0] * results.rate).astype(int)
    omega = results.ang_vel
    alpha = np.gradient(omega, 1.0 / results.rate, axis=0)
    lever = -np.cross(alpha, shift) - np.cross(omega, np.cross(omega, shift))
    assert np.abs(change[:, :3] - lever[rows]).max() < 0.1 * np.abs(lever[rows]).max()
    lift = (1.2e-6 * results.rotor_speed**2).sum(axis=1)[rows]
    torque = np.cross(-shift, np.stack((0 * lift, 0 * lift, lift), axis=1))
    expected = torque / np.diag(ROBOT.body.inertia)
    np.testing.assert_allclose(change[:, 3:6], expected, atol=0.02 * np.abs(expected).max())


def test_thinned_rows_predict_what_all_rows_do(tmp_path: Path) -> None:
    results = load(tmp_path, rate=500.0, noise=1.0)
    thin, full = (make_predictor([results], every_row=every) for every in (False, True))
    place = np.round((thin.times[0] - full.times[0][0]) * results.rate).astype(int)
    predicted = (each.predict(ModelParams())[0] for each in (thin, full))
    for some, every in (predicted, (thin.measured[0], full.measured[0])):
        np.testing.assert_allclose(some, every[place], atol=2e-3 * np.abs(every).max())


def test_the_jacobian_of_a_wrench_effect_is_its_regressor(tmp_path: Path) -> None:
    """d f / d (drag) = -v_body / m per unit, at any drag; scale 0.1 N s/m."""
    results = load(tmp_path)
    predictor = make_predictor([results])
    params = ModelParams(effects={"rotor_drag": np.full(3, 0.2)})
    jacobian = effect_jacobian(predictor, params, ("rotor_drag",), predictor.predict(params))[0]
    zero = predictor.predict(ModelParams())[0]
    one = predictor.predict(ModelParams(effects={"rotor_drag": np.array([0.1, 0.0, 0.0])}))[0]
    np.testing.assert_allclose(jacobian[:, :, 0], one - zero, atol=1e-8)


MODELS = {
    "declared": ModelParams(),
    "drag": ModelParams(effects={"rotor_drag": np.full(3, 0.2)}),
    "inflow": ModelParams(effects={"axial_inflow": np.array([1e-5]), "h_force_flapping": np.array([1e-5, 1e-6])}),
    "wind": ModelParams(effects={"rotor_drag": np.full(3, 0.2), "constant_wind": np.array([1.0, -2.0, 0.5])}),
    "other wind": ModelParams(effects={"rotor_drag": np.full(3, 0.2), "constant_wind": np.array([-1.0, 0.0, 0.5])}),
    "heavy": ModelParams(effects={"payload_mass": np.array([0.1])}),
    "off": ModelParams(
        effects={"rotor_drag": np.full(3, 0.2)}, deviation=np.linspace(-1.0, 1.0, len(Tolerances().names(4)))
    ),
    "turned sensor": ModelParams(effects={"imu_misalignment": np.array([0.02, 0.01, -0.03])}),
    "misread speeds": ModelParams(effects={"rotor_speed_scale": np.array([1.1])}),
}


def test_a_prediction_does_not_depend_on_the_earlier_models(tmp_path: Path) -> None:
    results = load(tmp_path)

    def new() -> Predictor:
        return make_predictor([results])

    alone = {name: new().predict(params)[0] for name, params in MODELS.items()}
    distinct = {values.tobytes() for values in alone.values()}
    assert len(distinct) == len(MODELS)
    same, order = new(), np.random.default_rng(0).integers(0, len(MODELS), 60)
    for name in (list(MODELS)[place] for place in order):
        np.testing.assert_array_equal(same.predict(MODELS[name])[0], alone[name], err_msg=name)


@pytest.mark.parametrize("effects", [{"rotor_drag": np.full(3, 0.25)}, {"slung_payload": np.array([0.1, 0.5, 0.02])}])
def test_a_deviation_is_predicted_alike_after_others_and_alone(effects: dict[str, np.ndarray], tmp_path: Path) -> None:
    """One whose effect on the motion is not in the key of the cached accelerations would be without effect."""
    results = load(tmp_path, drag=0.25)
    warm, cold = make_predictor([results]), make_predictor([results])
    for name in Tolerances().names(4):
        params = ModelParams(effects=effects, deviation=draw_deviations(**{name: 2.0}))
        cold.clear_caches()
        np.testing.assert_array_equal(warm.predict(params)[0], cold.predict(params)[0], err_msg=name)


def test_an_error_of_a_reading_does_not_move_the_vehicle_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor, before, moved = make_predictor([load(tmp_path)]), BandResponse.accelerations_in_band, list[str]()

    def accelerations(*args: object, **kwargs: object) -> object:
        moved.append(name)
        return before(*args, **kwargs)

    predictor.predict(ModelParams(deviation=draw_deviations(gyro_bias_y=1.0)))
    monkeypatch.setattr(BandResponse, "accelerations_in_band", accelerations)
    for name in (
        "gyro_bias_x",
        "acc_bias_z",
        "imu_place_x",
        "acc_scale_x",
        "attitude_scale_y",
        "mass",
    ):
        predictor.predict(ModelParams(deviation=draw_deviations(**{name: 1.0})))
    assert moved == ["mass"]


def test_neighbouring_flights_are_evaluated_together_up_to_a_number_of_rows() -> None:
    assert group_flights([6000, 10000, 1, 18000, 100, 200]) == [slice(0, 1), slice(1, 3), slice(3, 4), slice(4, 6)]
    assert group_flights([9000]) == group_flights([50000]) == [slice(0, 1)]
    assert group_flights([1000] * 16) == [slice(0, 16)]


def test_two_cores_get_batches_of_equal_size() -> None:
    """33 flights of 1,000 rows need three batches; the two cores would then wait for one of them."""
    assert group_flights([1000] * 33) == [slice(0, 8), slice(8, 16), slice(16, 25), slice(25, 33)]


def test_flights_are_predicted_alike_alone_and_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flights = load_tables(tmp_path, [flight(seed, seconds=6.0 + seed) for seed in range(3)])
    predictors = []
    for most in (1, 10**6):
        monkeypatch.setattr("aerial_gym.sim2real.predict.rows.batches.MOST_ROWS", most)
        predictors.append(make_predictor(flights))
    for name, params in MODELS.items():
        for alone, beside in zip(*(predictor.predict(params) for predictor in predictors), strict=True):
            np.testing.assert_allclose(alone, beside, rtol=1e-9, atol=1e-10, err_msg=name)
    for alone, beside in zip(*(predictor.times for predictor in predictors), strict=True):
        np.testing.assert_array_equal(alone, beside)


def test_batches_on_two_threads_are_predicted_as_on_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit, whatever was predicted before, and each batch on a thread of its own."""
    monkeypatch.setattr("aerial_gym.sim2real.predict.rows.batches.MOST_ROWS", 1)
    flights = load_tables(tmp_path, [flight(seed, seconds=2.1 + seed) for seed in range(2)])
    names, predict = set[str](), FlightBatch.predict

    def predict_on_known_thread(batch: FlightBatch, *arguments: object) -> list[Columns]:
        names.add(current_thread().name)
        return predict(batch, *arguments)

    monkeypatch.setattr(FlightBatch, "predict", predict_on_known_thread)
    results, before = [], torch.get_num_threads()
    for threads in (1, 2):
        torch.set_num_threads(threads)
        with one_thread():
            predictor, names = make_predictor(flights), set[str]()
            derivatives = [tolerance_jacobian(predictor, params) for params in MODELS.values()]
        results.append([part for parts in derivatives for part in parts])
        assert len(names) == threads
    torch.set_num_threads(before)
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


def test_the_kinematic_force_of_a_gyro_scale_is_not_that_of_the_last_one(tmp_path: Path) -> None:
    """The acceleration of an accelerometer beside the origin follows from the turning, which the gyro's scale changes."""
    results = load(tmp_path)
    predictor, fresh = make_predictor([results]), make_predictor([results])
    names = predictor.tolerances.names(4)
    off = np.array([2.0 * name.startswith("imu_place") for name in names])
    scaled = off + np.array([3.0 * name.startswith("gyro_scale") for name in names])
    predictor.predict(ModelParams(deviation=scaled))
    after, alone = (one.predict(ModelParams(deviation=off))[0] for one in (predictor, fresh))
    np.testing.assert_array_equal(after, alone)


def test_an_error_of_the_sensors_that_is_none_changes_no_channel(tmp_path: Path) -> None:
    results = load(tmp_path)
    predictor = make_predictor([results])
    for deviation in (None, np.linspace(-1.0, 1.0, predictor.num_tolerances)):
        params = ModelParams(deviation=deviation)
        neutral = params.with_effect("imu_misalignment", np.zeros(3))
        np.testing.assert_allclose(*(predictor.predict(p)[0] for p in (params, neutral)), atol=1e-10)


def test_rollouts_of_an_exact_flight_stay_on_it_and_find_the_error_of_a_wrong_mass(tmp_path: Path) -> None:
    """Open loop for 1 s: a millimetre and a milliradian. A vehicle that is 5 % heavier falls behind by g 5 % t² / 2."""
    results = load(tmp_path, rate=400.0)
    errors = roll_out(ROBOT, [results], ModelParams(), horizons=(0.1, 0.5, 1.0))
    assert errors.driven_by == "measured rotor speeds"
    assert errors.position[:, 2].max() < 1e-3
    assert errors.attitude[:, 2].max() < 1e-3
    heavy = replace(ROBOT, body=replace(ROBOT.body, mass=1.05 * ROBOT.body.mass))
    given = roll_out(heavy, [results], ModelParams(), horizons=(0.1, 0.5, 1.0), given_attitude=True)
    assert given.attitude is None
    assert np.median(given.position[:, 2]) == pytest.approx(0.5 * 9.81 * (1.0 - 1.0 / 1.05), rel=0.15)


def test_a_rollout_that_diverges_is_as_far_off_as_counts(tmp_path: Path) -> None:
    """Flapping 10,000 times too strong is too stiff for the steps: no number holds the rollout, and every error is finite."""
    stiff = ModelParams(effects={"h_force_flapping": np.array([0.1, 0.1])})
    errors = roll_out(ROBOT, [load(tmp_path)], stiff, horizons=(0.1, 1.0))
    assert (errors.position[:, 1] == FARTHEST).all()
    assert (errors.velocity[:, 1] == FARTHEST).all()
    assert (errors.attitude <= np.pi).all()


def test_rollouts_of_slow_logs_are_integrated_finely_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One step of 10 ms for each row of a log at 100 Hz, against eight: after half a second 2 mm apart at most."""
    results, heavy = load(tmp_path, rate=100.0), ModelParams(effects={"payload_mass": np.array([0.02])})
    usual = roll_out(ROBOT, [results], heavy, horizons=(0.5,))
    monkeypatch.setattr("aerial_gym.sim2real.predict.rollout.STEP_S", 0.00125)
    fine = roll_out(ROBOT, [results], heavy, horizons=(0.5,))
    np.testing.assert_allclose(usual.position, fine.position, atol=2e-3)


def test_rollouts_side_by_side_are_those_of_each_model_and_variant_alone(tmp_path: Path) -> None:
    results, variants = load(tmp_path), {"free": False, "given": True}
    com, wind, drag = np.array([0.01, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.full(3, 0.25)
    models = [
        ModelParams(),
        ModelParams(effects={"com_offset": com, "rotor_drag": drag}),
        ModelParams(effects={"constant_wind": wind, "rotor_drag": drag}),
    ]
    creeping = ModelParams(effects={"joint_creep": np.array([0.4, 30.0, 0.4])})
    for some in (models, [*models[:1], creeping]):
        options = {"links": [None] * len(some), "horizons": (0.1, 0.5)}
        together = rollout_errors_of_models(ROBOT, [results], some, variants, **options)
        for of_model, params in zip(together, some, strict=True):
            for variant, given in variants.items():
                alone = roll_out(ROBOT, [results], params, horizons=(0.1, 0.5), given_attitude=given)
                np.testing.assert_allclose(of_model[variant].position, alone.position, rtol=1e-9, atol=1e-12)
                np.testing.assert_allclose(of_model[variant].velocity, alone.velocity, rtol=1e-9, atol=1e-12)
            assert of_model["given"].attitude is None
        declared, *remaining = (of_model["free"].velocity for of_model in together)
        assert min(np.abs(other - declared).max() for other in remaining) > 1e-3
        if some is models:
            assert np.abs(together[1]["free"].velocity - together[1]["given"].velocity).max() > 0.01


def test_windows_cover_every_flight_and_fit_the_longest_horizon(tmp_path: Path) -> None:
    results = load(tmp_path)
    windows = find_windows([results, results], 2.0)
    assert set(windows.flight) == {0, 1}
    assert (windows.row.max() / results.rate) + 2.0 < results.time[-1]
    assert len(set(windows.cluster)) >= 4
    assert not set(windows.cluster[windows.flight == 0]) & set(windows.cluster[windows.flight == 1])


def test_flights_with_and_without_measured_rotors_do_not_mix(tmp_path: Path) -> None:
    results = load(tmp_path)
    commanded = replace(results, rotor_command=results.rotor_speed, rotor_speed=None)
    with pytest.raises(DataError, match="measured rotor speeds"):
        make_predictor([results, commanded])


def test_channels_are_what_every_flight_has(tmp_path: Path) -> None:
    results = load(tmp_path)
    kinds = ("specific_force", "angular_acceleration", "kinematic_force", "kinematic_rate")
    assert [channel.kind for channel in find_channels([results])] == [kind for kind in kinds for _ in range(3)]
    blind = replace(results, specific_force=None, accelerometer=False)
    assert {channel.kind for channel in find_channels([results, blind])} == {"angular_acceleration", "kinematic_rate"}
    with pytest.raises(DataError, match="no quantity in common"):
        find_channels([replace(blind, gyro=False)])


def test_missing_sensors_are_derived_or_left_out(tmp_path: Path) -> None:
    table = flight(4)
    (full,) = load_tables(tmp_path, [table])
    rest = [column for column in table if not column.startswith(("v_", "acc_", "omega_"))]
    bare = uniform_flight(table[[*rest, "omega_x", "omega_y", "omega_z"]], tmp_path)
    assert bare.lin_vel is None  # derived only by load_flights
    assert bare.notes == (Finding("velocity_unknown"),)
    poor = table[[*rest, "acc_x", "acc_y", "acc_z"]]
    (results,) = load_tables(tmp_path, [poor])
    assert not results.gyro
    inner = slice(100, -100)
    np.testing.assert_allclose(results.lin_vel[inner], full.lin_vel[inner], atol=0.01)
    np.testing.assert_allclose(results.ang_vel[inner], full.ang_vel[inner], atol=0.02)
    assert {"velocity_derived", "rates_derived"} <= {note.code for note in results.notes}
    forces = [column for column in table if not column.startswith("acc_")]
    (results,) = load_tables(tmp_path, [table[forces]])
    assert results.notes == (Finding("force_derived"),)


def test_tolerances_change_what_they_say() -> None:
    robot = replace(ROBOT, battery=BATTERY)
    vehicle, tolerances = vehicle_from_config(robot, num_envs=1, dtype=torch.float64), Tolerances()
    names = tolerances.names(4)
    deviation = torch.zeros(len(names), dtype=torch.float64)
    for name, size in (("mass", 2.0), ("thrust_3", -1.0), ("inertia_y", 1.0), ("com_z", 1.0), ("time_constant", 1.0)):
        deviation[names.index(name)] = size
    deviation[names.index("nominal_voltage")] = -1.0
    off = vehicle_with_deviations(vehicle, tolerances, deviation)
    assert float(off.mass[0]) == pytest.approx(0.6 * 1.006)
    assert float(off.thrust_map[0, 2, 2]) == pytest.approx(1.2e-6 * 0.996)
    assert float(off.torque_map[0, 2, 2]) == pytest.approx(1.2e-6 * 0.015 * 0.996)
    assert float(off.thrust_map[0, 0, 2]) == pytest.approx(1.2e-6)
    assert torch.diagonal(off.inertia[0]).tolist() == pytest.approx([2e-3, 2.4e-3 * 1.02, 4e-3])
    assert off.com[0].tolist() == pytest.approx([0.0, 0.0, 0.0003])
    assert off.time_constant_up[0].tolist() == pytest.approx([0.04 * 1.03] * 4)
    assert off.battery[0].tolist() == pytest.approx([BATTERY.nominal_voltage * 0.997, *vehicle.battery[0, 1:].tolist()])
    for name, size in (("acc_bias_y", 2.0), ("gyro_bias_x", -1.0), ("command_hold", 1.0), ("joint_rest", -2.0)):
        deviation[names.index(name)] = size
    logged = sensor_errors(tolerances, deviation)
    force, rate = logged.acc_bias, logged.gyro_bias
    assert force.tolist() == pytest.approx([0.0, 0.04, 0.0])
    assert rate.tolist() == pytest.approx([-0.002, 0.0, 0.0])
    replayed = vehicle_for_replay(vehicle, tolerances, deviation.numpy())
    assert replayed.command_shift == pytest.approx(0.3)
    assert replayed.joint_start == pytest.approx(0.4)


def test_a_load_that_hangs_at_the_centre_of_mass_exerts_no_torque(tmp_path: Path) -> None:
    """With hook and centre of mass 2 mm from the origin, all torques are those without a load; else its pull tells."""
    predictor = make_predictor([load(tmp_path)])
    load_params = {"slung_payload": np.array([0.1, 0.5, 0.02])}
    place = {"com_x": 2.0 / 0.3, "com_y": -2.0 / 0.3}
    hook = {"load_place_x": 0.2, "load_place_y": -0.2}
    torques = [
        predictor.predict(ModelParams(effects=effects, deviation=draw_deviations(**place, **more)))[0][:, 3:6]
        for effects, more in (({}, {}), (load_params, hook), (load_params, {}), ({}, hook))
    ]
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-9)
    np.testing.assert_array_equal(torques[3], torques[0])
    assert np.abs(torques[2] - torques[0]).max() > 0.1


def test_a_gyro_that_is_off_within_its_tolerance_shows_in_the_kinematic_rate_alone(tmp_path: Path) -> None:
    results = load(tmp_path)
    predictor = make_predictor([results])
    deviation = draw_deviations(gyro_bias_z=3.0)
    moved = predictor.predict(ModelParams(deviation=deviation))[0] - predictor.predict(ModelParams())[0]
    for place, channel in enumerate(predictor.channels):
        expected = 0.006 if channel.name == "kinematic_rate.z" else 0.0
        np.testing.assert_allclose(moved[:, place], expected, atol=1e-12, err_msg=channel.name)


def turn_attitude(table: pd.DataFrame, turn: Rotation, folder: Path) -> tuple[Flight, Flight]:
    """Return a flight as it was, and with its logged attitude turned against the body."""
    logged, columns = table.copy(), ["q_x", "q_y", "q_z", "q_w"]
    logged[columns] = (Rotation.from_quat(table[columns].to_numpy()) * turn).as_quat()
    return uniform_flight(table, folder, "aligned"), uniform_flight(logged, folder, "off")


def two_and_one() -> np.ndarray:
    """Return the tolerance parameters that turn such a log back by 0.02 rad about y and -0.01 rad about z."""
    return draw_deviations(attitude_y=2.0, attitude_z=-1.0)


LATE = {"rotors": ("rotor_",), "acc": ("acc_",), "gyro": ("omega_",), "attitude": ("q_", "p_"), "velocity": ("v_",)}
"""Columns of what may be late by itself."""


def delay_columns(table: pd.DataFrame, label: str, seconds: float) -> pd.DataFrame:
    """Return a log in which some columns are so many seconds late."""
    results, time = table.copy(), table["t"].to_numpy()
    for name in (name for name in table if str(name).startswith(LATE[label])):
        results[name] = CubicSpline(time, table[name].to_numpy())(time - seconds)
    return results


def draw_deviations(**sizes: float) -> np.ndarray:
    """Return some deviations of a quadrotor, in standard deviations."""
    names = Tolerances().names(4)
    return np.array([sizes.get(name, 0.0) for name in names])


@pytest.mark.parametrize("accelerometer", [True, False])
@pytest.mark.parametrize("label", LATE)
def test_a_sensor_that_is_late_within_its_tolerance_is_put_back(label, accelerometer, tmp_path) -> None:
    """6 ms, two deviations, leave what the log on one clock does, but 10 %; of each sensor, with drag in a wind."""
    table = flight(3, drag=0.6, wind=(2.0, -1.0, 0.5))
    if not accelerometer:
        table = table.drop(columns=["acc_x", "acc_y", "acc_z"])
    params = ModelParams(effects={"rotor_drag": np.full(3, 0.6), "constant_wind": np.array([2.0, -1.0, 0.5])})
    on_time, late = (
        uniform_flight(log, tmp_path, name)
        for name, log in (("on_time", table), ("late", delay_columns(table, label, 0.006)))
    )
    as_was, moved = residual(on_time, params), residual(late, params)
    back = residual(late, replace(params, deviation=draw_deviations(**{f"sensor_delay_{label}": 2.0})))
    left = np.sqrt(np.mean((back - as_was) ** 2, axis=0))
    off = np.sqrt(np.mean((moved - as_was) ** 2, axis=0))
    assert off.max() > 0.01 or (label == "acc" and not accelerometer)
    np.testing.assert_array_less(left, 2e-3 + 0.1 * off)


def test_the_scale_and_the_place_of_an_accelerometer_within_its_tolerances_are_put_back(tmp_path: Path) -> None:
    """1 % along y and -0.5 % along z; 1 cm ahead, 5 mm below: forces as they were, and nothing else is touched."""
    table = flight(3)
    results = uniform_flight(table, tmp_path, "a")
    place, scale = np.array([0.01, 0.0, -0.005]), np.array([0.0, 0.01, -0.005])
    rate = results.ang_vel
    turning = lowpass(rate, results.rate, 40.0, derivative=True)
    felt = results.specific_force + np.cross(turning, place) + np.cross(rate, np.cross(rate, place))
    kind_of = [channel.kind for channel in find_channels([results])]
    forces, implied = (
        [k for k, kind in enumerate(kind_of) if kind == f"{name}_force"] for name in ("specific", "kinematic")
    )
    as_was = residual(results, ModelParams())
    kinds = forces + implied  # both are compared with the accelerometer
    for read, sizes in (
        (felt, {"imu_place_x": 2.0, "imu_place_z": -1.0}),
        ((1.0 + scale) * results.specific_force, {"acc_scale_y": 2.0, "acc_scale_z": -1.0}),
    ):
        off = replace(results, specific_force=read)
        moved, back = residual(off, ModelParams()), residual(off, ModelParams(deviation=draw_deviations(**sizes)))
        other_kinds = [k for k in range(len(kind_of)) if k not in kinds]
        assert np.abs(moved - as_was)[:, kinds].max() > 0.02
        assert np.abs(back - as_was)[:, kinds].max() < 0.05 * np.abs(moved - as_was)[:, kinds].max()
        if read is felt:
            body = replace(ROBOT.body, accelerometer=(0.01, 0.0, -0.005))
            at_place = make_predictor([off], robot=replace(ROBOT, body=body)).residuals(ModelParams())[0]
            np.testing.assert_allclose(at_place, back, atol=1e-12)
            same_point = draw_deviations(**sizes, velocity_place_x=2.0, velocity_place_z=-1.0)
            together = residual(off, ModelParams(deviation=same_point))
            np.testing.assert_allclose(together[:, implied], moved[:, implied], atol=1e-12)
            np.testing.assert_array_equal(together[:, forces], back[:, forces])
        unread = residual(results, ModelParams(deviation=draw_deviations(**sizes)))
        np.testing.assert_array_equal(unread[:, other_kinds], as_was[:, other_kinds])


def test_the_swing_of_a_load_is_found_wherever_the_accelerometer_is(tmp_path: Path) -> None:
    """1 cm above the origin and with a scale of 1 %, within their tolerances: the link starts as with an exact reading."""
    results, place = uniform_flight(flight(3), tmp_path, "a"), np.array([0.0, 0.0, 0.01])
    rate, turning = results.ang_vel, lowpass(results.ang_vel, results.rate, 40.0, derivative=True)
    felt = results.specific_force + np.cross(turning, place) + np.cross(rate, np.cross(rate, place))
    off = replace(results, specific_force=felt * (1.0, 1.01, 1.0))
    effects = {"slung_payload": np.array([0.05, 0.7, 0.01])}
    sizes = draw_deviations(imu_place_z=2.0, acc_scale_y=2.0)
    exact, moved, back = (
        make_predictor([log]).load_links(ModelParams(effects=effects, deviation=deviation))[0].load
        for log, deviation in ((results, None), (off, None), (off, sizes))
    )
    assert np.abs(moved - exact).max() > 1e-3
    assert np.abs(back - exact).max() < 0.05 * np.abs(moved - exact).max()


def test_a_derived_force_is_that_of_the_point_whose_velocity_is_logged(tmp_path: Path) -> None:
    """Without an accelerometer, a velocity logged 1 cm ahead and 5 mm below the origin adds that point's lever arm."""
    table, place = flight(3).drop(columns=["acc_x", "acc_y", "acc_z"]), np.array([0.01, 0.0, -0.005])
    moved = table.copy()
    rate = table[[f"omega_{axis}" for axis in "xyz"]].to_numpy()
    attitude = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
    moved[["v_x", "v_y", "v_z"]] += attitude.apply(np.cross(rate, place))
    origin, point = (residual(uniform_flight(t, tmp_path, n), ModelParams()) for n, t in (("a", table), ("b", moved)))
    sizes = draw_deviations(velocity_place_x=2.0, velocity_place_z=-1.0)
    back = residual(uniform_flight(moved, tmp_path, "c"), ModelParams(deviation=sizes))
    assert np.abs(point - origin)[:, :3].max() > 0.05
    assert np.abs(back - origin)[:, :3].max() < 0.05 * np.abs(point - origin)[:, :3].max()
    np.testing.assert_array_equal(back[:, 3:], point[:, 3:])


def test_air_drag_is_that_of_the_origin_where_the_velocity_of_another_point_is_logged(tmp_path: Path) -> None:
    """1 cm ahead and 5 mm below: else a shifted centre of mass seems to explain its drag."""
    table, place = flight(3), np.array([0.01, 0.0, -0.005])
    moved = table.copy()
    rate = table[[f"omega_{axis}" for axis in "xyz"]].to_numpy()
    attitude = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
    moved[["v_x", "v_y", "v_z"]] += attitude.apply(np.cross(rate, place))
    params = ModelParams(effects={"rotor_drag": np.full(3, 3.0)})
    origin, point = (residual(uniform_flight(t, tmp_path, n), params) for n, t in (("a", table), ("b", moved)))
    sizes = draw_deviations(velocity_place_x=2.0, velocity_place_z=-1.0)
    back = residual(uniform_flight(moved, tmp_path, "c"), replace(params, deviation=sizes))
    felt = [
        k for k, one in enumerate(find_channels([uniform_flight(table, tmp_path, "d")])) if one.kind == "specific_force"
    ]
    off, left = (np.abs(one - origin)[:, felt].max() for one in (point, back))
    assert off > 0.02
    assert left < 0.05 * off


def test_a_delay_of_the_velocity_keeps_the_power_of_its_noise(tmp_path: Path) -> None:
    """White noise of 0.1 m/s, 12 ms late: a first order adds ``w² d²``, here 9 % of amplitude."""
    table = flight(3)
    table[["v_x", "v_y", "v_z"]] += 0.1 * np.random.default_rng(6).standard_normal((len(table), 3))
    noisy = uniform_flight(table, tmp_path, "a")
    implied = [k for k, channel in enumerate(find_channels([noisy])) if channel.kind == "kinematic_force"]
    on_time, late = (
        residual(noisy, ModelParams(deviation=draw_deviations(sensor_delay_velocity=size)))[:, implied]
        for size in (0.0, -4.0)
    )
    np.testing.assert_allclose(late.std(axis=0), on_time.std(axis=0), rtol=0.05)


def test_noise_of_what_kinematics_imply_is_no_scale_of_the_accelerometer(tmp_path: Path) -> None:
    """Velocities with noise: what they imply varies more than what is felt, and a scale of it would come out 40 % small."""
    rng, flights = np.random.default_rng(5), []
    for seed in range(3):
        table = flight(seed, noise=1.0, drag=0.2)
        table[["v_x", "v_y", "v_z"]] += 0.02 * rng.standard_normal((len(table), 3))
        flights.append(uniform_flight(table, tmp_path, str(seed)))
    params = ModelParams(effects={"rotor_drag": np.full(3, 0.2)})
    sizes = Tolerances(acc_scale=0.1)
    predictor = make_predictor(flights, tolerances=sizes)
    fit = linearise_at_params(predictor, (), params, tolerance_jacobian(predictor, params))
    kinematic = np.array([channel.kind == "kinematic_force" for channel in predictor.channels])
    weight = inverse_variance_weights(predictor.residuals(params)).weight * kinematic
    product, gradient = normal_equations_without_prior(fit, weight)
    covariance = np.linalg.inv(product + np.eye(len(gradient)))
    place = [sizes.names(4).index(f"acc_scale_{axis}") for axis in "xyz"]
    results, std = (covariance @ gradient)[place], np.sqrt(np.diag(covariance)[place])
    assert (std[:2] < 0.9).all()
    assert (np.abs(results) < 3.0 * std).all()


@pytest.mark.parametrize("accelerometer", [True, False])
@pytest.mark.parametrize(("letters", "axis", "name"), [("omega", "y", "gyro_scale"), ("v", "x", "velocity_scale")])
def test_a_scale_of_gyro_or_velocity_within_its_tolerance_is_put_back(
    letters: str, axis: str, name: str, accelerometer: bool, tmp_path: Path
) -> None:
    """Two deviations along one axis leave what an exact scale does, but 10 %; with drag in a wind."""
    table, size = flight(3, drag=0.6, wind=(2.0, -1.0, 0.5)), 2.0 * getattr(Tolerances(), name)
    if not accelerometer:
        table = table.drop(columns=["acc_x", "acc_y", "acc_z"])
    params = ModelParams(effects={"rotor_drag": np.full(3, 0.6), "constant_wind": np.array([2.0, -1.0, 0.5])})
    scaled = table.assign(**{f"{letters}_{axis}": (1.0 + size) * table[f"{letters}_{axis}"]})
    on_scale, off_scale = uniform_flight(table, tmp_path, "on"), uniform_flight(scaled, tmp_path, "off")
    as_was, moved = residual(on_scale, params), residual(off_scale, params)
    back = residual(off_scale, replace(params, deviation=draw_deviations(**{f"{name}_{axis}": 2.0})))
    left, off = (np.sqrt(np.mean((one - as_was) ** 2, axis=0)) for one in (back, moved))
    assert off.max() > 0.01
    np.testing.assert_array_less(left, 2e-3 + 0.1 * off)


@pytest.mark.parametrize("accelerometer", [True, False])
def test_an_attitude_that_is_off_within_its_tolerance_is_turned_back(tmp_path: Path, accelerometer: bool) -> None:
    """A log whose attitude is turned against the body by 2 and -1 tolerances leaves what the aligned one does, in its axes."""
    table = flight(3) if accelerometer else flight(3).drop(columns=["acc_x", "acc_y", "acc_z"])
    turn = Rotation.from_euler("xyz", [0.0, 0.02, -0.01])  # log to body axes
    aligned, off = turn_attitude(table, turn, tmp_path)
    left, channels = residual(aligned, ModelParams()), find_channels([aligned])
    plain, rotate_ring = residual(off, ModelParams()), residual(off, ModelParams(deviation=two_and_one()))
    kinds = [channel.kind for channel in channels]
    kind = "kinematic_force" if accelerometer else "specific_force"
    places = [place for place, name in enumerate(kinds) if name == kind]
    as_seen = left[:, places] if accelerometer else turn.apply(left[:, places], inverse=True)
    assert np.abs(plain[:, places[0]] - as_seen[:, 0]).mean() == pytest.approx(0.02 * 9.81, rel=0.1)
    np.testing.assert_allclose(rotate_ring[:, places], as_seen, atol=2e-3)


def test_an_attitude_bias_is_turned_back_in_rows_and_rollouts(tmp_path: Path) -> None:
    """A log whose attitude is turned by 0.05 and -0.03 rad leaves what the aligned one does in every channel and rollout."""
    turn = Rotation.from_euler("xyz", [0.0, 0.05, -0.03])  # log to body axes
    aligned, off = turn_attitude(flight(3, drag=0.2), turn, tmp_path)
    drag = {"rotor_drag": np.full(3, 0.2)}
    right, wrong = (
        ModelParams(effects=drag),
        ModelParams(effects={**drag, "attitude_bias": np.array([0.0, 0.05, -0.03])}),
    )
    assert np.abs(residual(off, right) - residual(aligned, right)).max() > 0.3
    np.testing.assert_allclose(residual(off, wrong), residual(aligned, right), atol=1e-3)
    as_was, turned = (roll_out(ROBOT, [one], of, horizons=(0.5,)) for one, of in ((aligned, right), (off, wrong)))
    np.testing.assert_allclose(turned.attitude, as_was.attitude, atol=1e-6)
    np.testing.assert_allclose(turned.velocity, as_was.velocity, atol=1e-6)


@pytest.mark.parametrize("params", [
    {"rotor_drag": np.array([0.5, 0.0, 0.0])},
    {"constant_wind": np.array([3.0, -2.0, 1.0]), "quadratic_drag": np.array([0.3, 0.0, 0.1])},
    {"slung_payload": np.array([0.05, 0.4, 0.1])},
])  # fmt: skip
def test_an_attitude_that_is_off_turns_the_airspeed_and_what_hangs(tmp_path, params) -> None:
    aligned, off = turn_attitude(flight(3, drag=0.2), Rotation.from_euler("xyz", [0.0, 0.02, -0.01]), tmp_path)
    params, back = ModelParams(effects=params), ModelParams(effects=params, deviation=two_and_one())
    felt = [channel.kind in ("specific_force", "angular_acceleration") for channel in find_channels([aligned])]
    as_was, without, results = (residual(*case)[:, felt] for case in ((aligned, params), (off, params), (off, back)))
    assert np.abs(without - as_was).max() > 0.01
    np.testing.assert_allclose(results, as_was, atol=1e-6 + 0.02 * np.abs(without - as_was).max())


def test_derivatives_half_way_know_how_deviations_act_on_each_other(tmp_path: Path) -> None:
    """A gyro that is early and an accelerometer beside the origin: what it feels of the turning comes at another time.
    Derivatives where nothing deviates miss 4 % of the change of the force in this gentle flight; of third order is 0.03
    %."""
    results = load(tmp_path, rate=400.0)
    predictor = make_predictor([results])
    deviation = draw_deviations(sensor_delay_gyro=-3.0, imu_place_z=2.0)
    params = ModelParams(deviation=deviation)
    change = (predictor.predict(params)[0] - predictor.predict(ModelParams())[0])[:, :2]
    at_once, half_way = ((tolerance_jacobian(predictor, one)[0] @ deviation)[:, :2] for one in (ModelParams(), params))
    assert np.abs(at_once - change).max() > 0.03 * np.abs(change).max()
    np.testing.assert_allclose(half_way, change, rtol=0.0, atol=1e-3 * np.abs(change).max())


def test_the_noise_floor_is_the_residual_of_a_perfect_model(tmp_path: Path) -> None:
    results = load(tmp_path, rate=400.0, noise=1.0, seconds=20.0)
    channels = find_channels([results])
    left = residual(results, ModelParams())
    floor = noise_floor(ROBOT, [results], ModelParams(), channels, bandwidth=BAND)
    ratio = np.sqrt((left**2).mean(axis=0)) / floor
    assert np.all((ratio > 0.7) & (ratio < 1.2)), ratio
    # Below 10 Hz, white noise of 0.05 m/s² at 400 Hz keeps sqrt(sum H²) of its power: 0.05 sqrt(2 * 0.92 * 10 / 400) = 0.011.
    assert floor[0] == pytest.approx(0.05 * np.sqrt(2.0 * 0.92 * 10.0 / 400.0), rel=0.1)


def test_a_reading_whose_values_differ_is_not_rounded_between_rare_values() -> None:
    """Noise with a last command of 200 rad/s: most rounded copies of a sparse tail would be off by tens of rad/s."""
    speed = 1000.0 + 80.0 * np.random.default_rng(0).standard_normal((4000, 1))
    speed[-10:] -= np.linspace(0.0, 700.0, 10)[:, None]
    signal_, *rounded = simulate_rounding(speed, 400.0, 10.0, slice(None))
    for log in rounded:
        np.testing.assert_array_equal(log, signal_)
    signal_, *rounded = simulate_rounding(20.0 * np.round(speed / 20.0), 400.0, 10.0, slice(None))
    assert np.std(rounded[0] - signal_) == pytest.approx(20.0 / np.sqrt(12.0), rel=0.2)


@pytest.mark.parametrize(
    ("step", "noise"), frequent_values(product((20.0, 60.0), (0.0, 1.0)), [(20.0, 1.0), (60.0, 0.0)])
)
def test_the_noise_floor_of_rounded_rotor_speeds_is_what_a_perfect_model_leaves(noise, step, tmp_path) -> None:
    """Speeds that stay within a step for long are wrong by the same all the while, which above the band is not seen.
    What is white there alone would give 0.1 to 0.6 of it along z. Of one step or another, rms is known to half of
    itself."""
    results = load(tmp_path, rate=400.0, noise=noise, seconds=20.0)
    coarse = replace(results, rotor_speed=np.round(results.rotor_speed / step) * step)
    channels = find_channels([results])
    floor = noise_floor(ROBOT, [coarse], ModelParams(), channels, bandwidth=BAND)
    made = [channels.index(Channel(kind="specific_force", axis="z"))]
    made += [channels.index(Channel(kind="angular_acceleration", axis=axis)) for axis in "xyz"]
    ratio = (np.sqrt((residual(coarse, ModelParams()) ** 2).mean(axis=0)) / floor)[made]
    assert np.all((ratio > 0.5) & (ratio < 2.0)), ratio


def test_what_a_log_holds_in_full_has_no_noise_of_rounding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No copy of it is predicted: all are equal."""
    results = load(tmp_path, rate=400.0, noise=1.0, seconds=20.0)
    monkeypatch.delattr("aerial_gym.sim2real.predict.noise_floor.wide_band_predictor")
    assert not mean_square_of_rounding(ROBOT, results, ModelParams(), find_channels([results]), BAND).any()


def test_the_noise_floor_of_a_filtered_sensor_is_that_below_its_filter(tmp_path: Path) -> None:
    """A filter at 30 Hz takes noise away above, none below 10 Hz: the floor stays. Lines from 15 to 24 Hz cannot tell a
    level from growth with f²; growth alone would give 10 / 19.5 / sqrt(3) = 0.3 of it."""
    results = load(tmp_path, rate=400.0, noise=1.0, seconds=20.0)
    assert results.specific_force is not None
    channels = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    smooth = replace(results, specific_force=lowpass(results.specific_force, 400.0, 30.0))
    raw, filtered = (noise_floor(ROBOT, [each], ModelParams(), channels, bandwidth=BAND) for each in (results, smooth))
    assert np.all(filtered[:2] > 0.5 * raw[:2])
    assert np.all(filtered / raw < 1.3)


@pytest.mark.parametrize("rate", [50.0, pytest.param(100.0, marks=pytest.mark.slow)])
def test_the_noise_floor_shows_in_a_log_of_the_highest_band(rate: float, tmp_path: Path) -> None:
    """At 10 Hz there is little left above the band, but noise of a sensor is white: sqrt(400 / rate) times that at 400
    Hz. Of 30 s some 250 lines of Welch's spectrum tell it to 5 %; where growth may take a share, only to a factor of
    two. Along z there is noise of rotors too, which a log of 50 Hz is too slow to tell."""
    slow, fast = (load(tmp_path, rate=each, noise=1.0, seconds=30.0) for each in (rate, 400.0))
    channels = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    floors = [noise_floor(ROBOT, [each], ModelParams(), channels, bandwidth=BAND) for each in (slow, fast)]
    ratio = (floors[0] / floors[1] / np.sqrt(400.0 / rate))[: 3 if rate > 50.0 else 2]
    assert np.all((ratio > 0.85) & (ratio < 1.15)), ratio


def test_no_floor_where_the_log_is_too_slow(tmp_path: Path) -> None:
    results = load(tmp_path, rate=25.0)
    channels = [Channel(kind="specific_force", axis="x")]
    assert noise_floor(ROBOT, [results], ModelParams(), channels, bandwidth=8.0) is None


def test_a_tolerance_that_strains_is_told_by_its_name() -> None:
    tolerances, names = Tolerances(), Tolerances().names(6)
    deviation = np.full(len(names), 2.9)
    assert tolerances.implausible_deviations(deviation) == []
    asked = {"mass": 3.4, "thrust_6": -4.0, "command_clock": 3.1}
    deviation[[names.index(name) for name in asked]] = list(asked.values())
    notes = tolerances.implausible_deviations(deviation)
    assert notes == [Finding("tolerance_strained", name, {"deviation_std": size}) for name, size in asked.items()]


def test_a_deviation_that_was_cut_off_or_of_what_is_not_there_is_no_finding() -> None:
    tolerances = Tolerances()
    deviation = draw_deviations(mass=3.5, inertia_x=5.0, com_y=-5.0, nominal_voltage=5.0, joint_rest=4.0)
    notes = tolerances.implausible_deviations(deviation, absent={"nominal_voltage", "joint_rest"}, farthest=5.0)
    cut = {"tolerances": ["inertia_x", "com_y"], "deviation_std": 5.0}
    strained = Finding("tolerance_strained", "mass", {"deviation_std": 3.5})
    assert notes == [strained, Finding("tolerances_cut_off", "", cut)]


def test_forces_derived_from_the_velocity_have_no_errors_of_an_accelerometer(tmp_path: Path) -> None:
    table = flight(3).drop(columns=["acc_x", "acc_y", "acc_z"])
    results = uniform_flight(table, tmp_path, "a")
    names = Tolerances().names(4)
    bias, tilt = np.array([0.5, -0.3, 0.2, 0.0, 0.0, 0.0]), np.array([0.05, -0.03, 0.0])
    off = np.array([5.0 * name.startswith("acc_bias") for name in names])
    left = residual(results, ModelParams())
    for params in (ModelParams(effects={"imu_bias": bias}), ModelParams(deviation=off)):
        np.testing.assert_array_equal(residual(results, params), left)
    moved = residual(results, ModelParams(effects={"imu_misalignment": tilt})) - left
    channels = find_channels([results])
    for place, channel in enumerate(channels):
        assert np.any(np.abs(moved[:, place]) > 1e-6) == (channel.kind != "specific_force"), channel.name
    assert finding_on_untestable_effect("imu_bias", ROBOT, [results]) is None
    without = replace(results, gyro=False)
    for name in ("imu_bias", "imu_misalignment"):
        assert finding_on_untestable_effect(name, ROBOT, [without]) == Finding("no_inertial_sensor", name)


@pytest.mark.parametrize(
    ("rate", "band", "rows"), [(400.0, 10.0, 8), (100.0, 10.0, 2), (50.0, 5.0, 1), (400.0, 5.0, 8)]
)
def test_logs_are_thinned_to_five_times_the_band_and_no_slow_ones(rate: float, band: float, rows: int) -> None:
    assert row_stride(hover("a", 1.0, rate=rate), bandwidth=band) == rows
