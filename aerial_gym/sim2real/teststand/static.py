"""Rotor thrust and torque at steady speed: polynomials selected by held-out error.

Letters: T rows, K terms.
"""

from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.statistics import Estimate, Rms
from aerial_gym.sim2real.teststand.statistics import (
    LawFit,
    cross_validation_error,
    estimates,
    hc3_covariance,
    leverage,
    rms,
    smallest_good_candidate,
)
from aerial_gym.sim2real.teststand.tables import Bench, check_plausibility_of_rotor_data

FEWEST_ROWS = 6

MAPS: dict[str, tuple[int, ...]] = {
    "w²": (2,),
    "w² and constant": (2, 0),
    "w² and w": (2, 1),
    "w², w and constant": (2, 1, 0),
}
"""Powers of the speed in each map that a robot file supports."""

BEYOND = {"w³, w² and w": (3, 2, 1)}
"""A map that no robot file supports; a much smaller error of it shows that second order is insufficient."""

STALLED = 0.02  # Least thrust, relative to the highest, at which a speed of 0 indicates a failed speed sensor


class MapFit(LawFit):
    """Fit of one candidate map: coefficients c3 to c0, c2 in .. s²/rad², or a torque ratio [m]."""

    def polynomial(self) -> tuple[float, float, float]:
        """Return c0, c1, c2."""
        c0, c1, c2 = (self.params[f"c{p}"].value if f"c{p}" in self.params else 0.0 for p in range(3))
        return c0, c1, c2

    def polynomial_values(self, speed: Array) -> Array:
        """Return the polynomial at speeds, (T,)."""
        return np.polyval(self.polynomial()[::-1], speed)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        numbers = select_fields(self, "name", "fit_rms", "held_out_rms")
        return {**numbers, "coefficients": plain(self.params)}


@dataclass(frozen=True, kw_only=True)
class MapChoice:
    """Candidate maps for one quantity, and the selected one."""

    unit: str
    candidates: dict[str, MapFit]
    chosen: str
    nested: Array  # Nested cross-validation errors, with the map selected again without that row, (T,)

    @property
    def best(self) -> MapFit:
        """Selected candidate."""
        return self.candidates[self.chosen]

    @property
    def rms_squared_only(self) -> Rms:
        """Held-out error of the map with w² alone."""
        return self.candidates["w²"].error

    @property
    def rms_chosen(self) -> Rms:
        """Nested cross-validation error of the selection."""
        return cross_validation_error(self.nested)

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {
            **select_fields(self, "unit", "chosen"),
            "before": {"model": "w²", "held_out": plain(self.rms_squared_only)},
            "after": {"model": self.chosen, "held_out": plain(self.rms_chosen)},
            "candidates": plain(list(self.candidates.values())),
        }


@dataclass(frozen=True)
class StaticFit:
    """Rotor maps from one static test."""

    name: str
    speed: Array  # [rad/s], (T,)
    thrust: Array  # [N], (T,)
    torque: Array | None  # [N m], (T,)
    thrust_map: MapChoice
    torque_map: MapChoice | None
    torque_ratio: Estimate | None  # Torque over thrust [m]
    notes: tuple[Finding, ...]
    reverse: "StaticFit | None" = None  # Maps of reverse rotation, with signs of speed, thrust and torque inverted

    @property
    def thrust_coefficient(self) -> Estimate:
        """Thrust coefficient [N s²/rad²] of the fit with w² alone."""
        return self.thrust_map.candidates["w²"].params["c2"]

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        parts = {
            "c_t": self.thrust_coefficient,
            "thrust": self.thrust_map,
            "c_t2t": self.torque_ratio,
            "torque": self.torque_map,
            "reverse": self.reverse,
        }
        results = {name: plain(part) for name, part in parts.items() if part is not None}
        return {"name": self.name, "rows": self.speed.size, **results, "notes": list(self.notes)}


def fit_static(bench: Bench, *, num_motors: int = 1) -> tuple[list[StaticFit], list[Finding]]:
    """Return the maps of one file, and findings on rejected tests; a column ``test`` separates several tests.

    Negative speeds belong to a reversible rotor in reverse, with negative thrust and torque. They have separate maps, and all
    maps then pass through 0.

    Raises:
        DataError: If columns are missing, or no test is usable.
    """
    column = bench.column_of_quantity("thrust") or ""
    if "total" in column.lower() and num_motors == 1:
        raise DataError(f"{bench.path}: {column!r} is the thrust of several motors; say how many with --num-motors")
    measured = {"speed": bench.values_of_quantity("speed"), "thrust": bench.values_of_quantity("thrust") / num_motors}
    if bench.column_of_quantity("torque") is not None:
        measured["torque"] = bench.values_of_quantity("torque") / num_motors
    elif (power := bench.electric_power()) is not None:
        measured["power"] = power / num_motors
    named = bench.tests()
    if named is None:
        return [_fit_both_directions(bench.path, measured)], []
    tests = np.asarray(named)
    fits, left_out = [], []
    for test in dict.fromkeys(tests):
        part = {quantity: values[tests == test] for quantity, values in measured.items()}
        try:
            fits.append(_fit_both_directions(f"{bench.path}, test {test}", part))
        except DataError as error:
            left_out.append(Finding("test_left_out", test, {"error": str(error)}))
    if not fits:
        raise DataError(str(left_out[0].values["error"]))
    return fits, left_out


