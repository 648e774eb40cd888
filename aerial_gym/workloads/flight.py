"""The workload of ``bench physics``: a batch of vehicles near hover, for at most 20 s at a time.

Letters: E environments, R rotors, P parameters of an effect, U entries of an action.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.allocation import Allocation
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import BACKENDS, EFFECTS, BodyState, PhysicsBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import Articulation, build_articulation
from aerial_gym.physics.model import EffectParams
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.workloads.measure import WorkloadError, make_batch

LAUNCHES_PER_BATCH = 20  # Launches in one CUDA graph: the cost of starting a replay is shared by them
STRETCH_S = 20.0  # Longest simulated time from the start [s]; the bare plant drifts some hundred metres in it
MAX_DISTANCE = 1000.0  # Distance from the origin beyond which a vehicle no longer flies [m]
MAX_SPEED = 100.0  # Speed beyond which a vehicle no longer flies [m/s]
MAX_NORM_ERROR = 1e-3  # Largest distance of a quaternion's norm from 1; float32 round-off stays below 1e-6


class HoverFlight:
    """A backend, the state it advances, and the hover action that it holds."""

    def __init__(self, backend: PhysicsBackend, state: BodyState, action: Tensor, *, dt: float, substeps: int) -> None:
        """Take backend, state and action; ``substeps`` of ``dt`` [s] per launch. A copy of the state is the start."""
        self.device = action.device
        self.state, self._start = state, replace(state, **{name: t.clone() for name, t in vars(state).items()})
        launches = max(1, int(STRETCH_S / (dt * substeps)))
        self.launches_per_batch = min(LAUNCHES_PER_BATCH, launches) if self.device.type == "cuda" else 1
        self.batches_per_stretch = launches // self.launches_per_batch
        self.run_batch = make_batch(
            lambda: backend.step(state, action, dt, substeps), self.launches_per_batch, self.device
        )

    def restore(self) -> None:
        """Restore the start state."""
        self.state.copy_(self._start)

    def check(self, *, started: bool) -> None:
        """Raise ``WorkloadError`` unless all vehicles fly, and every one has moved if ``started``."""
        check_flying(self.state)
        if started:
            check_moved(self._start, self.state)


def check_flying(state: BodyState) -> None:
    """Raise ``WorkloadError`` unless every vehicle is finite, turned by a unit quaternion, near enough and slow enough."""
    for name, tensor in vars(state).items():
        if not torch.isfinite(tensor).all():
            raise WorkloadError(f"{name} is not finite in {_count_environments(~torch.isfinite(tensor))} environments")
    limits = (
        ("norm error of the quaternion", (state.attitude.norm(dim=-1) - 1.0).abs(), MAX_NORM_ERROR, ""),
        ("distance from the origin", state.position.norm(dim=-1), MAX_DISTANCE, " m"),
        ("speed", state.lin_vel.norm(dim=-1), MAX_SPEED, " m/s"),
    )
    for name, value, limit, unit in limits:
        if not (value < limit).all():
            raise WorkloadError(f"{name} reached {value.max():.3g}{unit}: must stay below {limit:g}{unit}")


def check_moved(before: BodyState, after: BodyState) -> None:
    """Raise ``WorkloadError`` if the position of a vehicle is the same as before."""
    still = (before.position == after.position).all(dim=-1)
    if still.any():
        raise WorkloadError(f"{_count_environments(still)} of {before.num_envs} environments did not move")


def _count_environments(flags: Tensor) -> int:
    return int(flags.reshape(flags.shape[0], -1).any(dim=-1).sum())


def make_flight(
    *, backend: str, robot: str | RobotCfg, controller: str, effects: Sequence[str], integrator: str, num_envs: int,
    substeps: int, dt: float, device: torch.device, seed: int = 0,
) -> HoverFlight:  # fmt: skip
    """Return a batch near hover, built from names."""
    if not 0.0 < dt < float("inf"):
        raise ConfigError(f"--dt-s = {dt!r}: must be > 0 and finite")
    stepper, cfg, law = BACKENDS.get(backend)(), robot_by_name(robot), CONTROLLERS.get(controller)
    if device.type not in stepper.capabilities.devices:
        able = ", ".join(stepper.capabilities.devices)
        raise CapabilityError(f"backend {backend}: cannot run on {device}. Devices: {able}")
    declared = vehicle_from_config(cfg, num_envs=num_envs, device=device)
    articulation = build_articulation(cfg, like=declared.mass)
    rows = moderate_effects(effects, cfg, num_envs=num_envs, device=device)
    model = build_model(declared, rows, articulation=articulation)
    control = make_controller(law, declared, model.gravity, dt=dt, control=cfg.control)
    generator = torch.Generator(device=device).manual_seed(seed)
    hover = _hover_thrust_and_speed(cfg, effects, device)
    state = state_near_hover(num_envs, hover[1], generator)
    action = hover_action(law.law, len(control.action_names), hover, num_envs, generator)
    if articulation is not None:
        state, action = _states_and_actions_with_joints(articulation, state, action)
    stepper.allocate(model, control, integrator=integrator)
    return HoverFlight(stepper, state, action, dt=dt, substeps=substeps)


def _states_and_actions_with_joints(
    articulation: Articulation, state: BodyState, action: Tensor
) -> tuple[ArticulatedState, Tensor]:
    """Return state and action of vehicles in their reference pose, whose drives hold it."""
    joint_pos = articulation.reference.repeat(state.num_envs, 1)
    held = [
        articulation.reference[k] if mode == "position" else articulation.reference.new_zeros(())
        for k, mode in zip(articulation.driven, articulation.modes, strict=True)
    ]
    jointed = ArticulatedState(**vars(state), joint_pos=joint_pos, joint_vel=torch.zeros_like(joint_pos))
    if not held:
        return jointed, action
    return jointed, torch.cat((action, torch.stack(held).expand(state.num_envs, -1)), dim=1).contiguous()


def moderate_effects(
    names: Sequence[str], robot: RobotCfg, *, num_envs: int, device: torch.device
) -> list[EffectParams]:
    """Return the effects with every parameter (E, P) one ``scale`` above neutral, within its bounds."""
    rows = []
    for name in names:
        effect = EFFECTS.get(name)
        effect.check(robot)
        pairs = zip(effect.neutral(robot), effect.parameters, strict=True)
        row = torch.tensor([min(max(value + p.scale, p.low), p.high) for value, p in pairs], device=device)
        rows.append((effect, row.expand(num_envs, -1).clone()))
    return rows


def _hover_thrust_and_speed(robot: RobotCfg, effects: Sequence[str], device: torch.device) -> tuple[Tensor, Tensor]:
    """Return thrust [N] and speed [rad/s] of each rotor, (1, R), that hold the vehicle with its effects level in place."""
    declared: Vehicle = vehicle_from_config(robot, num_envs=1, device=device)
    effects = [name for name in effects if EFFECTS.get(name).on_rigid]
    vehicle = build_model(declared, moderate_effects(effects, robot, num_envs=1, device=device)).vehicle
    allocation = Allocation(vehicle, STANDARD_GRAVITY)
    weight = torch.zeros(1, 6, device=device)
    weight[:, 2] = vehicle.mass * STANDARD_GRAVITY
    thrust = allocation.thrust(weight)
    return thrust, allocation.speed(thrust)


def state_near_hover(num_envs: int, rotor_speed: Tensor, generator: torch.Generator) -> BodyState:
    """Return level vehicles within 1 m of the origin, at most 0.1 m/s and 0.01 rad/s an axis, rotors at (1, R) [rad/s]."""
    state = state_at_rest(num_envs, rotor_speed.shape[1], device=rotor_speed.device, dtype=rotor_speed.dtype)
    for tensor, size in ((state.position, 1.0), (state.lin_vel, 0.1), (state.ang_vel, 0.01)):
        tensor.uniform_(-size, size, generator=generator)
    state.rotor_speed.copy_(rotor_speed.expand_as(state.rotor_speed))
    return state


def hover_action(
    law: str, num_actions: int, hover: tuple[Tensor, Tensor], num_envs: int, generator: torch.Generator
) -> Tensor:
    """Return the action (E, U) that hovers under a law, up to 0.1 % off per environment.

    It is zero for a geometric law, else thrust [N] or speed [rad/s] of each rotor, ``hover`` (1, R) each.
    """
    thrust, speed = hover
    if law not in ("thrust", "rotor_speed"):
        return torch.zeros(num_envs, num_actions, device=thrust.device)
    factor = torch.empty(num_envs, 1, device=thrust.device).uniform_(0.999, 1.001, generator=generator)
    return (factor * (thrust if law == "thrust" else speed)).contiguous()
