"""Drag of single links, given to the reference engine as the forces on links that it takes: against closed forms.

No effect does this (``docs/joints.md``, drag of links); these are the forces that one would have to give.
"""

from math import cos, exp, pi, sqrt, tanh

import pytest
import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.articulated.motion import cross, move_links, place_links
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from tests.physics.articulated.trees import F64, pendulum

G = 9.81


def drag(tree: Tree, links: Links, state: TreeState, linear: float, quadratic: float) -> Tensor:
    """Return ``-(d1 + d2 |v|) v`` at all centres of mass but the base's, as force and torque at origins, (E, L, 6)."""
    places = place_links(tree, links, state.joint_pos)
    base_vel = quat_rotate_inverse(state.attitude, state.lin_vel)
    motion = move_links(tree, places, base_vel, state.ang_vel, state.joint_vel)
    velocity = motion.lin_vel + cross(motion.ang_vel, places.com - places.origin)
    force = -(linear + quadratic * velocity.norm(dim=-1, keepdim=True)) * velocity
    force = (places.rotation.transpose(-1, -2) @ force.unsqueeze(-1)).squeeze(-1)
    force[:, 0] = 0.0
    return torch.cat((force, cross(links.com.expand_as(force), force)), dim=-1)


def swing(
    dt: float, span: float, start: float, *, linear: float = 0.0, quadratic: float = 0.0, gravity: float = G
) -> Tensor:
    """Return angle and rate of a pendulum of 0.5 m and 0.2 kg with drag, let go at rest (or at 2 rad/s without weight)."""
    tree, links = pendulum(0.5, 0.2)
    state = TreeState.at_rest(1, 1, like=links.mass)
    state.joint_pos[:] = start
    state.joint_vel[:] = 2.0 * (gravity == 0.0)
    for _ in range(round(span / dt)):
        wrench = drag(tree, links, state, linear, quadratic)
        state = implicit_euler(tree, links, (), state, dt, gravity=gravity, wrench=wrench)
    return torch.cat((state.joint_pos, state.joint_vel))[:, 0]


def test_linear_drag_damps_a_pendulum_by_half_of_it_over_the_mass() -> None:
    """After one period ``a exp(-d T / 2 m)``, as ``m l² q'' + d l² q' + m g l q = 0``; the step is of order 1."""
    linear, mass, length, start = 0.08, 0.2, 0.5, 1e-3
    rate = linear / (2.0 * mass)
    period = 2.0 * pi / sqrt(G / length - rate**2)
    ends = []
    for number in (150, 300):
        ends.append(float(swing(period / number, period, start, linear=linear)[0]))
    assert 2.0 * ends[1] - ends[0] == pytest.approx(start * exp(-rate * period), rel=1e-3)


def test_quadratic_drag_slows_a_link_hyperbolically() -> None:
    """Without weight ``m l q'' = -d l² q'²``: ``q' = q0' / (1 + d l q0' t / m)``, against the turn either way."""
    quadratic, mass, length = 0.3, 0.2, 0.5
    ends = [float(swing(dt, 1.0, 0.0, quadratic=quadratic, gravity=0.0)[1]) for dt in (4e-3, 2e-3)]
    assert 2.0 * ends[1] - ends[0] == pytest.approx(2.0 / (1.0 + quadratic * length * 2.0 / mass), rel=1e-4)


def test_drag_of_a_link_alone_makes_the_terminal_speed_of_the_whole() -> None:
    """A base of 1 kg falls under 0.2 kg on a free joint, which brake it as a parachute does and stay above it:
    ``v = -sqrt(M g / d) tanh(t sqrt(g d / M))``."""
    tree = Tree(joints=(Joint(parent=0, axis=(0.0, 1.0, 0.0)),))
    com = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]], dtype=F64)
    inertia = 1e-3 * torch.eye(3, dtype=F64).expand(1, 2, 3, 3)
    links = Links(mass=torch.tensor([[1.0, 0.2]], dtype=F64), com=com, inertia=inertia)
    ends, span, whole, quadratic = [], 0.6, 1.2, 1.5
    for dt in (4e-3, 2e-3):
        state = TreeState.at_rest(1, 1, like=links.mass)
        for _ in range(round(span / dt)):
            wrench = drag(tree, links, state, 0.0, quadratic)
            state = implicit_euler(tree, links, (), state, dt, gravity=G, wrench=wrench)
        ends.append(float(state.lin_vel[0, 2]))
        assert cos(float(state.joint_pos[0, 0])) == 1.0
    terminal = sqrt(whole * G / quadratic)
    assert 2.0 * ends[1] - ends[0] == pytest.approx(-terminal * tanh(span * G / terminal), rel=1e-3)
