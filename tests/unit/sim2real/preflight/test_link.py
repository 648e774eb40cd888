"""Arrival of commands and the rate loop against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.preflight.link import TrainingLink, arrival_statistics, check_link, rate_loop_constants
from aerial_gym.sim2real.teststand.log_geometry import layout_of_robot

RATE, SPAN_S = 400.0, 24.0


def log_of_arrivals(arrivals: np.ndarray) -> FlightLog:
    """Return a log that holds only commands."""
    time = np.arange(round(SPAN_S * RATE)) / RATE
    setpoints = {"rate_setpoint": (arrivals, np.zeros((arrivals.size, 3)))}
    return FlightLog(
        path="a.csv", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1)), setpoints=setpoints
    )


@pytest.mark.parametrize(("period", "jitter", "loss"), [(0.01, 0.0005, 0.0), (0.025, 0.006, 0.0), (0.01, 0.002, 0.05)])
def test_rate_jitter_and_loss_of_arrivals(period: float, jitter: float, loss: float) -> None:
    """Rate and jitter are those with which the arrivals were drawn, and the loss is the share that was drawn."""
    rng, logs, lost = np.random.default_rng(0), [], []
    for _ in range(6):
        sent = np.arange(round(SPAN_S / period)) * period
        arrivals = sent + rng.uniform(0.0, 12.0**0.5 * jitter, sent.size)
        kept = rng.uniform(size=sent.size) >= loss
        logs.append(log_of_arrivals(arrivals[kept]))
        lost.append(np.mean(~kept))
    rate, shown, share = arrival_statistics(logs)
    assert rate is not None
    assert shown is not None
    assert share is not None
    assert rate.value == pytest.approx(1.0 / period, rel=0.001)
    assert shown.value == pytest.approx(jitter, rel=0.1, abs=0.0003)
    assert share.value == pytest.approx(np.mean(lost), abs=0.001)


def test_rows_that_the_logger_lost_are_no_lost_commands() -> None:
    logs = []
    for part in range(6):
        log = log_of_arrivals(np.arange(2400) * 0.01)
        lost = np.zeros(log.time.size, dtype=bool)
        lost[1000 + part : 9000 : 1500] = True
        lost |= np.roll(lost, 1) | np.roll(lost, 2) | np.roll(lost, 3) | np.roll(lost, 4)
        time, values = log.setpoints["rate_setpoint"]
        seen = ~lost[np.rint(time * RATE).astype(int)]
        logs.append(replace(log, lost=lost, setpoints={"rate_setpoint": (time[seen], values[seen])}))
    loss = arrival_statistics(logs)[2]
    assert loss is not None
    assert loss.low <= 0.0 <= loss.high
    assert loss.value == pytest.approx(0.0, abs=3e-4)  # half a step of the search of the rate, of 100 Hz


def test_a_sender_without_a_clock_shows_loss_by_the_variance_alone() -> None:
    """Periods that drift by 2 % have no common rate, and no command is lost."""
    rng, logs = np.random.default_rng(2), []
    for _ in range(6):
        periods = 0.01 * (1.0 + 0.02 * rng.standard_normal(2000).cumsum() / 2000**0.5)
        logs.append(log_of_arrivals(np.cumsum(periods)))
    loss = arrival_statistics(logs)[2]
    assert loss is not None
    assert loss.low <= 0.01


def log_of_rate_loop(gain: float, late: float) -> FlightLog:
    """Return the log of a rate loop that a rigid body follows at once, with steps of the command every 0.3 s."""
    robot, rng = robot_by_name("base_quadrotor"), np.random.default_rng(1)
    time = np.arange(round(SPAN_S * RATE)) / RATE
    asked = np.repeat(rng.choice((-1.0, 0.0, 1.0), (80, 3)), 120, axis=0)[: time.size]
    delayed = np.concatenate((np.zeros((round(late * RATE), 3)), asked))[: time.size]
    weights = layout_of_robot(robot).weights
    assert weights is not None
    rate, integral, torques, rates = np.zeros(3), np.zeros(3), [], []
    for row in delayed:
        error = gain * row - rate
        integral = integral + error / RATE
        torque = 12.0 * error + 15.0 * integral
        torques.append(torque)
        rates.append(rate)
        rate = rate + torque / RATE
    inverse = np.linalg.pinv(weights)
    thrust = 5.0 + 0.01 * np.array(torques) @ inverse.T
    speed = np.sqrt(thrust / robot.the_rotor("the test").thrust_map[2])
    return FlightLog(
        path="a.csv", time=time, attitude=np.tile((0.0, 0.0, 0.0, 1.0), (time.size, 1)), ang_vel=np.array(rates),
        rotor_command=speed, setpoints={"rate_setpoint": (time[::4], asked[::4])},
    )  # fmt: skip


@pytest.mark.parametrize(("gain", "late"), [(1.0, 0.0), (0.85, 0.0), (1.15, 0.03), (1.0, 0.05)])
def test_rate_loop_shows_gain_and_latency(gain: float, late: float) -> None:
    latency, gains = rate_loop_constants([log_of_rate_loop(gain, late)], robot_by_name("base_quadrotor"))
    assert latency is not None
    assert latency.value == pytest.approx(late, abs=0.002)
    assert [one.value for one in gains if one is not None] == pytest.approx([gain] * 3, rel=0.01)


def test_a_log_without_commanded_rates_leaves_the_link_assumed() -> None:
    log = replace(log_of_rate_loop(1.0, 0.0), setpoints={})
    constants = check_link([log], robot_by_name("base_quadrotor"), TrainingLink(rate=100.0))
    assert {one.state for one in constants} == {"assumed"}
    assert {one.reason for one in constants} == {"no_rate_setpoint"}
