"""Compliant joint of a folding arm after release of a load: spring laws with viscoelastic creep.

All parameters are per unit of the joint's inertia. Letters: T rows, N creep elements, K parameters.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import odeint

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.json_values import plain
from aerial_gym.sim2real.statistics import Rms
from aerial_gym.sim2real.teststand.statistics import (
    CurveFit,
    LawFit,
    cross_validation_error,
    errors_on_left_out_folds,
    fit_curve,
    rms,
    smallest_good_candidate,
)
from aerial_gym.sim2real.teststand.tables import Bench

PUBLISHED = {"stiffness": 5834.85, "damping": 229.24, "rest": 0.12566}
"""Quadratic spring of Morphy in the Aerial Gym Simulator 2.0.1 [1/(rad s²)], [1/s], [rad]: robots/morphy.py."""

BLOCK_EDGES_S = (0.0, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0, 8.0)
"""Starts of the left-out blocks after the release [s]; early blocks are short, to weight the first moments."""

ALTERNATE_S = 0.06
"""Length of alternating blocks [s], every second one fitted: one period of the arm, 2 pi over 103 rad/s. A left-out block
thus shares no row of the same swing with the fit."""

POWER_TIMES = tuple(10.0 ** (0.5 * k) for k in range(-6, 4))
"""Time constants of the elements that approximate a power law [s]: two per decade, beyond sample time and record."""

BOUNDS: dict[str, tuple[float, float, float]] = {
    "release": (0.003, -0.005, 0.01),
    "stiffness": (9000.0, 1e2, 1e6),
    "quadratic_stiffness": (2400.0, 1e2, 1e6),
    "damping": (90.0, 1.0, 2e3),
    "rest": (0.125, -1.6, 1.6),
    "stiffness_1": (3500.0, 1.0, 1e6),
    "time_1": (0.05, 1e-3, 1e2),
    "stiffness_2": (1500.0, 1.0, 1e6),
    "time_2": (0.4, 1e-3, 1e2),
    "stiffness_3": (700.0, 1.0, 1e6),
    "time_3": (4.0, 1e-3, 1e2),
    "creep": (1000.0, 1.0, 1e5),
    "exponent": (0.3, -1.0, 2.0),
}
"""Initial value, lower and upper bound: release and times [s], stiffness and creep [1/s²] (quadratic: [1/(rad s²)]), damping
[1/s], rest [rad]."""

LAWS: dict[str, tuple[str, ...]] = {
    "quadratic spring": ("quadratic_stiffness", "damping", "rest"),
    "linear spring": ("stiffness", "damping", "rest"),
    "linear spring, 1 creep element": ("stiffness", "damping", "rest", "stiffness_1", "time_1"),
    **{
        f"linear spring, {count} creep elements": (
            *("stiffness", "damping", "rest"),
            *(f"{name}_{i + 1}" for i in range(count) for name in ("stiffness", "time")),
        )
        for count in (2, 3)
    },
    "linear spring, power-law creep": ("stiffness", "damping", "rest", "creep", "exponent"),
}
"""Parameters of each law; the time of release is fitted as well."""


@dataclass(frozen=True, kw_only=True)
class ReleaseRecord:
    """Record of an arm at rest under a load that is released at time 0."""

    path: str
    time: Array  # Time from the release [s], (T,)
    angle: Array  # Joint angle [rad], (T,)
    start: float  # Angle before the release [rad]

    @property
    def block(self) -> Indices:
        """Block number of each row, (T,)."""
        return np.searchsorted(np.array(BLOCK_EDGES_S), self.time, side="right")


@dataclass(frozen=True)
class JointStudy:
    """The published law, all fitted laws, and the one with the least held-out error."""

    record: ReleaseRecord
    published: Array = field(repr=False)  # Measured minus the published law, with release at 0 [rad], (T,)
    laws: dict[str, LawFit]
    chosen: str
    forecast: dict[str, Rms]  # Error in the second half of the record, from fits to the first half [rad], by law
    alternate: dict[str, Array] = field(repr=False)  # Errors of fits to the alternate blocks [rad], (T,), by law

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        best = self.laws[self.chosen]
        return {
            "unit": "rad",
            "rows": self.record.time.size,
            "chosen": self.chosen,
            "before": {"model": "published quadratic spring", **errors_by_span(self.record.time, self.published)},
            "after": {"model": self.chosen, **errors_by_span(self.record.time, best.held_out)},
            "candidates": [
                {
                    "name": law.name,
                    "fit": errors_by_span(self.record.time, law.residual),
                    "held_out": errors_by_span(self.record.time, law.held_out),
                    "held_out_by_block": rms_by_block(self.record, law),
                    "forecast": self.forecast[law.name].as_mapping(),
                    "alternate": errors_by_span(self.record.time, self.alternate[law.name]),
                    "params": plain(law.params),
                }
                for law in self.laws.values()
            ],
        }


def errors_by_span(time: Array, error: Array) -> dict[str, float]:
    """Return RMS and largest error [rad] of a record, and the RMS in and after its first second."""
    early, largest = time < 1.0, float(np.abs(error).max())
    by_span = {"rms": rms(error), "rms_first_second": rms(error[early]), "largest": largest}
    return by_span | {"rms_after_first_second": rms(error[~early])}


def release_record(bench: Bench, *, release: float = 0.0) -> ReleaseRecord:
    """Return the record from the release time [s] on."""
    time, angle = bench.values_of_quantity("time") - release, bench.values_of_quantity("angle")
    if np.any(np.diff(time) <= 0.0):
        raise DataError(f"{bench.path}: time does not increase; sort the rows, remove repeated ones")
    before = time < 0.0
    if before.sum() < 5 or (~before).sum() < 50:
        raise DataError(
            f"{bench.path}: {before.sum()} rows before and {(~before).sum()} after the release at {release:g} s; needs 5 and "
            "50: give the moment of release with --release-s"
        )
    if np.abs(angle).max() > np.pi:
        raise DataError(
            f"{bench.path}: angles up to {np.abs(angle).max():.3g} rad; if they are degrees: --units angle deg"
        )
    start = float(angle[before].mean())
    if np.abs(angle[before] - start).max() > 0.2 * np.ptp(angle[~before]):
        raise DataError(
            f"{bench.path}: the arm moves before {release:g} s; give the moment of release with --release-s"
        )
    return ReleaseRecord(path=bench.path, time=time[~before], angle=angle[~before], start=start)


def law_angle(record: ReleaseRecord, params: dict[str, float]) -> Array:
    """Return the angle [rad] that a law predicts, (T,).

    ``th'' = -k e - kq |e| e - c th' - sum k_i (e - z_i)``, ``z_i' = (e - z_i) / T_i`` with ``e = th - rest``. It starts at rest
    at the loaded angle, with relaxed creep elements (``z_i = e``).

    Source:
        Quadratic spring: parity with the Aerial Gym Simulator 2.0.1. Creep: the generalised Maxwell model, Tschoegl (1989),
        The Phenomenological Theory of Linear Viscoelastic Behavior, section 3.4.
    """
    since = np.maximum(record.time - params.get("release", 0.0), 0.0)
    if "quadratic_stiffness" in params:
        return _quadratic_spring_angle(record.start, params, since)
    stiffness, times = creep_elements(params)
    number = times.size
    motion = np.zeros((2 + number, 2 + number))
    motion[0, 1] = 1.0
    motion[1, :2] = -params["stiffness"] - stiffness.sum(), -params["damping"]
    motion[1, 2:], motion[2:, 0] = stiffness, 1.0 / times
    motion[2:, 2:] = -np.diag(1.0 / times)
    begin = np.full(2 + number, record.start - params["rest"])
    begin[1] = 0.0
    rates, modes = np.linalg.eig(motion)
    amounts = modes[0] * np.linalg.solve(modes, begin.astype(complex))
    return params["rest"] + (np.exp(since[:, None] * rates) * amounts).sum(axis=1).real


def creep_elements(params: Mapping[str, float]) -> tuple[Array, Array]:
    """Return stiffness k_i [1/s²] and time constant T_i [s] of a law's creep elements, (N,) each.

    A power law describes relaxation without a characteristic time: ``k_i = creep (T_i / 1 s)^-exponent``.

    Source:
        Power law: Bagley, Torvik (1983), A theoretical basis for the application of fractional calculus to viscoelasticity;
        as a sum of elements: Schapery (1962), Approximate methods of transform inversion for viscoelastic stress analysis.
    """
    if "exponent" in params:
        times = np.array(POWER_TIMES)
        return params["creep"] * times ** -params["exponent"], times
    number = sum(name.startswith("time_") for name in params)
    stiffness = np.array([params[f"stiffness_{i + 1}"] for i in range(number)])
    return stiffness, np.array([params[f"time_{i + 1}"] for i in range(number)])


def _quadratic_spring_angle(start: float, params: dict[str, float], since: Array) -> Array:
    stiffness, damping, rest = params["quadratic_stiffness"], params["damping"], params["rest"]

    def motion(state: Array, _: float) -> tuple[float, float]:
        away = state[0] - rest
        return state[1], -stiffness * abs(away) * away - damping * state[1]

    grid, place = np.unique(np.append(since, 0.0), return_inverse=True)
    course = odeint(motion, (start, 0.0), grid, rtol=1e-8, atol=1e-10)[:, 0]
    return course[place[:-1]]


def fit_joint(record: ReleaseRecord) -> JointStudy:
    """Return the fits of all laws to the record, their errors on left-out blocks, and the choice."""
    laws = {name: _fit_law(name, record) for name in LAWS}
    errors = {name: rms(np.array(rms_by_block(record, law))) for name, law in laws.items()}  # weights the first moments
    chosen = smallest_good_candidate(errors, {name: len(parameters) for name, parameters in LAWS.items()})
    law = {"quadratic_stiffness": PUBLISHED["stiffness"], "damping": PUBLISHED["damping"], "rest": PUBLISHED["rest"]}
    late = record.time > 0.5 * record.time[-1]
    forecast = {}
    for name in laws:
        error = fit_curve_of_law(name, record, ~late).residual[late]
        forecast[name] = cross_validation_error(error, np.arange(error.size) // max(1, error.size // 20))
    published = record.angle - law_angle(record, law)
    alternate = {name: errors_on_alternate_blocks(name, record) for name in laws}
    return JointStudy(record, published, laws, chosen, forecast, alternate)


def alternate_blocks(record: ReleaseRecord) -> Indices:
    """Return the parity of each row's block of ``ALTERNATE_S``, 0 or 1, (T,)."""
    return (record.time / ALTERNATE_S).astype(np.int64) % 2


