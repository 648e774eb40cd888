"""Check that position, velocity and accelerometer agree in unit, sign and order of axes.

Over windows of 0.5 s the change of one is the integral of the next; no vehicle model enters. Errors in both variables bias
either regression, and the true factor lies between their slopes (Frisch, 1934, Statistical Confluence Analysis). Letters: N
windows.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.mapping import UNITS
from aerial_gym.sim2real.logs.recording import AT_REST, FlightLog, sample_rate
from aerial_gym.sim2real.logs.signals import DERIVED_BAND, lowpass
from aerial_gym.sim2real.statistics import normal_tail, student_quantile

AXES = np.arange(3)

WINDOW_S = 0.5  # Window length [s]; errors of different windows count as independent
SURE = normal_tail(4.0)  # Error probability of a refusal per axis, small because each log has six axes
CLEARLY = 10.0  # Least log likelihood ratio of another order, whose moved axes are explained to ``SHARED``
SHARED = 0.8
FEWEST = 4  # Least number of windows
DERIVED_HZ = 4.0  # Bandwidth of a velocity that is derived from the position [Hz]
MATERIAL = 0.05  # Least deviation of a factor from 1 that is reported
FITS = 0.1  # A unit is named if its factor fits within a tenth: velocity estimators err so much (IDSIA flights: 0.09)

VELOCITY_UNITS = ("km/h", "mph", "kn", "ft/s", "cm/s", "mm/s")
POSITION_UNITS = ("ft", "cm", "mm")

WRONG = np.log([1.0, *(UNITS[u] for u in VELOCITY_UNITS), *(1.0 / UNITS[u] for u in POSITION_UNITS)])
"""Log ratios of distance to integrated velocity under mistaken units; the first one, 0, is correct units."""


@dataclass(frozen=True, kw_only=True)
class AxisRelation:
    """Axis-by-axis relation of two vectors: ``effect_i = factor_i cause_order(i) + constant``."""

    order: tuple[int, ...]  # Index of the cause's axis for each axis of the effect
    factor: Array  # Signed slope, (3,)
    low: Array  # Lower limit of the interval of ``|factor|``, (3,); 0, with ``high`` infinite, if the sign is uncertain
    high: Array
    share: Array  # Squared correlation of each pair of axes, (3,)

    @property
    def significant_axes(self) -> Flags:
        """Return the axes with a certain sign and size of the factor, (3,)."""
        return self.low > 0.0

    @property
    def axis_swaps(self) -> Flags:
        """Return the axes that follow another axis of the cause, (3,)."""
        return np.array(self.order) != np.arange(3)

    @property
    def sign_flips(self) -> Flags:
        """Return the axes with inverted sign, (3,)."""
        return self.significant_axes & (self.factor < 0.0) & (self.share > SHARED)

    @property
    def wrong_unit_axes(self) -> Flags:
        """Return the axes whose factor differs from 1 and is nearest to that of a mistaken unit, (3,)."""
        size = np.log(np.where(self.significant_axes, np.abs(self.factor), 1.0))
        unit = np.argmin(np.abs(size[:, None] - WRONG), axis=1) > 0
        return self.differs_from_one & unit

    @property
    def differs_from_one(self) -> Flags:
        """Return the axes whose ``|factor|`` differs significantly from 1, (3,)."""
        return self.significant_axes & ((self.low > 1.0) | (self.high < 1.0))

    @property
    def wrong_axes(self) -> Flags:
        """Return the axes with a wrong order, sign or unit, (3,)."""
        return self.axis_swaps | self.sign_flips | self.wrong_unit_axes


def axis_relation(effect: Array, cause: Array) -> AxisRelation | None:
    """Return the relation of the increments (N, 3) of two vectors; None for too few windows or a constant axis."""
    count = len(effect)
    sizes = np.std(effect, axis=0), np.std(cause, axis=0)
    if count < FEWEST or not np.all(np.concatenate(sizes) > 0.0):
        return None
    scores = [(part - part.mean(axis=0)) / size for part, size in zip((effect, cause), sizes, strict=True)]
    shared = np.clip(scores[0].T @ scores[1] / count, -1.0 + 1e-12, 1.0 - 1e-12)
    order = _most_likely_axis_order(shared, count)
    share, size = shared[AXES, order], sizes[0] / sizes[1][list(order)]
    error = np.sqrt((1.0 - share**2) / (count - 2)) / np.maximum(np.abs(share), 1e-12)
    error = -student_quantile(SURE, count - 2) * error
    known = error < 1.0  # otherwise the correlation may be 0
    widening = np.exp(np.minimum(error, 1.0))
    low = np.where(known, np.abs(share) * size / widening, 0.0)
    high = np.where(known, size / np.maximum(np.abs(share), 1e-12) * widening, np.inf)
    return AxisRelation(order=order, factor=np.sign(share) * size, low=low, high=high, share=share**2)


def _most_likely_axis_order(shared: Array, count: int) -> tuple[int, ...]:
    """Return the order of axes that fits correlations (3, 3) clearly best; (0, 1, 2) if none does."""
    plain = (0, 1, 2)

    def log_likelihood(order: tuple[int, ...]) -> float:
        return float(-0.5 * count * np.log1p(-(shared[AXES, order] ** 2)).sum())

    best = max(permutations(plain), key=log_likelihood)
    moved = shared[AXES, best][np.array(best) != AXES]
    clear = log_likelihood(best) - log_likelihood(plain) > CLEARLY and np.all(moved**2 > SHARED)
    return best if clear else plain


def check_units_of_velocity_and_position(log: FlightLog) -> list[Finding]:
    """Raise ``DataError`` if velocity and position differ in unit, sign or axes; return a finding on smaller factors."""
    velocity, place = log.lin_vel, log.position
    if velocity is None or place is None:
        return []
    way = _changes_over_windows(log, place)
    relation = axis_relation(way, _integrals_over_windows(log, velocity))
    if relation is None or not relation.wrong_axes.any():
        return _factor_findings(relation)
    both = "velocity (v_x, v_y, v_z) and the derivative of position (p_x, p_y, p_z)"
    start = f"{log.path}: {both} contradict each other; it looks as if"
    body = axis_relation(way, _integrals_over_windows(log, Rotation.from_quat(log.attitude).apply(velocity)))
    fewer = body is None or body.significant_axes.sum() < relation.significant_axes.sum()
    if body is not None and not fewer and not body.wrong_axes.any():
        raise DataError(f"{start} v is in body axes: turn it into world axes")
    raise DataError(f"{start} {_remedies(relation, _letters_of_wrong_quantities(relation, log))}")


def check_units_against_accelerometer(log: FlightLog) -> None:
    """Raise ``DataError`` if velocity and position contradict the accelerometer in sign, or in unit on all certain axes.

    An attitude estimate that relies on the accelerometer may hide slow motion, but not equally on all axes.
    """
    letters = [letter for letter, values in (("v", log.lin_vel), ("p", log.position)) if values is not None]
    by = _relation_to_accelerometer(log, letters[0]) if letters else None
    if by is None:
        return
    names = " and ".join({"v": "velocity", "p": "position"}[letter] for letter in letters)
    if by.sign_flips.any():
        columns = " and ".join(_column_names([letter], by.sign_flips) for letter in letters)
        raise DataError(
            f"{log.path}: {names} contradict acc and attitude; it looks as if {columns} have the wrong sign: multiply the "
            "columns by -1"
        )
    if by.significant_axes.sum() >= 2 and np.array_equal(by.wrong_unit_axes, by.significant_axes):
        factor = _mean_factor_of_wrong_axes(by)
        ways = "; ".join(_unit_remedy(letter, by, factor, 1.0 / factor) for letter in letters)
        raise DataError(f"{log.path}: the change of {names} contradicts acc and attitude; it looks as if {ways}")


def _relation_to_accelerometer(log: FlightLog, letter: str) -> AxisRelation | None:
    """Return the relation of velocity, or of the position's derivative, to the integrated acceleration; None without data."""
    values = log.lin_vel if letter == "v" else log.position
    if values is None or log.specific_force is None:
        return None
    if letter == "p":
        values = lowpass(values, sample_rate(log), min(DERIVED_HZ, DERIVED_BAND * sample_rate(log)), derivative=True)
    felt = Rotation.from_quat(log.attitude).apply(log.specific_force) - AT_REST
    return axis_relation(_changes_over_windows(log, values), _integrals_over_windows(log, felt))


