"""Random wind: the test whether the remaining residual of the specific force is caused by ``gusts``, and their size.

A random wind predicts no row and lowers no residual, so only the statistics of the residual show it. The derivative of the
model's drag turns the residual of the specific force into an equivalent wind along world axes. If that wind is an
Ornstein-Uhlenbeck process and nothing else, it is called gusts. Letters: T rows, C channels, P features.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding, finding_on_refusal
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.judge.outcome import NOT_SHOWN, NOTHING_NAMED, Decision
from aerial_gym.sim2real.judge.random_wind.common_wind import CommonWind, correlation_of_winds, winds_of_pairs
from aerial_gym.sim2real.judge.random_wind.ornstein_uhlenbeck import (
    CORR_TIMES,
    WindSeries,
    covariance_of_filtered_process,
    fit_process,
    p_value_of_noise,
    p_values_of_rivals,
    std_of_logarithms,
)
from aerial_gym.sim2real.judge.verdict import MOST_CONFIDENT, NamedEffect, parameters_in_file
from aerial_gym.sim2real.logs.flights import Flight, values_in_all_mappings
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.noise_floor import noise_floor_of_flight
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times

NAME = "gusts"
LAWS = ("a vertical axis of its own", "the same process on each axis")
PARAMETERS = ("std", "corr_time", "vertical", "vertical_time")

WIND_STEP = 0.01  # Difference step of the wind [m/s]

LEAST_RESPONSE = 0.02
"""Least acceleration per wind along every axis [1/s]: with less, noise of 0.02 m/s² looks like a wind of 1 m/s."""

LEAST_P_VALUE = 0.001  # Gusts are refused if the p-value of any property that they cannot have is smaller


@dataclass(frozen=True)
class RandomWind:
    """Fitted or declared gusts, with the objections to them."""

    std: float = 0.0  # Standard deviation of the wind along each axis [m/s]
    corr_time: float = 1.0  # Correlation time [s]
    spread: tuple[float, ...] = (0.0, 0.0)  # Standard deviations of the logarithms of the parameters
    p_value: float = 1.0  # P-value of the process against white noise alone
    objections: tuple[Finding, ...] = ()  # Reasons why the residual is not called gusts
    untestable: Finding | None = None  # Reason why the flights cannot show gusts; None if they can
    vertical: tuple[float, ...] = ()  # Relative std and correlation time of the vertical axis; empty if it has no own

    gain: float = 0.0
    """Log likelihood that a vertical axis of its own gains, less the cost of its two parameters."""

    common: CommonWind | None = None  # Whether both vehicles of a pair feel it; None without pairs

    @property
    def is_accepted(self) -> bool:
        """Whether the flights show gusts."""
        return self.std > 0.0 and not self.objections and self.untestable is None

    def params(self) -> dict[str, float]:
        """Return the parameters as in robot files."""
        values = (self.std, self.corr_time, *self.vertical)
        return {name: float(f"{value:.6g}") for name, value in zip(PARAMETERS, values, strict=False)}

    @property
    def notes(self) -> tuple[Finding, ...]:
        """Notes on gusts: their effect on the noise floor, or the objections to them."""
        if self.is_accepted:
            laws = LAWS if self.vertical else LAWS[::-1]
            odds = self.gain if self.vertical else -self.gain
            law = Finding("law_preferred", NAME, {"law": laws[0], "other": laws[1], "log_odds": odds})
            both = [] if self.common is None else [self.common.finding]
            return (Finding("gusts_are_random", NAME), *both, *([law] if self.gain else []))
        return (finding_on_refusal("gusts_refused", NAME, self.objections),) if self.objections else ()

    def decision(self, made: Decision) -> Decision:
        """Return a decision with accepted gusts among its candidates."""
        if not self.is_accepted:
            return made
        if made.kind not in NOTHING_NAMED:
            return replace(made, candidates=(*made.candidates, NAME))
        if self.common is not None and self.common.finding.code == "gusts_undecided":
            return Decision(kind="ambiguous", candidates=(NAME,), findings=(self.common.finding, *made.findings))
        rest = made.findings if made.kind == NOT_SHOWN else (Finding("gusts_reach_floor", NAME),)
        return Decision(kind="explained", candidates=(NAME,), findings=rest)

    def as_effect(self, robot: RobotCfg) -> NamedEffect:
        """Return the gusts as an effect of the verdict."""
        std = {key: value * s for (key, value), s in zip(self.params().items(), self.spread, strict=True)}
        confidence, declared = float(min(1.0 - self.p_value, MOST_CONFIDENT)), parameters_in_file(NAME, robot)
        more = {"std": std, "noise_std": std, "frozen": (), "confidence": confidence, "declared": declared}
        return NamedEffect(name=NAME, params=self.params(), **more)

    def channel_rms(self, predictor: Predictor, params: ModelParams) -> Array:
        """Return the rms that the wind adds to the residual of each channel below the bandwidth, (C,)."""
        response = np.concatenate(wind_response(predictor, params))
        size, time = self.vertical or (1.0, 1.0)
        axes = ((1.0, 1.0), (1.0, 1.0), (size, time))
        variance = [
            (own * self.std) ** 2
            * covariance_of_filtered_process(share * self.corr_time, predictor.bandwidth, np.zeros(1))[0]
            for own, share in axes
        ]
        return np.sqrt(np.mean(response**2 @ np.array(variance), axis=0))


def random_wind_in_file(robot: RobotCfg) -> RandomWind:
    """Return the gusts that a robot file declares; a std of 0 if it declares none."""
    if NAME not in robot.effects:
        return RandomWind()
    std, corr_time, *vertical = EFFECTS.get(NAME).parse_params(robot.effects[NAME])
    return RandomWind(std=std, corr_time=corr_time, vertical=() if vertical == [1.0, 1.0] else tuple(vertical))


def noise_floors_in_declared_wind(predictor: Predictor, params: ModelParams) -> list[Array | None]:
    """Return each flight's noise floors (C,), with the declared random wind; None where the log shows none."""
    wind = random_wind_in_file(predictor.robot).channel_rms(predictor, params)
    settings = (params, predictor.channels, predictor.bandwidth)
    floors = [noise_floor_of_flight(predictor.robot, flight, *settings) for flight in predictor.flights]
    return noise_floors_with_wind(floors, wind)


