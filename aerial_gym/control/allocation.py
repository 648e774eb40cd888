"""Control allocation: from a wanted body wrench to rotor commands.

The allocation matrix comes from the rotors of the *declared* vehicle, because an autopilot does not know unmodelled effects.
With ``effectiveness: actual`` it comes from the vehicle of each environment (``control.effectiveness``).
Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
from torch import Tensor

from aerial_gym.control.effectiveness import (
    CommandAxes,
    allocation_matrix,
    find_actuation,
    pseudo_inverse,
    right_inverse,
)
from aerial_gym.math.rows import compute_if
from aerial_gym.physics.fused.allocation import NEGLIGIBLE, UNLIMITED, make_thrusts_by_priority
from aerial_gym.physics.rotors import rotor_thrust, state_for_thrust
from aerial_gym.physics.vehicle import Vehicle, is_shared, move_rows, own_rows, share_row

Saturation = Literal["prioritised", "clamp"]
MAP_FIELDS = ("thrust_map", "reverse_thrust_map")  # Fields of `Vehicle` that map between thrusts and rotor states

MATRIX_FIELDS = frozenset(
    ("mass", "com", "rotor_position", "rotor_axis", "rotor_spin", "torque_map", "reverse_torque_map", *MAP_FIELDS)
)
"""Fields of ``Vehicle`` on which the effectiveness matrix depends."""


@dataclass(frozen=True)
class Allotment:
    """Allocated thrusts, and the shares of the wanted torque that they give."""

    thrust: Tensor  # [N], (E, R)
    turn: Tensor  # Share of the roll and pitch torque, 0 to 1, (E, 1)
    rest: Tensor  # Share of the yaw torque and the lateral force, 0 to 1, (E, 1)


def allot(inverse: Tensor, wrench: Tensor, low: Tensor, high: Tensor, *, idle: bool = True) -> Allotment:
    """Return thrusts [N], (E, R), within their limits: by the pseudo-inverse if possible, else by ``ThrustsByPriority``.

    Args:
        inverse: Pseudo-inverse of the allocation matrix, (E, R, 6).
        wrench: Wanted force [N] and torque [N m], body, (E, 6).
        low: Lowest thrusts [N], (E, R).
        high: Highest thrusts [N], (E, R).
        idle: Whether any rotor has no part in the force along body z.
    """
    parts, lift, force = inverse * wrench.unsqueeze(1), inverse[..., 2], wrench[:, 2:3]
    turn, rest = parts[..., 3] + parts[..., 4], parts[..., 0] + parts[..., 1] + parts[..., 5]
    plain = parts.sum(-1)
    beyond, whole = ~is_within_limits(plain, low, high), torch.ones_like(force)
    arguments = (lift, turn, rest, force, low, high)
    return Allotment(*compute_if(beyond, ThrustsByPriority(idle), arguments, (plain, whole, whole)))


@dataclass(frozen=True)
class ThrustsByPriority:
    """Thrusts within their limits, (E, R), by priority, and the shares of the wanted torque that they give, (E, 1) each.

    Priorities: first the largest feasible share of roll and pitch torque; then the thrust along body z nearest to the wanted
    one; then the largest share of yaw torque and lateral force. Each step is the exact optimum, given those before it, within
    the span of the pseudo-inverse. Yaw torque that allows more thrust is used.

    Source:
        Derived: linear programs in two unknowns, solved by eliminating one of them between each pair of limits
        (Fourier-Motzkin). The order is that of Faessler, Falanga, Scaramuzza (2017), Thrust mixing, saturation, and body-rate
        control for accurate aggressive quadrotor flight, IEEE RA-L 2(2).
    """

    idle: bool  # Whether any rotor has no part in the force along body z

    def __call__(
        self, lift: Tensor, turn: Tensor, rest: Tensor, force: Tensor, low: Tensor, high: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the thrusts and shares.

        Args:
            lift: Thrusts per force along body z [-], (E, R).
            turn: Thrusts for the roll and pitch torque [N], (E, R).
            rest: Thrusts for the yaw torque and the lateral force [N], (E, R).
            force: Wanted force along body z [N], (E, 1).
            low: Lowest thrusts [N], (E, R).
            high: Highest thrusts [N], (E, R).
        """
        carries = lift != 0.0
        unit = torch.where(carries, lift, 1.0)
        ends = low / unit, high / unit
        floor = torch.where(carries, torch.minimum(*ends), -UNLIMITED)
        ceiling = torch.where(carries, torch.maximum(*ends), UNLIMITED)
        slope, twist = (torch.where(carries, change / unit, 0.0) for change in (turn, rest))
        resting = torch.where(carries, 0.0, torch.clamp(torch.zeros_like(low), low, high))
        idle = torch.where(carries, 0.0, turn)
        share = torch.minimum(
            _largest_share_for_rotor_pairs(floor, ceiling, slope), _share_within_limits(resting, idle, low, high)
        )
        floor, ceiling = floor - share * slope, ceiling - share * slope
        resting = resting + share * idle
        other = torch.where(carries, 0.0, rest)
        most = torch.minimum(
            _largest_share_for_rotor_pairs(floor, ceiling, twist), _share_within_limits(resting, other, low, high)
        )
        lowest, highest = -_highest_force_with_yaw(-floor, -twist, most), _highest_force_with_yaw(ceiling, twist, most)
        collective = torch.maximum(torch.minimum(force, highest), lowest)
        thrust = torch.where(carries, share * turn + collective * lift, resting)
        rest_share = _share_within_limits(thrust, rest, low, high)
        return torch.clamp(thrust + rest_share * rest, low, high), share, rest_share

    def make_warp(
        self, shapes: Sequence[tuple[int, ...]], constants: Mapping[tuple[int, int], float], differentiable: bool
    ) -> Any:
        """Return the Warp function."""
        return make_thrusts_by_priority(shapes[0][0], idle=self.idle, differentiable=differentiable)


