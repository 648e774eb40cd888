"""Units, signs and order of velocity and position: each mistake is named with its way out, good and quiet logs pass."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real import find_mapping, read_flight_log
from aerial_gym.sim2real.logs.checks.units import (
    axis_relation,
    check_units_against_accelerometer,
    check_units_of_velocity_and_position,
)
from tests.repetitions import thin_values
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_flight, write

V, P, ACC = (["v_x", "v_y", "v_z"], ["p_x", "p_y", "p_z"], ["acc_x", "acc_y", "acc_z"])


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """Return a flight whose position and velocity are as noisy as those of an estimator."""
    result = flight(1, seconds=12.0, rate=100.0, noise=1.0)
    noise = np.random.default_rng(5).standard_normal((2, len(result), 3))
    result[P] += 0.01 * noise[0]
    result[V] += 0.05 * noise[1]
    return result


def check(table: pd.DataFrame, folder: Path) -> list[str]:
    log = read_flight_log(write(table, folder / "a.csv"))
    notes = check_units_of_velocity_and_position(log)
    check_units_against_accelerometer(log)
    return notes


def scale(table: pd.DataFrame, columns: list[str], factor: object) -> pd.DataFrame:
    return table.assign(**{name: table[name] * k for name, k in zip(columns, np.broadcast_to(factor, 3), strict=True)})


def swap_columns(table: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    result = table.copy()
    result[columns[:2]] = table[[columns[1], columns[0]]].to_numpy()
    return result


def test_a_good_log_passes_whatever_it_lacks(table: pd.DataFrame, tmp_path: Path) -> None:
    for missing in ([], V, P, ACC, [*V, *P]):
        assert check(table.drop(columns=missing), tmp_path) == []


@pytest.mark.parametrize(
    ("unit", "factor"),
    thin_values(
        [("mph", 0.44704), ("kn", 1.852 / 3.6), ("km/h", 1 / 3.6), ("ft/s", 0.3048), ("mm/s", 1e-3), ("cm/s", 1e-2)], 3
    ),
)
def test_the_unit_of_velocity_is_named_and_the_way_out_mends_it(table, tmp_path, unit, factor) -> None:
    wrong = scale(table, V, 1.0 / factor)
    match = rf"v_x, v_y, v_z were in {unit} \(factor .*\): give lin_vel unit: {unit} in a mapping file"
    with pytest.raises(DataError, match=match):
        check(wrong, tmp_path)
    with pytest.raises(DataError, match=match):
        check(wrong.drop(columns=ACC), tmp_path)
    entry = f"lin_vel: {{columns: [v_x, v_y, v_z], unit: {unit}}}\n"
    base = Path(__file__).parents[5] / "aerial_gym/sim2real/logs/mappings/aerial_gym.yaml"
    lines = [line for line in base.read_text().splitlines() if not line.startswith("lin_vel")]
    (tmp_path / "mended.yaml").write_text("\n".join([*lines, entry]))
    path = write(wrong, tmp_path / "b.csv")
    mended = load_flight(path, ROBOT, mapping=find_mapping(tmp_path / "mended.yaml"), bandwidth=10.0)
    right = load_flight(write(table, tmp_path / "c.csv"), ROBOT, mapping=None, bandwidth=10.0)
    np.testing.assert_allclose(mended.lin_vel, right.lin_vel, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("change", "message"), [
    (lambda t: scale(t, P, 1 / 0.3048), r"if p_x, p_y, p_z were in ft \(factor 0\.3.*give position unit: ft"),
    (lambda t: scale(t, P, 1e3), r"if p_x, p_y, p_z were in mm .*give position unit: mm"),
    (lambda t: scale(t, V, 1.6), r"v_x, v_y, v_z need a factor of 0\.62.*, which is no known unit: give lin_v"),
    (lambda t: scale(t, P, (-1, 1, 1)), r"it looks as if p_x have the wrong sign: multiply each column by -1"),
    (lambda t: scale(t, V, (1, 1, -1)), r"it looks as if v_z have the wrong sign"),
    (lambda t: scale(t, V, (1, 1, -1)).drop(columns=ACC), r"it looks as if v_z or p_z have the wrong sign"),
    (lambda t: swap_columns(t, V), r"the axes of v were exchanged: name its columns in the order y, x, z"),
    (lambda t: swap_columns(t, P), r"the axes of p were exchanged: name its columns in the order y, x, z"),
    (
        lambda t: scale(scale(t, V, 1 / 0.3048), P, 1 / 0.3048),
        r"the change of velocity and position contradicts acc .* v_z were in ft/s .*unit: ft/s.*p_z were in ft .*unit: ft",
    ),
    (lambda t: scale(t, V, 1 / 0.44704).drop(columns=P), r"the change of velocity .* v_x, v_y, v_z were in mph"),
    (lambda t: scale(t, P, 1 / 0.3048).drop(columns=V), r"the change of position .* p_x, p_y, p_z were in ft "),
    (
        lambda t: scale(scale(t, V, (1, -1, 1)), P, (1, -1, 1)),
        r"contradict acc and attitude; it looks as if v_y and p_y have the wrong sign: multiply the columns by -1",
    ),
])  # fmt: skip
def test_other_units_signs_and_orders(table: pd.DataFrame, tmp_path: Path, change: object, message: str) -> None:
    with pytest.raises(DataError, match=message) as refused:
        check(change(table), tmp_path)
    assert str(refused.value).count("looks as if") == 1


def test_a_log_that_hardly_moves_cannot_tell_and_passes(table: pd.DataFrame, tmp_path: Path) -> None:
    rng, hover = np.random.default_rng(3), table.copy()
    hover[P] = 0.01 * rng.standard_normal((len(table), 3)) + (0.0, 0.0, 1.0)
    hover[V] = 0.05 * rng.standard_normal((len(table), 3))
    hover[ACC] = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]]).apply([0.0, 0.0, 9.81], inverse=True)
    for factor in (1.0, 1 / 0.44704):
        assert check(scale(hover, V, factor), tmp_path) == []


def test_a_lesser_factor_is_said_and_left(table: pd.DataFrame, tmp_path: Path) -> None:
    (note,) = check(scale(table, V, (1.1, 1.0, 1.0)), tmp_path)
    assert (note.code, note.values["axes"]) == ("velocity_factor", ["x"])
    assert note.values["factor"] == pytest.approx([1.1], abs=0.01)
    assert note.values["low"] < note.values["factor"] < note.values["high"]


def test_the_factor_lies_between_both_regressions_and_they_cover_it() -> None:
    """Noise on both sides as large as half the signal: one slope is 0.8, the inverse of the other 1.25; 1 lies between."""
    rng, missed = np.random.default_rng(7), 0
    for _ in range(300):
        true = rng.standard_normal((40, 3))
        result = axis_relation(
            0.447 * (true + 0.5 * rng.standard_normal((40, 3))), true + 0.5 * rng.standard_normal((40, 3))
        )
        assert result.order == (0, 1, 2)
        missed += int(np.sum((result.low > 0.447) | (result.high < 0.447)))
    assert missed == 0  # of 900, at 4 standard errors


def test_no_log_of_noise_is_refused() -> None:
    """Of 2,000 logs whose vectors have nothing to do with each other none is found scaled, turned or exchanged."""
    rng = np.random.default_rng(8)
    result = [axis_relation(rng.standard_normal((30, 3)), rng.standard_normal((30, 3))) for _ in range(2000)]
    assert not any(one is not None and one.wrong_axes.any() for one in result)