def errors_on_alternate_blocks(name: str, record: ReleaseRecord) -> Array:
    """Return the residuals of all rows, each from the fit to the other alternate blocks [rad], (T,)."""
    return errors_on_left_out_folds(
        alternate_blocks(record), lambda out: fit_curve_of_law(name, record, ~out).residual[out]
    )


def fit_curve_of_law(
    name: str, record: ReleaseRecord, kept: Flags | None = None, near: Array | None = None
) -> CurveFit:
    """Return a law fitted to the rows ``kept``, starting at the parameters ``near``."""
    labels = ("release", *LAWS[name])
    start, low, high = (np.array(column) for column in zip(*(BOUNDS[label] for label in labels), strict=True))
    if near is not None:
        start = np.clip(near, low + 1e-3 * (high - low) * (low < 0.0), high - 1e-3 * (high - low))

    def predict(values: Array) -> Array:
        return law_angle(record, dict(zip(labels, values, strict=True)))

    return fit_curve(predict, record.angle, start, low, high, kept)


def _fit_law(name: str, record: ReleaseRecord) -> LawFit:
    whole = fit_curve_of_law(name, record)
    held_out = errors_on_left_out_folds(
        record.block, lambda out: fit_curve_of_law(name, record, ~out, whole.params).residual[out]
    )
    params = dict(zip(("release", *LAWS[name]), whole.estimates(), strict=True))
    return LawFit(name=name, params=params, residual=whole.residual, held_out=held_out, fold=record.block)


def rms_by_block(record: ReleaseRecord, law: LawFit) -> list[float]:
    """Return the RMS held-out error of each block [rad]."""
    return [rms(law.held_out[record.block == block]) for block in np.unique(record.block)]
