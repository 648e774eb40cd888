"""Betaflight's rate loop as a controller with memory.

    action -> body rates (at ``ControllerCfg.rate_hz``) -> filters, PID and mixer (at ``BetaflightCfg.rate_hz``) -> motors

The throttle of an action is a thrust, as for other controllers: 0 holds the weight. A motor signal from 0 to 1 is linear in
the speed, from the lowest to the highest.
Not modelled: notch and RPM filters, dynamic cut-offs, PT2 and PT3 filters, the low-pass of yaw P, D max, anti-gravity,
throttle boost, stick smoothing, TPA below ``tpa_low_breakpoint``, thrust linearisation, dynamic idle, yaw spin recovery, and
the battery. TPA follows the throttle of the same run; the firmware's acts one run later.
Frames: body x forward, y left, z up. Betaflight's differ in signs only.
Letters: E environments, R rotors, M remembered numbers.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import torch
from torch import Tensor

from aerial_gym.config.autopilots.betaflight import BetaflightCfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.betaflight import betaflight_fused
from aerial_gym.control.betaflight.loop import (
    THROTTLE_STEP,
    actual_rate,
    integral_share,
    mix_signals,
    throttle_attenuation,
)
from aerial_gym.control.betaflight.parameters import derive_parameters, make_filters, require_fit
from aerial_gym.control.filters.biquad import apply_filter
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.laws import LAWS
from aerial_gym.control.stateful import StatefulController, make_layout
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.fused.law import FusedLaw, gain_rows
from aerial_gym.physics.law_memory import LawMemory
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle

PARTS = (3, 6, 6, 6, 6, 3, 3, 3, 1)
"""Sizes of its memory: integral; states of the two filters of body rates and of the two of the derivative; filtered rate of
the derivative, low-pass of the setpoint, and setpoint of the previous run; range of the corrections."""

STICKS = ("thrust (0 is hover) [-]", "roll stick, -1 to 1 [-]", "pitch stick [-]", "yaw stick [-]")


class BetaflightController(StatefulController):
    """``betaflight_rate_control``."""

    gains_by_name: Mapping[str, Tensor] = MappingProxyType({})
    """None are drawn: they are Betaflight's parameters, one set for all."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive gains and filters from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot file."""
        own: BetaflightCfg = select_autopilot(cfg, control)
        self._own = own
        self.timing = timing = make_timing(replace(cfg, betaflight=own), dt)
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        require_fit(cfg.law, vehicle, self.allocation)
        self.action_names = STICKS if own.rates_type == "ACTUAL" else LAWS[cfg.law].action
        self.gains = derive_parameters(cfg, own, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self.filters = make_filters(own, timing)
        self._relaxed = vehicle.com.new_tensor(
            {"OFF": [0.0] * 3, "RP": [1.0, 1.0, 0.0], "RPY": [1.0] * 3}[own.iterm_relax]
        )
        self._low, self._span = vehicle.speed_low, vehicle.speed_high - vehicle.speed_low
        self._layout = make_layout(
            timing, own=sum(PARTS), num_rotors=vehicle.num_rotors, num_actions=len(self.action_names)
        )

    @property
    def _hover_setpoint(self) -> Tensor:
        return torch.ones_like(self.gains.weight[0, 0])

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        wanted, gains = action[:, 1:], self.gains
        if self._own.rates_type == "ACTUAL":
            wanted = actual_rate(wanted.clamp(-1.0, 1.0), gains.center, gains.largest, gains.expo)
        setpoint, sent = self._delay_setpoint(torch.cat((action[:, :1] + 1.0, wanted), dim=-1), sent, memory.since)
        begins = (memory.since == 0).unsqueeze(-1)
        command, numbers = self._loop(state.ang_vel, setpoint, memory.numbers[:, : self._layout.held], begins)
        return command, numbers, sent

    def _loop(self, ang_vel: Tensor, setpoint: Tensor, kept: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds [rad/s], (E, R), for thrust per weight and body rates, (E, 4), and the new memory, (E, M)."""
        gains, own, span = self.gains, self._own, self.timing.loop * self.timing.dt
        integral, *inner, slow, eased, before, used = kept.split(PARTS, dim=-1)
        filters, rate, inners = (*self.filters.gyro, *self.filters.derivative), ang_vel, []
        for number, (low_pass, part) in enumerate(zip(filters, inner, strict=True)):
            if number == 2:
                seen = rate
            rate, part = (rate, 0.0 * part) if low_pass is None else apply_filter(rate, part, begins, low_pass)
            inners.append(part)
        ang_acc = torch.where(begins, 0.0, (rate - slow) / span)
        wanted, error = setpoint[:, 1:], setpoint[:, 1:] - seen
        eased = torch.where(begins, wanted, eased + self.filters.relax * (wanted - eased))
        change = torch.where(begins, 0.0, (wanted - before) / span)
        share = integral_share((wanted - eased) * self._relaxed, used, own.iterm_windup / 100.0)
        integral = _clamp(integral + share * gains.integral * error * span, gains.integral_limit)
        throttle = self._signal(self.allocation.speed(setpoint[:, :1] * gains.weight * self.allocation.inverse[..., 2]))
        weaker = throttle_attenuation(throttle, own.tpa_rate / 100.0, own.tpa_breakpoint / 1000.0 - 1.0)
        of_error = weaker if own.tpa_mode == "PD" else 1.0
        correction = (
            of_error * gains.rate * error + integral - weaker * gains.derivative * ang_acc + gains.forward * change
        )
        correction = gains.mix * _clamp(correction, gains.limit)
        mix = (self.allocation.inverse[..., 3:] * correction.unsqueeze(1)).sum(-1)
        signal, used = mix_signals(throttle, mix, airmode=own.airmode)
        if not own.airmode:  # the firmware resets the integrals after each run at zero throttle
            integral = torch.where(throttle.mean(-1, keepdim=True) < THROTTLE_STEP, 0.0, integral)
        return self._low + self._span * signal, torch.cat((integral, *inners, rate, eased, wanted, used), dim=-1)

    def _signal(self, speed: Tensor) -> Tensor:
        return (speed - self._low) / self._span

    def fused(self) -> FusedLaw:
        """Return the Warp version of the law."""
        return self._fused(
            make_stateful_step=betaflight_fused.maker(self._own, self.filters, self.timing, self._layout),
            gains_type=betaflight_fused.BetaflightRows,
            gains=gain_rows(betaflight_fused.BetaflightRows, self.gains),
        )


def _clamp(values: Tensor, limit: Tensor) -> Tensor:
    """Clamp values (E, 3) to plus and minus a limit (E, 3)."""
    return torch.minimum(torch.maximum(values, -limit), limit)
