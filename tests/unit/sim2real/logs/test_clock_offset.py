"""The clock of the rotor log, against offsets that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.errors import DataError
from aerial_gym.sim2real import FlightLog, read_flight_log
from aerial_gym.sim2real.logs.clock_offset import (
    LARGEST_SHIFT_S,
    ClockOffset,
    OffsetCurve,
    check_rotor_clock,
    commands_share_clock,
    common_offsets,
    offset_curve,
    shift_rotor_log,
)
from aerial_gym.sim2real.logs.signals import lowpass
from tests.unit.sim2real.flat_flights import ROBOT, flight, write
from tests.unit.sim2real.logs.test_signals import BAND, RATE, TIME, log


def noise(rng: np.random.Generator, band: float) -> np.ndarray:
    return lowpass(rng.standard_normal((TIME.size, 1)), RATE, band)[:, 0]


def response_with_lag(command: np.ndarray, constant: float) -> np.ndarray:
    """Return the speeds that held commands lead to through a lag [s]."""
    speed, kept = command.copy(), np.exp(-1.0 / (RATE * constant))
    for row in range(1, TIME.size):
        speed[row] = kept * speed[row - 1] + (1.0 - kept) * command[row - 1]
    return speed


def late(values: np.ndarray, rows: float) -> np.ndarray:
    """Return a periodic signal that comes so many rows later."""
    frequency = np.fft.rfftfreq(values.size)
    return np.fft.irfft(np.fft.rfft(values) * np.exp(-2j * np.pi * frequency * rows), n=values.size)


@pytest.mark.parametrize("offset", [-4.0, pytest.param(0.0, marks=pytest.mark.slow), 3.3])
def test_an_offset_of_the_rotor_log_is_found_with_its_spread(offset: float) -> None:
    """Drag along z and a lever arm must not look like an offset; a thrust that is off by 5 % neither. z is normal."""
    rng, result = np.random.default_rng(2), []
    for _ in range(200):
        thrust, climb, turning = 3.0 * noise(rng, 3.0), 2.0 * noise(rng, 0.5), 5.0 * noise(rng, 3.0)
        measured = 9.81 + 0.95 * thrust - 0.3 * climb + 0.004 * turning + 0.08 * rng.standard_normal(TIME.size)
        rest = np.stack((climb, turning), axis=1)
        result.append(offset_curve(measured, 9.81 + late(thrust, -offset), rest, RATE, BAND).offset)
    if offset == 0.0:
        assert all(one == ClockOffset() for one in result)
        return
    z = np.array([(one.rows - offset) / one.std for one in result])
    assert abs(z.mean()) < 4.0 / np.sqrt(200)
    assert 0.85 < z.std() < 1.25


@pytest.mark.parametrize("offset", [-4.0, 2.0, 2.25])
def test_an_offset_is_undone(offset: float) -> None:
    speed = np.arange(TIME.size, dtype=float)[:, None]
    logged = log(TIME, rotor_speed=speed, specific_force=np.repeat(speed, 3, axis=1))
    moved = shift_rotor_log(logged, ClockOffset(rows=offset, std=0.1))
    assert moved.time.size == TIME.size - np.ceil(abs(offset))
    np.testing.assert_allclose(moved.specific_force[:, 0] - moved.rotor_speed[:, 0], offset, atol=1e-9)
    lead = {"lead_ms": pytest.approx(5.0 * offset), "half_width_ms": pytest.approx(0.98), "with_commands": True}
    assert (moved.notes[-1].code, moved.notes[-1].values) == ("rotor_log_moved", lead)


@pytest.mark.parametrize("offset", [-4, 4])
@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("constant", [0.02, 0.03, 0.06])
def test_commands_move_with_the_rotor_log_only_if_a_lag_says_so(
    offset: int, *, together: bool, constant: float
) -> None:
    """Whatever the lag is, 0.04 s as declared or not, it is no shift."""
    command = 900.0 + 40.0 * noise(np.random.default_rng(5), 15.0)
    speed = response_with_lag(command, constant) + np.random.default_rng(6).standard_normal(TIME.size)
    asked = np.roll(command, -offset if together else 0)[:, None]
    logged = log(TIME, rotor_speed=np.roll(speed, -offset)[:, None], rotor_command=asked)
    ahead = ClockOffset(rows=float(offset), std=0.1)
    assert commands_share_clock([logged], [ahead], 0.04) is together
    moved = shift_rotor_log(logged, ahead, commands=together)
    inner = slice(20, moved.time.size - 20)
    row = np.round(moved.time * RATE).astype(int)
    np.testing.assert_allclose(moved.rotor_command[inner, 0], command[row][inner])
    (note,) = moved.notes
    lead = {"lead_ms": pytest.approx(1e3 * offset / RATE), "half_width_ms": pytest.approx(196.0 / RATE)}
    assert (note.code, note.values) == ("rotor_log_moved", {**lead, "with_commands": together})


def test_all_logs_of_a_logger_move_their_commands_or_none() -> None:
    rng = np.random.default_rng(8)

    def make_log(size: float) -> FlightLog:
        command = 900.0 + size * noise(rng, 15.0)
        speed = np.roll(response_with_lag(command, 0.04) + rng.standard_normal(TIME.size), -4)
        return log(TIME, rotor_speed=speed[:, None], rotor_command=command[:, None])

    clear, vague = [make_log(40.0) for _ in range(2)], make_log(0.1)
    ahead, none = ClockOffset(rows=4.0, std=0.1), ClockOffset()
    assert commands_share_clock([vague], [ahead], 0.04)
    assert not commands_share_clock([*clear, vague], [ahead] * 3, 0.04)
    assert not commands_share_clock([*clear, replace(vague, rotor_command=None), vague], [ahead] * 3 + [none], 0.04)
    assert commands_share_clock([], [], 0.04)


def test_a_signal_that_does_not_agree_at_all_is_not_shifted() -> None:
    rng = np.random.default_rng(3)
    assert offset_curve(noise(rng, 3.0), noise(rng, 3.0), np.zeros((TIME.size, 0)), RATE, BAND).offset == ClockOffset()


def test_a_lead_at_the_end_of_the_range_is_not_believed() -> None:
    rng = np.random.default_rng(4)
    thrust = 3.0 * noise(rng, 3.0)
    most = round(LARGEST_SHIFT_S * RATE)
    measured = 9.81 + np.roll(thrust, most) + 0.02 * rng.standard_normal(TIME.size)
    assert offset_curve(measured, 9.81 + thrust, np.zeros((TIME.size, 0)), RATE, BAND).offset == ClockOffset()


def make_curve(rng: np.random.Generator, offset: float, *, size: float) -> OffsetCurve:
    """Return the curve of a flight whose thrust varies by 0.5 ``size`` m/s², beside noise of 0.08 m/s²."""
    thrust = 3.0 * size * noise(rng, 3.0)
    measured = 9.81 + thrust + 0.08 * rng.standard_normal(TIME.size)
    return offset_curve(measured, 9.81 + late(thrust, -offset), np.zeros((TIME.size, 0)), RATE, BAND)


def test_a_flight_that_hardly_varies_is_moved_as_the_others_are() -> None:
    rng = np.random.default_rng(7)
    loud = [make_curve(rng, 4.0, size=1.0) for _ in range(3)]
    quiet = [make_curve(rng, 4.0, size=0.03) for _ in range(2)]
    assert all(one.offset == ClockOffset() for one in quiet)
    offsets = common_offsets([*loud, *quiet], 5)
    assert len({(offset.rows, offset.std) for offset in offsets}) == 1
    assert offsets[0].rows == pytest.approx(4.0, abs=4.0 * offsets[0].std)
    assert offsets[0].std < min(one.offset.std for one in loud)


def test_a_flight_that_speaks_for_its_own_clock_keeps_it() -> None:
    rng = np.random.default_rng(8)
    loud, unmoved = [make_curve(rng, 4.0, size=1.0) for _ in range(2)], make_curve(rng, 0.0, size=1.0)
    assert common_offsets([*loud, unmoved], 3)[2] == ClockOffset()
    apart = [make_curve(rng, 4.0, size=1.0), make_curve(rng, 7.0, size=1.0), make_curve(rng, 4.0, size=0.03)]
    assert common_offsets(apart, 3) == [one.offset for one in apart]
    assert common_offsets([make_curve(rng, 0.0, size=1.0) for _ in range(2)], 2) == [ClockOffset(), ClockOffset()]


def test_a_common_lead_is_a_time_not_a_number_of_rows() -> None:
    rng = np.random.default_rng(9)
    loud, quiet = make_curve(rng, 4.0, size=1.0), make_curve(rng, 4.0, size=0.03)
    faster = OffsetCurve(rate=2.0 * quiet.rate, left=np.repeat(quiet.left, 2)[:-1], samples=quiet.samples)
    slow, fast = common_offsets([loud, faster], 2)
    assert fast.rows == pytest.approx(2.0 * slow.rows)
    assert fast.std == pytest.approx(2.0 * slow.std)


def test_flights_that_judge_do_not_move_those_for_training() -> None:
    rng = np.random.default_rng(10)
    quiet, test = [make_curve(rng, 4.0, size=0.03) for _ in range(2)], make_curve(rng, 4.0, size=1.0)
    assert common_offsets([*quiet, test], 2) == [ClockOffset(), ClockOffset(), test.offset]
    train, other, silent = (make_curve(rng, rows, size=size) for rows, size in ((4.0, 1.0), (-6.0, 1.0), (4.0, 0.03)))
    offsets = common_offsets([train, other, silent], 1)
    for offset, expected in zip(offsets, (train.offset, other.offset, train.offset), strict=True):
        # Sums come in another order.
        assert (offset.rows, offset.std) == pytest.approx((expected.rows, expected.std), rel=1e-9)


@pytest.mark.parametrize(("offset", "moved"), [(1.6, False), (-1.6, False), (2.4, True), (-2.4, True)])
def test_what_late_sensors_explain_as_well_is_no_other_clock(offset: float, moved: bool) -> None:
    """Rotor speeds and accelerometer are late by 3 ms each: 8 ms are theirs, 12 ms are those of a clock, which is
    anywhere. Even odds of a normal deviation of ``s = 3 sqrt(2)`` ms and of any within 50 ms: ``s sqrt(2 ln(100 / (s
    sqrt(2 pi))))`` is 9.0 ms."""
    curve = make_curve(np.random.default_rng(11), offset, size=1.0)
    assert curve.offset.rows == pytest.approx(offset, abs=0.2)
    (result,), expected = common_offsets([curve], 1), curve.offset if moved else ClockOffset()
    assert (result.rows, result.std) == pytest.approx((expected.rows, expected.std), rel=1e-12)
    limits = [
        time
        for time in np.arange(5.0, 15.0, 0.1)
        if ClockOffset(rows=time, std=1e-3).is_likelier_than_sensor_delays(1000.0)
    ]
    assert min(limits) == pytest.approx(9.0, abs=0.11)
    assert not ClockOffset(rows=10.0, std=5.0).is_likelier_than_sensor_delays(1000.0)


def test_where_flights_contradict_each_other_an_offset_must_be_clear() -> None:
    """Of odds of 20 to 1 the limit is ``s sqrt(2 ln(20 * 100 / (s sqrt(2 pi))))``, 13.7 ms: 10.8 ms of one of two stay."""
    rng = np.random.default_rng(12)
    still, moved = make_curve(rng, 0.0, size=1.0), make_curve(rng, 2.2, size=1.0)
    assert common_offsets([moved], 1)[0].rows == pytest.approx(2.2, abs=0.2)  # between rows a parabola
    assert common_offsets([moved, still], 2) == [ClockOffset(), ClockOffset()]
    # A flight that only judges contradicts nothing.
    assert common_offsets([moved, still], 1)[0].rows == pytest.approx(2.2, abs=0.2)
    far = make_curve(rng, 3.2, size=1.0)
    assert common_offsets([far, still], 2) == [far.offset, ClockOffset()]
    limits = [
        time
        for time in np.arange(5.0, 20.0, 0.1)
        if ClockOffset(rows=time, std=1e-3).is_likelier_than_sensor_delays(1000.0, 20.0)
    ]
    assert min(limits) == pytest.approx(13.7, abs=0.11)


ROTORS = [f"rotor_{n}" for n in range(1, 5)]


def climbs(folder: Path, late: float, *, rate: float, vigour: float = 0.1) -> FlightLog:
    """Return the log of a level vehicle whose thrust varies below 5 Hz, its rotors logged so much too late [s]."""
    rng, rows = np.random.default_rng(4), round(14.0 * rate)
    wander = lowpass(rng.standard_normal((rows, 1)), rate, 5.0)[:, 0]
    thrust = 0.6 * 9.81 * (1.0 + vigour * wander / wander.std())
    climb = thrust / 0.6 - 9.81
    table = pd.DataFrame({"t": np.arange(rows) / rate, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0})
    table[["v_x", "v_y", "acc_x", "acc_y"]] = 0.01 * rng.standard_normal((rows, 4))
    table["v_z"] = np.cumsum(climb) / rate
    table["acc_z"] = 9.81 + climb + 0.07 * rng.standard_normal(rows)
    scatter = 1.0 + 0.003 * rng.standard_normal((rows, 4))
    table[ROTORS] = np.roll(np.sqrt(thrust / 4.8e-6), round(late * rate))[:, None] * scatter
    cut = round(rate)
    return read_flight_log(write(table[cut:-cut], folder / "a.csv"))


@pytest.mark.parametrize("rate", [100.0, 400.0])
@pytest.mark.parametrize(("late", "words"), [(0.1, "lag the accelerometer by 100 ms"), (-0.15, "lead .* by 150 ms")])
def test_a_delay_beyond_all_clocks_is_refused(tmp_path: Path, rate: float, late: float, words: str) -> None:
    with pytest.raises(DataError, match=rf"rotor_1\.\.4 {words}, more than any clock offset \(50 ms\); correct the"):
        check_rotor_clock(climbs(tmp_path, late, rate=rate), ROBOT, 10.0)


@pytest.mark.parametrize("late", [-0.04, 0.0, 0.04])
def test_a_clock_is_set_and_not_refused(tmp_path: Path, late: float) -> None:
    check_rotor_clock(climbs(tmp_path, late, rate=100.0), ROBOT, 10.0)


def test_a_thrust_that_hardly_varies_tells_no_delay(tmp_path: Path) -> None:
    check_rotor_clock(climbs(tmp_path, 0.1, rate=100.0, vigour=1e-4), ROBOT, 10.0)


def test_a_force_along_z_that_follows_the_thrust_later_is_no_delay_where_the_turning_knows_of_none(tmp_path) -> None:
    """What rotors make turns the vehicle at once and lifts it 150 ms later: refused without a gyro, and with rotors that are
    late in both."""
    table, late = flight(5), round(0.15 * 200.0)
    table["acc_z"] = np.roll(table["acc_z"], late)
    felt_late = read_flight_log(write(table[late:-late], tmp_path / "felt_late.csv"))
    check_rotor_clock(felt_late, ROBOT, 10.0)
    with pytest.raises(DataError, match="lead the accelerometer by 150 ms"):
        check_rotor_clock(replace(felt_late, ang_vel=None), ROBOT, 10.0)
    table = flight(5)
    table[ROTORS] = np.roll(table[ROTORS], -late, axis=0)
    with pytest.raises(DataError, match=r"lead the accelerometer by 1[345]0 ms"):
        check_rotor_clock(read_flight_log(write(table[late:-late], tmp_path / "rotors.csv")), ROBOT, 10.0)
