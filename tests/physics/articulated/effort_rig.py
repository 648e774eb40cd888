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
    def limit(self) -> Tensor:
        """Return the largest effort of drive and friction together, (E, D); 0 where a joint has neither."""
        has_drive = (self.drive.stiffness + self.drive.damping + self.drive.effort.abs()).amax(0, keepdim=True) > 0.0
        return torch.where(has_drive, self.drive.limit, 0.0) + self.friction.limit

    def lawful(self, position: Tensor, rate: Tensor) -> Tensor:
        """Return the efforts of drive and friction at a position and rate, (E, D), written out anew."""
        drive, size = self.drive, self.friction.limit
        wanted = drive.stiffness * (drive.position - position) + drive.damping * (drive.rate - rate) + drive.effort
        sticks = size * (rate / STICK_RATE).clamp(-1.0, 1.0)
        return wanted.clamp(-drive.limit, drive.limit) - sticks


Stepper = Callable[..., TreeState]
"""As ``steppers.implicit_euler``."""


def step(bent: TreeCase, dt: float = DT, stepper: Stepper = steppers.implicit_euler) -> TreeState:
    return stepper(
        bent.tree, bent.links, bent.laws, bent.state, dt, gravity=9.81, drive=bent.drive, friction=bent.friction,
        wrench=bent.wrench,
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
    """A step function whose last call is kept: the efforts of all laws, and the state that they led to."""

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
        """Return the efforts of drives and friction of joints in the step that ended so [N m], (E, D)."""
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


def residuals(bent: TreeCase, effort: Tensor, end: TreeState) -> tuple[float, float, float]:
    """Return the largest violations in shares of a joint's limit: complementarity, limit, and friction's power. Friction's
    effort is what the drive does not give; its power is taken where it is all that acts."""
    limit = bent.limit.clamp_min(1e-12).expand_as(effort)
    has = (bent.limit > 0.0).expand_as(effort)
    alone = ((bent.limit == bent.friction.limit) & (bent.limit > 0.0)).expand_as(effort)
    gap = ((effort - bent.lawful(end.joint_pos, end.joint_vel)).abs() / limit)[has]
    excess = (effort.abs() / limit - 1.0)[has]
    power = (effort * torch.sign(end.joint_vel) / limit)[alone]
    worst = [each.max().item() if each.numel() else 0.0 for each in (gap, excess, power)]
    return worst[0], worst[1], worst[2]


def fly(bent: TreeCase, steps: int, *, dt: float = DT, stepper: Stepper = steppers.implicit_euler) -> TreeCase:
    for _ in range(steps):
        bent = replace(bent, state=step(bent, dt, stepper))
    return bent


def worst_residuals(
    bents: list[TreeCase], watched: StepRecorder, steps: int, stepper_of: Callable[[TreeCase], Stepper]
) -> tuple[float, float, float]:
    """Return the largest violations in the flights of several trees, as ``residuals`` has them."""
    worst = (0.0, 0.0, 0.0)
    for bent in bents:
        stepper = stepper_of(bent)
        for _ in range(steps):
            end = step(bent, stepper=stepper)
            result = residuals(bent, watched.effort(bent, end), end)
            worst = max(worst[0], result[0]), max(worst[1], result[1]), max(worst[2], result[2])
            bent = replace(bent, state=end)
    return worst
