"""The robot of every environment: its parameters, controller, physics and reset.

Letters: E environments, R rotors, P parameters of an effect, U entries of an action.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.control import Controller
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.math.random import uniform
from aerial_gym.physics import (
    BACKENDS,
    PhysicsBackend,
    Vehicle,
    build_model,
    effects_from_config,
    vehicle_from_config,
)
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotors import speed_for_thrust
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.robots.state_keys import RobotTensors, declare_robot_tensors, refresh_derived

BACKEND_PREFERENCE = ("warp", "torch")
"""What the backend name ``auto`` tries, in order."""


def choose_backend(name: str) -> PhysicsBackend:
    """Return a new backend by name; ``auto`` takes the first registered one of ``BACKEND_PREFERENCE``."""
    if name == "auto":
        name = next(candidate for candidate in BACKEND_PREFERENCE if candidate in BACKENDS)
    return BACKENDS.get(name)()


def check_capabilities(backend: PhysicsBackend, robot: RobotCfg, device: torch.device) -> None:
    """Raise ``CapabilityError`` naming the device or effect that a backend cannot run."""
    able = backend.capabilities
    if device.type not in able.devices:
        raise CapabilityError(
            f"backend {type(backend).__name__}: cannot run on {device}. Devices: {', '.join(able.devices)}"
        )
    missing = [name for name in robot.effects if able.effects is not None and name not in able.effects]
    if missing:
        raise CapabilityError(
            f"backend {type(backend).__name__}: cannot run effect {missing[0]!r}. Use backend 'torch'."
        )


class RobotManager:
    """Owns the robot's tensors in the GTD."""

    def __init__(
        self,
        robot: RobotCfg,
        sim: SimCfg,
        gtd: GlobalTensorDictionary,
        *,
        root_state: Tensor,
        bounds: tuple[Tensor, Tensor],
        generator: torch.Generator,
    ) -> None:
        """Declare tensors and build the vehicle; ``attach`` completes it with a controller.

        Args:
            robot: What flies.
            sim: Time step, gravity, method.
            gtd: Receives the robot's keys; its size R is the number of rotors.
            root_state: This robot's row of ``vec_root_tensor``, (E, 13).
            bounds: Lower and upper bounds of the environments [m], each (E, 3).
            generator: Source of every random number of this manager.
        """
        self.cfg, self._sim, self._gtd, self._bounds, self._generator = robot, sim, gtd, bounds, generator
        self._num_envs = root_state.shape[0]
        self.declared: Vehicle = vehicle_from_config(robot, num_envs=self._num_envs, device=gtd.device)
        self._effects = effects_from_config(
            robot.effects, num_envs=self._num_envs, device=gtd.device, dtype=root_state.dtype
        )
        self._factors = {
            "mass_scale": torch.ones(self._num_envs, 1, device=gtd.device),
            "thrust_scale": torch.ones(self._num_envs, robot.num_rotors, device=gtd.device),
            "time_constant_scale": torch.ones(self._num_envs, robot.num_rotors, device=gtd.device),
        }
        ranges = {name: torch.tensor(getattr(robot.randomization, name), device=gtd.device) for name in self._factors}
        self._randomized = {
            name: (r[0], r[1]) for name, r in ranges.items() if getattr(robot.randomization, name) != (1.0, 1.0)
        }
        self._root_state = root_state
        self.backend = choose_backend(sim.backend)
        check_capabilities(self.backend, robot, gtd.device)
        self._initial = {k: torch.tensor(v, device=gtd.device) for k, v in vars(robot.initial_state).items()}

    def attach(self, controller: Controller) -> None:
        """Take the controller, declare the tensors and hand everything to the backend."""
        self.controller = controller
        gtd = self._gtd
        gtd.define_size("U", len(controller.action_names))
        self.tensors: RobotTensors = declare_robot_tensors(gtd, self._root_state)
        self._mass = gtd.declare(TensorSpec(
            key="robot_mass", shape=("E",), unit="kg", frame="-", owner="robot", meaning="true mass"
        ))  # fmt: skip
        self._inertia = gtd.declare(TensorSpec(
            key="robot_inertia", shape=("E", 3, 3), unit="kg m²", frame="body", owner="robot",
            meaning="true inertia about the centre of mass",
        ))  # fmt: skip
        for i, (effect, params) in enumerate(self._effects):
            names = ", ".join(f"{parameter.name} [{parameter.unit}]" for parameter in effect.parameters)
            spec = TensorSpec(
                key=f"effect_{effect.name}", shape=("E", params.shape[1]), unit="see meaning", frame="-", owner="robot",
                meaning=f"parameters {names}; call refresh_model() after writing",
            )  # fmt: skip
            stored = gtd.declare(spec)
            stored.copy_(params)
            self._effects[i] = (effect, stored)
        self.backend.allocate(self._build_model(), controller, integrator=self._sim.integrator)
        self._rest_speed = _hover_speed(self.declared, self._sim.gravity)
        self.tensors.state.rotor_speed.copy_(self._rest_speed)

    @property
    def num_actions(self) -> int:
        """Width U of an action."""
        return len(self.controller.action_names)

    def _build_model(self) -> Model:
        vehicle, factors = self.declared, self._factors
        mass, thrust, lag = factors["mass_scale"], factors["thrust_scale"].unsqueeze(-1), factors["time_constant_scale"]
        vehicle = replace(
            vehicle,
            mass=vehicle.mass * mass.squeeze(-1),
            inertia=vehicle.inertia * mass.unsqueeze(-1),
            thrust_map=vehicle.thrust_map * thrust,
            torque_map=vehicle.torque_map * thrust,
            time_constant_up=vehicle.time_constant_up * lag,
            time_constant_down=vehicle.time_constant_down * lag,
        )
        self.model = build_model(vehicle, self._effects, gravity=self._sim.gravity)
        self._mass.copy_(self.model.vehicle.mass)
        self._inertia.copy_(self.model.vehicle.inertia)
        return self.model

    def refresh_model(self) -> None:
        """Take changed parameters of effects (``gtd["effect_..."]``) into the physics."""
        self.backend.set_model(self._build_model())

    def act(self, actions: Tensor) -> None:
        """Store the action of this step, (E, U), and keep the one before."""
        if actions.shape != self.tensors.actions.shape:
            raise ShapeError(
                f"actions has shape {tuple(actions.shape)}, expected (E, U) = {tuple(self.tensors.actions.shape)}: "
                f"{', '.join(self.controller.action_names)}"
            )
        self.tensors.prev_actions.copy_(self.tensors.actions)
        self.tensors.actions.copy_(actions)

    def advance(self, substeps: int) -> None:
        """Advance the physics by ``substeps`` with the stored action held."""
        self.backend.step(self.tensors.state, self.tensors.actions, self._sim.dt, substeps)

    def refresh(self) -> None:
        """Bring every derived state to the instant of the physics."""
        refresh_derived(self.tensors)

    def reset(self, mask: Tensor) -> None:
        """Draw a new initial state, and new parameters where randomised, for the environments in ``mask``, bool (E,)."""
        draws = _draw_state(self._initial, self._bounds, self._generator, self._rest_speed)
        rows = mask.unsqueeze(-1)
        for tensor, draw in zip(self.tensors.state.tensors(), draws, strict=True):
            tensor.copy_(torch.where(rows, draw, tensor))
        self.tensors.actions.masked_fill_(rows, 0.0)
        self.tensors.prev_actions.masked_fill_(rows, 0.0)
        self._randomize(rows)
        self.controller.reset(mask, self._generator)
        self.backend.reset(mask)

    def _randomize(self, rows: Tensor) -> None:
        for name, (low, high) in self._randomized.items():
            factor = self._factors[name]
            draw = uniform(low, high, tuple(factor.shape), generator=self._generator)
            factor.copy_(torch.where(rows, draw, factor))
        if self._randomized:
            self.refresh_model()


def _hover_speed(vehicle: Vehicle, gravity: float) -> Tensor:
    """Return the rotor speeds (E, R) [rad/s] at which a reset starts: an equal share of the weight each."""
    share = (vehicle.mass * gravity / vehicle.num_rotors).unsqueeze(-1).expand(-1, vehicle.num_rotors)
    return torch.clamp(speed_for_thrust(vehicle.thrust_map, share), vehicle.speed_low, vehicle.speed_high)


def _draw_state(
    initial: dict[str, Tensor], bounds: tuple[Tensor, Tensor], generator: torch.Generator, rotor_speed: Tensor
) -> tuple[Tensor, ...]:
    """Return drawn position, attitude, velocities and rotor speeds for all environments, in the order of ``BodyState``."""
    lower, upper = bounds
    shape = tuple(lower.shape)

    def draw(name: str) -> Tensor:
        return uniform(initial[f"{name}_low"], initial[f"{name}_high"], shape, generator=generator)

    position = lower + (upper - lower) * draw("position_ratio")
    attitude = quat_from_euler(draw("euler"))
    return position, attitude, draw("lin_vel"), draw("ang_vel"), rotor_speed
