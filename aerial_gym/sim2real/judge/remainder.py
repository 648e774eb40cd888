"""Named winds and sensor errors that explain less of the residual than stays unexplained, and effects that gusts imitate.

Only the training flights decide. Letters: C channels.
"""

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import left_out_mean_square, linearise_at_params
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.select import FinalFit, SelectionResult
from aerial_gym.sim2real.judge.random_wind.gusts import (
    LEAST_P_VALUE,
    NAME,
    RandomWind,
    equivalent_winds,
    find_random_wind,
    noise_floors_in_declared_wind,
    random_wind_in_file,
    wind_response,
)
from aerial_gym.sim2real.judge.residual_excess import (
    channel_rms,
    excess_power,
    is_judged,
    is_material_excess,
    model_with_training_deviations,
)
from aerial_gym.sim2real.logs.recording import flight_numbers
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import rms_of_noise_floors
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.statistics import chi_square_tail

OUTSIDE = ("environment", "sensor")  # What an effect acts on, if it is no value of the vehicle


def are_gusts_sufficient(train: Predictor, declared: ModelParams, selection: SelectionResult) -> bool:
    """Return whether the declared vehicle in gusts explains the training flights, although effects were selected.

    Feedback makes thrust and attitude follow gusts, so effects imitate them: in a hover, a centre of mass 0.3 m too high.
    These leave an excess in the force. Gusts suffice if they pass all of their tests, no other channel has an excess without
    effects, and the mean is that of gusts: in force, along body axes, within tolerances, and in wind, along world axes. In a
    mean, a wind of correlation time T counts ``2 T`` over the time flown of its variance.
    """
    if NAME in train.robot.effects or not selection.best.effects:
        return False
    forces = np.array([channel.kind == "specific_force" for channel in train.channels])
    if not (forces & _open_channels(train, selection)[2]).any():
        return False
    weight, floor = selection.weights.weight, rms_of_noise_floors(noise_floors_in_declared_wind(train, declared))
    fit = linearise_at_params(train, (), declared, tolerance_jacobian(train, declared, np.float32))
    within = model_with_training_deviations(declared, fit, weight)
    excess = is_material_excess(channel_rms(train.residuals(within)), floor, selection.tolerated)
    excess &= is_judged(train.channels, train.flights)
    known = {"floor": floor, "tolerated": selection.tolerated, "remaining": excess}
    if (excess & ~forces).any() or not (
        wind := find_random_wind(train, within, selection.criteria, **known)
    ).is_accepted:
        return False
    mean, span = np.concatenate(train.residuals(declared)).mean(axis=0), sum(float(time[-1]) for time in train.times)
    std = np.hypot(selection.tolerated, np.sqrt(2.0 * wind.corr_time / span) * wind.channel_rms(train, within))
    places = [place for place, is_force in enumerate(forces) if is_force]
    response = [part[:, places] for part in wind_response(train, within)]
    steady = np.concatenate(equivalent_winds(train, within, response, places)).mean(axis=0)
    size, time = wind.vertical or (1.0, 1.0)
    drawn = wind.std * np.sqrt(2.0 * wind.corr_time / span) * np.array([1.0, 1.0, size * np.sqrt(time)])
    squares = (mean[places] / std[places]) ** 2, (steady / drawn) ** 2
    return all(chi_square_tail(float(each.sum()), 3) >= LEAST_P_VALUE for each in squares)


def effects_below_remainder(train: Predictor, declared: ModelParams, selection: SelectionResult) -> dict[str, Finding]:
    """Return the named winds and sensor errors that no channel supports, each with its finding.

    Wind and sensor errors can take the shape of an unknown cause. A value of the vehicle cannot so easily: a moment of inertia
    is real even where unsteady air leaves a larger residual. An explained channel supports an effect. Any other channel does
    if the effect removes more of its mean square than remains above the noise floor, each training flight predicted by a
    fit of the others. The gain in log likelihood of these channels must reach ``LEAST_SCORE``.
    """
    names = [name for name in selection.effect_names if EFFECTS.get(name).acts_on in OUTSIDE]
    remainder = power_above_noise(train, selection) if names else np.zeros(0)
    if not remainder.any():
        return {}
    rows, weight = sum(time.size for time in train.times), selection.weights.weight
    numbers, final = flight_numbers(train.flights), FinalFit(train, declared, selection)
    power = left_out_mean_square(selection.fit, weight, numbers)
    channels = [channel.name for channel, left in zip(train.channels, remainder, strict=True) if left]
    results = {}
    for name in names:
        less = selection.without[name]
        removed = left_out_mean_square(final.fit(less.effects, less.params)[0], weight, numbers) - power
        gain = 0.5 * rows * float(weight @ np.where(removed > remainder, removed, 0.0))
        if gain < LEAST_SCORE * selection.best.parameter_overdispersion:
            results[name] = Finding("remainder_larger", name, {"channels": channels})
    return results


def power_above_noise(train: Predictor, selection: SelectionResult) -> Array:
    """Return the mean square above noise and random wind that training flights leave beyond tolerances, (C,)."""
    fit, weight = selection.fit, selection.weights.weight
    rms, floor, is_open = _open_channels(train, selection)
    if floor is None or not is_open.any():
        return np.zeros(rms.size)
    within = model_with_training_deviations(fit.params, fit, weight)
    known = {"floor": floor, "tolerated": selection.tolerated, "remaining": is_open}
    is_declared = random_wind_in_file(train.robot).is_accepted  # then part of the noise floor
    wind = RandomWind() if is_declared else find_random_wind(train, within, selection.criteria, **known)
    if wind.is_accepted:
        floor = np.hypot(floor, wind.channel_rms(train, within))
        is_open &= is_material_excess(rms, floor, selection.tolerated)
    return is_open * excess_power(rms, floor)


def _open_channels(train: Predictor, selection: SelectionResult) -> tuple[Array, Array | None, Flags]:
    """Return the rms of flights left out, without their offsets, its noise floor, and where it exceeds that and tolerances."""
    floor = rms_of_noise_floors(noise_floors_in_declared_wind(train, selection.fit.params))
    square = left_out_mean_square(selection.fit, selection.weights.weight, flight_numbers(train.flights))
    rms = np.sqrt(square.clip(min=0.0))
    excess = is_material_excess(rms, floor, selection.tolerated)
    return rms, floor, excess & is_judged(train.channels, train.flights)
