"""Which effects a set of flights can test at all, and which parameters end where physics ends."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import ImuEffect
from aerial_gym.physics.model import check_rotors
from aerial_gym.sim2real.identify.candidates.library import starts
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    WEAK_PRIOR,
    effect_jacobian,
    is_number,
    tolerance_jacobian,
)
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import FIT_FROM, floor_of_columns, wide_predictor
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.replay.rotor_commands import missing_in_logs, too_steady
from aerial_gym.sim2real.predict.scene import lacks_of_scene

Array = NDArray[np.float64]


def lacks(name: str, robot: RobotCfg, train: Sequence[Flight], test: Sequence[Flight] = ()) -> str:
    """Return what robot file or logs lack for an effect; empty if nothing."""
    effect, flights = EFFECTS.get(name), [*train, *test]
    if effect.kind is ImuEffect and not any(flight.accelerometer or flight.gyro for flight in train):
        return "the logs hold no inertial sensor: forces are derived from the velocity"
    if reason := missing_in_logs(effect, flights) or lacks_of_scene(name, flights) or too_steady(effect, train):
        return reason
    try:
        check_rotors(effect, robot.rotor_traits)
        effect.check(robot)
    except ConfigError as error:
        return str(error)
    return ""


def noise_shares(
    predictor: Predictor, declared: ModelParams, names: Sequence[str], tolerance: Sequence[Array], weight: Array
) -> dict[str, float]:
    """Return the share by which noise of the logs would make an effect smaller in a fit: how much of it is not seen.

    What an effect does is predicted from what was logged, and so has noise in it, of rotor speeds and rates. A fit takes that
    noise for the effect and makes it smaller until it no longer shows (attenuation): where a vehicle hardly moves, its inertia
    seems several times as large. With P the normal equations of an effect and the tolerances beside it, L the inverse prior
    variances and N the part of P that is noise, a parameter of 1 is fitted as ``((P + L)^-1 (P - N))_kk``. N is made of the
    level of each derivative above the band of the comparison, carried down into it (``noise_floor``), and of how derivatives
    go together up there; the longest flight stands for all. Of several parameters and starts the one that is seen best
    counts. Empty where rotors are driven by commands, which have no noise, or the logs are too slow to tell.

    Args:
        predictor: Training flights.
        declared: The declared model.
        names: Effects.
        tolerance: Derivatives by the deviations within the tolerances, (rows, C, N).
        weight: Of one row of each channel, (C,).

    Source:
        Fuller (1987), Measurement Error Models, section 2.2 (attenuation and the moments of the noise).
    """
    flight = max(predictor.flights, key=lambda one: one.num_rows)
    if flight.rotor_speed is None:
        return {}
    wide, band = wide_predictor(predictor.robot, flight, predictor.channels), predictor.bandwidth
    predicted = [channel.kind != "rotor_speed" for channel in predictor.channels]  # these come from commands
    root = np.sqrt(np.where(predicted, weight, 0.0))[:, None]
    rows, found = sum(time.size for time in predictor.times), dict[str, float]()

    def noise_of(columns: Array) -> Array | None:
        """Return rows (T C, K) whose sums of products are as large as those of the noise in derivatives (T, C, K)."""
        moved = columns.any(axis=0)
        if not moved.any():
            return rows_of(columns)
        own = columns[:, moved]
        floor = floor_of_columns(own, flight.rate, band, [False] * own.shape[1])
        if floor is None:
            return None
        above = own - lowpass(own, flight.rate, FIT_FROM * band)
        size, found = np.sqrt((above**2).sum(axis=0)), np.zeros(columns.shape)
        found[:, moved] = above * (np.sqrt(rows) * floor / np.where(size > 0.0, size, np.inf))
        return rows_of(found)

    def rows_of(columns: Array) -> Array:
        return (columns * root).reshape(-1, columns.shape[2])

    noise_beside = noise_of(tolerance_jacobian(wide, declared, wide.predict(declared))[0])
    if noise_beside is None:
        return {}
    beside = rows_of(np.concatenate(tolerance))
    for name in names:
        for point in starts(name, declared, declared, predictor.robot):
            noise = noise_of(effect_jacobian(wide, point, (name,), wide.predict(point))[0])
            own = rows_of(np.concatenate(effect_jacobian(predictor, point, (name,), predictor.predict(point))))
            if noise is None or not (np.isfinite(noise).all() and np.isfinite(own).all()):
                continue
            chosen = [k for k in range(own.shape[1]) if is_number(name, k) and own[:, k].any()]
            whole, noise = np.hstack((own[:, chosen], beside)), np.hstack((noise[:, chosen], noise_beside))
            product, prior = whole.T @ whole, np.repeat((WEAK_PRIOR**-2, 1.0), (len(chosen), beside.shape[1]))
            seen = np.diag(np.linalg.solve(product + np.diag(prior), product - noise.T @ noise))[: len(chosen)]
            if seen.size:
                found[name] = min(found.get(name, np.inf), float(1.0 - seen.max()))
    return found


def at_bounds(name: str, params: ModelParams, neutral: Array, robot: RobotCfg) -> list[str]:
    """Return the parameters of an effect that end at a bound that is not neutral: the cause is another one."""
    effect, found = EFFECTS.get(name), []
    rows = zip(effect.parameters, effect.bounds(robot), params.effects[name], neutral, strict=True)
    for parameter, bounds, value, start in rows:
        near = 1e-3 * parameter.scale
        ends = [bound for bound in bounds if abs(value - bound) <= near]
        if parameter.kind == "number" and ends and abs(start - ends[0]) > near:
            found.append(parameter.name)
    return found
