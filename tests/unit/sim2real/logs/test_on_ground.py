"""A vehicle that stands before take-off and after landing: those rows are found and not compared."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.logs.flights import Flight, load_flight
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import declared_params
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

RATE = 100.0
ROTORS = [f"rotor_{n}" for n in range(1, 5)]
FIELDS = [f"{name}_{axis}" for name in ("p", "v", "omega", "acc") for axis in "xyz"]


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    return flight(1, seconds=6.0, rate=RATE, noise=1.0)


def on_ground(table: pd.DataFrame, rows: int, *, idle: float, at: int = 0) -> pd.DataFrame:
    """Return rows of a vehicle that stands as in a row of the flight, with idling rotors."""
    rng = np.random.default_rng(0)
    ground = table.iloc[[at] * rows].copy()
    ground = ground.assign(**dict.fromkeys(("v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z"), 0.0))
    attitude = Rotation.from_quat(ground[["q_x", "q_y", "q_z", "q_w"]].to_numpy(copy=True))
    ground[["acc_x", "acc_y", "acc_z"]] = attitude.apply([0.0, 0.0, 9.81], inverse=True)
    ground[FIELDS] += 0.002 * rng.standard_normal((rows, len(FIELDS)))
    ground[ROTORS] = idle * (1.0 + 0.003 * rng.standard_normal((rows, 4)))
    return ground


def loaded(parts: list[pd.DataFrame], folder: Path) -> Flight:
    whole = pd.concat(parts, ignore_index=True)
    whole["t"] = np.arange(len(whole)) / RATE
    return load_flight(write(whole, folder / "a.csv"), ROBOT, mapping=None, bandwidth=10.0)


@pytest.mark.parametrize("idle", [0.0, 200.0])
def test_rows_on_the_ground_are_found_without_a_height(table: pd.DataFrame, tmp_path: Path, idle: float) -> None:
    """All but a few rows at the touch, where low-passed thrust is that of neither; none of the flight."""
    found = loaded([on_ground(table, 150, idle=idle), table, on_ground(table, 150, idle=idle, at=-1)], tmp_path)
    assert found.on_ground is not None
    inner = np.r_[0:130, len(table) + 170 : len(table) + 300]
    assert found.on_ground[inner].all()
    assert not found.on_ground[160 : 140 + len(table)].any()
    assert any("stands on the ground in" in note for note in found.notes)
    channels = find_channels([found])
    predictor = Predictor(ROBOT, [found], bandwidth=5.0, channels=channels, tolerances=Tolerances())
    residual = predictor.residuals(declared_params(ROBOT))[0]
    assert np.abs(residual[:, 2]).max() < 0.5  # standing, it would be g


def test_a_flight_that_never_stands_has_no_such_rows(table: pd.DataFrame, tmp_path: Path) -> None:
    assert loaded([table], tmp_path).on_ground is None


def test_a_drop_with_idle_rotors_is_flight(table: pd.DataFrame, tmp_path: Path) -> None:
    """Nothing carries a vehicle that falls: its accelerometer reads next to nothing."""
    falling = on_ground(table, 60, idle=100.0, at=-1)
    falling[["acc_x", "acc_y", "acc_z"]] *= 0.01
    assert loaded([table, falling], tmp_path).on_ground is None


def test_a_log_of_a_vehicle_on_the_ground_is_refused(table: pd.DataFrame, tmp_path: Path) -> None:
    ground = on_ground(table, 4000, idle=200.0, at=-1)
    with pytest.raises(DataError, match=r"stands on the ground in 8\d% of the rows: .* cut the log to the flight"):
        loaded([table, ground], tmp_path)
