"""Prediction errors of a model: residuals of each channel and open-loop rollouts, each with a 95 % interval."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.moments import time_block_of_rows
from aerial_gym.sim2real.logs.flights import Flight, flight_names
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import (
    HORIZONS_S,
    QUANTITIES,
    RolloutErrors,
    find_windows,
    rollout_errors_of_models,
)
from aerial_gym.sim2real.statistics import Rise, Rms, rise_with_interval, rms_with_interval

LEAST_GAP = 1.21
"""Least ratio of the residual's mean square to that of the noise floor at which a gap exists: 10 % in rms."""


@dataclass(frozen=True)
class ModelEvaluation:
    """Residuals and rollout errors of one model on the test flights."""

    channels: tuple[Channel, ...]
    residual: tuple[Rms, ...]  # Residual (rms) of each channel below the bandwidth of the comparison
    floor: tuple[float, ...] | None  # Noise floor (rms) of each channel; None where the logs are too slow to tell
    rollouts: dict[str, RolloutErrors]  # By variant: free, given_attitude
    rollout: dict[str, dict[str, dict[float, Rms]]]  # Rms by variant, quantity and horizon [s]

    def shares_of_gap_closed(self, before: "ModelEvaluation") -> list[float | None]:
        """Return the share of another model's mean square above the noise floor that this one removes, by channel."""
        floor = self.floor or (None,) * len(self.channels)
        pairs = zip(before.residual, self.residual, floor, strict=True)
        return [gap_closed(first.value, second.value, level) for first, second, level in pairs]

    def as_mapping(self, *, before: "ModelEvaluation | None" = None) -> dict[str, object]:
        """Return it for JSON, with the share of the gap closed since ``before``."""
        result: dict[str, object] = {}
        closed = None if before is None else self.shares_of_gap_closed(before)
        for place, (channel, rms) in enumerate(zip(self.channels, self.residual, strict=True)):
            entry: dict[str, object] = {**rms.as_mapping()}
            if self.floor is not None:
                entry["noise_floor"] = self.floor[place]
            if closed is not None:
                entry["gap_closed"] = closed[place]
            kind = result.setdefault(channel.kind, {"unit": channel.unit})
            assert isinstance(kind, dict)
            kind[channel.axis] = entry
        for variant, quantities in self.rollout.items():
            horizons: dict[str, dict[str, object]] = {}
            for quantity, values in quantities.items():
                for horizon, rms in values.items():
                    entry = {"unit": QUANTITIES[quantity], **rms.as_mapping()}
                    horizons.setdefault(f"{horizon:g}", {})[quantity] = entry
            name = "rollout" if variant == "free" else f"rollout_{variant}"
            result[name] = {"driven_by": self.rollouts[variant].driven_by, **horizons}
        return result


def evaluate_models(
    robot: RobotCfg, predictor: Predictor, models: Sequence[ModelParams], *, floor: Array | None, seed: int
) -> list[ModelEvaluation]:
    """Return residuals and rollouts of each model on flights that were not used for its fit.

    Rollouts are free only if all flights show torques; others take the attitude of the log.
    """
    flights, group = predictor.flights, time_block_of_rows(predictor.times)
    residuals = [np.concatenate(predictor.residuals(one)) for one in models]
    rollouts: list[dict[str, RolloutErrors]] = [{} for _ in models]
    if not reason_against_rollouts(flights):
        variants = {"free": False} if all(flight.torques for flight in flights) else {}
        more = {"links": [predictor.load_links(one) for one in models], "tolerances": predictor.tolerances}
        rollouts = rollout_errors_of_models(robot, flights, models, variants | {"given_attitude": True}, **more)
    results, floors = [], None if floor is None else tuple(floor.tolist())
    for residual, flown in zip(residuals, rollouts, strict=True):
        rms = tuple(rms_with_interval(residual, group, seed=seed))
        rollout = {name: _rollout_rms(errors, seed) for name, errors in flown.items()}
        results.append(ModelEvaluation(predictor.channels, rms, floors, flown, rollout))
    return results


def reason_against_rollouts(flights: Sequence[Flight]) -> Finding | None:
    """Return the reason why no rollout can start at a measured velocity and attitude; None if one can."""
    blind = [flight for flight in flights if flight.lin_vel is None]
    if blind:
        return Finding("rollouts_lack_velocity", flight_names(blind, flights))
    turning = [flight for flight in flights if flight.attitude_integrated]
    if turning:
        return Finding("rollouts_lack_attitude", flight_names(turning, flights))
    shortest = min(HORIZONS_S)
    if find_windows(flights, shortest).row.size:
        return None
    return Finding("rollouts_too_short", "", {"shortest_s": shortest})


def rollout_rises(errors: RolloutErrors, reference: RolloutErrors) -> Iterator[tuple[str, float, Rise]]:
    """Yield each quantity, horizon [s] and the relative rise of its error over the reference in the same windows."""
    for quantity in QUANTITIES:
        values, reference_values = getattr(errors, quantity), getattr(reference, quantity)
        if values is not None:
            rises = rise_with_interval(values, reference_values, errors.windows.cluster, errors.windows.flight)
            yield from ((quantity, *pair) for pair in zip(errors.horizons, rises, strict=True))


def gap_closed(before: float, after: float, floor: float | None) -> float | None:
    """Return the share ``(b² - a²) / (b² - f²)`` of the gap above floor f that closes from b to a; None without a gap."""
    if floor is None or before**2 < LEAST_GAP * floor**2:
        return None
    return (before**2 - after**2) / (before**2 - floor**2)


def _rollout_rms(errors: RolloutErrors, seed: int) -> dict[str, dict[float, Rms]]:
    result = {}
    for quantity in QUANTITIES:
        values = getattr(errors, quantity)
        if values is not None:
            results = rms_with_interval(values, errors.windows.cluster, seed=seed)
            result[quantity] = dict(zip(errors.horizons, results, strict=True))
    return result
