"""The Crazyflie's controllers as controllers with memory.

    crazyflie_mellinger_control:  action -> Mellinger (at ``ControllerCfg.rate_hz``) -> counts -> rotors
    crazyflie_pid_control:        action -> position, velocity (at ``ControllerCfg.rate_hz``)
                                         -> attitude, rates (at ``CrazyfliePidCfg.rate_hz``) -> counts -> rotors
    crazyflie_lee_control:        action -> Lee with integrals (at ``ControllerCfg.rate_hz``) -> allocation -> rotors
    crazyflie_brescianini_control: action -> thrust, wanted rates (at ``ControllerCfg.rate_hz``)
                                         -> torque (at ``BrescianiniCfg.rate_hz``) -> allocation -> rotors

Differences to the firmware: integrals and differences start from the first measurement, so that a reset gives no kick, and
the thrust of Mellinger and Brescianini respects ``ControlCfg.max_inclination``.
Not modelled: the estimator, compensation of the battery, and the cut of the thrust near the ground.
Frames: world z up, body x forward, y left, z up. Letters: E environments, R rotors, M remembered numbers.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import degrees
from types import MappingProxyType

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie import (
    brescianini,
    brescianini_fused,
    crazyflie_fused,
    geometric,
    geometric_fused,
    mellinger,
    pid,
)
from aerial_gym.control.crazyflie.distribution import MOST_COUNTS, require_position, rotor_counts, rotor_signs
from aerial_gym.control.crazyflie.parameters import (
    CountGains,
    NominalGains,
    brescianini_gains,
    integral_gains,
    mellinger_gains,
    pid_gains,
)
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import thrust_wrench
from aerial_gym.control.stateful import StatefulController, make_layout
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.fused.law import FusedLaw, gain_rows
from aerial_gym.physics.law_memory import LawMemory
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle


class _Crazyflie(StatefulController):
    """Common part of the controllers: parameters, and a target point."""

    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})
    """Empty, because all environments share the Crazyflie's parameters."""

    own_numbers: int  # Size of the own memory

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive timing and layout from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        assert cfg.autopilot is not None
        require_position(cfg.law)
        self._own = select_autopilot(cfg, control)
        self.timing = timing = make_timing(replace(cfg, **{cfg.autopilot: self._own}), dt)
        self.action_names = LAWS[cfg.law].action
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        self._layout = make_layout(
            timing, own=self.own_numbers, num_rotors=vehicle.num_rotors, num_actions=len(self.action_names)
        )


class _CrazyflieInCounts(_Crazyflie):
    """Common part of controllers with output in counts: the power distribution."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains; arguments as for ``make_controller``."""
        super().__init__(cfg, vehicle, gravity, dt=dt, control=control)
        self._signs = rotor_signs(cfg.law, vehicle, self.allocation, gravity)
        self._derived = CountGains(
            cfg, control, vehicle, self.allocation, self._signs, gravity=gravity, timing=self.timing
        )

    def _speeds(self, thrust: Tensor, moment: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), for a thrust (E, 1) and moments (E, 3) [counts]."""
        return self.allocation.speed(self.allocation.high * rotor_counts(thrust, moment, self._signs) / MOST_COUNTS)


def _point(action: Tensor) -> mellinger.FlatTarget:
    """Return the target at rest of an action (E, 4): position and yaw."""
    still = torch.zeros_like(action[:, :3])
    return mellinger.FlatTarget(
        position=action[:, :3], velocity=still, acceleration=still, yaw=action[:, 3], rates=still
    )


class MellingerController(_CrazyflieInCounts):
    """``crazyflie_mellinger_control``."""

    own_numbers = mellinger.WIDTH

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains; arguments as for ``make_controller``."""
        super().__init__(cfg, vehicle, gravity, dt=dt, control=control)
        self.gains = mellinger_gains(self._own, self._derived)

    @property
    def _hover_setpoint(self) -> Tensor:
        return torch.zeros_like(self.gains.mass[0, 0])  # nothing is on its way

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        kept = memory.numbers[:, : self.own_numbers]
        begins = (memory.since == 0).unsqueeze(-1)
        kept = torch.cat((kept[:, :6], torch.where(begins, state.ang_vel[:, :2], kept[:, 6:])), dim=-1)
        thrust, moment, kept = mellinger.mellinger_control(
            state,
            _point(action),
            kept,
            self.gains,
            gravity=self._derived.gravity,
            dt=self.timing.loop * self.timing.dt,
            max_inclination=self._derived.tilt,
        )
        return self._speeds(thrust, moment), kept, sent

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=crazyflie_fused.mellinger_maker(
                self.timing,
                self._layout,
                self._signs,
                gravity=self._derived.gravity,
                max_inclination=self._derived.tilt,
            ),
            gains_type=crazyflie_fused.MellingerRows,
            gains=gain_rows(crazyflie_fused.MellingerRows, self.gains),
        )


