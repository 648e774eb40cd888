"""Springs, dampers and dry friction of joints from flights with logged joint angles.

The joint effort follows from the motion (``joint_motion``) and is fitted by laws of the joint's angle and rate::

    effort = preload - (k + k2 |q - rest|) (q - rest) - c q' - F s,    s = low-passed q' / sqrt(q'² + v²)

with q' in the widest band of the log. In stiction the effort may be anything up to F, so rows without motion to one side over
the low-pass's whole span are excluded.
Link masses, joint positions and thrusts are as declared: a relative error of a link's inertia appears equally here.
Letters: T rows, D joints, K parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.joint import JointCfg, JointsCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.statistics import Estimate, Rms
from aerial_gym.sim2real.teststand.joints.joint_motion import JointMotion
from aerial_gym.sim2real.teststand.statistics import (
    FOLDS,
    LawFit,
    cross_validation_error,
    errors_on_left_out_folds,
    estimates,
    fit_law,
    fold_labels,
    hac_covariance,
    smallest_good_candidate,
)

CLEAR = 0.8  # Least |s| of rows with continuous motion to one side
MATERIAL = 0.02  # Least share of the effort's standard deviation in which a material change of a parameter results

LAWS: dict[str, tuple[str, ...]] = {
    "linear spring": ("stiffness", "damping", "rest"),
    "linear spring, friction": ("stiffness", "damping", "rest", "friction"),
    "quadratic spring": ("quadratic", "damping", "rest", "preload"),
}
"""Parameters of each law: stiffness [N m/rad], quadratic [N m/rad²], damping [N m s/rad], rest [rad], others [N m]."""

NUM_PARAMETERS = {name: len(parameters) for name, parameters in LAWS.items()}


@dataclass(frozen=True, kw_only=True)
class JointResult:
    """Result for one joint, with or without logged angles."""

    name: str
    changed: tuple[str, ...]  # Parameters that differ significantly (95 %) and materially from the declared ones
    declared: dict[str, float]
    params: dict[str, Estimate]  # Fitted parameters by the names of ``SpringCfg``
    spring: SpringCfg  # Spring for the robot file

    @property
    def finding(self) -> Finding:
        """Return a finding with the parameters that differ from the declared ones."""
        numbers = [
            {"name": name, "value": self.params[name].value, "declared": self.declared[name]}
            for name in self.changed
            if name in self.params and name in self.declared
        ]
        return Finding("joint_found", self.name, {"numbers": numbers, "changed": list(self.changed)})

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return select_fields(self, "name", "changed", "declared", "params")


@dataclass(frozen=True, kw_only=True)
class LogJointFit(JointResult):
    """Result for a joint with logged angles: the spring is of the chosen law if anything differs, else the declared one."""

    declared_error: Rms  # RMS error of the declared law [N m]
    laws: dict[str, LawFit]
    chosen: str
    rows: int

    def fits_as_mapping(self) -> dict[str, object]:
        """Return the fits of all laws for JSON."""
        laws = {name: {"held_out": plain(law.error), "params": plain(law.params)} for name, law in self.laws.items()}
        pair = {"before": plain(self.declared_error), "after": plain(self.laws[self.chosen].error)}
        return {**select_fields(self, "name", "changed", "chosen", "rows"), **pair, "laws": laws}


def require_joints(robot: RobotCfg) -> JointsCfg:
    """Return the joints of a robot; raise ``ConfigError`` if it is rigid."""
    if robot.joints is None:
        raise ConfigError("identify joints: this robot has no joints. identify joint fits a bench record")
    return robot.joints


def fit_flown_joints(robot: RobotCfg, motions: Sequence[JointMotion]) -> tuple[list[LogJointFit], list[Finding]]:
    """Return the fits of all passive joints to all flights, and findings on joints left out."""
    results, left_out = [], []
    for k, joint in enumerate(require_joints(robot).layout):
        if reason := reason_against_fitting_joint(joint):
            left_out.append(reason)
        else:
            results.append(_fit_joint(joint, k, motions))
    return results, left_out


def reason_against_fitting_joint(joint: JointCfg) -> Finding | None:
    """Return a finding on the reason why a joint cannot be fitted; None if it can."""
    if joint.drive is not None:
        return Finding("joint_driven", joint.name)
    return Finding("joint_creeps", joint.name) if joint.spring and joint.spring.creep else None


def _fit_joint(joint: JointCfg, k: int, motions: Sequence[JointMotion]) -> LogJointFit:
    low, high = (-np.inf, np.inf) if joint.ends is None else (joint.ends.low, joint.ends.high)
    if max(np.ptp(motion.angle[:, k]) for motion in motions) < 1e-9:
        raise DataError(f"joint {joint.name}: its angle is the same in all rows; check the column")
    kept = [
        (motion.angle[:, k] > low) & (motion.angle[:, k] < high) & (np.abs(motion.side[:, k]) >= CLEAR)
        for motion in motions
    ]
    angle, rate, side, effort = (
        np.concatenate([getattr(c, name)[rows, k] for c, rows in zip(motions, kept, strict=True)])
        for name in ("angle", "rate", "side", "effort")
    )
    counts = [int(rows.sum()) for rows in kept]
    if angle.size < 50 * FOLDS:
        raise DataError(
            f"joint {joint.name}: {angle.size} rows of motion between its end stops, needs {50 * FOLDS}; fly longer"
        )
    fold = fold_labels(counts)
    laws = {name: _fit_law(name, angle, rate, side, effort, fold) for name in LAWS}
    chosen = smallest_good_candidate({name: law.error.value for name, law in laws.items()}, NUM_PARAMETERS)
    declared, params = joint.spring or SpringCfg(), laws[chosen].params
    before = cross_validation_error(effort - _effort_of_spring(declared, angle, rate, side), fold)
    sizes = {"stiffness": angle.std(), "quadratic": (angle**2).std(), "damping": rate.std(), "friction": side.std()}
    rest = params["stiffness"].value if "stiffness" in params else 0.0
    least = {n: MATERIAL * effort.std() / max(s, 1e-12) for n, s in (sizes | {"rest": rest, "preload": 1.0}).items()}
    changed = _significant_changes(declared, laws[chosen], least)
    spring = declared
    if changed:
        rounded = {name: float(f"{value.value:.6g}") for name, value in params.items()}
        spring = SpringCfg(**{n: v if n in ("rest", "preload") else max(v, 0.0) for n, v in rounded.items()})  # type: ignore[arg-type]
    stated = {name: float(getattr(declared, name)) for name in (*params, *changed) if hasattr(declared, name)}
    return LogJointFit(
        name=joint.name, changed=changed, declared=stated, params=params, spring=spring,
        declared_error=before, laws=laws, chosen=chosen, rows=angle.size,
    )  # fmt: skip


def _effort_of_spring(spring: SpringCfg, angle: Array, rate: Array, side: Array) -> Array:
    away = angle - spring.rest
    effort = spring.preload - (spring.stiffness + spring.quadratic * np.abs(away)) * away - spring.damping * rate
    return effort - spring.friction * side


def _fit_law(name: str, angle: Array, rate: Array, side: Array, effort: Array, fold: Indices) -> LawFit:
    """Return a law fitted to all rows, with its error on left-out folds."""
    if name == "quadratic spring":
        return _fit_quadratic_spring(name, angle, rate, effort, fold)
    columns = (np.ones_like(angle), -angle, -rate)
    rows = np.stack((*columns, -side) if "friction" in LAWS[name] else columns, axis=1)
    left = errors_on_left_out_folds(
        fold, lambda out: effort[out] - rows[out] @ np.linalg.lstsq(rows[~out], effort[~out], rcond=None)[0]
    )
    values = np.linalg.lstsq(rows, effort, rcond=None)[0]
    residual = effort - rows @ values
    covariance = hac_covariance(rows, residual)
    preload, stiffness = values[0], values[1]
    change = np.eye(len(values))
    change[0, :2] = 1.0 / stiffness, -preload / stiffness**2
    shown = np.concatenate(([preload / stiffness], values[1:]))
    results = estimates(shown, change @ covariance @ change.T, effort.size - len(values))
    params: dict[str, Estimate] = dict(zip(("rest", "stiffness", "damping", "friction"), results, strict=False))
    return LawFit(name=name, params=params, residual=residual, held_out=left, fold=fold)


def _fit_quadratic_spring(name: str, angle: Array, rate: Array, effort: Array, fold: Indices) -> LawFit:
    spread = float(np.ptp(angle))
    middle, size = float(np.median(angle)), float(np.abs(effort).max()) + 1e-12
    slope = size / spread**2
    start = np.array((slope, size / (np.abs(rate).max() + 1e-12), middle, 0.0))
    low = np.array((0.0, 0.0, middle - 3.0 * spread, -10.0 * size))
    high = np.array((1e3 * slope, 1e3 * start[1], middle + 3.0 * spread, 10.0 * size))

    def predict(values: Array) -> Array:
        quadratic, damping, rest, preload = values
        away = angle - rest
        return preload - quadratic * np.abs(away) * away - damping * rate

    return fit_law(name, LAWS[name], predict, effort, (start, low, high), fold)


def _significant_changes(declared: SpringCfg, law: LawFit, least: dict[str, float]) -> tuple[str, ...]:
    """Return the parameters whose declared values lie outside the fitted intervals, by at least ``least``.

    The result is ``law`` if the fitted law is of another kind.
    """
    linear = declared.quadratic == 0.0
    if linear != (law.name != "quadratic spring"):
        return ("law",)
    stated = vars(declared).copy()
    if linear and declared.stiffness > 0.0:
        stated["rest"] = declared.rest + declared.preload / declared.stiffness
    results = [
        name
        for name, value in law.params.items()
        if not value.low <= stated[name] <= value.high and abs(value.value - stated[name]) >= least[name]
    ]
    if declared.friction >= least["friction"] and "friction" not in law.params:
        results.append("friction")
    return tuple(results)
