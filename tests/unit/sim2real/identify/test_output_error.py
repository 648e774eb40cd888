"""The effects fitted on whole rollouts, on exact flights whose drag is known."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from aerial_gym.interop import one_thread
from aerial_gym.sim2real.identify.output_error import Refit, _doubts, impossible, refit_on_rollouts
from aerial_gym.sim2real.identify.selection.scoring import Criteria
from aerial_gym.sim2real.identify.selection.select import Selection, select_effects
from aerial_gym.sim2real.identify.window_rollouts import eliminated
from aerial_gym.sim2real.logs.flights import load_flights
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, declared_params
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, write

DRAG = 0.25
AXES = ("dx", "dy")


def refit(folder, effect: str, tables: list[pd.DataFrame]) -> Refit:
    """Return the refit of one effect, the only one that is looked for."""
    with one_thread():
        return refit_on_rollouts(*selected(folder, effect, tables))


def selected(folder, effect: str, tables: list[pd.DataFrame]) -> tuple[Predictor, Selection]:
    """Return the selection where one effect alone is looked for, and what it predicts with."""
    paths = [write(table, folder / f"f{number}.csv") for number, table in enumerate(tables)]
    flights = load_flights(paths, ROBOT, mapping=None, bandwidth=10.0)
    predictor = Predictor(ROBOT, flights, bandwidth=10.0, channels=find_channels(flights), tolerances=Tolerances())
    selection = select_effects(predictor, declared_params(ROBOT), Criteria(), candidates=(effect,))
    assert selection.accepted == (effect,)
    return predictor, selection


def flights_with_drag(noise: float) -> list[pd.DataFrame]:
    return [flight(30 + seed, drag=DRAG, noise=noise, seconds=20.0, rate=100.0) for seed in range(3)]


@pytest.mark.slow
def test_rollouts_find_the_drag_and_leave_it_to_precise_single_steps(tmp_path) -> None:
    found = refit(tmp_path, "rotor_drag", flights_with_drag(1.0))
    changes = {change.parameter: change for change in found.changes}
    for axis in AXES:
        assert abs(changes[axis].rollout - DRAG) < 3.0 * changes[axis].std
        assert changes[axis].rollout == pytest.approx(changes[axis].step, rel=0.05)
    assert not found.adopted
    assert not found.contradictions
    assert found.as_mapping()["because"] == list(found.objections)


@pytest.mark.slow
def test_rollouts_decide_where_accelerometers_are_noisy(tmp_path) -> None:
    """Noise of 5 m/s² leaves single steps unsure; velocity and attitude are exact, and so rollouts know the drag."""
    tables, rng = flights_with_drag(0.0), np.random.default_rng(0)
    for table in tables:
        table[["acc_x", "acc_y", "acc_z"]] += 5.0 * rng.standard_normal((len(table), 3))
    found = refit(tmp_path, "rotor_drag", tables)
    changes = {change.parameter: change for change in found.changes}
    for axis in AXES:
        assert abs(changes[axis].rollout - DRAG) < 3.0 * changes[axis].std
        assert abs(changes[axis].rollout - DRAG) < abs(changes[axis].step - DRAG)
    assert found.adopted, found.objections
    assert found.velocity > 0.05
    assert found.scored is not None
    assert found.scored.fit.params.effects["rotor_drag"][0] == pytest.approx(DRAG, rel=0.01)


@pytest.mark.slow
def test_a_sensor_that_reads_too_little_strains_its_tolerance_and_does_not_decide(tmp_path) -> None:
    """An accelerometer that reads 20 % less sideways: its scale is many tolerances away, and rollouts have the true drag."""
    tables = flights_with_drag(1.0)
    for table in tables:
        table[["acc_x", "acc_y"]] *= 0.8
    with one_thread():
        predictor, selection = selected(tmp_path, "rotor_drag", tables)
        found = refit_on_rollouts(predictor, selection)
    deviation = dict(zip(predictor.tolerances.names(4), selection.chosen.named.deviation, strict=True))
    assert deviation["acc_scale_x"] < -5.0
    assert deviation["acc_scale_y"] < -5.0
    assert abs(deviation["acc_scale_z"]) < 1.0
    for change in found.changes:
        if change.parameter in AXES:
            assert change.step < 0.85 * DRAG
            assert abs(change.rollout - DRAG) < 3.0 * change.std
    assert not found.adopted
    assert any("specific_force" in objection for objection in found.objections)


@pytest.mark.slow
def test_a_sensor_that_is_cut_off_is_told_by_the_difference(tmp_path) -> None:
    """An accelerometer that reads half of the largest sideways force at most: steps say less drag, rollouts the truth."""
    tables = flights_with_drag(1.0)
    for table in tables:
        most = 0.5 * table[["acc_x", "acc_y"]].abs().quantile(0.99).max()
        table[["acc_x", "acc_y"]] = table[["acc_x", "acc_y"]].clip(-most, most)
    found = refit(tmp_path, "rotor_drag", tables)
    for change in found.changes:
        if change.parameter in AXES:
            assert change.step < 0.9 * DRAG
            assert abs(change.rollout - DRAG) < 3.0 * change.std
    assert not found.adopted
    assert any("rotor_drag dx" in text for text in found.contradictions)
    assert any("single steps rule out its rotor_drag dx" in text for text in found.objections)


def test_what_is_left_when_starts_are_eliminated_is_the_least_of_the_whole_problem() -> None:
    """Against one least-squares problem in the parameters and in nine errors of the start of each window, all written out."""
    rng, windows, rows, params = np.random.default_rng(3), 4, 5, 2
    residual, weight = rng.standard_normal((windows, rows, 6)), rng.uniform(0.5, 2.0, (rows, 6))
    jacobian, start = rng.standard_normal((params, windows, rows, 6)), rng.standard_normal((9, windows, rows, 6))
    sums = eliminated(residual, jacobian, start, weight)
    step = np.linalg.solve(sums.product.sum(axis=(0, 1)), sums.gradient.sum(axis=(0, 1)))
    each, root = rows * 6, np.sqrt(weight).ravel()
    matrix = np.zeros((windows * (each + 9), params + 9 * windows))
    right = np.zeros(len(matrix))
    for w in range(windows):
        own, free = slice(w * each, (w + 1) * each), slice(params + 9 * w, params + 9 * (w + 1))
        matrix[own, :params] = jacobian[:, w].reshape(params, -1).T * root[:, None]
        matrix[own, free] = start[:, w].reshape(9, -1).T * root[:, None]
        right[own] = residual[w].ravel() * root
        matrix[windows * each + 9 * w : windows * each + 9 * (w + 1), free] = np.eye(9)
    whole, least, *_ = np.linalg.lstsq(matrix, right, rcond=None)
    np.testing.assert_allclose(step, whole[:params], rtol=1e-9)
    np.testing.assert_allclose(sums.squares_after(np.tile(step, (windows, 1))).sum(), least, rtol=1e-9)


@pytest.mark.parametrize(
    ("names", "change", "said"),
    [
        (("rotor_drag",), {}, ""),
        ((), {}, "no effect is accepted"),
        (("rotor_drag",), {"lin_vel": None}, "the logs have no velocity and attitude to compare rollouts with"),
        (("rotor_drag",), {"attitude_integrated": True}, "the logs have no velocity and attitude"),
        (("slung_payload",), {}, "where a slung load hangs at the start of a window is not logged"),
        (("imu_bias",), {}, "errors of the inertial sensors change no rollout"),
        (("imu_bias", "rotor_drag"), {}, ""),
    ],
)
def test_why_nothing_is_fitted_on_rollouts(names: tuple[str, ...], change: dict, said: str) -> None:
    flights = [SimpleNamespace(**({"lin_vel": np.zeros((3, 3)), "attitude_integrated": False} | change))]
    params = ModelParams(effects={name: np.zeros(1) for name in names})
    final = SimpleNamespace(effects=names, fit=SimpleNamespace(params=params))
    selection = SimpleNamespace(accepted=names, final=final)
    found = impossible(SimpleNamespace(flights=flights), selection)  # type: ignore[arg-type]
    assert found.startswith(said) if said else found == ""


@pytest.mark.parametrize(
    ("velocity", "attitude", "said"),
    [
        ([0.5] * 4, [1.0] * 4, []),
        ([0.97] * 4, [1.0] * 4, ["it takes at most 1.5% off the rollout errors of flights left out"]),
        ([0.2, 0.2, 1.1, 1.1], [1.0] * 4, ["only 50% of the flights left out are predicted better"]),
        ([0.3] * 4, [1.3] * 4, ["it makes the attitude of rollouts worse by 14.0%"]),
        ([1.0] * 4, [1.0] * 4, ["the gain on flights left out may be chance", "only 0%", "it takes at most 0.0%"]),
    ],
)
def test_why_rollouts_do_not_decide(velocity: list[float], attitude: list[float], said: list[str]) -> None:
    """Four flights of eight windows; mean squares after the refit over those before it, falls of rms by their roots."""
    flight = np.repeat(np.arange(4), 8)
    windows = SimpleNamespace(flight=flight, cluster=np.arange(32))
    before = np.random.default_rng(0).uniform(0.9, 1.1, (32, 2))
    after = before * np.stack((np.array(velocity)[flight], np.array(attitude)[flight]), axis=1)
    falls = 1.0 - np.sqrt(after.sum(axis=0) / before.sum(axis=0))
    found = _doubts(before, after, falls, windows, Criteria())  # type: ignore[arg-type]
    assert len(found) == len(said), found
    assert all(text.startswith(start) for text, start in zip(found, said, strict=True)), found