def noise_floors_with_wind(floors: Sequence[Array | None], wind: Array) -> list[Array | None]:
    """Return the root sum of squares of each flight's noise floors and the rms of random wind, (C,) each."""
    return [None if floor is None else np.hypot(floor, wind) for floor in floors]


def find_random_wind(
    predictor: Predictor,
    params: ModelParams,
    criteria: Criteria,
    *,
    floor: Array | None,
    tolerated: Array,
    remaining: Flags,
) -> RandomWind:
    """Return the gusts fitted to the remaining residual, with the reasons why they are refused or not testable.

    Args:
        params: The final model, with the best deviations within the tolerances.
        floor: Noise floor (rms) of each channel, (C,); None where the logs are too slow to tell.
        tolerated: Residual (rms) that the tolerances of the vehicle cause, (C,).
        remaining: Whether the residual of each channel exceeds noise and tolerances, (C,).
    """
    places = [place for place, channel in enumerate(predictor.channels) if channel.kind == "specific_force"]
    if floor is None:
        return RandomWind(untestable=Finding("gusts_no_floor", NAME))
    if len(places) != 3 or any(flight.lin_vel is None for flight in predictor.flights):
        return RandomWind(untestable=Finding("gusts_no_forces", NAME))
    response = [part[:, places] for part in wind_response(predictor, params)]
    if np.linalg.svd(np.concatenate(response), compute_uv=False)[:, -1].min() < LEAST_RESPONSE:
        return RandomWind(untestable=Finding("gusts_no_drag", NAME))
    if not remaining[places].any():
        return RandomWind()
    series = wind_series(predictor, params, response, places)
    fit, common = fit_process(series), None
    winds = equivalent_winds(predictor, params, response, places)
    if pairs := winds_of_pairs(predictor.flights, predictor.times, winds, series.step):
        common = correlation_of_winds(pairs, series, fit)
        if common.probability > 0.5:  # two logs of one wind count once
            series = series.select([k for k, f in enumerate(predictor.flights) if f.pair is None or not f.pair.vehicle])
            fit = fit_process(series)
    results = RandomWind(
        fit.std,
        fit.corr_time,
        std_of_logarithms(series, fit),
        p_value_of_noise(series, fit),
        vertical=fit.vertical,
        gain=fit.gain,
        common=common,
    )
    added, still = results.channel_rms(predictor, params)[places], floor[places]
    share, seen = 1.0 - still / np.hypot(still, added), added > criteria.visible * tolerated[places]
    objections = []
    if results.p_value > criteria.significance:
        objections.append(Finding("may_be_noise", NAME, {"p_value": results.p_value}))
    if max(share * seen) < criteria.material:
        objections.append(Finding("adds_too_little", NAME))
    if not CORR_TIMES[0] * 1.5 < results.corr_time < 2.0 * max(flight.time[-1] for flight in predictor.flights):
        objections.append(Finding("wrong_corr_time", NAME, {"corr_time_s": results.corr_time}))
    p_values = p_values_of_rivals(series, fit)
    objections += [
        Finding("rival_process", NAME, {"process": process, "p_value": p})
        for process, p in p_values.items()
        if p < LEAST_P_VALUE
    ]
    return replace(results, objections=tuple(objections))


