"""A batch of environments whose vehicles are flown by the firmware of an autopilot.

``act -> [IMU -> firmware -> rotors -> effects -> integrate] x K -> collide``: the firmware reads the IMU and commands the
rotors in every physics step.
Letters: E environments, R rotors, K physics steps.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, NoReturn

import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from aerial_gym.config.sensor import ImuCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.interop import action_tensor
from aerial_gym.sensors import mounted_sensors
from aerial_gym.sensors.imu import Imu
from aerial_gym.sensors.mounts import Carrier

NONE = (0.0, 0.0, 0.0)
EXACT = ImuCfg(
    summary="IMU without errors", accel_noise_density=NONE, gyro_noise_density=NONE,
    accel_bias_walk=NONE, gyro_bias_walk=NONE, accel_initial_bias=NONE,
    gyro_initial_bias=NONE, accel_range=156.9, gyro_range=34.9, source="Ranges of 16 g and 2000 deg/s",
)  # fmt: skip
"""The IMU of robots that have none."""

TURNS = ((-1, 1), (-1, -1), (1, 1), (1, -1))
"""Signs of the roll and pitch torque of rotors: rear right, front right, rear left, front left."""


class FirmwareEnv(EnvManager):
    """Environments flown by a firmware."""

    firmware: ClassVar[str]  # Its name, for messages
    ended: Mapping[int, str]  # Reasons of instances that have ended, by environment
    motors: NDArray[Any]  # Motor commands in the firmware's units, (E, ...)
    twin: Any  # Controller here that follows the firmware
    observer: Callable[[Tensor, Tensor], None] | None = None  # Receives action and rotor speeds of each exchange

    def __init__(self, *, period: float, **options: Any) -> None:
        """Build the simulation. Arguments not named here are those of ``EnvManager``.

        Args:
            period: Time between two exchanges with the firmware, and of a physics step [s].

        Raises:
            ConfigError: If the environment step is no multiple of the period.
            CapabilityError: If the device is not the CPU.
        """
        sim, env = options["sim"], options["env"]
        span = sim.dt * env.physics_steps_per_env_step
        if abs(span / period - round(span / period)) > 1e-6:
            raise ConfigError(
                f"environment step of {span:g} s: must be a multiple of the firmware's period, {period:g} s"
            )
        options["sim"] = replace(sim, dt=period)
        options["env"] = replace(env, physics_steps_per_env_step=round(span / period))
        super().__init__(controller=CONTROLLERS.get("rotor_speed_control"), **options)
        if self.device.type != "cpu":
            raise CapabilityError(f"sitl: {self.firmware} runs on the CPU, not on {self.device}. Take device cpu")
        self.imu_reading = torch.zeros(self.num_envs, 6)  # Force [m/s²] and rate [rad/s], body
        self._imu = self._make_imu(period)

    def _make_imu(self, period: float) -> Imu:
        """Return an IMU like the robot's first one, at the body origin, for every physics step."""
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        position, attitude, lin_vel, ang_vel = (self.gtd[key] for key in keys)
        body = Carrier(position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=ang_vel)
        manager = self.robot_manager
        mounted = mounted_sensors(manager.cfg.sensor_mounts)[1]
        cfg = next((sensor.cfg for sensor in mounted.values()), EXACT)
        return Imu(
            replace(cfg, position=NONE, euler=NONE), body, pose=None, measurement_out=self.imu_reading, dt=period,
            gravity=self.sim_cfg.gravity, random=self.random, number=len(mounted), errors=manager.imu_errors,
        )  # fmt: skip

    @abstractmethod
    def rotor_speeds(self) -> Tensor:
        """Give the firmware the sensors of this instant, and return its commanded rotor speeds [rad/s], (E, R)."""

    def firmware_rates(self) -> Tensor:
        """Return the angular velocity of which the firmware has computed its last commands [rad/s], body, (E, 3)."""
        return self.imu_reading[:, 3:]

    def take_action(self, action: Tensor) -> None:
        """Give the firmware the action of an environment step, (E, U)."""

    def position_action(self, goal: Tensor) -> Tensor:
        """Return the action (E, U) that flies to a position [m] and yaw [rad], (E, 4)."""
        return goal

    def step(self, actions: Tensor | ArrayLike | None, env_actions: Tensor | ArrayLike | None = None) -> None:
        """Fly one environment step; see ``EnvManager.step``."""
        manager = self.robot_manager
        if actions is not None:
            manager.act(action_tensor(actions, self.device))
        if env_actions is not None:
            self.asset_manager.take_actions(action_tensor(env_actions, self.device))
        stored = manager.tensors.actions
        action = stored.clone()
        self.take_action(action.nan_to_num())
        for _ in range(self.cfg.physics_steps_per_env_step):
            speeds = self.rotor_speeds()
            if self.observer is not None:
                self.observer(action, speeds)
            stored.copy_(speeds)
            self.fly(1)
            self._imu.measure()
        stored.copy_(action)
        self.collide()
        if self.ended:
            self.gtd["crashes"][list(self.ended)] = True
        manager.refresh(self.dt)
        self.imus.measure()

    def reset(
        self, mask: Tensor | None = None, *, counted: bool = False, place: Callable[[Tensor], None] | None = None
    ) -> None:
        """Reset the environments in ``mask``, bool (E,), or all, with their firmware; see ``EnvManager.reset``."""
        super().reset(mask, counted=counted, place=place)
        self._imu.reset(self.random.mask)
        self.reset_firmware(self.random.mask.nonzero()[:, 0].tolist())

    def reset_firmware(self, envs: list[int]) -> None:
        """Return the firmware of environments to the state in which a flight starts."""

    def state_tensors(self) -> NoReturn:
        """Refuse: the memory of the firmware cannot be saved."""
        raise CapabilityError(
            f"save_state: the memory of {self.firmware} cannot be saved. Fly without firmware, or reset"
        )

    def close_firmware(self) -> None:
        """End the firmware, if it has started."""

    def close(self) -> None:
        """End the firmware, and release device memory."""
        self.close_firmware()
        super().close()


def motor_order(inverse: Tensor, numbers: tuple[int, int, int, int]) -> tuple[list[int], bool]:
    """Return the firmware's motor of each rotor, and whether the rotors spin against those of the firmware.

    Both firmwares want rotors on a diagonal to spin alike, in the usual order those rear right and front left clockwise.

    Args:
        inverse: Inverse of the allocation matrix, (R, 6).
        numbers: The firmware's motors, from 0, in the order of ``TURNS``.

    Raises:
        ConfigError: If the rotors are not four in an X, of which neighbours spin against each other.
    """
    signs = [tuple(row) for row in inverse[:, 3:].sign().int().tolist()]
    places = [TURNS.index(row[:2]) if row[:2] in TURNS else -1 for row in signs]
    spins = {yaw * (1 if place in (0, 3) else -1) for place, (_, _, yaw) in zip(places, signs, strict=True)}
    if sorted(places) != [0, 1, 2, 3] or len(spins) != 1:
        raise ConfigError(
            "sitl: needs four rotors in an X, of which neighbours spin against each other. Take another robot"
        )
    return [numbers[place] for place in places], spins == {-1}
