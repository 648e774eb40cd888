"""Steps in time of a tree of links.

``implicit_euler``: the efforts of joints are those at the end of the step, linearised; all else is semi-implicit Euler. It is
of order 1 and stable however stiff a joint is. A drive that would be beyond its limit at the end of the step is at its limit
through it, as is dry friction: whether it would is found by a step without limits. (Judged at the start, a drive that moves a
light link to its place within a step would overshoot in each.) With drives or friction, what turning and swinging take is that
of the rates half way to the end of a step under the efforts so found: taken at the rates at the start it feeds what whirls, and
half way to the end of the step without limits, in which drives do as they like, it does so too; snakes under random commands
ended in NaN. ``rk4``: order 4, for motion that no stiff joint is in.
Letters: E environments, D joints, L links.

Sources:
    Hairer, Lubich, Wanner (2006), Geometric Numerical Integration, I.1.2 (symplectic Euler);
    Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit Euler);
    Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, table II.1.2 (Runge-Kutta of order 4).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_exp, quat_multiply, quat_normalize
from aerial_gym.physics.articulated.dynamics import Equations, equations, solve
from aerial_gym.physics.articulated.joint_laws import Drive, Effort, JointLaw, joint_effort
from aerial_gym.physics.articulated.link_damping import LinkDamping, damped
from aerial_gym.physics.articulated.link_fluid import LinkFluid, entrained
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState


def implicit_euler(
    tree: Tree,
    links: Links,
    laws: Sequence[JointLaw],
    state: TreeState,
    dt: float,
    *,
    gravity: float,
    drive: Drive | None = None,
    friction: Drive | None = None,
    wrench: Tensor | None = None,
    effort: Tensor | None = None,
    damping: LinkDamping | None = None,
    fluid: LinkFluid | None = None,
) -> TreeState:
    """Return the state after one step.

    With the effort ``f - K (q' dt + a dt²) - C a dt`` of stiffness K and damping C at the step's end:
    ``(M + C dt + K dt²) a = f - h - K q' dt``.

    Args:
        tree: How links hang together.
        links: What they weigh.
        laws: What acts in the joints.
        state: Motion at the start.
        dt: Length of the step [s].
        gravity: Downward acceleration of free fall [m/s²].
        drive: Of the joints that have one; the gains of others are zero.
        friction: As ``joint_laws.dry_friction`` gives it; None where there is none.
        wrench: Held through the step, as for ``equations``, (E, L, 6).
        effort: Of the joints beside the laws, held through the step, (E, D).
        damping: Of the links, taken at the end of the step; None where there is none.
        fluid: That they set in motion; None where there is none.
    """

    def step(acts: Effort, swings: TreeState) -> TreeState:
        found = equations(tree, links, swings, gravity=gravity, wrench=wrench, effort=effort)
        if fluid is not None:
            found = entrained(tree, found, state.attitude, fluid)
        if damping is not None:
            found = damped(tree, found, damping, dt)
        return _implicit(tree, state, found, acts, dt)

    return with_drive(step, laws, drive, friction, state)


def with_drive(
    step: Callable[[Effort, TreeState], TreeState],
    laws: Sequence[JointLaw],
    drive: Drive | None,
    friction: Drive | None,
    state: TreeState,
) -> TreeState:
    """Return the state after a step under laws and a drive, which gives way where a first step would take it to its limit.

    Then it is found likewise which joints dry friction does not hold; in the first step it acts on those that move already.
    A step under what was found says what the rates half way are, at which the last one takes what turning and swinging take.

    Args:
        step: A step from ``state`` under efforts of joints, taken at its end, and what turning and swinging take in a motion.
        laws: What acts in the joints.
        drive: Of the joints that have one; None for no drive.
        friction: Likewise.
        state: Motion at the start.
    """
    pos, vel = state.joint_pos, state.joint_vel
    acts, nowhere = joint_effort(laws, pos, vel), torch.zeros_like(pos)
    if drive is None and friction is None:
        return step(acts, state)
    if drive is not None:
        with torch.no_grad():  # which side a drive is at its limit has no slope
            trial = acts + drive.effort_at(pos, vel, nowhere)
            if friction is not None:
                trial = trial + friction.effort_at(pos, vel, friction.beyond(pos, vel))
            end = step(trial, state)
            at_limit = drive.beyond(end.joint_pos, end.joint_vel)
        acts = acts + drive.effort_at(pos, vel, at_limit)
    if friction is not None:
        with torch.no_grad():
            end = step(acts + friction.effort_at(pos, vel, nowhere), state)
            slips = friction.beyond(end.joint_pos, end.joint_vel)
        acts = acts + friction.effort_at(pos, vel, slips)
    return step(acts, half_way(state, step(acts, state)))


def half_way(state: TreeState, end: TreeState) -> TreeState:
    """Return where a step begins, with the rates half way to its end."""
    return replace(
        state,
        ang_vel=0.5 * (state.ang_vel + end.ang_vel),
        joint_vel=0.5 * (state.joint_vel + end.joint_vel),
    )


def _implicit(tree: Tree, state: TreeState, found: Equations, acts: Effort, dt: float) -> TreeState:
    """Return the state after a step under equations without the efforts of joints, and these."""
    soft = acts.stiffness * dt
    held = torch.nn.functional.pad(acts.value - soft * state.joint_vel, (6, 0))
    stiff = torch.nn.functional.pad(dt * (acts.damping + soft), (6, 0))
    now = solve(tree, state, found.mass + torch.diag_embed(stiff), found.force + held)
    return moved_on(
        state,
        state.lin_vel + dt * now.lin_acc,
        state.ang_vel + dt * now.ang_acc,
        state.joint_vel + dt * now.joint_acc,
        dt,
    )


def moved_on(state: TreeState, lin_vel: Tensor, ang_vel: Tensor, joint_vel: Tensor, dt: float) -> TreeState:
    """Return the state after a step with these velocities at its end, by which places move."""
    return TreeState(
        position=state.position + dt * lin_vel,
        attitude=quat_normalize(quat_multiply(state.attitude, quat_exp(dt * ang_vel))),
        lin_vel=lin_vel,
        ang_vel=ang_vel,
        joint_pos=state.joint_pos + dt * joint_vel,
        joint_vel=joint_vel,
    )


def rk4(
    tree: Tree,
    links: Links,
    laws: Sequence[JointLaw],
    state: TreeState,
    dt: float,
    *,
    gravity: float,
    wrench: Tensor | None = None,
    effort: Tensor | None = None,
    fluid: LinkFluid | None = None,
) -> TreeState:
    """Return the state after one classical Runge-Kutta step; arguments as for ``implicit_euler``."""

    def slope(at: TreeState) -> tuple[Tensor, ...]:
        acts = joint_effort(laws, at.joint_pos, at.joint_vel).value
        found = equations(
            tree, links, at, gravity=gravity, wrench=wrench, effort=acts if effort is None else acts + effort
        )
        if fluid is not None:
            found = entrained(tree, found, at.attitude, fluid)
        now = solve(tree, at, found.mass, found.force)
        turning = 0.5 * quat_multiply(at.attitude, torch.nn.functional.pad(at.ang_vel, (0, 1)))
        return at.lin_vel, turning, now.lin_acc, now.ang_acc, at.joint_vel, now.joint_acc

    first = slope(state)
    second = slope(_moved(state, first, 0.5 * dt))
    third = slope(_moved(state, second, 0.5 * dt))
    last = slope(_moved(state, third, dt))
    mean = tuple((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(first, second, third, last, strict=True))
    return _moved(state, mean, dt)


def _moved(state: TreeState, slope: tuple[Tensor, ...], dt: float) -> TreeState:
    position, attitude, lin_vel, ang_vel, joint_pos, joint_vel = slope
    return TreeState(
        position=state.position + dt * position,
        attitude=quat_normalize(state.attitude + dt * attitude),
        lin_vel=state.lin_vel + dt * lin_vel,
        ang_vel=state.ang_vel + dt * ang_vel,
        joint_pos=state.joint_pos + dt * joint_pos,
        joint_vel=state.joint_vel + dt * joint_vel,
    )
