"""The comparison of simulated IMUs with their files: its estimates, and what the command leaves."""

import json
from pathlib import Path

import pytest
import torch

from aerial_gym.sensors import IMUS
from aerial_gym.sensors.allan import allan_deviation
from benchmarks.devices.imu_allan import (
    AllanRecord,
    ImuAllanCmd,
    compare,
    crossing_s,
    fit_densities,
    interval,
    lowest_point,
    shares,
)

NOISE, WALK, DT = 0.7, 0.2, 0.25


def signals(num_signals: int, count: int, seed: int) -> torch.Tensor:
    """Return white noise on a bias that walks, (T, S), made without the IMU."""
    draws = torch.randn(2, count, num_signals, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    return NOISE * draws[0] / DT**0.5 + (WALK * draws[1] * DT**0.5).cumsum(0)


def test_known_densities_are_found_whatever_is_assumed_and_their_intervals_hold_them() -> None:
    """95 % intervals of 100 experiments hold the truth in 88 to 100 of them (binomial, 3 standard errors)."""
    held = torch.zeros(2)
    for seed in range(100):
        tau, deviation = allan_deviation(signals(32, 1024, seed), DT)
        squares = fit_densities(tau, deviation, DT, torch.tensor([4.0 * NOISE**2, 0.5 * WALK**2], dtype=torch.float64))
        for column, truth in enumerate((NOISE, WALK)):
            result, low, high = interval(squares[:, column])
            assert result == pytest.approx(truth, rel=0.25)
            held[column] += low <= truth <= high
    assert ((held >= 88) & (held <= 100)).all()


def test_shares_are_the_variances_of_a_sampled_walk_by_hand() -> None:
    """Steps s of variance 1: neighbours differ by s, averages of two by (s1 + 2 s2 + s3) / 2. Half the variance of each."""
    result = shares(torch.tensor([1.0, 2.0]), 1.0)
    torch.testing.assert_close(result, torch.tensor([[1.0, 0.5], [0.5, 0.75]]))
    torch.testing.assert_close(shares(torch.tensor([3.0]), 3.0), torch.tensor([[1.0 / 3.0, 1.5]]))


def test_interval_is_that_of_the_mean() -> None:
    """Squares 1, 4, 9: mean 14/3, standard error sqrt(49/3) / sqrt(3)."""
    result, low, high = interval(torch.tensor([1.0, 4.0, 9.0], dtype=torch.float64))
    half = 1.96 * (49.0 / 3.0) ** 0.5 / 3.0**0.5
    assert (result, low, high) == pytest.approx(((14 / 3) ** 0.5, (14 / 3 - half) ** 0.5, (14 / 3 + half) ** 0.5))


def test_the_lowest_point_is_where_the_lines_meet() -> None:
    """``N / sqrt(tau) = K sqrt(tau / 3)``; the longest averaging times do not count."""
    tau = crossing_s(NOISE, WALK)
    assert NOISE / tau**0.5 == pytest.approx(WALK * (tau / 3.0) ** 0.5)
    short, long = (
        AllanRecord(dt=dt, tau=dt * 2.0 ** torch.arange(8), deviation=torch.ones(8, 2, 6)) for dt in (1.0, 5.0)
    )
    assert lowest_point(8.5, short, long) == (short, 3)
    assert lowest_point(60.0, short, long) == (long, 4)  # 64 s of the short record is left out
    assert lowest_point(20.0, short, long) == (long, 2)


def test_rows_tell_a_wrong_density_from_a_right_one() -> None:
    cfg = IMUS.get("bmi088")
    fast, slow = (AllanRecord.simulate(cfg, dt=dt, num_sensors=32, num_samples=1024, seed=3) for dt in (0.01, 0.5))
    right = compare("bmi088", cfg, fast, slow)
    assert [row["sensor"] + row["axis"] for row in right[:4]] == ["accelx", "accely", "accelz", "gyrox"]
    for row in right:
        for name in ("noise", "walk", "lowest"):
            configured, low, high = (row[f"{name}_{label}"] for label in ("configured", "low", "high"))
            assert low - (high - low) <= configured <= high + (high - low), (row, name)  # 6 standard errors
    wrong = compare("bmi088", IMUS.get("vn100"), fast, slow)
    assert not wrong[3]["noise_low"] <= wrong[3]["noise_configured"] <= wrong[3]["noise_high"]


def test_the_command_prints_rows_and_draws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = {"out": tmp_path, "imu": ("vn100",), "num_sensors": 4, "num_samples": 64}
    assert ImuAllanCmd(**common, json=True).run() == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(row["sensor"], row["axis"]) for row in rows] == [
        (kind, axis) for kind in ("accel", "gyro") for axis in "xyz"
    ]
    assert rows[3]["noise_configured"] == IMUS.get("vn100").gyro_noise_density[0]
    assert (tmp_path / "imu_allan.png").read_bytes().startswith(b"\x89PNG")
    assert ImuAllanCmd(**common).run() == 0
    assert "K found" in capsys.readouterr().out