def is_within_limits(thrust: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return whether all rotors of an environment are within their limits, bool (E, 1)."""
    return ((thrust >= low) & (thrust <= high)).all(-1, keepdim=True)


def _largest_share(room: Tensor, need: Tensor) -> Tensor:
    """Return the quotient ``room / need``, at most 1."""
    room = room.clamp_min(0.0)
    short = need > room
    return torch.where(short, room / torch.where(short, need, 1.0), 1.0)


def _share_within_limits(thrust: Tensor, change: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Return the largest feasible share (E, 1), at most 1, of a change of thrusts (E, R)."""
    room = torch.where(change > 0.0, high - thrust, thrust - low)
    return _largest_share(room, change.abs()).amin(-1, keepdim=True)


def _largest_share_for_rotor_pairs(floor: Tensor, ceiling: Tensor, slope: Tensor) -> Tensor:
    """Return the largest s <= 1, (E, 1), with one F for which ``floor <= F + s slope <= ceiling`` in every rotor."""
    room, upper, lower = ceiling.unsqueeze(1) - floor.unsqueeze(2), slope.unsqueeze(1), slope.unsqueeze(2)
    need = upper - lower
    need = torch.where(
        need > NEGLIGIBLE * (upper.abs() + lower.abs()), need, 0.0
    )  # ignore round-off between equal rotors
    return _largest_share(room, need).flatten(1).amin(-1, keepdim=True)


def _highest_force_with_yaw(ceiling: Tensor, twist: Tensor, most: Tensor) -> Tensor:
    """Return the largest F, (E, 1), with one y from 0 to ``most`` for which ``F + y twist <= ceiling`` in every rotor."""
    alone = ceiling - most * twist.clamp_max(0.0)
    up, down = twist.unsqueeze(2), twist.unsqueeze(1)
    against = (up > 0.0) & (down < 0.0)
    weight = torch.where(against, up / torch.where(against, up - down, 1.0), 0.0)
    both = torch.where(
        against, ceiling.unsqueeze(2) + weight * (ceiling.unsqueeze(1) - ceiling.unsqueeze(2)), UNLIMITED
    )
    return torch.minimum(alone.amin(-1, keepdim=True), both.flatten(1).amin(-1, keepdim=True))


class Allocation:
    """Pseudo-inverse allocation within the rotors' limits."""

    def __init__(
        self, vehicle: Vehicle, gravity: float, *, saturation: Saturation = "prioritised",
        effectiveness: str = "nominal",
    ) -> None:  # fmt: skip
        """Compute the allocation of a declared vehicle.

        Args:
            saturation: Rule at rotor limits: priorities, or a clamp of each thrust.
            effectiveness: Matrix of the ``nominal`` vehicle, or of the ``actual`` one once ``follow`` is called.
        """
        matrix = allocation_matrix(vehicle, gravity)
        asked = find_actuation(matrix[0]).mask_rows(matrix)
        low, high = _thrust_limits(vehicle)
        self.vehicle, self.saturation, self.effectiveness = vehicle, saturation, effectiveness
        if is_shared(vehicle.mass):  # a declared vehicle is the same everywhere
            inverse = pseudo_inverse(asked[0].cpu()).to(asked.device)  # the first decomposition on a GPU takes 0.5 s
            self.inverse = share_row(inverse, vehicle.num_envs)  # (E, R, 6)
            self.low, self.high = (share_row(limit[0], vehicle.num_envs) for limit in (low, high))
        else:
            self.inverse, self.low, self.high = pseudo_inverse(asked), low, high
        self._matrix, self._gravity, self._dtype = matrix[0].detach(), gravity, matrix.dtype
        self._rests = bool((self.inverse[:, :, 2] == 0.0).any())
        self._actuation: CommandAxes | None = None
        self._own: tuple[str, ...] = ()

    def bind_vehicle(self, vehicle: Vehicle) -> "Allocation":
        """Return the allocation for its vehicle on another device."""
        result = copy(self)
        result.vehicle, device = vehicle, vehicle.mass.device
        result.inverse, result.low, result.high = (move_rows(r, device) for r in (self.inverse, self.low, self.high))
        result._matrix = self._matrix.to(device)
        return result

    def follow(self, vehicle: Vehicle) -> None:
        """Give each environment its own rows of all values that depend on vehicle fields with own rows.

        Only an ``actual`` effectiveness has any. Call it before ``fused``; a second call changes nothing.
        """
        if self.effectiveness != "actual" or self._own:
            return
        own = {name for name, rows in vehicle.tensors_by_name().items() if not is_shared(rows)}
        if own & MATRIX_FIELDS:
            self._own += ("allocation",)
            self._actuation, self.inverse = find_actuation(self._matrix), own_rows(self.inverse)
        if own & set(MAP_FIELDS):
            names = MAP_FIELDS if "reversible" in vehicle.traits else MAP_FIELDS[:1]
            self._own += ("low", "high", *names)
            self.low, self.high = own_rows(self.low), own_rows(self.high)
            self.vehicle = replace(self.vehicle, **{name: own_rows(getattr(self.vehicle, name)) for name in names})

    @property
    def rows(self) -> dict[str, Tensor]:
        """Values with own rows per environment, by the fields of ``FusedLaw``, (E, ...)."""
        limits = {"allocation": self.inverse, "low": self.low, "high": self.high}
        return {name: limits[name] if name in limits else getattr(self.vehicle, name) for name in self._own}

    def compute_rows(self, vehicle: Vehicle) -> dict[str, Tensor]:
        """Compute the values of ``rows`` for a vehicle, as a row function of ``interop.rows``."""
        vehicle = vehicle if vehicle.mass.dtype == self._dtype else vehicle.to_dtype(self._dtype)
        result = {name: rows for name, rows in vehicle.tensors_by_name().items() if name in self._own}
        if "low" in self._own:
            result["low"], result["high"] = _thrust_limits(vehicle)
        if self._actuation is not None:
            result["allocation"] = right_inverse(allocation_matrix(vehicle, self._gravity), self._actuation)
        return {name: result[name] for name in self._own}

    def thrust(self, wrench: Tensor) -> Tensor:
        """Return unclamped rotor thrusts [N], (E, R), of least norm for a wrench [N, N m], body, (E, 6)."""
        return (self.inverse * wrench.unsqueeze(1)).sum(-1)

    def speed(self, thrust: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), that give the thrusts [N] after clamping to the limits."""
        return self.speed_within_limits(torch.clamp(thrust, self.low, self.high))

    def speed_within_limits(self, thrust: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), that give thrusts [N] within the limits."""
        return state_for_thrust(self.vehicle, thrust)

    def speed_for_wrench(self, wrench: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), for a wrench [N, N m], body, (E, 6), within the limits."""
        return self.speed_within_limits(self.allot(wrench).thrust)

    def allot(self, wrench: Tensor) -> Allotment:
        """Return thrusts for a wrench [N, N m], body, (E, 6); clamped thrusts count as shares of 0."""
        if self.saturation == "prioritised":
            return allot(self.inverse, wrench, self.low, self.high, idle=self.has_rotor_without_lift)
        thrust = self.thrust(wrench)
        given = is_within_limits(thrust, self.low, self.high).to(thrust.dtype)
        return Allotment(torch.clamp(thrust, self.low, self.high), given, given)

    def torque_authority(self, weight: float) -> Tensor:
        """Return the torque authority [N m], (3,): the largest torque both ways about each body axis at a weight [N].

        It is that of the first environment; 0 about axes without authority.
        """
        return self.wrench_authority(weight)[3:]

    def wrench_authority(self, weight: float) -> Tensor:
        """Return the authority in force [N] and torque [N m], (6,), both ways along each body axis beside a weight [N].

        It is that of the first environment; 0 along axes without authority.
        """
        limit = self._wrenches_at_saturation(weight).amin(0)
        return torch.where(limit.isfinite(), limit * self.controllable_share_of_axes, 0.0)

    @property
    def controllable_share_of_axes(self) -> Tensor:
        """Share of a force or torque along each body axis that the rotors give, (6,): 1 if independently available, else 0."""
        return (self._matrix * self.inverse[0].detach().T).sum(-1)

    def rotor_at_limit_by_axis(self, weight: float) -> Tensor:
        """Return the index of the rotor that limits ``wrench_authority`` along each axis, int64, (6,)."""
        return self._wrenches_at_saturation(weight).argmin(0)

    def _wrenches_at_saturation(self, weight: float) -> Tensor:
        """Return the force and torque at which each rotor saturates while the rotors carry a weight [N], (R, 6)."""
        inverse, low, high = self.inverse[0].detach(), self.low[0], self.high[0]
        hover = inverse[:, 2] * weight
        room = torch.minimum(high - hover, hover - low).clamp_min(0.0).unsqueeze(-1)
        need = inverse.abs()
        return torch.where(need > 0.0, room / torch.where(need > 0.0, need, 1.0), torch.inf)

    @property
    def has_rotor_without_lift(self) -> bool:
        """Whether a rotor contributes nothing to the force along body z, or may do so later."""
        return "allocation" in self._own or self._rests

    def largest_thrust(self) -> float:
        """Return the largest thrust along body z without torque [N], of the first environment."""
        lift, high = self.inverse[0, :, 2].detach(), self.high[0]
        return float(torch.where(lift > 0.0, high / torch.where(lift > 0.0, lift, 1.0), torch.inf).amin())


def _thrust_limits(vehicle: Vehicle) -> tuple[Tensor, Tensor]:
    """Return the lowest and highest thrusts [N], (E, R) each."""
    return rotor_thrust(vehicle, vehicle.speed_low), rotor_thrust(vehicle, vehicle.speed_high)
