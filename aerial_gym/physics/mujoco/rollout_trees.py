"""Trees of links in MuJoCo on the CPU, in float64: vehicles that bend.

Springs and dampers in joints are those of the end of a step, as in ``steppers.implicit_euler``, with the stiffness K and the
damping C that the laws have in each state:

    (M + C dt + K dt²) a = f - h - K q' dt.

MuJoCo's ``Euler`` takes the damping D of a joint so: ``(M + D dt) a = u - h - D q'``. With ``D = C + K dt`` and
``u = f + C q'`` it is the same step. Damping of links is no joint's: it is held through a step as other forces on links are,
and refused where it would turn their motion round. A fixed base is level in MuJoCo and stands still: gravity is turned instead.
Letters: E environments, L links, D joints.
"""

from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from aerial_gym.config.contact import ContactCfg
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.joint_laws import Drive, Effort, JointLaw
from aerial_gym.physics.articulated.link_damping import LinkDamping
from aerial_gym.physics.articulated.motion import move_links, moving, place_links
from aerial_gym.physics.articulated.steppers import moved_on, with_drive
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.mujoco.bodies import LARGEST, load
from aerial_gym.physics.mujoco.mjcf import Floor, write_mjcf
from aerial_gym.physics.mujoco.rollouts import Rollouts
from aerial_gym.physics.mujoco.softness import solver_numbers

LEAST_MASS = 1e-9
"""Of links without mass [kg], and the moments of those without inertia [kg m²]: MuJoCo's links have some."""


