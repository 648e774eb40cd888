"""Joints that swing as they must have in flights whose logs do not have their angles: what the body felt of them.

The motion of the body and the states of its rotors are those of the log; the declared links move under

    M(q) a = f(q, q', motion, thrusts) + (0, effort(q, q')),    q'' = the joints' part of a,

by Runge-Kutta steps of order 4 from row to row, and the body feels the other part of a.
Letters: B sets of numbers, T rows, D joints, L links, E = B times the pieces of all flights.
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
from aerial_gym.physics.articulated.dynamics import equations
from aerial_gym.physics.articulated.joint_laws import Limits, Spring
from aerial_gym.physics.articulated.tree import Links, TreeState
from aerial_gym.physics.effects import EFFECTS, LinkFluidEffect
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.teststand.joints.courses import checked_rate, pushed_links, rotor_states

CHANNELS = ("force x", "force y", "force z", "rotation x", "rotation y", "rotation z")
"""Specific force [m/s²] and angular acceleration [rad/s²]."""

SETTLE_S = 2.0
"""For which joints swing before a row counts [s]: they begin at rest."""

DAMPED_S, DAMPED_BY = 0.5, 0.05
"""At first [s] they are damped by that time [s] times their stiffness, so that they come to where thrusts hold them."""

BENT = 0.2
"""Angle from rest at which a quadratic spring is as stiff as steps take it to be [rad]."""

QUICKEST = 1.5
"""Rate of a joint times a step; where it is twice that, steps of Runge and Kutta grow."""

USED_S = 2.0
"""Rows that count of each piece of a flight [s]."""


@dataclass(frozen=True, kw_only=True)
class Ride:
    """What a log says of the body that carries the joints."""

    name: str
    rate: float
    """Rows per second."""

    base: TreeState
    """Motion of the body; joints, whose angles are not known, stand as in the reference pose."""

    wrench: Tensor
    """On each link, (T, L, 6)."""

    felt: Array
    """``CHANNELS`` as measured, in the band, (T, 6)."""


def ride_of(robot: RobotCfg, log: FlightLog, *, bandwidth: float) -> Ride:
    """Return what a log of equal time steps says of the body.

    Raises:
        DataError: If it has neither accelerometer nor velocity, no gyro or no rotors, or is too slow or too short.
        ConfigError: If links set a fluid in motion.
    """
    if fluids := [name for name in robot.effects if isinstance(EFFECTS.get(name), LinkFluidEffect)]:
        raise ConfigError(
            f"identify joints: {fluids[0]} is left out where no angles of joints are logged. Log them (columns joint_NAME), or "
            "leave the effect out"
        )
    rate = checked_rate(log, bandwidth)
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
    wrench = pushed_links(robot, base, rows(rotor_states(robot, log)))[2]
    felt = np.concatenate((lowpass(force, rate, bandwidth), turned), axis=1)
    return Ride(name=log.name, rate=rate, base=base, wrench=wrench, felt=felt)


class Swing:
    """The joints of some flights under any numbers.

    What a joint did long ago is forgotten, so that flights are cut into pieces that swing side by side, each from ``SETTLE_S``
    before its first row that counts.
    """

    def __init__(self, robot: RobotCfg, rides: Sequence[Ride], *, bandwidth: float) -> None:
        """Take the declared robot, and flights of one rate."""
        rates = {round(ride.rate, 6) for ride in rides}
        if len(rates) > 1:
            raise DataError(f"logs of different rates: {sorted(rates)} rows per second; identify them one by one")
        self.rides, self.bandwidth, self.rate = tuple(rides), bandwidth, rides[0].rate
        self.warm, self.held = round(SETTLE_S * self.rate), round(DAMPED_S * self.rate)
        first = TreeState(**{name: rows[:1] for name, rows in vars(rides[0].base).items()})
        model, links, _ = pushed_links(robot, first, torch.zeros(1, robot.num_rotors).double())
        assert model.articulation is not None
        self._articulation = model.articulation
        self._links = Links(mass=links.mass[:1], com=links.com[:1], inertia=links.inertia[:1])
        used = round(USED_S * self.rate)
        self._pieces = [len(range(self.warm, len(ride.wrench), used)) for ride in rides]
        places = [torch.arange(count)[None] * used + torch.arange(self.warm + used)[:, None] for count in self._pieces]

        def cut(rows: Sequence[Tensor]) -> Tensor:  # a piece at the end goes on in the last row
            return torch.cat(
                [part[place.clamp_max(len(part) - 1)] for part, place in zip(rows, places, strict=True)], 1
            )

        names = ("attitude", "lin_vel", "ang_vel")
        self._base = {name: cut([getattr(ride.base, name) for ride in rides]) for name in names}
        self._wrench = cut([ride.wrench for ride in rides])

    def run(self, laws: "Laws", thrust: Tensor) -> tuple[list[Array], Tensor, Tensor]:
        """Return what the body feels in the band from ``warm`` rows on, (B, T, 6) of each flight, and joints' angles and rates.

        These, (T, pieces, D), are of the first set.

        Args:
            laws: Numbers of all joints, B sets of them.
            thrust: Scale of what rotors give, (B,).
        """
        sets, pieces, dt = len(thrust), sum(self._pieces), 1.0 / self.rate
        spread = laws.each(pieces)
        scale = thrust.repeat_interleave(pieces).view(-1, 1, 1)
        base = {name: value.repeat(1, sets, 1) for name, value in self._base.items()}
        wrench = self._wrench.repeat(1, sets, 1, 1)
        angle, rate = spread.spring.rest, torch.zeros_like(spread.spring.rest)
        felt, angles, rates = [], [], []

        def row(k: int) -> Row:
            return Row(motion={name: value[k] for name, value in base.items()}, wrench=scale * wrench[k])

        start = end = here = row(0)
        count = self._steps(laws, here)
        dt = dt / count
        for k in range(count * len(wrench)):
            if k % count == 0:
                start, end = here, row(min(k // count + 1, len(wrench) - 1))
            there = end if count == 1 else start.towards(end, (k % count + 1) / count)
            middle, held = here.towards(there, 0.5), k < count * self.held
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
            raise DataError("joints of these numbers do not come to rest: check the declared springs")
        parts, start = [], 0
        for ride, count in zip(self.rides, self._pieces, strict=True):
            own = np.moveaxis(whole[:, :, start : start + count], 2, 0).reshape(-1, sets, 6)
            own = own[: len(ride.wrench) - self.warm]
            parts.append(np.swapaxes(lowpass(own, self.rate, self.bandwidth), 0, 1))
            start += count
        return parts, torch.stack(angles), torch.stack(rates)

    def _steps(self, laws: "Laws", here: "Row") -> int:
        """Return how many steps from row to row joints need that are so quick."""
        own = {name: value[:1] for name, value in here.motion.items()}
        rest = laws.spring.rest[:1]
        state = TreeState(position=own["lin_vel"], joint_pos=rest, joint_vel=torch.zeros_like(rest), **own)
        mass = equations(self._articulation.tree, self._links, state, gravity=STANDARD_GRAVITY).mass
        ease = torch.linalg.inv(mass)[0].diagonal()[6:]  # acceleration per effort
        slope, damping = laws.quickest
        quickest = float(torch.maximum(damping * ease, (slope * ease).sqrt()).max())
        return max(1, ceil(quickest / self.rate / QUICKEST))

    def _accelerations(
        self, row: "Row", laws: "Laws", angle: Tensor, rate: Tensor, held: bool
    ) -> tuple[Tensor, Tensor]:
        """Return what the body feels, (E, 6), and how the joints accelerate, (E, D)."""
        state = TreeState(position=row.motion["lin_vel"], joint_pos=angle, joint_vel=rate, **row.motion)
        found = equations(
            self._articulation.tree,
            self._links,
            state,
            gravity=STANDARD_GRAVITY,
            wrench=row.wrench,
            effort=laws.effort_at(angle, rate, held=held),
        )
        moved = torch.linalg.solve(found.mass, found.force)
        up = quat_rotate_inverse(row.motion["attitude"], _up(len(angle)))
        return torch.cat((moved[:, :3] + STANDARD_GRAVITY * up, moved[:, 3:6]), dim=-1), moved[:, 6:]


@dataclass(frozen=True, kw_only=True)
class Row:
    """What carries and pushes the links at an instant."""

    motion: dict[str, Tensor]
    wrench: Tensor

    def towards(self, other: "Row", share: float) -> "Row":
        """Return the instant at a share of the way to another one."""
        motion = {name: torch.lerp(value, other.motion[name], share) for name, value in self.motion.items()}
        return Row(motion=motion, wrench=torch.lerp(self.wrench, other.wrench, share))


@dataclass(frozen=True, kw_only=True)
class Laws:
    """What acts in all joints, for sets of numbers: tensors (B, D)."""

    spring: Spring
    ends: Limits
    friction: Tensor
    """Dry friction [N m]."""

    slow: Tensor
    """Rate below which it is less than whole [rad/s]: ``F q' / sqrt(q'² + slow²)``."""

    @property
    def quickest(self) -> tuple[Tensor, Tensor]:
        """Return the most by which efforts fall with angles and with rates, (B, D): bent by ``BENT``, on the ends, and held."""
        slope = self.spring.stiffness + 2.0 * self.spring.quadratic * BENT
        return slope + self.ends.stiffness, self.spring.damping + self.ends.damping + DAMPED_BY * slope

    def each(self, count: int) -> "Laws":
        """Return every set so many times, one after the other."""

        def spread(rows: Any) -> dict[str, Tensor]:
            return {name: value.repeat_interleave(count, dim=0) for name, value in vars(rows).items()}

        return Laws(
            spring=Spring(**spread(self.spring)),
            ends=Limits(**spread(self.ends)),
            friction=self.friction.repeat_interleave(count, dim=0),
            slow=self.slow.repeat_interleave(count, dim=0),
        )

    def effort_at(self, angle: Tensor, rate: Tensor, *, held: bool = False) -> Tensor:
        """Return the efforts [N m], (B, D); ``held`` as a piece begins."""
        spring = self.spring.effort_at(angle, rate)
        found = spring.value + self.ends.effort_at(angle, rate).value
        found = found - self.friction * rate / (rate.square() + self.slow.square()).sqrt()
        return found - DAMPED_BY * spring.stiffness * rate if held else found


def _up(number: int) -> Tensor:
    return torch.tensor(((0.0, 0.0, 1.0),), dtype=torch.float64).expand(number, 3)
