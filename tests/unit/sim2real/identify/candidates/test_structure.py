"""The structure of what remains, made up on the paths of exact flights."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.identify.candidates.structure import find_structure
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel
from tests.unit.sim2real.flat_flights import flight, load_tables


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