def _changes_over_windows(log: FlightLog, values: Array) -> Array:
    """Return the changes of values (T, 3) over each window, (N, 3)."""
    return np.diff(values[:: max(1, round(WINDOW_S * sample_rate(log)))], axis=0)


def _integrals_over_windows(log: FlightLog, values: Array) -> Array:
    """Return the integral of values (T, 3) over each window, (N, 3)."""
    return _changes_over_windows(log, cumulative_trapezoid(values, dx=1.0 / sample_rate(log), axis=0, initial=0.0))


def _letters_of_wrong_quantities(relation: AxisRelation, log: FlightLog) -> list[str]:
    """Return the letters of the wrong quantities: v, p, or both if the accelerometer is inconclusive."""

    def agrees_with_accelerometer(letter: str) -> bool:
        other = _relation_to_accelerometer(log, letter)
        return other is not None and bool(np.all((other.significant_axes & ~other.wrong_axes)[relation.wrong_axes]))

    wrong = [letter for letter in ("v", "p") if not agrees_with_accelerometer(letter)]
    return wrong or ["v", "p"]


def _column_names(letters: list[str], axes: Flags) -> str:
    """Return the names of columns: v_x, v_y or p_x, p_y."""
    return " or ".join(", ".join(f"{letter}_{'xyz'[axis]}" for axis in np.flatnonzero(axes)) for letter in letters)