class PidController(_CrazyflieInCounts):
    """``crazyflie_pid_control``."""

    own_numbers = pid.INNER_NUMBERS + pid.OUTER_NUMBERS

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains; arguments as for ``make_controller``."""
        super().__init__(cfg, vehicle, gravity, dt=dt, control=control)
        self.gains = pid_gains(self._own, self._derived)

    @property
    def _hover_setpoint(self) -> Tensor:
        return self.gains.thrust_base[0, 0]

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        timing, gains = self.timing, self.gains
        own = memory.numbers[:, : self.own_numbers]
        inner, outer = own.split((pid.INNER_NUMBERS, pid.OUTER_NUMBERS), dim=-1)
        inner = torch.where((memory.since == 0).unsqueeze(-1), pid.initial_memory(state), inner)
        wish, after = pid.outer_loop(state, action[:, :3], outer, gains, dt=timing.law * timing.dt)
        outer = torch.where((memory.since % timing.law == 0).unsqueeze(-1), after, outer)
        setpoint, sent = self._delay_setpoint(
            torch.cat((wish, degrees(1.0) * action[:, 3:]), dim=-1), sent, memory.since
        )
        moment, inner = pid.inner_loop(state, setpoint[:, 1:], inner, gains, dt=timing.loop * timing.dt)
        return self._speeds(setpoint[:, :1], moment), torch.cat((inner, outer), dim=-1), sent

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=crazyflie_fused.pid_maker(self.timing, self._layout, self._signs),
            gains_type=crazyflie_fused.PidRows,
            gains=gain_rows(crazyflie_fused.PidRows, self.gains),
        )


class CrazyflieLeeController(_Crazyflie):
    """``crazyflie_lee_control``; its thrust and torque go through the allocation, so that any multirotor flies."""

    own_numbers = geometric.WIDTH

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains; arguments as for ``make_controller``."""
        super().__init__(cfg, vehicle, gravity, dt=dt, control=control)
        self.gains = integral_gains(
            self._own, NominalGains(cfg, control, vehicle, self.allocation, gravity=gravity, timing=self.timing)
        )

    @property
    def _hover_setpoint(self) -> Tensor:
        return torch.zeros_like(self.gains.lee.mass[0])  # nothing is on its way

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        kept = memory.numbers[:, : self.own_numbers]
        span = self.timing.loop * self.timing.dt
        thrust, torque, kept = geometric.geometric_control(state, _point(action), kept, self.gains, dt=span)
        return self.allocation.speed_for_wrench(thrust_wrench(thrust, torque)), kept, sent

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=geometric_fused.geometric_maker(self.timing, self._layout),
            gains_type=geometric_fused.IntegralRows,
            gains=geometric_fused.integral_rows(self.gains),
        )


class BrescianiniController(_Crazyflie):
    """``crazyflie_brescianini_control``; its thrust and torque go through the allocation, so that any multirotor flies."""

    own_numbers = 0

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains; arguments as for ``make_controller``."""
        super().__init__(cfg, vehicle, gravity, dt=dt, control=control)
        self._derived = NominalGains(cfg, control, vehicle, self.allocation, gravity=gravity, timing=self.timing)
        self.gains = brescianini_gains(self._own, self._derived)

    @property
    def _hover_setpoint(self) -> Tensor:
        return self.gains.mass[0, 0] * self._derived.gravity

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        gravity, tilt = self._derived.gravity, self._derived.tilt
        wish = brescianini.outer_loop(state, _point(action), self.gains, gravity=gravity, max_inclination=tilt)
        setpoint, sent = self._delay_setpoint(wish, sent, memory.since)
        torque = brescianini.inner_loop(state.ang_vel, setpoint[:, 1:], self.gains)
        speeds = self.allocation.speed_for_wrench(thrust_wrench(setpoint[:, 0], torque))
        return speeds, memory.numbers[:, : self.own_numbers], sent

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=brescianini_fused.brescianini_maker(
                self.timing, self._layout, gravity=self._derived.gravity, max_inclination=self._derived.tilt
            ),
            gains_type=brescianini_fused.BrescianiniRows,
            gains=gain_rows(brescianini_fused.BrescianiniRows, self.gains),
        )
