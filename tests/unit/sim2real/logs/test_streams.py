"""Topics with bad stamps, wrapped counters, clocks that were set back, and resets of the estimator.
Streams on the samples of the gyro: attitude on the sphere, commands held, faster sensors averaged.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flight_spans import FlightSpan
from aerial_gym.sim2real.logs.raw_log import LogChannel
from aerial_gym.sim2real.logs.recording import row_arrays
from aerial_gym.sim2real.logs.row_grid import resample_streams, row_times
from aerial_gym.sim2real.logs.signals import welch
from aerial_gym.sim2real.logs.streams import Stream, undo_resets, usable_streams
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import read_topics, topics

TIME = 0.01 * np.arange(400)


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(2, seconds=4.0, rate=200.0, noise=1.0)


def change_stamps(name: str, change: Callable[[np.ndarray], object], table: pd.DataFrame, key: str = "timestamp"):
    results = topics(table)
    results[name] |= {key: np.asarray(change(results[name]["timestamp"].copy()))}
    return results


def check_same(one: FlightLog, other: FlightLog, *, rows: int = 0, **tolerance: float) -> None:
    """At most ``rows`` rows are missing at the ends, and the others are the same."""
    assert abs(one.time.size - other.time.size) <= rows
    common, first, second = np.intersect1d(np.round(one.time, 6), np.round(other.time, 6), return_indices=True)
    assert common.size >= min(one.time.size, other.time.size) - rows
    arrays = row_arrays(other)
    for name, values in row_arrays(one).items():
        if name != "time" and name in arrays:
            np.testing.assert_allclose(values[first], arrays[name][second], err_msg=name, **tolerance)


def test_without_a_usable_attitude_the_gyro_gives_the_reference_clock() -> None:
    def channel(quantity: str, time: np.ndarray) -> LogChannel:
        return LogChannel(quantity=quantity, time=time, values=np.ones((400, 3)), source=quantity)

    steps = np.where(np.arange(400) < 200, TIME, TIME - 1.5)
    channels = [channel("position", steps), channel("attitude", np.full(400, np.nan)), channel("ang_vel", TIME)]
    notes = list[Finding]()
    assert list(usable_streams(channels, notes)) == ["ang_vel"]
    assert [note.code for note in notes] == 2 * ["topic_left_out"]


@pytest.mark.parametrize("name", list(topics(flight(2, seconds=1.0))))
def test_one_absurd_stamp_costs_one_sample(name: str, table: pd.DataFrame) -> None:
    good = read_topics(topics(table))
    bad = 200 if len(topics(table)[name]["timestamp"]) > 200 else 5
    late = np.uint64(40_000_000)
    log = read_topics(change_stamps(name, lambda t: t + late * (np.arange(t.size) == bad).astype(np.uint64), table))
    assert abs(good.time.size - log.time.size) <= 1
    assert log.time[-1] == good.time[-1]
    assert [bad] in [n.values["places"] for n in log.notes if n.code == "samples_with_bad_stamps"]


@pytest.mark.parametrize("stamps", [lambda t: 0 * t, lambda t: t + np.uint64(10**12), lambda t: t[::-1]])
@pytest.mark.parametrize(("name", "lost"), [("battery_status", "battery"), ("vehicle_local_position", "position")])
def test_an_optional_topic_with_bad_stamps_is_left_out(name: str, lost: str, stamps, table: pd.DataFrame) -> None:
    log = read_topics(change_stamps(name, stamps, table))
    assert getattr(log, lost) is None
    assert ("topic_left_out", f"{name}[0]") in [(note.code, note.values.get("topic")) for note in log.notes]
    check_same(log, read_topics(topics(table)), rows=8, atol=1e-6)


def test_unusable_stamps_of_a_needed_topic_are_named(table: pd.DataFrame) -> None:
    with pytest.raises(DataError, match="rotor_speed"):
        read_topics(change_stamps("esc_status", lambda t: 0 * t, table))


def test_a_sample_stamp_that_is_on_no_clock_gives_way_to_that_of_the_message(table: pd.DataFrame) -> None:
    good = read_topics(topics(table))
    for stamps in (lambda t: 0 * t, lambda t: t - np.uint64(4_000_000), lambda t: t + np.uint64(10**12)):
        check_same(read_topics(change_stamps("vehicle_local_position", stamps, table, "timestamp_sample")), good)


def test_a_counter_of_32_bits_in_one_topic_is_unwrapped(table: pd.DataFrame) -> None:
    results = topics(table)
    for part in results.values():
        part["timestamp"] = part["timestamp"] + np.uint64(2**32 - 7_000_000)
    good = read_topics(results)
    results["esc_status"]["timestamp"] = results["esc_status"]["timestamp"] % np.uint64(2**32)
    check_same(read_topics(results), good, atol=1e-6)
    for part in results.values():
        part["timestamp"] = part["timestamp"] % np.uint64(2**32)
    check_same(read_topics(results), good, atol=1e-6)


def test_a_clock_set_back_in_all_topics_is_corrected_by_one_amount(table: pd.DataFrame) -> None:
    good, results = read_topics(topics(table)), topics(table)
    del results["battery_status"]
    for part in results.values():
        part["timestamp"] = part["timestamp"] - np.where(part["timestamp"] > 7_003_000, 1_500_000, 0).astype(np.uint64)
    log = read_topics(results)
    check_same(log, good, atol=1e-6)
    assert "clock_set_back" in [note.code for note in log.notes]


def test_two_exchanged_blocks_of_a_topic_cost_nothing(table: pd.DataFrame) -> None:
    good, results = read_topics(topics(table)), topics(table)
    rows = np.arange(len(table))
    rows[100:300] = np.roll(rows[100:300], 80)
    gyro = results["vehicle_angular_velocity"]
    results["vehicle_angular_velocity"] = {name: values[rows] for name, values in gyro.items()}
    mended = read_topics(results)
    check_same(mended, good)
    assert len(mended.notes) == len(good.notes) + 1


def channels(**values: np.ndarray) -> list[LogChannel]:
    return [LogChannel(quantity=name, time=TIME, values=all, source=name) for name, all in values.items()]


def test_a_reset_of_the_attitude_turns_all_earlier_samples() -> None:
    """A steady yaw of 0.5 rad/s; the estimate before sample 150 is off by 0.3 rad."""
    spin = np.tile((0.0, 0.0, 0.5), (TIME.size, 1))
    actual = Rotation.from_rotvec(spin * TIME[:, None])
    off = Rotation.from_rotvec([0.0, 0.0, -0.3])
    logged = Rotation.concatenate([off * actual[:150], actual[150:]]).as_quat()
    attitude, gyro = channels(attitude=logged, ang_vel=spin)
    attitude = LogChannel(**vars(attitude) | {"resets": TIME[[150]]})
    notes: list[Finding] = []
    streams = undo_resets(usable_streams([attitude, gyro], notes), notes)
    assert (actual.inv() * Rotation.from_quat(streams["attitude"].values)).magnitude().max() < 1e-9
    (note,) = notes
    assert (note.code, note.values["time_s"]) == ("reset_undone", TIME[150])
    assert note.values["angle_deg"] == pytest.approx(np.degrees(0.3))


def test_a_reset_of_the_position_moves_all_later_samples() -> None:
    velocity = np.tile((1.0, 0.0, 0.2), (TIME.size, 1))
    actual = velocity * TIME[:, None]
    logged = actual + np.where(np.arange(TIME.size) >= 200, 1.0, 0.0)[:, None] * (0.0, 2.0, 0.0)
    position, speed = channels(position=logged, lin_vel=velocity)
    position = LogChannel(**vars(position) | {"resets": TIME[[200]]})
    streams = undo_resets(usable_streams([position, speed], []), [])
    np.testing.assert_allclose(streams["position"].values, actual, atol=1e-9)


SPAN = FlightSpan(start=1.0, end=3.0, ended_by="log_end")


def stream(name: str, rate: float, values: np.ndarray | None = None) -> Stream:
    time = np.arange(round(4.0 * rate) + 1) / rate
    table = np.zeros((time.size, 3)) if values is None else values
    return Stream(channel=LogChannel(quantity=name, time=time, values=table, source=name), time=time, values=table)


@pytest.mark.parametrize(("gyro", "rate"), [(100.0, 100.0), (50.0, 50.0), (25.0, 200.0), (8000.0, 2000.0)])
def test_the_gyro_gives_the_rows_from_50_to_2000_hz(gyro: float, rate: float) -> None:
    """A slower gyro gives way to the fastest stream of motion, a faster one is thinned."""
    rows = row_times({"ang_vel": stream("ang_vel", gyro), "rotor_command": stream("rotor_command", 200.0)}, SPAN)
    assert (rows[0], rows[-1]) == (pytest.approx(1.0), pytest.approx(3.0))
    np.testing.assert_allclose(np.diff(rows), 1.0 / rate)


def test_attitude_at_20_hz_follows_a_steady_turn_exactly() -> None:
    slow = stream("attitude", 20.0)
    turn = np.array([0.3, 2.0, 1.0])
    slow = stream("attitude", 20.0, Rotation.from_rotvec(turn * slow.time[:, None]).as_quat())
    rows = np.arange(1.0, 3.0, 0.005)
    resampled = Rotation.from_quat(resample_streams({"attitude": slow}, rows)["attitude"])
    assert (Rotation.from_rotvec(turn * rows[:, None]).inv() * resampled).magnitude().max() < 1e-9


def test_fast_commands_are_averaged_over_a_row_and_slow_ones_interpolated() -> None:
    """A held command that changes within a row has its share of the row, and is neither late nor early."""
    fast, slow = stream("rotor_command", 100.0), stream("rotor_command", 10.0)
    rows = np.arange(1.0, 3.0, 0.004)
    held = resample_streams({"rotor_command": stream("rotor_command", 100.0, fast.time[:, None])}, rows)[
        "rotor_command"
    ]
    fine = np.floor((rows[:, None] + np.arange(0.5, 8.0) * 5e-4) * 100.0) / 100.0
    np.testing.assert_allclose(held[:, 0], fine.mean(axis=1), atol=1e-9)
    line = resample_streams({"rotor_command": stream("rotor_command", 10.0, slow.time[:, None])}, rows)["rotor_command"]
    np.testing.assert_allclose(line[:, 0], rows, atol=1e-12)


def test_a_faster_accelerometer_is_averaged_and_rows_of_one_clock_stay_as_they_are() -> None:
    """The mean of alternating 0 and 2 is 1; a line stays a line."""
    fast = stream("specific_force", 1000.0)
    wave = np.stack((fast.time, 2.0 * (np.arange(fast.time.size) % 2), np.zeros(fast.time.size)), axis=1)
    rows = np.arange(1.0, 3.0, 0.01) + 0.0005
    values = resample_streams({"specific_force": stream("specific_force", 1000.0, wave)}, rows)["specific_force"]
    np.testing.assert_allclose(values[:, 0], rows, atol=1e-9)
    np.testing.assert_allclose(values[:, 1], 1.0, atol=0.21)  # the local slope of such a wave is no trend
    own = stream("ang_vel", 1000.0, wave)
    np.testing.assert_array_equal(resample_streams({"ang_vel": own}, own.time[5:-5])["ang_vel"], wave[5:-5])


def test_rotor_speeds_between_rows_keep_noise_and_motion() -> None:
    """Lines would lose 40 % of the noise from 15 to 60 Hz, by which the noise floor is measured."""
    white = np.random.default_rng(0).standard_normal((801, 3))
    white[:, 2] = np.sin(2.0 * np.pi * 40.0 * np.arange(801) / 200.0)
    rows = np.arange(1.0, 3.0, 0.005) + 0.0025
    values = resample_streams({"rotor_speed": stream("rotor_speed", 200.0, white)}, rows)["rotor_speed"]
    density = [welch(one[:, :2], 200.0, 100)[1][8:31].mean() for one in (values, white[200:601])]
    assert density[0] / density[1] == pytest.approx(1.0, abs=0.07)
    np.testing.assert_allclose(values[20:-20, 2], np.sin(2.0 * np.pi * 40.0 * rows[20:-20]), atol=0.02)


def test_setpoints_turn_and_move_with_the_resets_of_their_measurement() -> None:
    """A yaw reset of 0.3 rad turns all earlier attitude setpoints; a jump of the position moves all later setpoints."""
    time = 0.01 * np.arange(200)
    angle = np.where(time < 1.0, 0.0, 0.3)
    turned = Rotation.from_euler("z", angle[:, None]).as_quat()
    attitude = LogChannel(quantity="attitude", time=time, values=turned, source="a[0]", resets=np.array([1.0]))
    asked = LogChannel(quantity="attitude_setpoint", time=time, values=turned, source="s[0]")
    gyro = LogChannel(quantity="ang_vel", time=time, values=np.zeros((200, 3)), source="g[0]")
    jumped = np.where(time < 1.0, 0.0, 2.0)[:, None] * np.ones(3)
    position = LogChannel(quantity="position", time=time, values=jumped, source="p[0]", resets=np.array([1.0]))
    wanted = LogChannel(quantity="position_setpoint", time=time, values=jumped, source="w[0]")
    speed = LogChannel(quantity="lin_vel", time=time, values=np.zeros((200, 3)), source="v[0]")
    streams = undo_resets(usable_streams([attitude, asked, gyro, position, wanted, speed], []), [])
    heading = Rotation.from_quat(streams["attitude_setpoint"].values).as_euler("ZYX")[:, 0]
    np.testing.assert_allclose(heading, 0.3, atol=1e-12)
    np.testing.assert_allclose(streams["position_setpoint"].values, 0.0, atol=1e-12)
