"""Simulation of joints in flights without logged joint angles, and their reaction on the body.

Body motion and rotor states come from the log. The declared links move under
    M(q) a = f(q, q', motion, thrusts) + (0, effort(q, q')),    q'' = the joint rows of a,
integrated by Runge-Kutta of order 4; the other rows of a are the predicted motion of the body.
Letters: B parameter sets, T rows, D joints, L links, E = B times the segments of all flights.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.math.quaternion import quat_normalize, quat_rotate_inverse
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.joint_laws import JointLimits, Spring
from aerial_gym.physics.articulated.tree import Links, TreeState
from aerial_gym.physics.effects import EFFECTS, LinkFluidEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.teststand.joints.joint_motion import apply_link_wrenches, require_rate, rotor_states

CHANNELS = ("force x", "force y", "force z", "rotation x", "rotation y", "rotation z")
"""Specific force [m/s²] and angular acceleration [rad/s²]."""

SETTLE_S = 2.0  # Simulated time before the first compared row [s], as joints start at rest

DAMPED_S, DAMPED_BY = 0.5, 0.05
"""Duration of extra initial damping [s], and its time constant [s] relative to stiffness, to reach equilibrium."""

BENT = 0.2  # Deflection at which a quadratic spring's stiffness is evaluated for the step size [rad]

QUICKEST = 1.5
"""Largest product of a joint's natural frequency and the step; Runge-Kutta is unstable at about twice that."""

USED_S = 2.0  # Length of the compared part of each segment [s]


@dataclass(frozen=True, kw_only=True)
class BodyMotion:
    """Logged motion of the body that carries the joints."""

    name: str
    rate: float  # Sample rate [Hz]
    base: TreeState  # Motion of the body, with joints in the reference pose
    wrench: Tensor  # Wrench on each link, (T, L, 6)
    felt: Array  # Measured ``CHANNELS`` in the band, (T, 6)


def body_motion(robot: RobotCfg, log: FlightLog, *, bandwidth: float) -> BodyMotion:
    """Return the motion of the body from a log at equal time steps."""
    if fluids := [name for name in robot.effects if isinstance(EFFECTS.get(name), LinkFluidEffect)]:
        raise ConfigError(
            f"identify joints: {fluids[0]} cannot be simulated without logged joint angles. Log them (columns joint_NAME), or "
            "remove the effect"
        )
    rate = require_rate(log, bandwidth)
    assert log.ang_vel is not None

    def rows(values: Array | None) -> Tensor:
        if values is None:
            return torch.zeros(len(log.time), 3, dtype=torch.float64)
        return torch.from_numpy(np.ascontiguousarray(lowpass(values, rate, rate / 5.0)))

    attitude = quat_normalize(rows(log.attitude))
    force = log.specific_force
    if force is None:
        assert log.lin_vel is not None
        moved = torch.from_numpy(lowpass(log.lin_vel, rate, rate / 5.0, derivative=True))
        force = quat_rotate_inverse(attitude, moved + torch.tensor((0.0, 0.0, STANDARD_GRAVITY)).double()).numpy()
    turned = lowpass(log.ang_vel, rate, bandwidth, derivative=True)
    references = [] if robot.joints is None else [joint.reference for joint in robot.joints.layout]
    joints = torch.tensor(references, dtype=torch.float64).expand(len(attitude), -1)
    base = TreeState(
        position=rows(log.position),
        attitude=attitude,
        lin_vel=rows(log.lin_vel),
        ang_vel=rows(log.ang_vel),
        joint_pos=joints,
        joint_vel=torch.zeros_like(joints),
    )
    wrench = apply_link_wrenches(robot, base, rows(rotor_states(robot, log)))[2]
    felt = np.concatenate((lowpass(force, rate, bandwidth), turned), axis=1)
    return BodyMotion(name=log.name, rate=rate, base=base, wrench=wrench, felt=felt)