def _remedies(relation: AxisRelation, letters: list[str]) -> str:
    """Return the probable errors of position or velocity with the mapping entries that correct them."""
    said: list[str] = []
    if relation.axis_swaps.any():
        names = ", ".join("xyz"[axis] for axis in relation.order)
        said.append(
            f"the axes of {' or '.join(letters)} were exchanged: name its columns in the order {names} in a mapping file"
        )
    if relation.sign_flips.any():
        said.append(f"{_column_names(letters, relation.sign_flips)} have the wrong sign: multiply each column by -1")
    if relation.wrong_unit_axes.any():
        factor = _mean_factor_of_wrong_axes(relation)
        said.append(_unit_remedy("v" if factor < 1.0 else "p", relation, factor, min(factor, 1.0 / factor)))
    return "; and ".join(said)


def _mean_factor_of_wrong_axes(relation: AxisRelation) -> float:
    return float(np.exp(np.mean(np.log(np.abs(relation.factor[relation.wrong_unit_axes])))))


def _unit_remedy(letter: str, relation: AxisRelation, factor: float, mends: float) -> str:
    """Return the probable unit of a quantity's columns with a wrong factor, with the mapping entry that corrects it."""
    units, name = (VELOCITY_UNITS, "lin_vel") if letter == "v" else (POSITION_UNITS, "position")
    columns = _column_names([letter], (relation.low < factor * (1.0 + FITS)) & (relation.high > factor * (1.0 - FITS)))
    best = min(units, key=lambda unit: abs(np.log(mends / UNITS[unit])))
    if abs(np.log(mends / UNITS[best])) < FITS:
        return f"{columns} were in {best} (factor {mends:.3g}): give {name} unit: {best} in a mapping file"
    way = f"give {name} gain: {mends:.3g} in a mapping file"
    return f"{columns} need a factor of {mends:.3g}, which is no known unit: {way}"


def _factor_findings(relation: AxisRelation | None) -> list[Finding]:
    if relation is None:
        return []
    size = np.abs(np.log(np.where(relation.significant_axes, np.abs(relation.factor), 1.0)))
    material = relation.differs_from_one & (size > MATERIAL)
    if not material.any():
        return []
    axes = np.flatnonzero(material).tolist()
    factor, low, high = (1.0 / values[axes] for values in (np.abs(relation.factor), relation.high, relation.low))
    values = {"axes": ["xyz"[axis] for axis in axes], "factor": factor.tolist()}
    return [Finding("velocity_factor", "", {**values, "low": low.tolist(), "high": high.tolist()})]
