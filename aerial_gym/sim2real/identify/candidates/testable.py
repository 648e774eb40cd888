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
from aerial_gym.sim2real.identify.least_squares.gauss_newton import effect_jacobian
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import floor_of_columns, wide_predictor
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
    """Return how much of what would show an effect is noise of the logs: of its information beside the tolerances, the share.

    What an effect does is predicted from what was logged, and so has noise in it, of rotor speeds and rates. A fit takes that
    noise for the effect and makes it smaller until it no longer shows (attenuation): where a vehicle hardly moves, its inertia
    seems several times as large. The level of a derivative above the band of the comparison, carried down into it
    (``noise_floor``), tells how much of it is noise; the longest flight stands for all. Of several parameters and starts the
    one with the smallest share counts. Empty where rotors are driven by commands or the logs are too slow to tell.

    Args:
        predictor: Training flights.
        declared: The declared model.
        names: Effects.
        tolerance: Derivatives by the deviations within the tolerances, (rows, C, N).
        weight: Of one row of each channel, (C,).

    Source:
        Fuller (1987), Measurement Error Models, section 1.1 (attenuation and the reliability ratio).
    """
    flight = max(predictor.flights, key=lambda one: one.num_rows)
    if flight.rotor_speed is None:
        return {}  # commands have no noise: what they hold above the band was sent
    wide = wide_predictor(predictor.robot, flight, predictor.channels)
    predicted = [channel.kind != "rotor_speed" for channel in predictor.channels]  # that is made from commands
    weight = np.where(predicted, weight, 0.0)
    root, rows = np.sqrt(weight)[:, None], sum(time.size for time in predictor.times)
    beside = np.concatenate([(part * root).reshape(-1, part.shape[2]) for part in tolerance])
    inner = beside.T @ beside + np.eye(beside.shape[1])
    found: dict[str, float] = {}
    for name in names:
        for point in starts(name, declared, declared, predictor.robot):
            across = effect_jacobian(wide, point, (name,), wide.predict(point))[0]
            if not np.isfinite(across).all():
                continue
            num_rows, channels, params = across.shape
            columns = across.reshape(num_rows, channels * params)
            floor = floor_of_columns(columns, flight.rate, predictor.bandwidth, [False] * columns.shape[1])
            if floor is None:
                return {}
            noise = rows * weight @ floor.reshape(channels, params) ** 2
            parts = effect_jacobian(predictor, point, (name,), predictor.predict(point))
            own = np.concatenate([(part * root).reshape(-1, params) for part in parts])
            shared = beside.T @ own
            whole = (own**2).sum(axis=0) - (shared * np.linalg.solve(inner, shared)).sum(axis=0)
            shares = noise[whole > 0.0] / whole[whole > 0.0]
            if shares.size:
                found[name] = min(found.get(name, np.inf), float(shares.min()))
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
