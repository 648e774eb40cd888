"""Test of effects on inertial sensors against the kinematic channels, which need no dynamics."""

from collections.abc import Iterable, Sequence

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.evidence.fitting import Fitter
from aerial_gym.sim2real.identify.least_squares.moments import flight_of_rows, time_block_of_rows
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.predict.channels import KINEMATIC
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.statistics import sum_with_interval


def effects_against_kinematics(fitter: Fitter, params: ModelParams, names: Iterable[str]) -> dict[str, Finding]:
    """Return the effects on inertial sensors, among ``names``, that the kinematic channels contradict on training flights.

    Such an effect stands in for an error of the dynamics. With it these channels alone are less probable than without, by
    more than ``LEAST_SCORE`` and the 95 % interval of the scatter between parts of flights. Tolerances fit them as well as
    they can in both cases: a logged attitude that is turned by 1 degree makes the right turn of the gyro look wrong.
    """
    predictor = fitter.predictor
    places = [k for k, channel in enumerate(predictor.channels) if channel.kind in KINEMATIC]
    tested = [name for name in names if places and isinstance(EFFECTS.get(name), ImuEffect)]
    if not tested:
        return {}
    results, group, flight = dict[str, Finding](), time_block_of_rows(predictor.times), flight_of_rows(predictor.times)
    loss, cost, missed = loss_beyond_tolerances(fitter, params, places)
    for name in tested:
        neutral = params.with_effect(name, neutral_params(name, fitter.declared, predictor.robot))
        loss_without, cost_without, missed_without = loss_beyond_tolerances(fitter, neutral, places)
        least = sum_with_interval(loss - loss_without, group, flight)[1] + cost - cost_without
        if least > LEAST_SCORE:
            rises = np.sqrt(missed / missed_without) - 1.0
            channel = predictor.channels[places[int(rises.argmax())]].name
            results[name] = Finding("kinematics_disagree", name, {"channel": channel, "rise": float(rises.max())})
    return results


def loss_beyond_tolerances(fitter: Fitter, params: ModelParams, channels: Sequence[int]) -> tuple[Array, float, Array]:
    """Return the loss of log likelihood in some channels by row, that of the deviations fitted to them alone, and squares.

    The squares are those of each channel without deviations, summed over rows.
    """
    residual = np.concatenate(fitter.predictor.residuals(params))[:, channels]
    root, deviation = np.sqrt(fitter.weights.weight[list(channels)]), np.zeros(0)
    scaled = residual * root
    columns = [np.concatenate([own.dense_columns(channels) for own in one]) for one in fitter.tolerance_columns()]
    if columns:
        derivatives = np.concatenate(columns, axis=2).astype(float) * root[:, None]  # (rows, channels, N)
        flat = derivatives.reshape(-1, len(columns))
        deviation = np.linalg.solve(flat.T @ flat + np.eye(len(columns)), flat.T @ scaled.ravel())
        scaled = scaled - derivatives @ deviation
    return 0.5 * (scaled**2).sum(axis=1), 0.5 * float(deviation @ deviation), (residual**2).sum(axis=0)
