"""Flights of binary logs: numbers of flights, native rates and what they forbid, mappings, and use with a robot."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.config import build
from aerial_gym.errors import DataError
from aerial_gym.sim2real import read_flight_log
from aerial_gym.sim2real.logs.flights import file_digests, load_flights, read_flight_inputs
from aerial_gym.sim2real.logs.readers.flight_log import read_flights
from aerial_gym.sim2real.logs.readers.mapping import LogMapping
from aerial_gym.sim2real.logs.recording import split_flight_number
from aerial_gym.sim2real.predict.channels import comparison_band, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.teststand.inertia_study import read_throw
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, write
from tests.unit.sim2real.ulog_files import read_topics, topics, write_ulog

Topics = dict[str, dict[str, np.ndarray]]
FULL_SPEED = 2000.0  # Rotor speed at full command [rad/s]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(4, seconds=12.0, rate=200.0)


def with_commands(table: pd.DataFrame, every: int) -> Topics:
    """Return a flight with relative commands in every so many rows in place of measured speeds, and attitude at 20 Hz."""
    results = topics(table)
    del results["esc_status"]
    share = table.filter(like="rotor_").to_numpy()[::every] / FULL_SPEED
    stamp = results["vehicle_angular_velocity"]["timestamp"]
    results["actuator_motors"] = {"timestamp": stamp[::every]} | {f"control[{i}]": share[:, i] for i in range(4)}
    results["vehicle_attitude"] = {key: values[::5] for key, values in results["vehicle_attitude"].items()}
    return results


def layout(**fields: object) -> LogMapping:
    base = {"summary": "test", "source": "test", "time": {"columns": ["t"]}}
    return build(LogMapping, base | fields, where="test")


def shift_stamps(results: Topics, seconds: float) -> Topics:
    shift = np.uint64(round(1e6 * seconds))
    return {name: part | {"timestamp": part["timestamp"] + shift} for name, part in results.items()}


def two_flights(table: pd.DataFrame, path: Path) -> Path:
    first, second = topics(table), shift_stamps(topics(flight(6, seconds=8.0, rate=200.0)), 40.0)
    joined = {
        name: {key: np.concatenate((first[name][key], second[name][key])) for key in first[name]} for name in first
    }
    return write_ulog(path, joined)


def test_a_pose_and_rotor_speeds_are_a_flight() -> None:
    """As a motion capture and a motor driver give them; a pose without place shows no motion beyond the turning."""
    parts = topics(flight(5, seconds=8.0, rate=100.0))
    pose = {name: parts[name] for name in ("vehicle_attitude", "vehicle_local_position", "esc_status")}
    log = read_topics(pose)
    assert log.ang_vel is log.specific_force is None
    assert log.position is not None
    with pytest.raises(DataError):
        read_topics({name: pose[name] for name in ("vehicle_attitude", "esc_status")})


def test_a_file_with_two_flights_gives_each_by_its_number(table: pd.DataFrame, tmp_path: Path) -> None:
    path = two_flights(table, tmp_path / "day.ulg")
    with pytest.raises(DataError, match=r"holds 2 flights; give one of them: .*day\.ulg#1 \(5\.\d to .*day\.ulg#2 "):
        read_flight_log(path)
    assert_refused(DataError, "holds 2 flights, numbered from 1", read_flight_log, f"{path}#3")
    logs = read_flights([path])
    assert [log.name for log in logs] == ["day#1", "day#2"]
    assert [np.ptp(log.time) for log in logs] == pytest.approx([12.0, 8.0], abs=0.1)
    assert logs[1].time[0] == pytest.approx(45.0, abs=0.1)
    flights = load_flights([path], ROBOT, mapping=None, bandwidth=10.0)
    assert [one.name for one in flights] == ["day#1", "day#2"]
    inputs = read_flight_inputs(ROBOT, [f"{path}#1"], [f"{path}#2"], mapping=None, bandwidth=10.0)
    assert ([one.name for one in inputs.train], [one.name for one in inputs.test]) == (["day#1"], ["day#2"])
    assert len(set(file_digests([path, f"{path}#2"]).values())) == 1


def test_a_throw_is_one_flight_of_its_file(table: pd.DataFrame, tmp_path: Path) -> None:
    """A file with two flights lists them; a selected one is read, and is no throw, as it carries its weight."""
    path = two_flights(table, tmp_path / "day.ulg")
    assert_refused(DataError, r"give one of them: .*day\.ulg#1", read_throw, path)
    with pytest.raises(DataError, match=r"day\.ulg#2: is no throw"):
        read_throw(Path(f"{path}#2"))


def test_a_file_whose_name_ends_like_a_number_is_a_file(table: pd.DataFrame, tmp_path: Path) -> None:
    path = write(table, tmp_path / "a.csv#2")
    assert split_flight_number(path) == (str(path), None)
    assert split_flight_number(tmp_path / "a.csv#3") == (str(tmp_path / "a.csv"), 3)
    assert read_flight_log(path).time.size == len(table)


def test_rates_of_all_streams_are_data(table: pd.DataFrame) -> None:
    log = read_topics(topics(table))
    rates = {name: round(timing.rate) for name, timing in log.streams.items()}
    assert rates == {
        **{"attitude": 100, "position": 50, "lin_vel": 50, "ang_vel": 200, "specific_force": 200},
        **{"rotor_speed": 100, "battery": 4},
    }
    assert log.time.size == pytest.approx(200 * 11.9, abs=20)
    assert log.torques


def load(results: Topics, path: Path, mapping: LogMapping | None = None):
    (one,) = load_flights([write_ulog(path, results)], ROBOT, mapping=mapping, bandwidth=10.0)
    return one


def test_commands_at_10_hz_show_neither_torques_nor_lag(table: pd.DataFrame, tmp_path: Path) -> None:
    """Attitude at 20 Hz is accepted; forces are compared below a fifth of the rate of the commands."""
    one = load(with_commands(table, 20), tmp_path / "a.ulg")
    assert not one.gyro
    assert {channel.kind for channel in find_channels([one])} == {"specific_force", "kinematic_force"}
    assert comparison_band([one], 10.0) == pytest.approx(2.0, rel=0.01)
    (note,) = [note for note in one.notes if note.code == "rotors_too_slow"]
    assert note.values["rate_hz"] == pytest.approx(10.0, rel=0.01)
    assert "torques_not_logged" not in [note.code for note in one.notes]


def test_a_slow_velocity_follows_the_accelerometer_between_its_samples(table: pd.DataFrame) -> None:
    """Straight lines would leave 0.1 m/s, which follows the angular velocity like the motion of a displaced sensor."""
    results = topics(table)
    slow = results["vehicle_local_position"]
    results["vehicle_local_position"] = {key: values[::10] for key, values in slow.items()}
    log = read_topics(results)
    assert log.streams["lin_vel"].rate == pytest.approx(5.0, rel=0.01)
    for name, column, largest in (("lin_vel", "v", 0.01), ("position", "p", 0.003)):
        true = [np.interp(log.time - log.time[0], table["t"], table[f"{column}_{axis}"]) for axis in "xyz"]
        assert np.abs(getattr(log, name) - np.transpose(true)).max() < largest


def test_a_log_without_torques_has_the_whole_motion_in_its_kinematic_forces(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    """The gyro is measured although slow commands show no torques; filtered twice, forces were off by 0.3 m/s²."""
    one = load(with_commands(table, 20), tmp_path / "a.ulg")
    predictor = make_predictor([one], bandwidth=0.6, channels=find_channels([one], 0.6))
    (residual,) = predictor.residuals(ModelParams())
    forces = [k for k, channel in enumerate(predictor.channels) if channel.kind == "kinematic_force"]
    assert np.std(residual[:, forces], axis=0).max() < 0.01


def test_a_force_from_a_slow_velocity_is_compared_below_a_fifth_of_its_rate(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    results = topics(table)
    del results["sensor_combined"]
    slow = results["vehicle_local_position"]
    results["vehicle_local_position"] = {key: values[::5] for key, values in slow.items()}
    one = load(results, tmp_path / "a.ulg")
    assert not one.accelerometer
    assert comparison_band([one], 10.0) == pytest.approx(2.0, rel=0.01)


def test_relative_commands_become_speeds_by_the_measured_thrust(table: pd.DataFrame, tmp_path: Path) -> None:
    one = load(with_commands(table, 1), tmp_path / "a.ulg")
    (note,) = [note for note in one.notes if note.code == "relative_commands_scaled"]
    assert note.values["full"] == pytest.approx(FULL_SPEED, rel=0.01)
    assert one.gyro
    expected = np.array([np.interp(one.time, table["t"] - table["t"][0], table[f"rotor_{n}"]) for n in range(1, 5)]).T
    assert np.median(np.abs(one.rotor_command / expected - 1.0)) < 0.02


def test_commands_beside_slow_speeds_are_scaled_by_these_and_show_no_lag(table: pd.DataFrame, tmp_path: Path) -> None:
    results = with_commands(table, 1) | {"esc_status": topics(table)["esc_status"]}
    fast = load(results, tmp_path / "fast.ulg")
    assert "rotor_speed" in {channel.kind for channel in find_channels([fast])}
    slow = load(with_commands(table, 20) | {"esc_status": results["esc_status"]}, tmp_path / "slow.ulg")
    assert slow.gyro
    assert "rotor_speed" not in {channel.kind for channel in find_channels([slow])}


def test_a_mapping_overrides_what_a_format_declares(table: pd.DataFrame) -> None:
    results = with_commands(table, 1)
    own = read_topics(results, layout(rotor_command={"columns": ["rotor_command"], "gain": 1500.0}))
    relative = read_topics(results)
    np.testing.assert_allclose(own.rotor_command, 1500.0 * relative.rotor_command)
    assert (own.relative_commands, relative.relative_commands) == (False, True)
    columns = [f"actuator_motors.control[{i}]" for i in (1, 0, 3, 2)]
    swapped = read_topics(results, layout(rotor_command={"columns": columns}))
    np.testing.assert_allclose(swapped.rotor_command, relative.rotor_command[:, [1, 0, 3, 2]])
    with pytest.raises(DataError, match="has no column 'no_topic.x'"):
        read_topics(results, layout(battery={"columns": ["no_topic.x"]}))


def test_a_log_without_attitude_integrates_the_gyro_and_keeps_body_axes(table: pd.DataFrame) -> None:
    results = topics(table)
    del results["vehicle_attitude"]
    log = read_topics(results)
    assert log.attitude_integrated
    assert log.position is None
    assert "attitude_integrated" in [note.code for note in log.notes]


@pytest.mark.parametrize(("lost", "named"), [
    (("vehicle_attitude", "vehicle_angular_velocity"), "attitude nor angular velocity"), (("esc_status",), "rotor_speed"),
])  # fmt: skip
def test_a_log_without_a_needed_quantity_is_refused(lost, named, table: pd.DataFrame) -> None:
    results = {name: part for name, part in topics(table).items() if name not in lost}
    assert_refused(DataError, named, read_topics, results)


def test_commands_too_small_to_carry_a_vehicle_are_no_flight(table: pd.DataFrame, tmp_path: Path) -> None:
    """At a tenth of full command on average, full command would give 100 weights."""
    results = with_commands(table, 1)
    motors = results["actuator_motors"]
    results["actuator_motors"] = {
        name: values if name == "timestamp" else 0.15 * values for name, values in motors.items()
    }
    with pytest.raises(DataError, match="of full on average"):
        load(results, tmp_path / "a.ulg")


def test_a_log_whose_motion_covers_a_part_of_it_is_refused(table: pd.DataFrame) -> None:
    """Stamps of the rotor speeds in nanoseconds make all other topics cover too little of the log; the battery may err."""
    results = topics(table)
    results["battery_status"]["timestamp"] = results["battery_status"]["timestamp"] * 1000
    assert read_topics(results).time.size > 2000
    results["esc_status"]["timestamp"] = results["esc_status"]["timestamp"] * 1000
    assert_refused(DataError, "of the whole log", read_topics, results)
