"""Springs, dampers and dry friction of joints from flights without logged angles, by the reaction of the body.

The joints of the declared links are simulated (``swing``). The predicted specific force and angular acceleration of the body
are compared with its sensors in one band. Gauss-Newton steps fit the parameters of all joints together, with a constant error
per channel and flight and a common thrust scale.
Link masses and joint positions are as declared. A joint without excitation has wide intervals.
Letters: F flights, N compared rows, D joints, P parameters of all joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.joint import SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics.articulated.joint_laws import JointLimits, Spring
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds
from aerial_gym.sim2real.logs.signals import num_edge_rows
from aerial_gym.sim2real.predict.rows.dataset import SAMPLES_PER_BAND
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Rms
from aerial_gym.sim2real.teststand.joints.angle_logs import (
    MATERIAL,
    JointResult,
    reason_against_fitting_joint,
    require_joints,
)
from aerial_gym.sim2real.teststand.joints.joint_motion import SLOW
from aerial_gym.sim2real.teststand.joints.joint_simulation import (
    CHANNELS,
    SETTLE_S,
    BodyMotion,
    JointLaws,
    JointSimulation,
)
from aerial_gym.sim2real.teststand.statistics import cross_validation_error, estimates, fold_labels, hac_covariance

LEAST_ROWS = 50  # Least number of compared rows per flight

MOST_STEPS = 8
NEAR = 0.1  # Convergence limit of a step as a share of a material change

NO_ENDS = {"low": -np.inf, "high": np.inf, "stiffness": 0.0, "damping": 0.0}

NUMBERS = {False: ("stiffness", "damping", "rest", "friction"), True: ("quadratic", "damping", "rest")}
"""Fitted parameters of a joint, by whether its declared spring is quadratic."""


@dataclass(frozen=True, kw_only=True)
class BodyMotionFit:
    """Fit of all joints to the body's motion."""

    joints: tuple[JointResult, ...]
    channels: dict[str, tuple[Rms, Rms]]
    """Error of each channel on left-out flights or folds, with declared and with fitted parameters."""


def fit_hidden_joints(
    robot: RobotCfg, motions: Sequence[BodyMotion], *, bandwidth: float, progress: Progress = silent
) -> BodyMotionFit:
    """Return the fit of all joints to the body's motion in all flights."""
    for reason in filter(None, map(reason_against_fitting_joint, require_joints(robot).layout)):
        why = "has a drive, whose effort is not logged" if reason.code == "joint_driven" else "creeps"
        raise ConfigError(
            "identify joints: without logged angles every joint must be passive and without creep, but "
            f"{reason.subject} {why}"
        )
    return JointFitter(robot, motions, bandwidth).fit(progress)


