"""An effect keeps its name beside a structure that no effect has, and loses it where it only stands in for that structure."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest
from aerial_gym.sim2real.identify.selection.surrogates import SurrogateTest

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import Effect
from aerial_gym.registry import Registry
from aerial_gym.sim2real.identify.candidates.structure import Structure
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit
from aerial_gym.sim2real.identify.selection import select
from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.judge.verdict import tied_rivals
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, declared_params
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

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
    ("scale", "change", "named", "surrogates"),
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
    surrogates: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Only thrust and drag are looked for, to save time."""
    few: Registry[Effect] = Registry("effect")
    for name in ("thrust_coefficient", "rotor_drag"):
        few.register(name, EFFECTS.get(name))
    monkeypatch.setattr(select, "EFFECTS", few)
    logs = [flight(seed, seconds=12.0, rate=100.0, noise=1.0, thrust_scale=scale) for seed in range(4)]
    paths = [write(change(log), tmp_path / f"f{n}.csv") for n, log in enumerate(logs)]
    flights = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    channels = find_channels(flights)
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=channels, tolerances=Tolerances())
    found = select.select_effects(predictor, ModelParams(), Criteria(), lambda stage, share: None)
    assert found.accepted == named
    assert found.surrogates == surrogates


@pytest.mark.parametrize(
    ("gyro", "candidates"), [(True, {"thrust_coefficient"}), (False, {"thrust_coefficient", "payload_mass"})]
)
def test_thrust_and_mass_are_told_by_torques_as_far_as_the_inertia_is_known(
    gyro: bool, candidates: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """5 % less thrust: a mass in its place needs an inertia off by 2.6 deviations about all axes; forces alone do not tell."""
    few: Registry[Effect] = Registry("effect")
    for name in ("thrust_coefficient", "payload_mass"):
        few.register(name, EFFECTS.get(name))
    monkeypatch.setattr(select, "EFFECTS", few)
    logs = [flight(seed, seconds=12.0, rate=100.0, noise=1.0, thrust_scale=0.95) for seed in range(4)]
    if not gyro:
        logs = [log.drop(columns=["omega_x", "omega_y", "omega_z"]) for log in logs]
    flights = load_flights(
        [write(log, tmp_path / f"f{n}.csv") for n, log in enumerate(logs)], ROBOT, mapping=None, bandwidth=10.0
    )
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=find_channels(flights), tolerances=Tolerances())
    found = select.select_effects(predictor, ModelParams(), Criteria(), lambda stage, share: None)
    (named,) = found.accepted
    assert {named, *tied_rivals(named, found)} == candidates
    surrogates = dict.fromkeys(candidates - {named}, "time")  # what only stands in for a structure is no rival
    assert tied_rivals(named, replace(found, surrogates=surrogates)) == []


def test_a_steady_wind_is_not_called_a_shear_that_hardly_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between 4 and 6 m a shear with a small power is a constant wind; the wider of two cases is no rival."""
    few: Registry[Effect] = Registry("effect")
    for name in ("constant_wind", "wind_shear", "rotor_drag"):
        few.register(name, EFFECTS.get(name))
    monkeypatch.setattr(select, "EFFECTS", few)
    drag = {"dx": 0.3, "dy": 0.3, "dz": 0.3}
    robot = replace(ROBOT, effects={"rotor_drag": drag}, effects_source="flown with it")
    logs = [flight(seed, seconds=12.0, rate=100.0, noise=1.0, drag=0.3, wind=(0.4, -0.3, 0.0)) for seed in range(4)]
    paths = [write(log, tmp_path / f"f{n}.csv") for n, log in enumerate(logs)]
    flights = load_flights(paths, robot, mapping=None, bandwidth=10.0)
    predictor = Predictor(robot, flights, bandwidth=10.0, channels=find_channels(flights), tolerances=Tolerances())
    declared = declared_params(robot)
    found = select.select_effects(predictor, declared, Criteria(), lambda stage, share: None)
    assert found.accepted == ("constant_wind",)
    assert tied_rivals("constant_wind", found) == []


@pytest.mark.parametrize(
    ("beside", "changes", "is_surrogate"),
    [(2.0, True, False), (0.9, True, True), (0.9, False, False), (0.4, False, True)],
)
def test_what_gains_more_beside_a_structure_than_alone_is_no_part_of_it(
    beside: float, changes: bool, is_surrogate: bool
) -> None:
    class Given(SurrogateTest):
        """Evidence and change are given, of an effect that gains 1 alone."""

        def __init__(self) -> None:
            self._structure = Structure(kind="position", share=0.5)

        def _evidence(self, less: list[np.ndarray]) -> tuple[float, float]:
            return 1.0, beside

        def _changes(self, name: str, fit: Fit, neutral: np.ndarray) -> bool:
            return changes

    fit = cast("Fit", None)
    assert Given().is_surrogate("rotor_drag", fit, np.zeros(3), []) is is_surrogate
