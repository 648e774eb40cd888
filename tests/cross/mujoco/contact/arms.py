"""Vehicles of a base and two arms in MuJoCo as a backend, stepped without a simulation around them; all in float64."""

import torch

from aerial_gym.config.environment import ContactCfg
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.joint_laws import Drive, Spring
from aerial_gym.physics.articulated.motion import move_links, place_links
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from aerial_gym.physics.ground import LinkContacts, LinkShape
from aerial_gym.physics.mujoco.mjcf import Floor
from aerial_gym.physics.mujoco.rollouts import RolloutTrees
from tests.physics.vehicles import F64

G = 9.81
CFG = ContactCfg(friction=0.5)
BASE_MASS, ARM_MASS, ARM = 0.2, 0.05, 0.2
MASS = BASE_MASS + 2.0 * ARM_MASS
MIDDLE = (0.0, 0.0, 0.0)


def springs(stiffness: float, damping: float, rest: tuple[float, float] = (0.0, 0.0)) -> Spring:
    zero = torch.zeros(1, 2, dtype=F64)
    return Spring(
        stiffness=zero + stiffness, damping=zero + damping, quadratic=zero, preload=zero,
        rest=torch.tensor([rest], dtype=F64),
    )  # fmt: skip


def two_arms(kind: str, axes: tuple[tuple[float, float, float], tuple[float, float, float]], aside: float) -> Tree:
    joints = (
        Joint(parent=0, axis=axis, position=(x, 0.0, 0.0), kind=kind)
        for axis, x in zip(axes, (aside, -aside), strict=True)
    )
    return Tree(joints=tuple(joints))


def weights(arm_com: float) -> Links:
    return Links(
        mass=torch.tensor([[BASE_MASS, ARM_MASS, ARM_MASS]], dtype=F64),
        com=torch.tensor([[[0.0, 0.0, 0.0], [arm_com, 0.0, 0.0], [-arm_com, 0.0, 0.0]]], dtype=F64),
        inertia=torch.diag_embed(
            torch.tensor([[[2e-4, 2e-4, 4e-4], [1e-5, 1e-5, 1e-5], [1e-5, 1e-5, 1e-5]]], dtype=F64)
        ),
    )


def arm_state(height: float, **remaining: tuple[float, float, float]) -> TreeState:
    rows = {"lin_vel": (0.0, 0.0, 0.0), "ang_vel": (0.0, 0.0, 0.0), "attitude": (0.0, 0.0, 0.0, 1.0)} | remaining
    state = {name: torch.tensor([row], dtype=F64) for name, row in rows.items()}
    empty = torch.zeros(1, 2, dtype=F64)
    return TreeState(position=torch.tensor([[0.0, 0.0, height]], dtype=F64), joint_pos=empty, joint_vel=empty, **state)


class ContactRig:
    """Two arms on a base, in steps; sums up what the ground gave."""

    def __init__(
        self, tree: Tree, links: Links, law: Spring, on_links: LinkContacts, spheres, *, dt: float, gravity=G,
        friction=0.5, height=0.0,
    ) -> None:  # fmt: skip
        floor = Floor(height=height, spheres=spheres, friction=friction, on_links=on_links)
        self.bodies = RolloutTrees(tree, 1, dt, floor=floor, cfg=CFG)
        self.tree, self.links, self.law, self.gravity = tree, links, law, gravity
        self.impulse = torch.zeros(1, 3, dtype=F64)

    def step(self, state: TreeState, *, driven: bool = False) -> TreeState:
        """Take a step; ``driven`` with a drive of the spring's numbers in its place."""
        own = {"stiffness": self.law.stiffness, "damping": self.law.damping, "position": self.law.rest}
        empty = {name: torch.zeros_like(self.law.rest) for name in ("rate", "effort")}
        drive = Drive(**own, **empty, limit=torch.full_like(self.law.rest, 1e3)) if driven else None
        state = self.bodies.move(
            self.tree, self.links, [] if driven else [self.law], state, self.bodies.dt, gravity=self.gravity,
            wrench=torch.zeros(1, 3, 6, dtype=F64), drive=drive,
        )  # fmt: skip
        self.impulse += self.bodies.impulse
        return state

    def run(self, state: TreeState, span: float) -> TreeState:
        for _ in range(round(span / self.bodies.dt)):
            state = self.step(state)
        return state

    def energy_and_momentum(self, state: TreeState) -> tuple[float, torch.Tensor]:
        """Of motion, height and springs [J], and momentum of all links [N s], world, (1, 3)."""
        places = place_links(self.tree, self.links, state.joint_pos)
        body_vel = quat_rotate_inverse(state.attitude, state.lin_vel)
        motion = move_links(self.tree, places, body_vel, state.ang_vel, state.joint_vel)
        mass = self.links.mass.unsqueeze(-1)
        velocity = motion.lin_vel + torch.linalg.cross(motion.ang_vel, places.com - places.origin)
        spin = (places.inertia @ motion.ang_vel.unsqueeze(-1)).squeeze(-1)
        moving = 0.5 * (mass * velocity.square()).sum() + 0.5 * (spin * motion.ang_vel).sum()
        center = state.position + quat_rotate(state.attitude, (mass * places.com).sum(1) / mass.sum(1))
        bent = 0.5 * (self.law.stiffness * (state.joint_pos - self.law.rest).square()).sum()
        energy = moving + self.gravity * mass.sum() * center[0, 2] + bent
        return float(energy), quat_rotate(state.attitude, (mass * velocity).sum(1))


def link_shape(link: int, radius: float, half: tuple[float, float, float]) -> LinkShape:
    return LinkShape(link=link, center=MIDDLE, attitude=(0.0, 0.0, 0.0, 1.0), half=half, radius=radius)


FEET = ((ARM, 0.0, 0.0, 0.01), (-ARM, 0.0, 0.0, 0.01))
HINGES = ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0))  # positive: the arm goes down
