"""PX4's cascade as a controller with memory.

    action -> position and attitude control (at ``ControllerCfg.rate_hz``) -> rate control (at ``Px4Cfg.rate_hz``) -> rotors

It has no landing detector and no hover-thrust estimator. Saturation is resolved by PX4's mixer if ``Px4Cfg.MC_AIRMODE`` is
given, else by ``ControllerCfg.allocation``. As in PX4, unallocated torque stops the integral in the next run.
Frames: world z up, body x forward, y left, z up. Letters: E environments, R rotors, M remembered numbers.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import torch
from torch import Tensor

from aerial_gym.config.autopilots.px4 import Px4Cfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.filters.biquad import apply_filter
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.control.px4 import px4_fused
from aerial_gym.control.px4.attitude import attitude_from_thrust, rate_setpoint
from aerial_gym.control.px4.mixer import mix
from aerial_gym.control.px4.parameters import derive_parameters, make_filters, thrust_curve
from aerial_gym.control.px4.position import limit_velocity, velocity_control
from aerial_gym.control.px4.rates import RATE_NUMBERS, rate_torque, update_integral
from aerial_gym.control.stateful import StatefulController, make_layout
from aerial_gym.control.timing import make_timing
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_from_yaw, quat_rotate, yaw_from_quat
from aerial_gym.physics.fused.law import FusedLaw, gain_rows
from aerial_gym.physics.law_memory import LawMemory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

OUTER_NUMBERS = 9
"""Memory of the outer loops: integral of velocity (3), previous velocity (3), acceleration (3)."""


class Px4Controller(StatefulController):
    """``px4_rate_control``, ``px4_attitude_control``, ``px4_velocity_control`` and ``px4_position_control``."""

    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})
    """None are drawn: they are PX4's parameters, one set for all."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive gains and filters from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        px4: Px4Cfg = select_autopilot(cfg, control)
        _require_fit(px4, vehicle)
        self.timing = timing = make_timing(replace(cfg, px4=px4), dt)
        law = LAWS[cfg.law]
        self.action_names, self._law = law.action, cfg.law
        self._factor, self._airmode = px4.THR_MDL_FAC, px4.MC_AIRMODE
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        self.gains = derive_parameters(cfg, px4, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self.filters = make_filters(px4, timing)
        self._full, self._low, self._span = _motors(vehicle)
        self._inner = RATE_NUMBERS + 6 * len(self.filters.notches)
        self._layout = make_layout(
            timing, own=self._inner + OUTER_NUMBERS, num_rotors=vehicle.num_rotors, num_actions=len(law.action)
        )

    @property
    def _hover_setpoint(self) -> Tensor:
        return self.gains.position.hover[0]

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        own = memory.numbers[:, : self._layout.held]
        inner, outer = own.split((self._inner, OUTER_NUMBERS), dim=-1)
        due = (memory.since % self.timing.law == 0).unsqueeze(-1)
        setpoint, after = self._outer(state, action, outer, (memory.since == 0).unsqueeze(-1))
        setpoint, sent = self._delay_setpoint(setpoint, sent, memory.since)
        command, inner = self._rates(state.ang_vel, setpoint, inner, (memory.since == 0).unsqueeze(-1))
        return command, torch.cat((inner, torch.where(due, after, outer)), dim=-1), sent

    def _outer(self, state: BodyState, action: Tensor, kept: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return normalised thrust and body-rate setpoint (E, 4) of an action, and the new memory, (E, 9)."""
        gains, still = self.gains, torch.zeros_like(action[:, 3])
        if self._law == "rates":
            return torch.cat(((action[:, :1] + 1.0) * gains.position.hover, action[:, 1:]), dim=-1), torch.zeros_like(
                kept
            )
        if self._law == "attitude":
            yaw = yaw_from_quat(state.attitude)
            wanted = quat_from_euler(torch.stack((action[:, 1], action[:, 2], yaw), dim=-1))
            thrust = (action[:, :1] + 1.0) * gains.position.hover
            return torch.cat((thrust, self._rate_setpoint(state, wanted, action[:, 3])), dim=-1), torch.zeros_like(kept)
        if self._law == "velocity":
            yaw, yaw_rate = yaw_from_quat(state.attitude), action[:, 3]
            velocity = quat_rotate(quat_from_yaw(yaw), action[:, :3])
        else:
            yaw, yaw_rate = action[:, 3], still
            velocity = gains.position.position * (action[:, :3] - state.position)
        thrust, kept = self._thrust(state, velocity, kept, begins)
        rates = self._rate_setpoint(state, attitude_from_thrust(thrust, yaw), yaw_rate)
        return torch.cat((thrust.norm(dim=-1, keepdim=True), rates), dim=-1), kept

    def _thrust(self, state: BodyState, velocity: Tensor, kept: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return the thrust [-], world, (E, 3), for a velocity setpoint [m/s], world, and the new memory, (E, 9)."""
        integral, before, smooth = kept.split(3, dim=-1)
        span = self.timing.law * self.timing.dt
        measured = torch.where(begins, 0.0, (state.lin_vel - before) / span)
        smooth = smooth + self.filters.acceleration * (measured - smooth)
        error = limit_velocity(velocity, self.gains.position) - state.lin_vel
        _, thrust, integral = velocity_control(error, integral, smooth, self.gains.position, span)
        return thrust, torch.cat((integral, state.lin_vel, smooth), dim=-1)

    def _rate_setpoint(self, state: BodyState, wanted: Tensor, yaw_rate: Tensor) -> Tensor:
        gains = self.gains
        return rate_setpoint(
            state.attitude, wanted, yaw_rate, gain=gains.attitude, yaw_weight=gains.yaw_weight, limit=gains.rate_limit
        )

    def _rates(self, ang_vel: Tensor, setpoint: Tensor, kept: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R), for normalised thrust and body rates, (E, 4), and the new memory, (E, M)."""
        gains, filters, span = self.gains, self.filters, self.timing.loop * self.timing.dt
        sizes = (3, 3, 3, 6, 3, 1, *[6] * len(filters.notches))
        integral, ang_acc, before, inner, short, yaw, *notched = kept.split(sizes, dim=-1)
        rate = ang_vel
        for k, band in enumerate(filters.notches):
            rate, notched[k] = apply_filter(rate, notched[k], begins, band)
        if filters.gyro is None:
            inner = torch.zeros_like(inner)
        else:
            rate, inner = apply_filter(rate, inner, begins, filters.gyro)
        measured = torch.where(begins, 0.0, (rate - before) / span)
        ang_acc = ang_acc + filters.ang_acc * (measured - ang_acc)
        wanted, error = setpoint[:, 1:], setpoint[:, 1:] - rate
        torque = rate_torque(error, wanted, ang_acc, integral, (gains.rate, gains.rate_derivative, gains.rate_forward))
        integral = update_integral(integral, error, short, gains.rate_integral, gains.integral_limit, span)
        yaw = yaw + filters.yaw_torque * (torque[:, 2:] - yaw)
        torque = torch.cat((torque[:, :2], yaw), dim=-1)
        thrust, short = self._mix(torque, setpoint[:, :1])
        return self._speeds(thrust), torch.cat((integral, ang_acc, rate, inner, short, yaw, *notched), dim=-1)

    def _mix(self, torque: Tensor, collective: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrusts [N], (E, R), for normalised torque and thrust, and the sign of unallocated torque, (E, 3)."""
        unit_torque, unit_thrust = self.gains.unit_torque, self.gains.unit_thrust
        if self._airmode is not None:
            inverse, full = self.allocation.inverse, self.allocation.high
            turning = inverse[..., 3:] * unit_torque.unsqueeze(1)
            lifting = inverse[..., 2:3] * unit_thrust.unsqueeze(1)
            columns = torch.cat((turning, lifting), dim=-1) / full.unsqueeze(-1)
            wanted = torch.cat((torque, collective), dim=-1)
            mixed = mix(columns, wanted, self.allocation.low / full, airmode=self._airmode)
            return mixed.signal * full, mixed.short
        allotted = self.allocation.allot(thrust_wrench((collective * unit_thrust)[:, 0], torque * unit_torque))
        given = torch.cat((allotted.turn, allotted.turn, allotted.rest), dim=-1)
        return allotted.thrust, torch.where(given < 1.0, torch.sign(torque), 0.0)

    def _speeds(self, thrust: Tensor) -> Tensor:
        """Return the rotor speeds [rad/s] of thrusts [N], (E, R), by PX4's thrust curve."""
        if self._factor is None:
            return self.allocation.speed(thrust)
        return self._low + self._span * thrust_curve((thrust / self._full).clamp(0.0, 1.0), self._factor)

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=px4_fused.maker(
                self._law,
                self.filters,
                self.timing,
                self._layout,
                first=self._inner,
                factor=self._factor,
                airmode=self._airmode,
            ),
            gains_type=px4_fused.Px4Rows,
            gains=gain_rows(px4_fused.Px4Rows, SimpleNamespace(**(vars(self.gains) | vars(self.gains.position)))),
        )


def _require_fit(px4: Px4Cfg, vehicle: Vehicle) -> None:
    """Raise ``ConfigError`` for a thrust curve with rotors that cannot have one."""
    if px4.THR_MDL_FAC is not None and vehicle.traits & {"reversible", "force"}:
        raise ConfigError(
            f"Px4Cfg.THR_MDL_FAC = {px4.THR_MDL_FAC:g}: the curve needs rotors that turn in one direction and take a speed. "
            "Leave it out"
        )


def _motors(vehicle: Vehicle) -> tuple[Tensor, Tensor, Tensor]:
    """Return the full thrust [N], the lowest speed and the span of speeds [rad/s] of each rotor, (E, R)."""
    low, high = vehicle.speed_low, vehicle.speed_high
    return rotor_thrust(vehicle, high), low, high - low
