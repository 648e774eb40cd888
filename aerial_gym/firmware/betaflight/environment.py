"""A batch of environments whose vehicles are flown by Betaflight, one process for each environment.

``act -> [IMU -> firmware -> rotors -> effects -> integrate] x K -> collide``: the firmware reads the IMU and writes the motors
in every physics step. Resets restore the process of an environment to its armed state.
Letters: E environments, K physics steps.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NoReturn

from numpy.typing import ArrayLike
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.betaflight.controller import BetaflightController
from aerial_gym.control.gains import select_autopilot
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.firmware.betaflight.build import Progress, build_firmware
from aerial_gym.firmware.betaflight.instances import RESTORE, InstanceGroup
from aerial_gym.firmware.betaflight.launch import arm_instances
from aerial_gym.firmware.betaflight.settings import firmware_settings, store_settings
from aerial_gym.firmware.betaflight.vehicle import BetaflightVehicle, write_state
from aerial_gym.firmware.imu import make_flight_imu
from aerial_gym.interop import action_tensor

PERIOD_S = 0.001  # Time between two exchanges [s], if not given


class FirmwareEnv(EnvManager):
    """Environments flown by Betaflight; actions are those of ``betaflight_rate_control``."""

    group: InstanceGroup

    def __init__(
        self, *, controller: ControllerCfg, period: float = PERIOD_S, progress: Progress | None = None,
        make_group: Callable[[bytes, int], InstanceGroup] | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Build simulation and firmware, and arm the instances. Arguments not named here are those of ``EnvManager``.

        Args:
            controller: ``betaflight_rate_control``, or another law of body rates, whose actions the firmware then takes.
            period: Time between two exchanges with the firmware, and of a physics step [s].
            make_group: Starts the instances for an EEPROM and E, in place of Betaflight's.

        Raises:
            ConfigError: If the controller takes no body rates, or time steps or vehicle do not fit the firmware.
            CapabilityError: If the firmware does not build, start or arm.
        """
        sim, env = options["sim"], options["env"]
        span = sim.dt * env.physics_steps_per_env_step
        if controller.law != "rates":
            raise ConfigError(f"law {controller.law!r}: the firmware takes body rates. Take betaflight_rate_control")
        if abs(span / period - round(span / period)) > 1e-6:
            raise ConfigError(
                f"environment step of {span:g} s: must be a multiple of the firmware's period, {period:g} s"
            )
        options["sim"] = replace(sim, dt=period)
        options["env"] = replace(env, physics_steps_per_env_step=round(span / period))
        super().__init__(controller=CONTROLLERS.get("rotor_speed_control"), **options)
        if self.device.type != "cpu":
            raise CapabilityError(
                f"sitl: the firmware exchanges states on the CPU, not on {self.device}. Take device cpu"
            )
        manager = self.robot_manager
        named = controller if controller.betaflight else CONTROLLERS.get("betaflight_rate_control")
        twin = make_controller(named, manager.declared, sim.gravity, dt=period, control=options["robot"].control)
        assert isinstance(twin, BetaflightController)
        self.vehicle = BetaflightVehicle(twin, manager.declared)
        manager.controller.action_names = twin.action_names  # tasks name and store the firmware's actions
        own = select_autopilot(named, options["robot"].control)
        self.settings = firmware_settings(own, twin.gains, period=period, yaw_reversed=self.vehicle.yaw_reversed)
        self._imu, self._measured = make_flight_imu(self, dt=period)
        self._begin(make_group, progress)

    def _begin(self, make_group: Callable[[bytes, int], InstanceGroup] | None, progress: Progress | None) -> None:
        if make_group is None:
            build = build_firmware(progress)
            eeprom = store_settings(build, self.settings)
            self.group = InstanceGroup.of_build(build, eeprom, self.num_envs)
        else:
            self.group = make_group(b"", self.num_envs)
        try:
            arm_instances(self.group, self.vehicle, range(self.num_envs), period=self.sim_cfg.dt)
        except CapabilityError:
            self.group.close()
            raise

    def step(self, actions: Tensor | ArrayLike, env_actions: Tensor | ArrayLike | None = None) -> None:
        """Apply thrust (0 is hover) and body rates [rad/s] or sticks, (E, 4), for one environment step."""
        manager = self.robot_manager
        manager.act(action_tensor(actions, self.device))
        if env_actions is not None:
            self.asset_manager.take_actions(action_tensor(env_actions, self.device))
        stored = manager.tensors.actions
        command = stored.clone()
        self.vehicle.channels(command.nan_to_num(), self.group.requests["channels"])
        for _ in range(self.cfg.physics_steps_per_env_step):
            stored.copy_(self.vehicle.speeds(self._fly_firmware()))
            self.fly(1)
            self._imu.measure()
        stored.copy_(command)
        self.collide()
        if self.group.ended:
            self.gtd["crashes"][list(self.group.ended)] = True
        manager.refresh(self.dt)
        self.imus.measure()

    def _fly_firmware(self) -> Any:
        measured = self._measured.numpy()
        write_state(
            self.group.requests["state"], ang_vel=measured[:, 3:], force=measured[:, :3],
            attitude=self.gtd["robot_orientation"].numpy(),
        )  # fmt: skip
        return self.group.exchange()

    def reset(
        self, mask: Tensor | None = None, *, counted: bool = False, place: Callable[[Tensor], None] | None = None
    ) -> None:
        """Reset the environments in ``mask``, bool (E,), or all; their firmware starts armed, at hover throttle."""
        super().reset(mask, counted=counted, place=place)
        mask = self.random.mask
        self._imu.reset(mask)
        envs = mask.nonzero()[:, 0].tolist()
        self.group.repeat(RESTORE, envs)
        restarted = [env for env in envs if env in self.group.ended]
        if restarted:
            self.group.start(restarted)
            arm_instances(self.group, self.vehicle, restarted, period=self.sim_cfg.dt)

    def state_tensors(self) -> NoReturn:
        """Refuse: the memory of the firmware's processes cannot be saved."""
        raise CapabilityError("save_state: the firmware's memory cannot be saved. Fly without firmware, or reset")

    def close(self) -> None:
        """End the firmware, and release device memory."""
        if "group" in vars(self):
            self.group.close()
        super().close()
