"""Flights within a log: arming, landing, gaps, resets of the velocity, and an impact at the end."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.flight_spans import FlightSpan, flight_spans, leave_out_partial_streams
from aerial_gym.sim2real.logs.raw_log import LogChannel
from aerial_gym.sim2real.logs.readers.stamps import ClockStep
from aerial_gym.sim2real.logs.streams import Stream

TIME = 0.01 * np.arange(6001)


def stream(name: str, time: np.ndarray, values: np.ndarray | float = 0.0, resets: np.ndarray | None = None) -> Stream:
    table = np.broadcast_to(np.asarray(values, dtype=float).reshape(-1, 1), (time.size, 1))
    channel = LogChannel(quantity=name, time=time, values=table, source=name, resets=resets)
    return Stream(channel=channel, time=time, values=table)


def spans(*streams: Stream) -> list[tuple[float, float, str]]:
    flights = flight_spans({one.quantity: one for one in streams}, [])
    return [(round(one.start, 6), round(one.end, 6), one.ended_by) for one in flights]


def test_a_flight_is_armed_and_not_landed() -> None:
    armed = stream("armed", np.array([0.0, 5.0, 40.0]), np.array([0, 1, 0]))
    landed = stream("landed", np.array([0.0, 6.0, 20.0, 25.0]), np.array([1, 0, 1, 0]))
    gyro = stream("ang_vel", TIME)
    assert spans(gyro, armed, landed) == [(6.0, 20.0, "landing"), (25.0, 40.0, "landing")]
    assert spans(gyro, armed) == [(5.0, 40.0, "landing")]
    assert spans(gyro) == [(0.0, 60.0, "log_end")]


def test_states_that_show_no_flight_do_not_count() -> None:
    notes: list[Finding] = []
    never = stream("armed", np.array([0.0, 30.0]), 0.0)
    flights = flight_spans({"ang_vel": stream("ang_vel", TIME), "armed": never}, notes)
    assert flights == [FlightSpan(start=0.0, end=60.0, ended_by="log_end")]
    assert [note.code for note in notes] == ["flight_state_unknown"]


@pytest.mark.parametrize("name", ["ang_vel", "position", "rotor_command"])
def test_a_gap_of_any_topic_but_the_voltage_ends_a_flight(name: str) -> None:
    gap = TIME[(TIME < 20.0) | (TIME > 20.5)]
    other = stream("attitude", TIME)
    assert spans(other, stream(name, gap)) == [(0.0, 19.99, "gap"), (20.51, 60.0, "log_end")]
    assert spans(other, stream("ang_vel", TIME), stream("battery", gap)) == [(0.0, 60.0, "log_end")]


def test_flights_shorter_than_two_seconds_do_not_count() -> None:
    gap = TIME[(TIME < 1.5) | (TIME > 2.5)]
    assert spans(stream("ang_vel", gap)) == [(2.51, 60.0, "log_end")]


def test_a_reset_of_the_velocity_ends_a_flight() -> None:
    velocity = stream("lin_vel", TIME, resets=np.array([30.0]))
    assert spans(stream("ang_vel", TIME), velocity) == [(0.0, 29.99, "velocity_reset"), (30.0, 60.0, "log_end")]


def test_an_impact_at_the_end_is_cut_off_and_a_hard_manoeuvre_is_not() -> None:
    """Thrust that rises from 1 to 5 g within 0.2 s, then an impact of 4 g within 0.01 s."""
    force = 9.81 * (1.0 + np.interp(TIME, [20.0, 20.2, 20.4], [0.0, 4.0, 0.0]))
    force += 9.81 * np.interp(TIME, [58.5, 58.7, 58.9], [0.0, 4.0, 0.0])
    calm = stream("specific_force", TIME, force)
    assert spans(stream("ang_vel", TIME), calm) == [(0.0, 60.0, "log_end")]
    force[5900] += 40.0
    assert spans(stream("ang_vel", TIME), stream("specific_force", TIME, force)) == [(0.0, 58.9, "impact")]
    force[5900], force[3000] = 9.81, 50.0  # a knock in the middle of a flight does not end it
    assert spans(stream("ang_vel", TIME), stream("specific_force", TIME, force)) == [(0.0, 60.0, "log_end")]


def test_a_clock_that_was_set_back_splits_the_log() -> None:
    """As of a file that a vehicle continues after a restart at another place; a continuous motion is one flight."""
    steps = (ClockStep(row=2000, before=20.0, after=1.0, shift=19.0, counter=""),)
    gyro = stream("ang_vel", TIME)
    assert len(spans(gyro, replace(stream("position", TIME, TIME), steps=steps))) == 1
    parts = spans(gyro, replace(stream("position", TIME, TIME - 9.0 * (TIME >= 20.0)), steps=steps))
    assert [round(start, 2) for start, _, _ in parts] == [0.0, 20.0]
    assert [reason for _, _, reason in parts] == ["clock_set_back", "log_end"]


def test_a_stream_of_less_than_half_the_log_is_left_out() -> None:
    notes: list[Finding] = []
    short = stream("position", TIME[:2000])
    kept = leave_out_partial_streams({"ang_vel": stream("ang_vel", TIME), "position": short}, notes)
    assert list(kept) == ["ang_vel"]
    assert [(note.code, note.values["topic"]) for note in notes] == [("topic_covers_part", "position")]
