"""Delays of streams behind the inertial sensors, on exact flights with a known shift."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.rotor_delays import rotor_delay
from aerial_gym.sim2real.logs.signals import interpolate_columns, log_at_equal_steps
from aerial_gym.sim2real.logs.stream_delays import stream_delays
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import read_topics, topics

QUANTITIES = {"vehicle_attitude": "attitude", "vehicle_local_position": "lin_vel"}


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(3, seconds=12.0, rate=200.0)


def delay_topic(table: pd.DataFrame, topic: str, seconds: float) -> dict[str, dict[str, np.ndarray]]:
    results = topics(table)
    results[topic]["timestamp"] = (results[topic]["timestamp"].astype(np.int64) + round(1e6 * seconds)).astype(
        np.uint64
    )
    return results


@pytest.mark.parametrize("seconds", [-0.02, 0.0, 0.012, 0.11, 0.2])
@pytest.mark.parametrize("topic", QUANTITIES)
def test_a_known_delay_is_found_and_corrected(topic: str, seconds: float, table: pd.DataFrame) -> None:
    log = read_topics(delay_topic(table, topic, seconds))
    timing = log.streams[QUANTITIES[topic]]
    assert timing.delay == pytest.approx(seconds, abs=max(timing.half_width, 1e-3))
    assert timing.half_width < 0.005
    corrected = [note.values["topic"] for note in log.notes if note.code == "stream_moved"]
    assert corrected == [f"{topic}[0]"] * (seconds != 0.0)
    assert abs(stream_delays(log)[QUANTITIES[topic]].delay) < 2e-3  # of the corrected flight


@pytest.mark.parametrize("seconds", [-0.03, 0.0, 0.05])
def test_a_delay_of_rotor_speeds_is_stated_and_left_to_the_robot(seconds: float, table: pd.DataFrame) -> None:
    log = read_topics(delay_topic(table, "esc_status", seconds))
    timing = log.streams["rotor_speed"]
    assert timing.delay == pytest.approx(seconds, abs=max(timing.half_width, 2e-3))
    assert timing.half_width < 0.02
    assert not timing.with_lag
    assert "stream_moved" not in [note.code for note in log.notes]


def test_commands_lead_by_the_lag_and_are_left_as_logged(table: pd.DataFrame) -> None:
    results = topics(table)
    stamp = results["vehicle_angular_velocity"]["timestamp"] - np.uint64(30_000)
    share = table.filter(like="rotor_").to_numpy() / 2000.0
    results["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": share[:, i] for i in range(4)}
    del results["esc_status"]
    log = read_topics(results)
    timing = log.streams["rotor_command"]
    assert timing.with_lag
    assert timing.delay == pytest.approx(-0.03, abs=max(timing.half_width, 2e-3))
    assert "stream_moved" not in [note.code for note in log.notes]


def test_a_velocity_needs_an_attitude_of_known_delay_or_vertical_motion(table: pd.DataFrame) -> None:
    """In a flight that hardly turns, a late attitude and an early horizontal velocity are the same."""
    log = read_topics(topics(table))
    even = log_at_equal_steps(log)
    known = stream_delays(even)
    assert known["lin_vel"].half_width > known["attitude"].half_width
    still = replace(even, ang_vel=None)
    vertical = stream_delays(still)["lin_vel"]
    assert vertical.delay == pytest.approx(0.0, abs=max(vertical.half_width, 1e-3))
    level = replace(still, lin_vel=still.lin_vel * (1.0, 1.0, 0.0))
    assert "lin_vel" not in stream_delays(level)


def test_a_late_accelerometer_is_no_early_velocity(table: pd.DataFrame) -> None:
    """Thrust that is read late moves the vertical delay alone; the horizontal one is that of the attitude, and of the gyro."""
    even = log_at_equal_steps(read_topics(topics(table)))
    late = interpolate_columns(even.time - 0.01, even.time, even.specific_force)
    delay = stream_delays(replace(even, specific_force=late))["lin_vel"]
    assert delay.delay == pytest.approx(0.0, abs=min(delay.half_width, 1e-3))


def test_a_larger_delay_leaves_a_stream_out_or_refuses_the_log(table: pd.DataFrame) -> None:
    log = read_topics(delay_topic(table, "vehicle_local_position", 0.4))
    assert log.lin_vel is None
    assert "stream_too_late" in [note.code for note in log.notes]
    with pytest.raises(DataError, match=r"attitude is 0\.40 ± .* late against the gyro"):
        read_topics(delay_topic(table, "vehicle_attitude", 0.4))


def test_a_vehicle_at_rest_shows_no_delay(table: pd.DataFrame) -> None:
    still = table.assign(**{name: table[name].iloc[0] for name in table if name != "t"})
    still[["omega_x", "omega_y", "omega_z"]] = 0.0
    log = read_topics(topics(still))
    assert {timing.delay for timing in log.streams.values()} == {None}


def test_a_turn_that_rotors_explain_at_every_delay_shows_none() -> None:
    """One frequency in two phases explains a torque at any delay; noise alone decides which one fits best."""
    time, rng = np.arange(2400) / 200.0, np.random.default_rng(0)
    for _ in range(8):
        angle = 2.0 * np.pi * 1.3 * time + rng.uniform(0.0, 6.0)
        speed = 900.0 + 30.0 * np.sin(angle[:, None] + np.array([0.0, 1.6, 3.1, 4.7])) + rng.standard_normal((2400, 4))
        turning = 0.3 * np.sin(angle[:, None] + np.array([0.4, 2.0, 0.0])) + 0.01 * rng.standard_normal((2400, 3))
        level = np.tile((0.0, 0.0, 0.0, 1.0), (2400, 1))
        log = FlightLog(path="a", time=time, attitude=level, ang_vel=turning, rotor_speed=speed)
        assert rotor_delay(log, speed, 0.5) is None