class JointFitter:
    """Gauss-Newton fit that starts at the declared parameters."""

    def __init__(self, robot: RobotCfg, motions: Sequence[BodyMotion], bandwidth: float) -> None:
        self.joints = require_joints(robot).layout
        self.simulation = JointSimulation(robot, motions, bandwidth=bandwidth)
        self.springs = [joint.spring or SpringCfg() for joint in self.joints]
        self.parameter_owners = [
            (k, name) for k, spring in enumerate(self.springs) for name in NUMBERS[spring.quadratic > 0.0]
        ]
        self.declared = np.array([getattr(self.springs[k], name) for k, name in self.parameter_owners])
        self.slow = torch.ones(1, len(self.joints), dtype=torch.float64)
        rate = self.simulation.rate
        every, edge = max(1, int(rate / (SAMPLES_PER_BAND * bandwidth))), num_edge_rows(rate, bandwidth)
        self.kept = [np.arange(edge, len(motion.wrench) - self.simulation.warm - edge, every) for motion in motions]
        if min(rows.size for rows in self.kept) < LEAST_ROWS:
            raise DataError(
                f"flights are too short: without angles {SETTLE_S:g} s at their start are left out; fly longer"
            )
        self.fold = fold_labels([rows.size for rows in self.kept])

    def fit(self, progress: Progress) -> BodyMotionFit:
        """Return the converged fit."""
        progress("joints as declared", 0.05)
        angle, rate = self.simulation.run(self.joint_laws(self.declared[None]), torch.ones(1).double())[1:]
        self.slow = (SLOW * rate.flatten(0, 1).std(0, keepdim=True)).clamp_min(1e-9)
        unit = self.material_changes(angle, rate)
        numbers, thrust = self.declared.copy(), 1.0
        before = residual, columns = self.residual_and_columns(numbers, thrust, unit)
        step, least = np.zeros(unit.size + 1), np.inf
        for count in range(MOST_STEPS):
            progress(f"joints, step {count + 1}", 0.1 + 0.8 * count / MOST_STEPS)
            if count > 0:
                residual, columns = self.residual_and_columns(numbers, thrust, unit)
            weight = _channel_weights(residual)
            cost = float(np.sum(np.log(np.mean(residual**2, axis=0))))
            if cost > least + 1e-9:
                step = 0.5 * step
                numbers, thrust = numbers - step[:-1] * unit, thrust - step[-1]
                continue
            least, best = cost, (residual, columns, weight, numbers.copy())
            step = self.step_within_bounds(residual * weight, columns * weight[:, None], numbers / unit)
            numbers, thrust = numbers + step[:-1] * unit, thrust + step[-1]
            if np.abs(step[:-1]).max() < NEAR:
                break
        return self.fit_with_intervals(before, best, unit)

    def joint_laws(self, numbers: Array) -> JointLaws:
        """Return the joint laws for parameter sets (B, P)."""
        stated = {
            name: torch.tensor([[getattr(spring, name) for spring in self.springs]] * len(numbers), dtype=torch.float64)
            for name in ("stiffness", "quadratic", "damping", "friction", "rest", "preload")
        }
        for place, (k, name) in enumerate(self.parameter_owners):
            stated[name][:, k] = torch.from_numpy(numbers[:, place])
        friction = stated.pop("friction")
        like, bounds = torch.ones_like(friction), {}
        for name, nowhere in NO_ENDS.items():
            row = [nowhere if joint.ends is None else getattr(joint.ends, name) for joint in self.joints]
            bounds[name] = like * torch.tensor(row, dtype=torch.float64)
        return JointLaws(spring=Spring(**stated), ends=JointLimits(**bounds), friction=friction, slow=self.slow * like)

    def material_changes(self, angle: Tensor, rate: Tensor) -> Array:
        """Return the change of each parameter that changes its joint's effort by the share ``MATERIAL`` of its spread, (P,)."""
        laws = self.joint_laws(self.declared[None])
        flat = angle.flatten(0, 1), rate.flatten(0, 1)
        spring, away = laws.spring.evaluate_effort(*flat), flat[0] - laws.spring.rest
        effort = laws.joint_effort(*flat).std(0)
        sizes = {
            "stiffness": away.std(0),
            "quadratic": (away * away.abs()).std(0),
            "damping": flat[1].std(0),
            "friction": torch.ones_like(effort),
            "rest": spring.stiffness.mean(0),
        }
        if bool((effort <= 0.0).any()):
            raise DataError(
                "a joint does not move under its declared law, so it cannot be identified; check its spring"
            )
        return np.array(
            [MATERIAL * float(effort[k] / sizes[name][k].clamp_min(1e-12)) for k, name in self.parameter_owners]
        )

    def residual_and_columns(self, numbers: Array, thrust: float, unit: Array) -> tuple[Array, Array]:
        """Return the residual (N, 6) and its columns (N, 6, P + 1), per material change or thrust scale, without mean."""
        sets = np.concatenate((numbers[None], numbers + np.diag(unit), numbers[None]))
        scale = torch.full((len(sets),), thrust, dtype=torch.float64)
        scale[-1] = scale[-1] + MATERIAL
        felt, _, _ = self.simulation.run(self.joint_laws(sets), scale)
        residual, moved = [], []
        for motion, part, kept in zip(self.simulation.motions, felt, self.kept, strict=True):
            left, change = motion.felt[self.simulation.warm + kept] - part[0, kept], part[1:, kept] - part[0, kept]
            residual.append(left - left.mean(axis=0))
            moved.append(np.moveaxis(change - change.mean(axis=1, keepdims=True), 0, -1))
        columns = np.concatenate(moved)
        columns[..., -1] /= MATERIAL
        return np.concatenate(residual), columns

    def step_within_bounds(self, residual: Array, columns: Array, here: Array) -> Array:
        """Return the bounded Gauss-Newton step: parameters in units of material changes, then the thrust scale."""
        width = columns.shape[-1]
        flat, left = columns.reshape(-1, width), residual.reshape(-1)
        low, high = np.full(width, -np.inf), np.full(width, np.inf)
        positive = [place for place, (_, name) in enumerate(self.parameter_owners) if name != "rest"]
        low[positive] = np.maximum(low[positive], -here[positive])
        size = np.sqrt((flat**2).sum(axis=0)) + 1e-300
        flat = flat / size
        a = flat.T @ flat + 1e-9 * np.eye(width)
        return minimise_in_bounds(a, flat.T @ left, low * size, high * size) / size

    def fit_with_intervals(
        self, before: tuple[Array, Array], optimum: tuple[Array, Array, Array, Array], unit: Array
    ) -> BodyMotionFit:
        """Return the parameters with intervals, the significant changes, and the held-out errors."""
        residual, columns, weight, numbers = optimum
        rows = np.moveaxis(columns * weight[:, None], 1, 0).reshape(-1, columns.shape[-1])
        left = (residual * weight).T.reshape(-1)
        covariance = hac_covariance(rows, left)[: unit.size, : unit.size]
        values = estimates(numbers, covariance * np.outer(unit, unit), left.size - rows.shape[1])
        joints = []
        for k, joint in enumerate(self.joints):
            own = {name: place for place, (owner, name) in enumerate(self.parameter_owners) if owner == k}
            params = {name: values[place] for name, place in own.items()}
            changed = tuple(
                name
                for name, place in own.items()
                if not params[name].low <= self.declared[place] <= params[name].high
                and abs(params[name].value - self.declared[place]) >= unit[place]
            )
            rounded = {name: float(f"{value.value:.6g}") for name, value in params.items()} if changed else {}
            declared = {name: float(self.declared[place]) for name, place in own.items()}
            spring = replace(self.springs[k], **rounded)
            joints.append(
                JointResult(name=joint.name, declared=declared, params=params, changed=changed, spring=spring)
            )
        nuisances = before[1][..., unit.size :]
        errors = (
            self.errors_on_left_out_folds(before[0], nuisances, _channel_weights(before[0])),
            self.errors_on_left_out_folds(residual, columns, weight),
        )
        return BodyMotionFit(joints=tuple(joints), channels=dict(zip(CHANNELS, zip(*errors, strict=True), strict=True)))

    def errors_on_left_out_folds(self, residual: Array, columns: Array, weight: Array) -> list[Rms]:
        """Return the cross-validation error of each channel, from linear fits about this one."""
        left, width = np.empty_like(residual), columns.shape[-1]
        for number in np.unique(self.fold):
            out = self.fold == number
            rows = (columns[~out] * weight[:, None]).reshape(-1, width)
            step = np.linalg.lstsq(rows, (residual[~out] * weight).reshape(-1), rcond=None)[0]
            left[out] = residual[out] - columns[out] @ step
            left[out] -= left[out].mean(axis=0)  # a flight's own constant error
        return [cross_validation_error(channel, self.fold) for channel in left.T]


def _channel_weights(residual: Array) -> Array:
    """Return the inverse rms of each channel of residuals (N, C), (C,)."""
    return 1.0 / np.maximum(np.sqrt(np.mean(residual**2, axis=0)), 1e-12)