class JointSimulation:
    """Simulation of the joints of some flights for any parameters.

    Joints forget their initial state, so flights are divided into segments that are simulated side by side. Each starts
    ``SETTLE_S`` before its first compared row.
    """

    def __init__(self, robot: RobotCfg, motions: Sequence[BodyMotion], *, bandwidth: float) -> None:
        """Store the declared robot, and flights of one rate."""
        rates = {round(motion.rate, 6) for motion in motions}
        if len(rates) > 1:
            raise DataError(f"logs of different rates: {sorted(rates)} rows per second; identify them one by one")
        self.motions, self.bandwidth, self.rate = tuple(motions), bandwidth, motions[0].rate
        self.warm, self.held = round(SETTLE_S * self.rate), round(DAMPED_S * self.rate)
        first = TreeState(**{name: rows[:1] for name, rows in vars(motions[0].base).items()})
        model, links, _ = apply_link_wrenches(robot, first, torch.zeros(1, robot.num_rotors).double())
        assert model.articulation is not None
        self._articulation = model.articulation
        self._links = Links(mass=links.mass[:1], com=links.com[:1], inertia=links.inertia[:1])
        used = round(USED_S * self.rate)
        self._pieces = [len(range(self.warm, len(motion.wrench), used)) for motion in motions]
        places = [torch.arange(count)[None] * used + torch.arange(self.warm + used)[:, None] for count in self._pieces]

        def cut(rows: Sequence[Tensor]) -> Tensor:  # the last segment is padded with the last row
            return torch.cat(
                [part[place.clamp_max(len(part) - 1)] for part, place in zip(rows, places, strict=True)], 1
            )

        names = ("attitude", "lin_vel", "ang_vel")
        self._base = {name: cut([getattr(motion.base, name) for motion in motions]) for name in names}
        self._wrench = cut([motion.wrench for motion in motions])

    def run(self, laws: "JointLaws", thrust: Tensor) -> tuple[list[Array], Tensor, Tensor]:
        """Return the predicted body motion from row ``warm`` on, (B, T, 6) per flight, and the joints' angles and rates.

        Angles and rates, (T, segments, D), are those of the first parameter set.

        Args:
            thrust: Scale of the rotors' wrench, (B,).
        """
        sets, pieces, dt = len(thrust), sum(self._pieces), 1.0 / self.rate
        spread = laws.repeat(pieces)
        scale = thrust.repeat_interleave(pieces).view(-1, 1, 1)
        base = {name: value.repeat(1, sets, 1) for name, value in self._base.items()}
        wrench = self._wrench.repeat(1, sets, 1, 1)
        angle, rate = spread.spring.rest, torch.zeros_like(spread.spring.rest)
        felt, angles, rates = [], [], []

        def row(k: int) -> LinkLoads:
            return LinkLoads(motion={name: value[k] for name, value in base.items()}, wrench=scale * wrench[k])

        start = end = here = row(0)
        count = self._steps_per_row(laws, here)
        dt = dt / count
        for k in range(count * len(wrench)):
            if k % count == 0:
                start, end = here, row(min(k // count + 1, len(wrench) - 1))
            there = end if count == 1 else start.interpolate(end, (k % count + 1) / count)
            middle, held = here.interpolate(there, 0.5), k < count * self.held
            feels, first = self._accelerations(here, spread, angle, rate, held)
            if k % count == 0 and k >= count * self.warm:
                felt.append(feels)
                angles.append(angle[:pieces])
                rates.append(rate[:pieces])
            _, second = self._accelerations(middle, spread, angle + 0.5 * dt * rate, rate + 0.5 * dt * first, held)
            at = angle + 0.5 * dt * (rate + 0.5 * dt * first)
            _, third = self._accelerations(middle, spread, at, rate + 0.5 * dt * second, held)
            at = angle + dt * (rate + 0.5 * dt * second)
            _, fourth = self._accelerations(there, spread, at, rate + dt * third, held)
            angle = angle + dt * rate + dt * dt / 6.0 * (first + second + third)
            rate = rate + dt / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
            here = there
        whole = torch.stack(felt).unflatten(1, (sets, pieces)).numpy()  # (rows of a piece, B, pieces, 6)
        if not np.isfinite(whole).all():
            raise DataError("joints with these parameters do not settle; check the declared springs")
        parts, start = [], 0
        for motion, count in zip(self.motions, self._pieces, strict=True):
            own = np.moveaxis(whole[:, :, start : start + count], 2, 0).reshape(-1, sets, 6)
            own = own[: len(motion.wrench) - self.warm]
            parts.append(np.swapaxes(lowpass(own, self.rate, self.bandwidth), 0, 1))
            start += count
        return parts, torch.stack(angles), torch.stack(rates)

    def _steps_per_row(self, laws: "JointLaws", here: "LinkLoads") -> int:
        """Return the number of integration steps per row that the fastest joint needs."""
        own = {name: value[:1] for name, value in here.motion.items()}
        rest = laws.spring.rest[:1]
        state = TreeState(position=own["lin_vel"], joint_pos=rest, joint_vel=torch.zeros_like(rest), **own)
        mass = equations_of_motion(self._articulation.tree, self._links, state, gravity=STANDARD_GRAVITY).mass
        ease = torch.linalg.inv(mass)[0].diagonal()[6:]  # joint acceleration per effort
        slope, damping = laws.largest_stiffness_and_damping
        quickest = float(torch.maximum(damping * ease, (slope * ease).sqrt()).max())
        return max(1, ceil(quickest / self.rate / QUICKEST))

    def _accelerations(
        self, row: "LinkLoads", laws: "JointLaws", angle: Tensor, rate: Tensor, held: bool
    ) -> tuple[Tensor, Tensor]:
        """Return the body's specific force and angular acceleration, (E, 6), and the joint accelerations, (E, D)."""
        state = TreeState(position=row.motion["lin_vel"], joint_pos=angle, joint_vel=rate, **row.motion)
        results = equations_of_motion(
            self._articulation.tree,
            self._links,
            state,
            gravity=STANDARD_GRAVITY,
            wrench=row.wrench,
            effort=laws.joint_effort(angle, rate, held=held),
        )
        moved = torch.linalg.solve(results.mass, results.force)
        up = torch.tensor(((0.0, 0.0, 1.0),), dtype=torch.float64).expand(len(angle), 3)
        weight = STANDARD_GRAVITY * quat_rotate_inverse(row.motion["attitude"], up)
        return torch.cat((moved[:, :3] + weight, moved[:, 3:6]), dim=-1), moved[:, 6:]


@dataclass(frozen=True, kw_only=True)
class LinkLoads:
    """Motion of the body and wrenches on the links at one instant."""

    motion: dict[str, Tensor]
    wrench: Tensor

    def interpolate(self, other: "LinkLoads", share: float) -> "LinkLoads":
        """Return the linear interpolation to another instant at a share."""
        motion = {name: torch.lerp(value, other.motion[name], share) for name, value in self.motion.items()}
        return LinkLoads(motion=motion, wrench=torch.lerp(self.wrench, other.wrench, share))


@dataclass(frozen=True, kw_only=True)
class JointLaws:
    """Joint laws of several parameter sets, as tensors (B, D)."""

    spring: Spring
    ends: JointLimits
    friction: Tensor  # Dry friction [N m]
    slow: Tensor  # Velocity scale of friction [rad/s]: ``F q' / sqrt(q'² + slow²)``

    @property
    def largest_stiffness_and_damping(self) -> tuple[Tensor, Tensor]:
        """Return the largest stiffness and damping, (B, D): deflected by ``BENT``, at the end stops, with extra damping."""
        slope = self.spring.stiffness + 2.0 * self.spring.quadratic * BENT
        return slope + self.ends.stiffness, self.spring.damping + self.ends.damping + DAMPED_BY * slope

    def repeat(self, count: int) -> "JointLaws":
        """Return every parameter set repeated ``count`` times in sequence."""

        def repetition(rows: Any) -> Any:
            if isinstance(rows, Tensor):
                return rows.repeat_interleave(count, dim=0)
            return type(rows)(**{name: repetition(value) for name, value in vars(rows).items()})

        return repetition(self)

    def joint_effort(self, angle: Tensor, rate: Tensor, *, held: bool = False) -> Tensor:
        """Return the joint efforts [N m], (B, D); ``held``: with the initial extra damping."""
        spring = self.spring.evaluate_effort(angle, rate)
        results = spring.value + self.ends.evaluate_effort(angle, rate).value
        results = results - self.friction * rate / (rate.square() + self.slow.square()).sqrt()
        return results - DAMPED_BY * spring.stiffness * rate if held else results
