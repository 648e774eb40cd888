"""A batch of environments whose vehicles are flown by Betaflight, one process for each environment.

    position --(PX4's position and attitude control, once per environment step)--> thrust, body rates --> sticks --> firmware

Resets restore the process of an environment to its armed state.
Letters: E environments, R rotors.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.autopilots import BetaflightCfg
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.betaflight.controller import BetaflightController
from aerial_gym.control.gains import select_autopilot
from aerial_gym.control.px4.controller import Px4Controller
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.firmware.betaflight.build import build_firmware
from aerial_gym.firmware.betaflight.instances import RESTORE, InstanceGroup
from aerial_gym.firmware.betaflight.launch import arm_instances
from aerial_gym.firmware.betaflight.settings import firmware_settings, store_settings
from aerial_gym.firmware.betaflight.vehicle import COUNTS_PER_RAD_S, BetaflightVehicle, gyro_counts, write_state
from aerial_gym.firmware.compiler import Progress
from aerial_gym.firmware.environment import FirmwareEnv
from aerial_gym.firmware.flight import STEP_S, hover_options

PERIOD_S = 0.001  # Time between two exchanges [s], if not given


class BetaflightEnv(FirmwareEnv):
    """Environments flown by Betaflight; actions are those of ``betaflight_rate_control``."""

    firmware = "Betaflight"
    group: InstanceGroup

    def __init__(
        self, *, controller: ControllerCfg, period: float = PERIOD_S, progress: Progress | None = None,
        make_group: Callable[[bytes, int], InstanceGroup] | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Build simulation and firmware, and arm the instances. Arguments not named here are those of ``FirmwareEnv``.

        Args:
            controller: ``betaflight_rate_control``, or another law of body rates, whose actions the firmware then takes.
            make_group: Starts the instances for an EEPROM and E, in place of Betaflight's.

        Raises:
            ConfigError: If the controller takes no body rates, or time steps or vehicle do not fit the firmware.
            CapabilityError: If the firmware does not build, start or arm.
        """
        if controller.law != "rates":
            raise ConfigError(f"law {controller.law!r}: the firmware takes body rates. Take betaflight_rate_control")
        super().__init__(period=period, **options)
        manager, control = self.robot_manager, options["robot"].control
        named = controller if controller.betaflight else CONTROLLERS.get("betaflight_rate_control")
        twin = make_controller(named, manager.declared, options["sim"].gravity, dt=period, control=control)
        assert isinstance(twin, BetaflightController)
        self.twin, self.vehicle = twin, BetaflightVehicle(twin, manager.declared)
        self._counts = np.zeros(
            (2, self.num_envs, 3)
        )  # Of the gyro: at the exchange before the last one, and at the last
        manager.controller.action_names = twin.action_names  # tasks name and store the firmware's actions
        own = select_autopilot(named, control)
        self.settings = firmware_settings(own, twin.gains, period=period, yaw_reversed=self.vehicle.yaw_reversed)
        self._pilot: PositionPilot | None = None
        if make_group is None:
            build = build_firmware(progress)
            self.group = InstanceGroup.of_build(build, store_settings(build, self.settings), self.num_envs)
        else:
            self.group = make_group(b"", self.num_envs)
        self.ended, self.motors = self.group.ended, self.group.replies["pulses"]
        try:
            arm_instances(self.group, self.vehicle, range(self.num_envs), period=period)
        except CapabilityError:
            self.group.close()
            raise

    def take_action(self, action: Tensor) -> None:
        """Set the sticks for thrust (0 is hover) and body rates [rad/s] or sticks, (E, 4)."""
        self.vehicle.channels(action, self.group.requests["channels"])

    def position_action(self, goal: Tensor) -> Tensor:
        """Return thrust (0 is hover) and body rates [rad/s], (E, 4), for position [m] and yaw [rad], (E, 4)."""
        if self._pilot is None:
            self._pilot = PositionPilot(self)
        return self._pilot.action(goal)

    def rotor_speeds(self) -> Tensor:
        """Give the firmware the sensors of this instant, and return its commanded rotor speeds [rad/s], (E, R)."""
        measured = self.imu_reading.numpy()
        write_state(
            self.group.requests["state"], ang_vel=measured[:, 3:], force=measured[:, :3],
            attitude=self.gtd["robot_orientation"].numpy(),
        )  # fmt: skip
        self._counts = np.stack((self._counts[1], gyro_counts(measured[:, 3:])))
        return self.vehicle.speeds(self.group.exchange())

    def firmware_rates(self) -> Tensor:
        """Return the mean of the gyro over the samples between two runs: half are those of the exchange before, (E, 3)."""
        return torch.from_numpy(self._counts.mean(0) / COUNTS_PER_RAD_S).float()

    def reset_firmware(self, envs: list[int]) -> None:
        """Restore instances, armed and at hover throttle; start those again that have ended."""
        self._counts[:, envs] = 0.0
        if self._pilot is not None:
            self._pilot.reset(envs)
        self.group.repeat(RESTORE, envs)
        if restarted := [env for env in envs if env in self.ended]:
            self.group.start(restarted)
            arm_instances(self.group, self.vehicle, restarted, period=self.sim_cfg.dt)

    def close_firmware(self) -> None:
        """End the processes."""
        if "group" in vars(self):
            self.group.close()


class PositionPilot:
    """The outer loops of ``px4_position_control``: from position to thrust and body rates."""

    def __init__(self, env: FirmwareEnv) -> None:
        manager = env.robot_manager
        law = make_controller(
            CONTROLLERS.get("px4_position_control"), manager.declared, env.sim_cfg.gravity, dt=env.dt,
            control=manager.cfg.control,
        )  # fmt: skip
        assert isinstance(law, Px4Controller)
        self._law, self._state = law, manager.tensors.state
        self._memory = torch.zeros(env.num_envs, law.needs.outer)
        self._begins = torch.ones(env.num_envs, 1, dtype=torch.bool)

    def reset(self, envs: list[int]) -> None:
        """Begin anew in some environments."""
        self._memory[envs], self._begins[envs] = 0.0, True

    def action(self, goal: Tensor) -> Tensor:
        """Return the action of the rate controller for a position and yaw, (E, 4)."""
        setpoint, self._memory = self._law.outer(self._state, goal, self._memory, self._begins)
        self._begins.zero_()
        return torch.cat((setpoint[:, :1] / self._law.gains.position.hover - 1.0, setpoint[:, 1:]), dim=-1)


def make_hover_env(
    robot: str | Path, *, instances: int, exchange_hz: float, seed: int = 0, progress: Progress | None = None,
    own: BetaflightCfg | None = None,
) -> BetaflightEnv:  # fmt: skip
    """Return vehicles in empty space, each flown by its own instance of Betaflight."""
    steps = round(STEP_S * exchange_hz)
    if not 1000.0 <= exchange_hz <= 4000.0 or abs(steps - STEP_S * exchange_hz) > 1e-9:
        raise ConfigError(f"exchange_hz = {exchange_hz:g}: must be 1000, 2000 or 4000")
    controller = CONTROLLERS.get("betaflight_rate_control")
    return BetaflightEnv(
        controller=controller if own is None else replace(controller, betaflight=own), period=STEP_S / steps, progress=progress,
        **hover_options(robot, instances=instances, seed=seed),
    )  # fmt: skip
