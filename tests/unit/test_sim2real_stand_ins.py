"""An effect keeps its name beside a structure that no effect has, and loses it where it only stands in for that structure."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import Effect
from aerial_gym.registry import Registry
from aerial_gym.sim2real import selection
from aerial_gym.sim2real.flights import load_flights
from aerial_gym.sim2real.prediction import Point, Predictor, find_channels
from aerial_gym.sim2real.scoring import Criteria
from aerial_gym.sim2real.tolerances import Tolerances
from tests.unit.flat_flights import ROBOT, flight, write

ROTORS = ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]


def fading(table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight whose thrust falls from 6.5 to 11.5 % below the declared one: rotors turn faster for it."""
    table[ROTORS] = table[ROTORS].div(np.sqrt(0.935 - 0.05 * table["t"] / table["t"].max()), axis=0)
    return table


def lifted_below(table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight on which something pushes up where it is low, by 0.4 m/s² per metre."""
    push = 0.4 * (table["p_z"] - 5.0)
    table[ROTORS] = table[ROTORS].mul(np.sqrt(1.0 + push / 9.81), axis=0)
    return table


@pytest.mark.parametrize(
    ("scale", "change", "named", "doubted"),
    [
        (1.0, fading, (), {"thrust_coefficient": "time"}),
        (0.9, lifted_below, ("thrust_coefficient",), {}),
        (0.9, lambda table: table, ("thrust_coefficient",), {}),
    ],
)
def test_a_name_holds_or_only_stands_in(
    scale: float,
    change: Callable[[pd.DataFrame], pd.DataFrame],
    named: tuple[str, ...],
    doubted: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only thrust and drag are looked for, to save time."""
    few: Registry[Effect] = Registry("effect")
    for name in ("thrust_coefficient", "rotor_drag"):
        few.register(name, EFFECTS.get(name))
    monkeypatch.setattr(selection, "EFFECTS", few)
    logs = [flight(seed, seconds=12.0, rate=100.0, noise=1.0, thrust_scale=scale) for seed in range(4)]
    paths = [write(change(log), tmp_path / f"f{n}.csv") for n, log in enumerate(logs)]
    flights = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    channels = find_channels(flights)
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=channels, tolerances=Tolerances())
    found = selection.select_effects(predictor, Point(), Criteria(), lambda stage, share: None)
    assert found.accepted == named
    assert found.doubted == doubted
