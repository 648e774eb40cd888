"""Integrators of a tree of links.

``implicit_euler``: linearised efforts of joints at the end of the step; all else is semi-implicit Euler. It has order 1 and is
stable at any stiffness. Drives and dry friction respect their limits at the end of the step (``bounded_efforts``); a limit
judged at the start would make a drive with a light link overshoot in each step. With drives, friction or added mass, velocity
terms (Coriolis and centrifugal) use the rates in the middle of the step, because those of the start feed energy to fast
rotations. With them, the energy of free motion differs by terms of order 1 that do not accumulate.
``rk4``: order 4, for trees without stiff joints.
Letters: E environments, D joints, L links.

Sources:
    Hairer, Lubich, Wanner (2006), Geometric Numerical Integration, I.1.2 (symplectic Euler);
    Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit Euler);
    Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, table II.1.2 (Runge-Kutta of order 4).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_exp, quat_multiply, quat_normalize
from aerial_gym.physics.articulated import joint_laws
from aerial_gym.physics.articulated.dynamics import EquationsOfMotion, equations_of_motion, solve
from aerial_gym.physics.articulated.link_loads import LinkDamping, LinkFluid, add_damping, add_fluid
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.state import JointEfforts


def implicit_euler(
    tree: Tree, links: Links, laws: Sequence[joint_laws.JointLaw], state: TreeState, dt: float, *, gravity: float,
    drive: joint_laws.Drive | None = None, friction: joint_laws.Drive | None = None, wrench: Tensor | None = None,
    effort: Tensor | None = None, damping: LinkDamping | None = None, fluid: LinkFluid | None = None,
    applied: JointEfforts | None = None,
) -> TreeState:  # fmt: skip
    """Return the state after one step.

    With the effort ``f - K (q' dt + a dt²) - C a dt`` of stiffness K and damping C at the step's end:
    ``(M + C dt + K dt²) a = f - h - K q' dt``.

    Args:
        drive: Drives of joints; other joints have zero gains.
        friction: Result of ``joint_laws.dry_friction``; None without friction.
        wrench: Constant wrenches as for ``equations_of_motion``, (E, L, 6).
        effort: Further constant efforts of joints, (E, D).
        damping: Damping of links, at the end of the step; None without damping.
        fluid: Added mass of links; None without any.
        applied: Receives the applied efforts of drives and friction.
    """

    traces = torch.is_grad_enabled()

    @cache  # by identity: all rounds of a solution share the equations of a motion
    def build_equations(swings: TreeState) -> EquationsOfMotion:
        with torch.set_grad_enabled(traces):  # the first of these rounds is without gradients
            system = equations_of_motion(tree, links, swings, gravity=gravity, wrench=wrench, effort=effort)
            if fluid is not None:
                system = add_fluid(tree, system, state.attitude, fluid)
            return system if damping is None else add_damping(tree, system, damping, dt)

    def step(acts: joint_laws.Effort, swings: TreeState) -> TreeState:
        return _implicit_step(tree, state, build_equations(swings), acts, dt)

    return step_within_limits(step, laws, drive, friction, state, dt, centered=fluid is not None, applied=applied)


def step_within_limits(
    step: Callable[[joint_laws.Effort, TreeState], TreeState], laws: Sequence[joint_laws.JointLaw],
    drive: joint_laws.Drive | None, friction: joint_laws.Drive | None, state: TreeState, dt: float, *,
    rounds: int = joint_laws.ROUNDS, centered: bool = False, applied: JointEfforts | None = None,
) -> TreeState:  # fmt: skip
    """Return the state after a step under laws, drives and dry friction, each within its limit at the end of the step.

    The first solution, with the initial rates, gives the rates in the middle. The second, with those, is the step.

    Args:
        step: Function of a step from ``state`` with efforts of joints at its end and the velocity terms of a motion.
        drive: Drives of joints; None without drives.
        centered: Whether velocity terms use the rates in the middle of the step without drives and friction, too.
        applied: Receives the applied efforts.
    """
    acts = joint_laws.joint_effort(laws, state.joint_pos, state.joint_vel)
    bounded = [(law, law is friction) for law in (drive, friction) if law is not None]
    if not bounded:
        end = step(acts, state)
        return step(acts, state_with_middle_rates(state, end)) if centered else end
    own, rubs = zip(*bounded, strict=True)
    ends = joint_laws.EffortLimits.at_end_of_step(own, state.joint_pos, dt)
    problem = joint_laws.DriveLimitAndFrictionProblem(laws=ends, friction=rubs, acts=acts, state=state, rounds=rounds)

    def solve_step(swings: TreeState, guess: TreeState) -> tuple[joint_laws.LimitState, TreeState]:
        solution = problem.solve(lambda effort: step(effort, swings), guess)
        return solution, step(problem.total_effort(solution), swings)

    _, first = solve_step(state, state)
    solution, end = solve_step(state_with_middle_rates(state, first), first)
    if applied is not None:
        with torch.no_grad():
            for effort, rub in zip(problem.law_efforts(solution, end).unbind(1), rubs, strict=True):
                (applied.friction if rub else applied.drive).copy_(effort)
    return end


def state_with_middle_rates(state: TreeState, end: TreeState) -> TreeState:
    """Return the initial state of a step with the rates of its middle."""
    return replace(
        state,
        lin_vel=0.5 * (state.lin_vel + end.lin_vel),
        ang_vel=0.5 * (state.ang_vel + end.ang_vel),
        joint_vel=0.5 * (state.joint_vel + end.joint_vel),
    )


def _implicit_step(
    tree: Tree, state: TreeState, system: EquationsOfMotion, acts: joint_laws.Effort, dt: float
) -> TreeState:
    """Return the state after a step under equations of motion and implicit efforts of joints."""
    effort, stiff = (torch.nn.functional.pad(rows, (6, 0)) for rows in acts.at_end_of_step(state.joint_vel, dt))
    now = solve(tree, state, system.mass + torch.diag_embed(stiff), system.force + effort)
    return advance_state(
        state,
        state.lin_vel + dt * now.lin_acc,
        state.ang_vel + dt * now.ang_acc,
        state.joint_vel + dt * now.joint_acc,
        dt,
    )


def advance_state(state: TreeState, lin_vel: Tensor, ang_vel: Tensor, joint_vel: Tensor, dt: float) -> TreeState:
    """Return the state after a step with given final velocities, which also move the positions."""
    return TreeState(
        position=state.position + dt * lin_vel,
        attitude=quat_normalize(quat_multiply(state.attitude, quat_exp(dt * ang_vel))),
        lin_vel=lin_vel,
        ang_vel=ang_vel,
        joint_pos=state.joint_pos + dt * joint_vel,
        joint_vel=joint_vel,
    )


def rk4(
    tree: Tree, links: Links, laws: Sequence[joint_laws.JointLaw], state: TreeState, dt: float, *, gravity: float,
    wrench: Tensor | None = None, effort: Tensor | None = None, fluid: LinkFluid | None = None,
) -> TreeState:  # fmt: skip
    """Return the state after one classical Runge-Kutta step; arguments as for ``implicit_euler``."""

    def slope(at: TreeState) -> tuple[Tensor, ...]:
        acts = joint_laws.joint_effort(laws, at.joint_pos, at.joint_vel).value
        system = equations_of_motion(
            tree, links, at, gravity=gravity, wrench=wrench, effort=acts if effort is None else acts + effort
        )
        if fluid is not None:
            system = add_fluid(tree, system, at.attitude, fluid)
        now = solve(tree, at, system.mass, system.force)
        turning = 0.5 * quat_multiply(at.attitude, torch.nn.functional.pad(at.ang_vel, (0, 1)))
        return at.lin_vel, turning, now.lin_acc, now.ang_acc, at.joint_vel, now.joint_acc

    first = slope(state)
    second = slope(_advance(state, first, 0.5 * dt))
    third = slope(_advance(state, second, 0.5 * dt))
    last = slope(_advance(state, third, dt))
    mean = tuple((a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(first, second, third, last, strict=True))
    return _advance(state, mean, dt)


def _advance(state: TreeState, slope: tuple[Tensor, ...], dt: float) -> TreeState:
    position, attitude, lin_vel, ang_vel, joint_pos, joint_vel = slope
    return TreeState(
        position=state.position + dt * position,
        attitude=quat_normalize(state.attitude + dt * attitude),
        lin_vel=state.lin_vel + dt * lin_vel,
        ang_vel=state.ang_vel + dt * ang_vel,
        joint_pos=state.joint_pos + dt * joint_pos,
        joint_vel=state.joint_vel + dt * joint_vel,
    )
