"""Commands on their way to the rotors in a replay of logs: lag, dead time and battery against closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.errors import ShapeError
from aerial_gym.sim2real.flight_log import read_flight_log
from aerial_gym.sim2real.flights import Flight, complete_flight
from aerial_gym.sim2real.rotor_lag import follow_commands
from aerial_gym.sim2real.rotor_replay import RotorReplay
from aerial_gym.sim2real.signals import uniform_log
from tests.unit.flat_flights import flight, write

F64 = torch.float64
TAU_UP, TAU_DOWN = 0.05, 0.03


def step_flight(folder: Path, *, rate: float, seconds: float, step_s: float = 0.5, high: float = 1100.0) -> Flight:
    """Return a flight whose command steps from 900 rad/s up at ``step_s`` and back half a second later, from rest at 900."""
    path = write(flight(3, rate=rate, seconds=seconds), folder / f"{rate:g}.csv")
    found = complete_flight(uniform_log(read_flight_log(path)))
    time = np.arange(found.num_rows) / rate
    command = np.where((time >= step_s - 1e-9) & (time < step_s + 0.5 - 1e-9), high, 900.0)[:, None].repeat(4, axis=1)
    return replace(found, rotor_command=command, rotor_speed=np.full_like(command, 900.0))


def up_and_down(time: np.ndarray, start: float, high: float = 1100.0) -> np.ndarray:
    """Return the speed [rad/s] of a step up from 900 at ``start`` and down half a second later, through the lag."""
    top = high + (900.0 - high) * np.exp(-0.5 / TAU_UP)
    rise = high + (900.0 - high) * np.exp(-np.maximum(time - start, 0.0) / TAU_UP)
    fall = 900.0 + (top - 900.0) * np.exp(-np.maximum(time - start - 0.5, 0.0) / TAU_DOWN)
    return np.where(time < start + 0.5, rise, fall)


def lags(scale: float = 1.0) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.full((4,), scale * TAU_UP, dtype=F64), torch.full((4,), scale * TAU_DOWN, dtype=F64)


def test_flights_of_several_rates_and_lengths_rise_and_fall_by_their_own_lag(tmp_path: Path) -> None:
    """``w_c + (w_0 - w_c) exp(-t / tau)`` with one constant up and another down; a flight without commands stays None."""
    flights = [step_flight(tmp_path, rate=rate, seconds=3.0 + rate / 200.0) for rate in (100.0, 200.0)]
    flights.insert(1, replace(flights[0], rotor_command=None))
    found = RotorReplay(flights).speeds(*lags(), 0.0)
    assert found[1] is None
    for number in (0, 2):
        speed, time = found[number], np.arange(flights[number].num_rows) / flights[number].rate
        assert speed is not None
        assert speed.shape == (time.size, 4)
        np.testing.assert_allclose(speed[:, 3], up_and_down(time, 0.5), rtol=1e-12)


def test_rotors_without_lag_follow_at_once(tmp_path: Path) -> None:
    driven = step_flight(tmp_path, rate=100.0, seconds=3.0)
    speed = RotorReplay([driven]).speeds(*lags(0.0), 0.0)[0]
    assert speed is not None
    assert driven.rotor_command is not None
    np.testing.assert_array_equal(speed[1:], driven.rotor_command[:-1])


def test_tables_that_do_not_fit_are_refused() -> None:
    table, ends, one = torch.ones(5, 4, dtype=F64), torch.tensor([0, 6], dtype=torch.int32), torch.ones(1, dtype=F64)
    with pytest.raises(ShapeError, match=r"commands have shapes \(5, 4\) and \(5, 4\), expected \(6, 4\)"):
        follow_commands(table[:1], table, table, one, ends=ends, step=one, tau_up=table[0], tau_down=table[0])
