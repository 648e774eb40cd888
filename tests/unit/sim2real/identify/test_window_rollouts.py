"""Rollouts of many models side by side: each that moves in its own way is flown once."""

from itertools import count

import numpy as np
import pytest

from aerial_gym.interop import one_thread
from aerial_gym.sim2real.identify import window_rollouts
from aerial_gym.sim2real.identify.window_rollouts import Rollouts
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, declared_params
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import Batch
from aerial_gym.sim2real.predict.tolerances import Tolerances
from aerial_gym.sim2real.predict.windows import find_windows
from tests.unit.sim2real.flat_flights import ROBOT, flight, write


def test_models_whose_sensors_alone_differ_are_flown_once(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sums are those of flying every one of them, bit by bit; mass, thrusts, inertias, centre and drag move differently."""
    paths = [write(flight(seed, drag=0.2, seconds=6.0, rate=100.0), tmp_path / f"{seed}.csv") for seed in range(2)]
    flights = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=find_channels(flights), tolerances=Tolerances())
    drag = np.array([0.1, 0.1, 0.0])
    params = declared_params(ROBOT).with_effect("rotor_drag", drag)
    windows = find_windows(predictor.flights, 1.0, every=1.0, most=8)
    flown: list[int] = []

    def spied(vehicles, points: list[ModelParams], *args, **options) -> Batch:
        flown.append(len(points))
        return Batch(vehicles, points, *args, **options)

    monkeypatch.setattr(window_rollouts, "Batch", spied)
    with one_thread():
        once = Rollouts(predictor, windows).linearise(("rotor_drag",), params, frozenset())
        numbers = count()
        monkeypatch.setattr(window_rollouts, "_moves_alike", lambda off, params: (next(numbers),))
        every = Rollouts(predictor, windows).linearise(("rotor_drag",), params, frozenset())
    assert flown[1] == 1 + 3 + predictor.num_tolerances
    assert flown[0] < 0.6 * flown[1]
    np.testing.assert_array_equal(once.fit.moments.product, every.fit.moments.product)
    np.testing.assert_array_equal(once.fit.moments.gradient, every.fit.moments.gradient)
