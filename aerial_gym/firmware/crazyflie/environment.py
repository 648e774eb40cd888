"""A batch of environments whose vehicles are flown by a controller of the Crazyflie's firmware, one copy for each.

The firmware gets the true state in place of its estimator's, and gyro and accelerometer of the IMU.
Letters: E environments, R rotors.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.crazyflie.distribution import MOST_COUNTS
from aerial_gym.errors import ConfigError
from aerial_gym.firmware.crazyflie.build import build_controller, find_checkout
from aerial_gym.firmware.crazyflie.instances import ControllerGroup
from aerial_gym.firmware.crazyflie.parameters import firmware_parameters
from aerial_gym.firmware.environment import FirmwareEnv, motor_order
from aerial_gym.firmware.flight import hover_options
from aerial_gym.physics.vehicle import Vehicle

PERIOD_S = 0.001  # Of the firmware's loop [s]
MOTORS = (1, 0, 2, 3)  # Rear right, front right, rear left, front left, from 0. Source: power_distribution_quadrotor.c
TWINS = {
    "pid": ("crazyflie_pid", 100.0), "mellinger": ("mellinger", 500.0), "lee": ("crazyflie_lee", 500.0),
    "brescianini": ("brescianini", 100.0),
}  # fmt: skip
"""Autopilots of ``ControllerCfg`` by the firmware's controller, and rates of their laws [Hz]. Loops below run at 500 Hz."""


def make_twin_cfg(name: str, given: ControllerCfg | None = None) -> ControllerCfg:
    """Return the controller that follows one of the firmware's, at its rates: ``given`` if it does, else the registered one."""
    autopilot, rate = TWINS[name]
    cfg = given if given is not None and given.autopilot == autopilot else CONTROLLERS.get(f"crazyflie_{name}_control")
    own = getattr(cfg, autopilot)
    loop = {"rate_hz": 500.0} if hasattr(own, "rate_hz") else {}
    return replace(cfg, rate_hz=rate, **{autopilot: replace(own, **loop)})


def platform_constants(allocation: Allocation, vehicle: Vehicle) -> dict[str, float]:
    """Return constants of ``platform_defaults.h`` for a vehicle: largest thrust of a rotor [N], and its torque ratio [m]."""
    ratio = (vehicle.torque_map[0, :, 2] / vehicle.thrust_map[0, :, 2]).mean()
    return {"THRUST_MAX": float(allocation.high[0].mean()), "THRUST2TORQUE": float(ratio)}


class CrazyflieEnv(FirmwareEnv):
    """Environments flown by the firmware of the Crazyflie; actions are position [m] and yaw [rad], (E, 4)."""

    firmware = "the firmware of the Crazyflie"
    ended: Mapping[int, str] = {}
    group: ControllerGroup

    def __init__(
        self, *, controller: ControllerCfg, flown_by: str | None = None, checkout: str | Path | None = None,
        make_group: Callable[[Mapping[str, float], int], ControllerGroup] | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Build simulation and firmware. Arguments not named here are those of ``FirmwareEnv``.

        Args:
            controller: ``crazyflie_*_control``, or another law of positions.
            flown_by: The firmware's controller, of ``FUNCTIONS``; the one that ``controller`` follows, else ``pid``.
            checkout: Folder of the firmware's source; see ``find_checkout``.
            make_group: Starts the instances for parameters and E, in place of the firmware's.

        Raises:
            ConfigError: If the controller takes no positions, there is no source, or vehicle or steps do not fit.
            CapabilityError: If the firmware does not compile.
        """
        if controller.law != "position":
            raise ConfigError(f"law {controller.law!r}: the firmware takes positions. Take crazyflie_pid_control")
        super().__init__(period=PERIOD_S, **options)
        followed = (name for name, (autopilot, _) in TWINS.items() if autopilot == controller.autopilot)
        name = flown_by or next(followed, "pid")
        manager, control = self.robot_manager, options["robot"].control
        cfg = make_twin_cfg(name if name in TWINS else "pid", controller)
        self.twin = make_controller(cfg, manager.declared, options["sim"].gravity, dt=PERIOD_S, control=control)
        self._allocation = allocation = self.twin.allocation
        self._order, spins_reversed = motor_order(allocation.inverse[0], MOTORS)
        if spins_reversed:
            raise ConfigError("sitl crazyflie: the rotors spin against those of a Crazyflie. Take another robot")
        manager.controller.action_names = self.twin.action_names  # tasks name and store the firmware's actions
        parameters = firmware_parameters(self.twin.gains) if name in TWINS else {}
        if make_group is not None:
            self.group = make_group(parameters, self.num_envs)
        else:
            with tempfile.TemporaryDirectory() as folder:
                constants = platform_constants(allocation, manager.declared)
                library = build_controller(name, find_checkout(checkout), Path(folder), constants)
                self.group = ControllerGroup(library, parameters, self.num_envs)
        self.motors = self.group.motors

    def take_action(self, action: Tensor) -> None:
        """Set the wanted position [m] and yaw [rad], (E, 4)."""
        self.group.input["goal"][:] = action.numpy()

    def rotor_speeds(self) -> Tensor:
        """Give the firmware state and sensors of this instant, and return its commanded rotor speeds [rad/s], (E, R)."""
        rows = self.group.input
        for name, key in (("position", "position"), ("attitude", "orientation"), ("lin_vel", "linvel")):
            rows[name][:] = self.gtd[f"robot_{key}"].numpy()
        rows["force"][:], rows["rate"][:] = self.imu_reading[:, :3].numpy(), self.imu_reading[:, 3:].numpy()
        self.group.run()
        share = torch.from_numpy(self.motors[:, self._order].astype(np.float32)) / MOST_COUNTS
        return self._allocation.speed(self._allocation.high * share)

    def reset_firmware(self, envs: list[int]) -> None:
        """Start the firmware of environments again."""
        self.group.start(envs)

    def close_firmware(self) -> None:
        """Unload the firmware."""
        if "group" in vars(self):
            self.group.close()


def make_hover_env(
    robot: str | Path, name: str, *, checkout: str | Path | None = None, instances: int, seed: int = 0,
) -> CrazyflieEnv:  # fmt: skip
    """Return vehicles in empty space, each flown by its own copy of one of the firmware's controllers."""
    return CrazyflieEnv(
        controller=CONTROLLERS.get("lee_position_control"), flown_by=name, checkout=checkout,
        **hover_options(robot, instances=instances, seed=seed),
    )  # fmt: skip
