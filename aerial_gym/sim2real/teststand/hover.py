"""Thrust coefficient from hover, where the rotors carry the weight: ``c_t = m f / sum(w²)``.

Letters: T rows, W windows, R rotors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.statistics import Estimate, Rms, student_quantile
from aerial_gym.sim2real.teststand.statistics import (
    cross_validation_error,
    errors_on_left_out_folds,
    fold_labels,
    hac_covariance,
    rms,
)

WINDOW_S = 0.5  # Length of the averaging windows [s]
SLOWEST = 0.4  # Largest speed [m/s] at hover; linear drag of 0.5 m/s² per m/s is then below 2 % of the weight
LARGEST_TILT = 0.15  # Largest tilt [rad] at hover; thrust then exceeds the weight by at most 1.2 %, which is corrected
FASTEST_TURN = 1.0  # Largest angular velocity [rad/s] at hover

FEWEST_WINDOWS = 4


@dataclass(frozen=True)
class HoverThrustMap:
    """One candidate thrust map."""

    thrust_map: tuple[float, float, float]  # c0, c1, c2 [N], [N s/rad], [N s²/rad²]
    error: Rms  # Held-out error of thrust over mass [m/s²], with its interval over flights or folds


@dataclass(frozen=True)
class HoverFit:
    """Thrust coefficient, and the scale of the declared thrust map."""

    mass: float
    thrust_coefficient: Estimate  # [N s²/rad²]
    scale: Estimate | None  # Factor of the declared thrust map; None without one
    by_flight: dict[str, float]  # Thrust coefficient of each flight
    models: dict[str, HoverThrustMap]
    chosen: str
    square_sum: Array = field(repr=False)  # Sum of squared speeds [rad²/s²], (W,)
    force: Array = field(repr=False)  # Thrust over mass [m/s²], (W,)
    notes: tuple[Finding, ...] = ()

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        errors = {name: plain(model.error) for name, model in self.models.items()}
        record: dict[str, object] = {"mass": self.mass, "windows": self.force.size}
        record |= {"c_t": self.thrust_coefficient.as_mapping(), "c_t_by_flight": self.by_flight}
        record |= {"chosen": self.chosen, "unit": "m/s²", "candidates": errors, "notes": list(self.notes)}
        if self.scale is not None:
            pairs = {"before": "declared", "after": self.chosen}
            record["scale"] = self.scale.as_mapping()
            record |= {when: {"model": name, "held_out": errors[name]} for when, name in pairs.items()}
        return record


def find_hover_rows(log: FlightLog, speed: Array) -> list[Flags]:
    """Return the rows (T,) of each hover window of a flight; ``speed`` are rotor speeds in any unit, (T, R)."""
    up = Rotation.from_quat(log.attitude).as_matrix()[:, 2, 2]
    still = up > np.cos(LARGEST_TILT)
    still &= speed.min(axis=1) > 0.2 * np.median(speed)  # excludes stopped rotors on the ground
    if log.lin_vel is not None:
        still &= np.linalg.norm(log.lin_vel, axis=1) < SLOWEST
    if log.ang_vel is not None:
        still &= np.linalg.norm(log.ang_vel, axis=1) < FASTEST_TURN
    label = np.floor((log.time - log.time[0]) / WINDOW_S).astype(int)
    usual = WINDOW_S / float(np.median(np.diff(log.time)))
    full = np.bincount(label, weights=still, minlength=label[-1] + 1) >= 0.9 * usual
    chosen = np.flatnonzero(full)
    if chosen.size < FEWEST_WINDOWS:
        raise DataError(
            f"{log.path}: hovers for {chosen.size} windows of {WINDOW_S:g} s (below {SLOWEST:g} m/s, {LARGEST_TILT:g} rad "
            f"and {FASTEST_TURN:g} rad/s), needs {FEWEST_WINDOWS}; give a flight that hovers"
        )
    return [still & (label == window) for window in chosen]


def means_of_hover_windows(log: FlightLog) -> tuple[Array, Array]:
    """Return means over the hover windows: sums over rotors of 1, w, w², (W, 3), and thrust over mass [m/s²], (W,).

    Without an accelerometer, the thrust is g over the cosine of the tilt.
    """
    if log.rotor_speed is None:
        raise DataError(f"{log.path}: needs measured rotor speeds; commands or duty cycles give no thrust coefficient")
    rows = find_hover_rows(log, log.rotor_speed)
    up = Rotation.from_quat(log.attitude).as_matrix()[:, 2, 2]
    force = STANDARD_GRAVITY / np.maximum(up, 0.1) if log.specific_force is None else log.specific_force[:, 2]
    powers = np.stack([(log.rotor_speed**p).sum(axis=1) for p in range(3)], axis=1)
    return np.array([powers[r].mean(axis=0) for r in rows]), np.array([force[r].mean() for r in rows])


def fit_hover(
    logs: Sequence[FlightLog], *, mass: float, mass_std: float = 0.0, declared: tuple[float, float, float] | None = None
) -> HoverFit:
    """Return the thrust coefficient from hover.

    Args:
        mass_std: Standard deviation of the mass [kg]; it widens the interval, since only c_t / m is observable.
        declared: Declared thrust map, for comparison and scaling.
    """
    if not 0.0 < mass < 1e3 or not 0.0 <= mass_std < mass:
        raise ConfigError(f"mass = {mass!r} ± {mass_std!r} kg: must be > 0, and its deviation in [0, mass)")
    parts, missed, notes = [], [], []
    for log in logs:
        try:
            parts.append((log.name, *means_of_hover_windows(log)))
            notes += [Finding("thrust_from_gravity", log.name)] if log.specific_force is None else []
        except DataError as error:
            missed.append(error)
    if not parts:
        raise missed[0] if missed else DataError("needs at least one flight that hovers")
    sizes = [force.size for *_, force in parts]
    group = fold_labels(sizes)
    _, *columns = zip(*parts, strict=True)
    moments, force = map(np.concatenate, columns)
    square, target = moments[:, 2], mass * force
    coefficient = _slope_with_interval(square, target, sizes, mass_std / mass)
    models = {"c_t w²": _fit_scaled_thrust_map((0.0, 0.0, 1.0), moments, force, mass, group)}
    scale = None
    if declared is not None:
        carried = (moments * declared).sum(axis=1)
        scale = _slope_with_interval(carried, target, sizes, mass_std / mass)
        models = {
            "declared": HoverThrustMap(declared, cross_validation_error(force - carried / mass, group)),
            "declared, scaled": _fit_scaled_thrust_map(declared, moments, force, mass, group),
            **models,
        }
    notes = [*(Finding("flight_left_out", "", {"error": str(error)}) for error in missed), *notes]
    if mass_std == 0.0:
        notes.append(Finding("mass_exact"))
    by_flight = {name: _slope_through_zero(sums[:, 2], mass * part) for name, sums, part in parts}
    chosen = min((name for name in models if name != "declared"), key=lambda name: models[name].error.value)
    return HoverFit(mass, coefficient, scale, by_flight, models, chosen, square, force, tuple(notes))


def _slope_through_zero(cause: Array, effect: Array) -> float:
    return float(cause @ effect / (cause @ cause))


def _slope_with_interval(cause: Array, effect: Array, sizes: Sequence[int], mass_error: float) -> Estimate:
    """Return the slope through the origin; the interval has the larger scatter of windows or flights, and the mass error."""
    slope = _slope_through_zero(cause, effect)
    unit = cause / rms(cause)
    residual = effect - slope * cause
    spread = (
        student_quantile(0.975, cause.size - 1) * np.sqrt(hac_covariance(unit[:, None], residual)[0, 0]) / rms(cause)
    )
    if len(sizes) >= 3:
        ends = np.cumsum(sizes)[:-1]
        each = [_slope_through_zero(c, e) for c, e in zip(np.split(cause, ends), np.split(effect, ends), strict=True)]
        spread = max(spread, student_quantile(0.975, len(each) - 1) * np.std(each, ddof=1) / np.sqrt(len(each)))
    half_width = float(np.hypot(spread, 1.96 * mass_error * slope))
    return Estimate.from_half_width(slope, half_width)


def _fit_scaled_thrust_map(
    shape: tuple[float, float, float], moments: Array, force: Array, mass: float, group: Indices
) -> HoverThrustMap:
    """Return a scaled thrust map of fixed shape, with the error of fits without each group."""
    carried, target = moments @ np.array(shape), mass * force
    errors = errors_on_left_out_folds(
        group, lambda out: force[out] - _slope_through_zero(carried[~out], target[~out]) * carried[out] / mass
    )
    size = _slope_through_zero(carried, target)
    c0, c1, c2 = (size * c for c in shape)
    return HoverThrustMap((c0, c1, c2), cross_validation_error(errors, group))