def _fit_both_directions(name: str, measured: dict[str, Array]) -> StaticFit:
    """Return the maps for both directions of rotation, from speed, thrust and optional torque, (T,) each."""
    back = measured["speed"] < 0.0
    if not back.any():
        return _fit_one_direction(name, measured)
    forwards = _fit_one_direction(name, {q: values[~back] for q, values in measured.items()}, through_zero=True)
    backwards = {q: -values[back] for q, values in measured.items()}
    return replace(forwards, reverse=_fit_one_direction(f"{name}, backwards", backwards, through_zero=True))


def _fit_one_direction(name: str, measured: dict[str, Array], *, through_zero: bool = False) -> StaticFit:
    speed, thrust = measured["speed"], measured["thrust"]
    check_plausibility_of_rotor_data(name, speed, thrust, measured.get("torque"), measured.get("power"))
    dead = (speed == 0.0) & (thrust > STALLED * thrust.max())
    notes = (Finding("rows_without_speed", name, {"rows": int(dead.sum())}),) if dead.any() else ()
    kept = {quantity: values[~dead] for quantity, values in measured.items()}
    speed, thrust, torque = kept["speed"], kept["thrust"], kept.get("torque")
    if np.unique(speed).size < FEWEST_ROWS:
        raise DataError(f"{name}: has {np.unique(speed).size} different speeds, needs at least {FEWEST_ROWS}")
    thrust_map = choose_map(speed, thrust, unit="N", through_zero=through_zero)
    ratio = torque_map = None
    if torque is not None:
        ratio = _fit_regressors("ratio", thrust[:, None], torque, ("ratio",)).params["ratio"]
        torque_map = choose_map(speed, torque, unit="N m", thrust=thrust_map.best, through_zero=through_zero)
    return StaticFit(name, speed, thrust, torque, thrust_map, torque_map, ratio, notes)


def choose_map(
    speed: Array, values: Array, *, unit: str, thrust: MapFit | None = None, through_zero: bool = False
) -> MapChoice:
    """Return the candidate maps for ``values`` (T,) at speeds (T,), and the selection.

    ``thrust``: the selected thrust map, which adds a constant torque ratio as a candidate. Maps without a positive w² term
    are excluded, as no robot file supports them. So are maps of a reversible rotor (``through_zero``) with a constant or a
    negative w term.
    """
    maps = {name: powers for name, powers in MAPS.items() if not (through_zero and 0 in powers)}
    columns = {name: speed[:, None] ** np.array(powers) for name, powers in (maps | BEYOND).items()}
    labels = {name: tuple(f"c{p}" for p in powers) for name, powers in (maps | BEYOND).items()}
    if thrust is not None:
        columns = {"torque ratio": thrust.polynomial_values(speed)[:, None], **columns}
        labels["torque ratio"] = ("ratio",)
    candidates = {name: _fit_regressors(name, rows, values, labels[name]) for name, rows in columns.items()}
    columns = {name: rows for name, rows in columns.items() if name not in BEYOND}
    nested, terms = np.empty(speed.size), {name: rows.shape[1] for name, rows in columns.items()}
    for row in range(speed.size):
        kept_rows = np.arange(speed.size) != row
        errors = {name: rms(_leave_one_out_errors(c[kept_rows], values[kept_rows])) for name, c in columns.items()}
        best = smallest_good_candidate(errors, terms)
        gains = np.linalg.lstsq(columns[best][kept_rows], values[kept_rows], rcond=None)[0]
        nested[row] = values[row] - columns[best][row] @ gains

    def is_possible(name: str) -> bool:
        _, c1, c2 = candidates[name].polynomial()
        return name == "torque ratio" or (c2 > 0.0 and (c1 >= 0.0 or not through_zero))

    chosen = smallest_good_candidate(
        {name: candidates[name].held_out_rms for name in filter(is_possible, columns)}, terms
    )
    return MapChoice(unit=unit, candidates=candidates, chosen=chosen, nested=nested)


def _leave_one_out_errors(regressors: Array, values: Array) -> Array:
    """Return the leave-one-out errors: residual over one minus leverage."""
    scale = np.abs(regressors).max(axis=0)
    scaled = regressors / np.where(scale > 0.0, scale, 1.0)
    residual = values - scaled @ np.linalg.lstsq(scaled, values, rcond=None)[0]
    return residual / np.maximum(1.0 - leverage(scaled), 1e-9)


def _fit_regressors(name: str, regressors: Array, values: Array, labels: tuple[str, ...]) -> MapFit:
    scale = np.abs(regressors).max(axis=0)
    scaled = regressors / scale
    gains = np.linalg.lstsq(scaled, values, rcond=None)[0]
    residual = values - scaled @ gains
    covariance = hc3_covariance(scaled, residual) / np.outer(scale, scale)
    results = estimates(gains / scale, covariance, values.size - gains.size)
    params, left = dict(zip(labels, results, strict=True)), _leave_one_out_errors(regressors, values)
    return MapFit(name=name, params=params, residual=residual, held_out=left)
