"""What is each flight's own among the structures that compete with effects."""

import numpy as np
import pytest

from aerial_gym.sim2real.identify.candidates.nuisance import (
    _flight_offset_columns,
    flight_offsets,
    largest_flight_offsets,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian, tolerance_rms
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, uniform_flight

CHANNELS = [Channel(kind="specific_force", axis=axis) for axis in "xyz"]
MEANS = np.array([[0.1, 3.0, 0.2], [-0.1, -3.0, 0.2], [0.3, 0.0, 0.2]])
"""Of three flights in each channel; the last one does not differ."""


def residuals() -> list[np.ndarray]:
    waves = [np.sin(np.linspace(0.0, 2.0 * np.pi * 4.0, 40, endpoint=False)) for _ in MEANS]
    return [mean + wave[:, None] for mean, wave in zip(MEANS, waves, strict=True)]


def test_an_offset_of_a_flight_is_a_constant_of_that_flight_as_large_as_flights_differ_and_no_larger_than_they_may() -> (
    None
):
    result = _flight_offset_columns(CHANNELS, residuals(), np.array([1.0, 0.5, 1.0]))
    assert [one.name for one in result] == ["flight in specific_force.x", "flight in specific_force.y"]
    x, y = result
    assert x.is_flight_offset
    assert x.size == pytest.approx(0.2)
    assert y.size == 0.5
    for number, columns in enumerate(x.columns):
        expected = np.zeros((40, 3))
        expected[:, number] = 0.2
        np.testing.assert_allclose(columns.dense_columns((0,))[:, 0], expected, rtol=1e-6)
        assert not columns.dense_columns((1,)).any()
        assert columns.values.shape == (40, 1, 1)  # no zeros are kept
    weight = np.array([1.0, 2.0, 3.0])
    own = flight_offsets(result, CHANNELS, weight)
    np.testing.assert_allclose(own.size, [0.2, 0.5, 0.0])
    np.testing.assert_allclose(own.most, [1.0, 0.5, 0.0])


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
        result = largest_flight_offsets(predictor, tolerance_rms(tolerance, ROBOT.num_rotors))
        sizes[name] = dict(zip((channel.name for channel in channels), result, strict=True))
    assert 0.1 < sizes["felt"]["specific_force.x"] < 0.2
    assert sizes["derived"]["specific_force.x"] == 0.0
    turned = "angular_acceleration.x"
    assert sizes["derived"][turned] == pytest.approx(sizes["felt"][turned], rel=1e-6)
    assert sizes["felt"]["angular_acceleration.x"] > 0.0