class RolloutTrees:
    """A MuJoCo model for each environment, whose ``move`` is a step as ``steppers.implicit_euler`` is."""

    impulse: Tensor
    """Of all contacts with the ground in the last step [N s], world, (E, 3), float64."""

    def __init__(
        self, tree: Tree, num_envs: int, dt: float, *, floor: Floor | None = None, cfg: ContactCfg | None = None
    ) -> None:
        """Make the models.

        Args:
            tree: How links hang together.
            num_envs: Environments E.
            dt: Length of a step [s].
            floor: What can be touched, of a floating tree; None for nothing.
            cfg: How it gives way; with a floor.

        Raises:
            MissingDependencyError: If MuJoCo is not installed.
            CapabilityError: If a tree on a stand is to touch something.
        """
        if floor is not None and not tree.floating:
            raise CapabilityError(
                "backend mujoco: no contact of a vehicle on a stand. Leave contact out of the environment"
            )
        self._touches = floor is not None
        self.dt, self._tree, shape = dt, tree, (1, tree.num_links)
        links = Links(mass=torch.ones(shape), com=torch.zeros(*shape, 3), inertia=torch.eye(3).expand(*shape, 3, 3))
        mujoco = load("mujoco", backend="mujoco")
        first = mujoco.MjModel.from_xml_string(write_mjcf(tree, links, gravity=0.0, dt=dt, floor=floor, actuated=True))
        if cfg is not None:
            first.geom_solref[:], first.geom_solimp[:] = first.pair_solref[:], first.pair_solimp[:] = solver_numbers(
                cfg, dt
            )
        self._rollouts = Rollouts(first, num_envs, num_envs, "mjSTATE_CTRL")
        names = [f"joint{k}" for k in range(tree.num_joints)]
        self._joint_pos = [1 + int(first.joint(name).qposadr[0]) for name in names]
        self._rates = [int(first.joint(name).dofadr[0]) for name in names]
        self._joint_vel = [1 + first.nq + place for place in self._rates]
        self._places = [int(first.body(f"link{link}").id) for link in range(tree.num_links)]
        self._weights = torch.full((num_envs, 13 * tree.num_links + 3), torch.nan, dtype=torch.float64)
        self._damping = torch.zeros(num_envs, tree.num_joints, dtype=torch.float64)

    def _follow(self, links: Links, gravity: Tensor, damping: Tensor) -> None:
        """Write what has changed into the models; gravity is its acceleration, axes of a fixed base, (E, 3)."""
        every = (links.mass, links.com, links.inertia)
        mass, com, inertia = (rows.double().expand(len(gravity), *rows.shape[1:]) for rows in every)
        weights = torch.cat((mass, com.flatten(1), inertia.flatten(1), gravity), dim=1)
        changed = (weights != self._weights).any(dim=-1).nonzero().squeeze(-1).tolist()
        if changed:
            self._weights[changed] = weights[changed]
            some = LEAST_MASS * torch.eye(3, dtype=inertia.dtype)
            inertia = torch.where((inertia == 0.0).flatten(2).all(-1)[..., None, None], some, inertia)[changed]
            mass = mass[changed].clamp_min(LEAST_MASS)
            self._rollouts.write_bodies(changed, self._places, mass, com[changed], inertia, gravity[changed])
            self._rollouts.settle(changed)
            if self._touches:
                self._rollouts.refer_contacts_to(changed, self._places, mass.sum(dim=-1))
        changed = (damping != self._damping).any(dim=-1).nonzero().squeeze(-1).tolist()
        self._damping[changed] = damping[changed]
        for k, row in zip(changed, damping[changed].numpy(), strict=True):
            self._rollouts.models[k].dof_damping[self._rates] = row

    def move(
        self,
        tree: Tree,
        links: Links,
        laws: Sequence[JointLaw],
        state: TreeState,
        dt: float,
        *,
        gravity: float,
        wrench: Tensor,
        drive: Drive | None = None,
        friction: Drive | None = None,
        damping: LinkDamping | None = None,
    ) -> TreeState:
        """Return the state after one step; arguments as for ``steppers.implicit_euler``, but that damping is held through it.

        Rows with a number that is not finite, or beyond ``bodies.LARGEST``, come out NaN; they are not stepped.

        Raises:
            ShapeError: If it was made for another tree or for steps of another length.
            CapabilityError: If damping of links is too large to be held.
        """
        if tree is not self._tree or dt != self.dt:
            raise ShapeError(f"MuJoCo's models are of another tree, or of steps of {self.dt:g} s. Make them anew")
        if damping is not None:
            _check_held(links, damping, dt)
            wrench = wrench + damping.held(links)
        end = with_drive(partial(self._step, links, state, gravity, wrench), laws, drive, friction, state)
        if self._touches:
            self.impulse = self._of_contacts(links, state, gravity)
        return end

    def _of_contacts(self, links: Links, state: TreeState, gravity: float) -> Tensor:
        """Return what the momentum of all links gained beyond wrench and gravity in the last step [N s], world, (E, 3)."""
        tree, dt, rate = self._tree, self.dt, self._rollouts.twist.start
        start, end = self._rollouts.start, self._rollouts.end
        attitude, mass = state.attitude.double(), links.mass.double().clamp_min(LEAST_MASS).unsqueeze(-1)
        wide = Links(**{name: values.double() for name, values in vars(links).items()})
        places = place_links(tree, wide, start[:, self._joint_pos])
        lin_vel, ang_vel = quat_rotate_inverse(attitude, start[:, rate : rate + 3]), start[:, rate + 3 : rate + 6]
        motion = move_links(tree, places, lin_vel, ang_vel, start[:, self._joint_vel])
        gained = (end - start) / dt
        acc = torch.cat(
            (
                quat_rotate_inverse(attitude, gained[:, rate : rate + 3]),
                gained[:, rate + 3 : rate + 6],
                gained[:, self._joint_vel],
            ),
            dim=-1,
        )
        com_acc = motion.com_acc + (moving(tree, places, places.com) @ acc[:, None, :, None]).squeeze(-1)
        push = self._rollouts.control[:, : 6 * tree.num_links].unflatten(-1, (tree.num_links, 6))[..., :3]
        applied = (places.rotation @ push.unsqueeze(-1)).squeeze(-1).sum(1)
        beyond = quat_rotate(attitude, (mass * com_acc).sum(1) - applied)
        beyond[:, 2] += gravity * mass.sum(1)[:, 0]
        return dt * beyond

    def _step(
        self, links: Links, state: TreeState, gravity: float, wrench: Tensor, acts: Effort, swings: TreeState
    ) -> TreeState:
        """Return the state after one step under efforts of joints, taken at its end.

        MuJoCo steps from the rates at which turning and swinging are taken, and what they gain is added to those of the state.
        Where something can be touched these are the rates at the start, at which MuJoCo's contacts push.
        """
        if self._touches:
            swings = state
        tree, dt = self._tree, self.dt
        damping = (acts.damping + dt * acts.stiffness).double()
        held = acts.value - dt * acts.stiffness * state.joint_vel + damping * swings.joint_vel
        push = torch.cat((wrench.flatten(1), held), dim=-1).double()
        start = torch.zeros_like(self._rollouts.start)
        start[:, self._joint_pos], start[:, self._joint_vel] = state.joint_pos.double(), swings.joint_vel.double()
        if tree.floating:
            pose, rate = self._rollouts.pose.start, self._rollouts.twist.start
            start[:, pose : pose + 7] = torch.cat((state.position, state.attitude.roll(1, dims=-1)), dim=-1).double()
            start[:, rate : rate + 6] = torch.cat((state.lin_vel, swings.ang_vel), dim=-1).double()
        sane = (torch.cat((start, push, damping), dim=-1).abs() < LARGEST).all(dim=-1, keepdim=True)
        rest = torch.zeros_like(start[:1])
        if tree.floating:
            rest[:, self._rollouts.pose.start + 3] = 1.0
        self._rollouts.start.copy_(torch.where(sane, start, rest))
        self._rollouts.control.copy_(torch.where(sane, push, 0.0))
        down = torch.zeros_like(start[:, :3])
        down[:, 2] = -gravity
        if not tree.floating:
            down = quat_rotate_inverse(state.attitude.double(), down)
        self._follow(links, torch.where(sane, down, 0.0), torch.where(sane, damping, 0.0))
        self._rollouts.step()
        end = torch.where(sane, self._rollouts.end, torch.nan).to(state.position.dtype)
        lin_vel, ang_vel = torch.zeros_like(state.lin_vel), torch.zeros_like(state.ang_vel)
        if tree.floating:
            twist = end[:, rate : rate + 6]
            lin_vel, ang_vel = twist[:, :3], state.ang_vel + twist[:, 3:] - swings.ang_vel
        return moved_on(state, lin_vel, ang_vel, state.joint_vel + end[:, self._joint_vel] - swings.joint_vel, dt)


def _check_held(links: Links, acts: LinkDamping, dt: float) -> None:
    """Raise ``CapabilityError`` where damping that is held through a step takes more than all of a link's motion.

    Below ``D dt = m`` of each link, and likewise for torques, no motion of the tree turns round:
    ``sum J^T D J dt <= sum J^T m J <= M``. A link that is a point has no inertia to say so by.
    """
    along, about = (part.amax(-1) for part in acts.damping.split(3, dim=-1))
    moment = torch.linalg.eigvalsh(links.inertia)[..., 0]
    for damping, size, what in ((along, links.mass, "mass [kg]"), (about, moment, "least moment of inertia [kg m²]")):
        size = size.expand_as(damping)
        if bool(((size > 0.0) & (dt * damping > size)).any()):
            ratio = float((dt * damping / size)[size > 0.0].nan_to_num(0.0).max())
            raise CapabilityError(
                f"backend mujoco: holds drag of links through a step of {dt:g} s, which would take {ratio:.3g} times the speed "
                f"of one: drag per speed times the step must stay below its {what}. Use backend 'torch' or 'warp', or "
                "shorter steps"
            )