def wind_response(predictor: Predictor, params: ModelParams) -> list[Array]:
    """Return the derivative of each flight's predicted channels with respect to wind along world axes, (T, C, 3)."""
    still = params.effects.get("constant_wind", np.zeros(3))
    base, columns = predictor.predict(params.with_effect("constant_wind", still)), []
    for axis in range(3):
        moved = predictor.predict(params.with_effect("constant_wind", still + WIND_STEP * np.eye(3)[axis]))
        columns.append([(m - b) / WIND_STEP for m, b in zip(moved, base, strict=True)])
    return [np.stack([column[flight] for column in columns], axis=2) for flight in range(len(base))]


def equivalent_winds(
    predictor: Predictor, params: ModelParams, response: Sequence[Array], places: Sequence[int]
) -> list[Array]:
    """Return the wind that would cause the residual of each flight's force (channels ``places``), world, (T, 3)."""
    residuals = [left[:, places, None] for left in predictor.residuals(params)]
    return [np.linalg.solve(gain, left)[:, :, 0] for gain, left in zip(response, residuals, strict=True)]


def wind_series(
    predictor: Predictor, params: ModelParams, response: Sequence[Array], places: Sequence[int]
) -> WindSeries:
    """Return the wind that would cause the residual of the specific force (channels ``places``)."""
    stride = max(1, round(1.0 / (predictor.bandwidth * float(np.median(np.diff(predictor.times[0]))))))
    rows = [np.arange(0, time.size, stride) for time in predictor.times]
    residuals = predictor.residuals(params)
    offsets = [np.linalg.inv(gain[kept]) for gain, kept in zip(response, rows, strict=True)]
    wind = [
        (inverse @ left[kept][:, places, None])[:, :, 0]
        for inverse, left, kept in zip(offsets, residuals, rows, strict=True)
    ]
    times = [time[kept] for time, kept in zip(predictor.times, rows, strict=True)]
    step = float(np.median(np.diff(times[0])))
    parts = [force_features(flight, time - step) for flight, time in zip(predictor.flights, times, strict=True)]
    features = values_in_all_mappings(parts)
    return WindSeries(wind=wind, features=features, offsets=offsets, step=step, bandwidth=predictor.bandwidth)


def force_features(flight: Flight, time: Array) -> dict[str, Array]:
    """Return quantities that later gusts do not depend on, but other causes of a force may, (T, P) by name.

    Those of the same row do depend on them: in a hover all motion is the vehicle's response to the wind.
    """
    rows = rows_at_times(flight, time)
    turn = Rotation.from_quat(flight.attitude[rows])
    yaw = np.arctan2(*turn.apply([1.0, 0.0, 0.0])[:, 1::-1].T)
    results = {
        "heading": np.stack([wave(k * yaw) for k in (1, 2, 3) for wave in (np.cos, np.sin)], axis=1),
        "time in flight": np.stack((time, time**2, time**3), axis=1),
        "attitude": turn.apply([0.0, 0.0, 1.0]),
    }
    if flight.lin_vel is not None:
        velocity = flight.lin_vel[rows]
        results["velocity"] = np.concatenate((velocity, velocity * np.linalg.norm(velocity, axis=1)[:, None]), axis=1)
    if flight.position is not None:
        x, y, z = flight.position[rows].T
        results["position"] = np.stack((x, y, z, x * x, y * y, z * z, x * y, y * z, x * z), axis=1)
    return results
