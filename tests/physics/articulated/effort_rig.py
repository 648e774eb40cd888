"""Trees and snakes whose joints have drives with limits and dry friction, and the efforts that a step applies to them.
Letters: E environments, D joints."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.physics import build_model, vehicle_from_config
from aerial_gym.physics.articulated import steppers
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.flight import link_wrenches
from aerial_gym.physics.articulated.joint_laws import STICK_RATE, Drive, Effort, JointLaw, dry_friction, joint_effort
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.model import Model
from aerial_gym.physics.rotors import state_for_thrust
from aerial_gym.physics.state import JointEfforts
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.trees import F64, random_links, random_motion, random_tree

DT = 2e-3


@dataclass(frozen=True)
class TreeCase:
    tree: Tree
    links: Links
    laws: tuple[JointLaw, ...]
    drive: Drive
    friction: Drive
    wrench: Tensor
    state: TreeState

    @property
    def drive_limit(self) -> Tensor:
        """Return the largest effort of the drive of each joint, (E, D); 0 where a joint has none."""
        has_drive = (self.drive.stiffness + self.drive.damping + self.drive.effort.abs()).amax(0, keepdim=True) > 0.0
        return torch.where(has_drive, self.drive.limit, 0.0)

    def lawful(self, position: Tensor, rate: Tensor) -> tuple[Tensor, Tensor]:
        """Return the efforts of drive and friction at a position and rate, (E, D), written out anew."""
        drive, size = self.drive, self.friction.limit
        wanted = drive.stiffness * (drive.position - position) + drive.damping * (drive.rate - rate) + drive.effort
        return wanted.clamp(-drive.limit, drive.limit), -size * (rate / STICK_RATE).clamp(-1.0, 1.0)


Stepper = Callable[..., TreeState]
"""As ``steppers.implicit_euler``."""


def step(
    bent: TreeCase, dt: float = DT, stepper: Stepper = steppers.implicit_euler, applied: JointEfforts | None = None
) -> TreeState:
    return stepper(
        bent.tree, bent.links, bent.laws, bent.state, dt, gravity=9.81, drive=bent.drive, friction=bent.friction,
        wrench=bent.wrench, applied=applied,
    )  # fmt: skip


def random_bent(seed: int, *, num_envs: int = 4, largest: int = 10) -> TreeCase:
    """Return a tree of 1 to ``largest`` joints; some have a drive, some dry friction, some both. Gains span three decades,
    so some drives would bring their joint to the command within a step, others never."""
    rng, num_joints = np.random.default_rng(seed + 77), 1 + seed % largest
    tree = random_tree(num_joints, seed, chain=seed % 3 == 0, floating=seed % 4 != 0)

    def draw(low: float, high: float) -> Tensor:
        return torch.from_numpy(np.exp(rng.uniform(np.log(low), np.log(high), (1, num_joints))))

    def normal(scale: float) -> Tensor:
        return torch.from_numpy(scale * rng.normal(size=(num_envs, num_joints)))

    driven, rubs = (torch.from_numpy(rng.random((1, num_joints)) < share).double() for share in (0.7, 0.6))
    drive = Drive(
        stiffness=driven * draw(0.1, 100.0), damping=driven * draw(0.01, 10.0), position=normal(1.0),
        rate=normal(3.0), effort=driven * normal(0.1), limit=torch.where(driven > 0.0, draw(0.01, 1.0), 1e9),
    )  # fmt: skip
    wrench = torch.from_numpy(0.3 * rng.normal(size=(num_envs, tree.num_links, 6)))
    links, state = random_links(tree, num_envs, seed), random_motion(tree, num_envs, seed)
    return TreeCase(tree, links, (), drive, dry_friction(rubs * draw(0.003, 0.3)), wrench, state)


def snake_model(name: str, num_envs: int, friction: float) -> Model:
    """Return a registered snake with dry friction [N m] in its joints, in float64."""
    vehicle = vehicle_from_config(ROBOTS.get(name), num_envs=num_envs, dtype=F64)
    bends = build_articulation(ROBOTS.get(name), like=vehicle.mass)
    bends = replace(bends, friction=torch.full_like(bends.friction, friction), rubs=friction > 0.0)
    return build_model(vehicle, [], articulation=bends)


def random_snakes(name: str, *, num_envs: int = 32, friction: float = 0.02, seed: int = 0) -> TreeCase:
    """Return snakes that are bent, moving and told anything, each rotor at 0 to 15 N."""
    model = snake_model(name, num_envs, friction)
    bends, generator = model.articulation, torch.Generator().manual_seed(seed)
    motion = random_motion(bends.tree, num_envs, seed)
    state = replace(motion, joint_pos=bends.reference + 0.5 * motion.joint_pos)
    share = torch.rand(num_envs, bends.num_driven + model.vehicle.num_rotors, dtype=F64, generator=generator)
    told, thrust = share[:, : bends.num_driven], 15.0 * share[:, bends.num_driven :]
    drive = bends.drive(bends.command_low + told * (bends.command_high - bends.command_low))
    speed = state_for_thrust(model.vehicle, thrust)
    wrench = link_wrenches(model, bends, state, speed, torch.zeros_like(speed))
    return TreeCase(
        bends.tree, bends.links(model.vehicle), bends.laws(None), drive, dry_friction(bends.friction), wrench, state
    )


class StepRecorder:
    """A step function whose last call is kept: the efforts of all laws, and the state that they led to. The change of rates is
    due to these efforts."""

    acts: Effort
    end: TreeState

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: object, name: str) -> None:
        """Watch ``owner.name``, whose arguments have the efforts."""
        own = getattr(owner, name)

        def record(*args: object, **kwargs: object) -> TreeState:
            self.acts = next(each for each in (*args, *kwargs.values()) if isinstance(each, Effort))
            self.end = own(*args, **kwargs)
            return self.end

        monkeypatch.setattr(owner, name, record)

    def effort(self, bent: TreeCase, end: TreeState) -> Tensor:
        """Return the total effort of drive and friction of each joint in the step that ended so [N m], (E, D)."""
        assert self.end is end
        start = bent.state
        passive = joint_effort(bent.laws, start.joint_pos, start.joint_vel)
        acts = (
            self.acts.value - passive.value,
            self.acts.stiffness - passive.stiffness,
            self.acts.damping - passive.damping,
        )
        value, stiffness, damping = acts
        return value - stiffness * (end.joint_pos - start.joint_pos) - damping * (end.joint_vel - start.joint_vel)


@dataclass(frozen=True)
class Residuals:
    """Largest violations by applied efforts, in shares of the limit of a drive or of the size of friction."""

    law: float = 0.0  # Distance from the law at the end of the step: complementarity
    excess: float = 0.0  # Excess of an effort over its limit
    power: float = 0.0  # Friction along the rate
    change: float = 0.0  # Distance of the total from the effort that changed the rates

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:.1e}" for name, value in vars(self).items())

    def join(self, other: "Residuals") -> "Residuals":
        return Residuals(*(max(pair) for pair in zip(vars(self).values(), vars(other).values(), strict=True)))

    @property
    def worst(self) -> float:
        return max(vars(self).values())


def largest_share(part: Tensor, limit: Tensor) -> float:
    """Return the largest share of a limit, among joints with one."""
    shares = (part / limit.clamp_min(1e-12))[(limit > 0.0).expand_as(part)]
    return shares.max().item() if shares.numel() else 0.0


def residuals(bent: TreeCase, efforts: JointEfforts, change: Tensor, end: TreeState) -> Residuals:
    """Return the violations of a step with the given end; ``change`` is the effort that changed the rates, (E, D)."""
    drive, friction = efforts.drive, efforts.friction
    limit, size = bent.drive_limit, bent.friction.limit
    of_drive, of_friction = bent.lawful(end.joint_pos, end.joint_vel)
    return Residuals(
        law=max(largest_share((drive - of_drive).abs(), limit), largest_share((friction - of_friction).abs(), size)),
        excess=max(largest_share(drive.abs() - limit, limit), largest_share(friction.abs() - size, size)),
        power=largest_share(friction * torch.sign(end.joint_vel), size),
        change=largest_share((drive + friction - change).abs(), limit + size),
    )


def no_efforts(bent: TreeCase) -> JointEfforts:
    return JointEfforts(drive=torch.zeros_like(bent.state.joint_pos), friction=torch.zeros_like(bent.state.joint_pos))


def fly(bent: TreeCase, steps: int, *, dt: float = DT, stepper: Stepper = steppers.implicit_euler) -> TreeCase:
    for _ in range(steps):
        bent = replace(bent, state=step(bent, dt, stepper))
    return bent


def worst_residuals(
    bents: list[TreeCase], watched: StepRecorder, steps: int, stepper_of: Callable[[TreeCase], Stepper]
) -> Residuals:
    """Return the largest violations in the flights of several trees."""
    worst = Residuals()
    for bent in bents:
        stepper, applied = stepper_of(bent), no_efforts(bent)
        for _ in range(steps):
            end = step(bent, stepper=stepper, applied=applied)
            worst = worst.join(residuals(bent, applied, watched.effort(bent, end), end))
            bent = replace(bent, state=end)
    return worst
