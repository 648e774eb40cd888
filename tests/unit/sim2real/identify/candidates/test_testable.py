"""What flights can test, what is each flight's own, and structures of what remains."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import hover_speed
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.nuisance import (
    _flight_offset_columns,
    limits_of_flight_offsets,
    prior_of_flight_offsets,
)
from aerial_gym.sim2real.identify.candidates.structure import CommonLines, find_structure
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect, parameters_at_bounds
from aerial_gym.sim2real.identify.least_squares.derivatives import rms_caused_by_tolerances, tolerance_jacobian
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import row_arrays
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor, uniform_flight
from tests.unit.sim2real.predict.test_scene import hover


@pytest.mark.parametrize("name", ["com_offset", "weak_motor"])
def test_what_torques_tell_is_not_looked_for_where_none_are_compared(name: str) -> None:
    whole = hover("a", 5.0)
    without = replace(whole, gyro=False)
    assert finding_on_untestable_effect(name, ROBOT, [whole], [whole]) is None
    for train, test in (([whole, without], [whole]), ([whole], [without])):
        assert finding_on_untestable_effect(name, ROBOT, train, test) == Finding("torques_not_compared", name)
    for shown in ("rotor_drag", "motor_tilt"):
        assert finding_on_untestable_effect(shown, ROBOT, [without]) is None
    unknown_air = replace(without, lin_vel=None)
    assert finding_on_untestable_effect("motor_tilt", ROBOT, [unknown_air]) == Finding(
        "torques_not_compared", "motor_tilt"
    )


@pytest.mark.parametrize(("noise", "shown"), [(0.0, True), (6.0, False)])
def test_slow_commands_show_a_thrust_curve_only_beyond_both_regressions(noise: float, shown: bool) -> None:
    """The force grows with the power 3 of the speed. What slow commands miss adds to the force."""
    short = hover("a", 5.0)
    rows = {name: np.concatenate([values] * 10) for name, values in row_arrays(short).items()}
    one = replace(short, **rows | {"time": np.arange(10 * short.num_rows) / short.rate})
    ratio = 1.0 + 0.1 * np.sin(one.time)
    force = (
        9.81 * ratio**3
        + np.repeat(np.random.default_rng(0).normal(0.0, noise, one.num_rows // 50 + 1), 50)[: one.num_rows]
    )
    up = np.stack((np.zeros_like(force), np.zeros_like(force), force), axis=1)
    speed = hover_speed(vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64), 9.81).numpy()
    slow = replace(
        one, rotor_speed=None, rotor_command=speed * ratio[:, None], specific_force=up, torques=False, gyro=False
    )
    reason = finding_on_untestable_effect("thrust_curve", ROBOT, [slow])
    assert reason == (None if shown else Finding("thrust_slope_open", "thrust_curve"))
    assert finding_on_untestable_effect("thrust_curve", ROBOT, [replace(slow, torques=True, gyro=True)]) is None


@pytest.mark.parametrize("name", ["motor_time_constant", "motor_asymmetry"])
def test_a_lag_is_not_looked_for_in_commands_logged_more_slowly_than_rotors_follow(name: str) -> None:
    """40 ms declared: rows of 25 and of 50 Hz. Delays and gains, and lags of flights without commands, are other matters."""
    flight = hover("a", 5.0)
    slow, quick = (
        replace(flight, rate=rate, rotor_command=np.full((flight.num_rows, 4), 900.0)) for rate in (25.0, 50.0)
    )
    assert finding_on_untestable_effect(name, ROBOT, [quick]) is None
    reason = finding_on_untestable_effect(name, ROBOT, [quick, slow])
    assert (reason.code, reason.values) == ("commands_too_coarse", pytest.approx({"row_ms": 40.0, "lag_ms": 40.0}))
    assert (
        finding_on_untestable_effect("actuation_delay", ROBOT, [slow])
        is finding_on_untestable_effect("thrust_coefficient", ROBOT, [slow])
        is None
    )
    assert finding_on_untestable_effect(name, ROBOT, [replace(slow, rotor_command=None)]) is None


@pytest.mark.parametrize("name", ["rotor_drag", "h_force_flapping", "axial_inflow", "constant_wind"])
def test_what_air_does_is_not_looked_for_where_the_speed_through_it_is_unknown(name: str) -> None:
    """Hubs move as a vehicle turns, and that alone would fit them a coefficient."""
    whole = hover("a", 5.0)
    assert finding_on_untestable_effect(name, ROBOT, [whole]) is None
    reason = finding_on_untestable_effect(name, ROBOT, [whole, replace(whole, lin_vel=None)])
    assert (reason.code, reason.values["need"]) == ("logs_lack", "lin_vel")
    assert finding_on_untestable_effect("thrust_coefficient", ROBOT, [replace(whole, lin_vel=None)]) is None


def test_a_parameter_that_ends_where_physics_does_is_told() -> None:
    """A drag of 0 along y is where the effect begins, a bound of an inertia is not."""
    neutral = np.ones(3)
    params = ModelParams(effects={"inertia_error": np.array([0.1, 1.0, 10.0]), "rotor_drag": np.array([0.2, 0.0, 0.1])})
    assert parameters_at_bounds("inertia_error", params, neutral, ROBOT) == ["sx", "sz"]
    assert parameters_at_bounds("rotor_drag", params, np.zeros(3), ROBOT) == []


CHANNELS = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
MEANS = np.array([[0.1, 3.0, 0.2], [-0.1, -3.0, 0.2], [0.3, 0.0, 0.2]])
"""Of three flights in each channel; the last one does not differ."""


def residuals() -> list[np.ndarray]:
    waves = [np.sin(np.linspace(0.0, 2.0 * np.pi * 4.0, 40, endpoint=False)) for _ in MEANS]
    return [mean + wave[:, None] for mean, wave in zip(MEANS, waves, strict=True)]


def test_the_flight_offsets_of_an_accelerometer_have_one_size_from_all_axes_and_those_of_other_channels_their_own() -> (
    None
):
    """Standard deviations 0.2, 3 (at most 0.5) and 0 of the axes have the rms sqrt(0.29 / 3); that of a rotor stays 0.2."""
    channels, most = [*CHANNELS, Channel(kind="rotor_speed", axis="1")], np.array([1.0, 0.5, 1.0, 9.0])
    flown = [np.column_stack((part, part[:, 0])) for part in residuals()]
    result = _flight_offset_columns(channels, flown, most)
    assert [one.name for one in result] == ["flight in specific_force", "flight in rotor_speed.1"]
    force, rotor = result
    size, limit = (0.29 / 3.0) ** 0.5, (2.25 / 3.0) ** 0.5
    assert force.is_flight_offset
    assert force.size == pytest.approx(size)
    assert rotor.size == pytest.approx(0.2)
    for number, columns in enumerate(force.columns):
        for axis in range(3):
            expected = np.zeros((40, 9))
            expected[:, 3 * number + axis] = size
            np.testing.assert_allclose(columns.dense_columns((axis,))[:, 0], expected, rtol=1e-6)
        assert not columns.dense_columns((3,)).any()
        assert columns.values.shape == (40, 3, 3)  # no columns of other flights are kept
    own = prior_of_flight_offsets(result, channels, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(own.size, [size, size, size, 0.2])
    np.testing.assert_allclose(own.most, [limit, limit, limit, 9.0])


def test_one_flight_alone_has_no_offset_of_its_own() -> None:
    assert _flight_offset_columns(CHANNELS, residuals()[:1], np.ones(3)) == []


def test_a_force_that_no_sensor_has_felt_has_none(tmp_path) -> None:
    """With an accelerometer 0.1 m/s² and what tolerances make; derived from the velocity nothing, beside a gyro that stays."""
    tables = {"felt": flight(3), "derived": flight(3).drop(columns=["acc_x", "acc_y", "acc_z"])}
    sizes = {}
    for name, table in tables.items():
        flown = uniform_flight(table, tmp_path, name)
        predictor = make_predictor([flown])
        channels = predictor.channels
        tolerance = tolerance_jacobian(predictor, params_from_robot(ROBOT))
        result = limits_of_flight_offsets(predictor, rms_caused_by_tolerances(tolerance, ROBOT.num_rotors))
        sizes[name] = dict(zip((channel.name for channel in channels), result, strict=True))
    assert 0.1 < sizes["felt"]["specific_force.x"] < 0.2
    assert sizes["derived"]["specific_force.x"] == 0.0
    turned = "angular_acceleration.x"
    assert sizes["derived"][turned] == pytest.approx(sizes["felt"][turned], rel=1e-6)
    assert sizes["felt"]["angular_acceleration.x"] > 0.0


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    tables = [flight(20 + n, noise=1.0, seconds=8.0, rate=100.0) for n in range(4)]
    return load_tables(tmp_path_factory.mktemp("flights"), tables)


@pytest.mark.parametrize("kind", ["position", "time", "periodic", "heading", "velocity", "none"])
def test_the_kind_of_a_remaining_structure(kind: str, flights: list[Flight]) -> None:
    rng = np.random.default_rng(0)
    channels = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    times, residuals = [], []
    for one in flights:
        turn = Rotation.from_quat(one.attitude[20:-20:3])
        ahead, forward = turn.apply([1.0, 0.0, 0.0]), turn.apply(one.lin_vel[20:-20:3], inverse=True)[:, 0]
        time = one.time[20:-20:3]
        height = one.position[20:-20:3, 2]
        left = 0.02 * rng.standard_normal((time.size, 3))
        left[:, 2] += {
            "position": 0.3 * np.exp(-(height - height.min()) / 0.3),
            "time": -0.03 * time,
            "periodic": 0.1 * np.sin(2.0 * np.pi * 7.0 * time + rng.uniform(0.0, 6.0)),
            "heading": 0.1 * ahead[:, 0] / np.hypot(ahead[:, 0], ahead[:, 1]),
            "velocity": 0.2 * forward * np.abs(forward),
            "none": 0.0,
        }[kind]
        times.append(time)
        residuals.append(left)
    result = find_structure(flights, times, residuals, channels, [2])
    assert result.kind == kind
    assert (result.freq_hz is None) == (kind != "periodic")
    if kind == "heading":  # an attitude that is the integral of a gyro has none
        drifting = [replace(one, attitude_integrated=True) for one in flights]
        assert find_structure(drifting, times, residuals, channels, [2]).kind != "heading"
    if kind == "periodic":
        assert result.freq_hz == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize(("sizes", "kind"), [((0.1, 0.12), "heading"), ((0.1, 0.23), "none"), ((0.1, 0.0), "none")])
def test_a_structure_needs_two_flights_that_agree(sizes: tuple[float, ...], kind: str, flights: list[Flight]) -> None:
    """The fit of one flight must predict the other better than its mean: twice its size is no agreement."""
    times, residuals = [one.time[20:-20:3] for one in flights[:2]], []
    for one, size in zip(flights, sizes, strict=False):
        ahead = Rotation.from_quat(one.attitude[20:-20:3]).apply([1.0, 0.0, 0.0])
        left = 0.005 * np.random.default_rng(0).standard_normal((len(ahead), 3))
        left[:, 2] += size * ahead[:, 0] / np.hypot(ahead[:, 0], ahead[:, 1])
        residuals.append(left)
    channels = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
    assert find_structure(flights[:2], times, residuals, channels, [2]).kind == kind


def test_a_line_is_found_where_one_flight_lacks_the_velocity() -> None:
    time, rng = np.arange(1200) / 50.0, np.random.default_rng(0)
    motion, noise = rng.standard_normal((2, 1200, 6)), 0.1 * rng.standard_normal((2, 1200))
    lines = CommonLines([time, time], [motion[0], motion[1, :, :3]])
    line = lines.strongest_line([np.sin(2.0 * np.pi * 7.0 * time) + part for part in noise])
    assert line is not None
    assert line[0] == pytest.approx(7.0, abs=0.5)
