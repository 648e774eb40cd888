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
    residual, tolerances = np.concatenate(fitter.predictor.residuals(params))[:, channels], fitter.tolerance_columns()
    root, parts = np.sqrt(fitter.weights.weight[list(channels)]), list[tuple[list[int], Array]]()
    scaled, none = residual * root, np.empty((len(residual), 0))
    for channel, factor in zip(channels, root, strict=True):  # without zeros, as all columns together are large
        moving = [k for k, one in enumerate(tolerances) if channel in one[0].channels]
        columns = (np.concatenate([own.dense_columns([channel])[:, 0] for own in tolerances[k]]) for k in moving)
        parts.append((moving, np.concatenate([none, *columns], axis=1) * factor))
    product, gradient = np.eye(len(tolerances)), np.zeros(len(tolerances))
    for own, (moving, columns) in zip(scaled.T, parts, strict=True):
        product[np.ix_(moving, moving)] += columns.T @ columns
        gradient[moving] += columns.T @ own
    deviation = np.linalg.solve(product, gradient)
    for own, (moving, columns) in zip(scaled.T, parts, strict=True):
        own -= columns @ deviation[moving]
    return 0.5 * (scaled**2).sum(axis=1), 0.5 * float(deviation @ deviation), (residual**2).sum(axis=0)
