"""Trees of links against what physics conserves, closed forms, and the order of the steps."""

from dataclasses import replace
from math import cos, exp, log2, sin, sqrt

import pytest
import torch
from scipy.special import ellipk
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.physics.articulated.joint_laws import Drive, JointLimits, Spring
from aerial_gym.physics.articulated.steppers import implicit_euler, rk4
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from benchmarks.joints.random_commands import fly
from tests.physics.articulated.trees import (
    F64,
    kinetic_energy,
    momenta,
    pendulum,
    random_links,
    random_motion,
    random_tree,
)

G = 9.81


def row(*numbers: float) -> Tensor:
    return torch.tensor([numbers], dtype=F64)


def pendulum_state(angle: float, rate: float = 0.0) -> TreeState:
    state = TreeState.at_rest(1, 1, like=row(0.0))
    return TreeState(**{**vars(state), "joint_pos": row(angle), "joint_vel": row(rate)})


def free(tree: Tree, links: Links, state: TreeState, dt: float, steps: int, *, gravity: float = 0.0) -> TreeState:
    for _ in range(steps):
        state = rk4(tree, links, (), state, dt, gravity=gravity)
    return state


def test_a_free_tree_keeps_momentum_and_energy_to_the_order_of_the_integrator() -> None:
    """No force acts; over 0.2 s at 4 and 2 ms what is lost falls by 2^4 or more, and momentum is kept in the mean motion."""
    tree = random_tree(6, 5)
    links, start = random_links(tree, 4, 5), random_motion(tree, 4, 5)
    energy, (push, spin) = kinetic_energy(tree, links, start), momenta(tree, links, start)
    lost = []
    for dt in (4e-3, 2e-3):
        end = free(tree, links, start, dt, round(0.2 / dt))
        after, (push_after, spin_after) = kinetic_energy(tree, links, end), momenta(tree, links, end)
        lost.append([(after / energy - 1.0).abs().max(), (push_after - push).norm(), (spin_after - spin).norm()])
    for coarse, fine in zip(*lost, strict=True):
        assert fine < 1e-6
        assert fine < coarse / 14.0 or coarse < 1e-12


def test_a_pendulum_swings_in_its_period() -> None:
    """From 2 rad back to it after ``4 sqrt(l / g) K(sin 1)``, K the complete elliptic integral; RK4 at T / 200: 1e-5."""
    tree, links = pendulum(0.7, 0.3)
    period = 4.0 * sqrt(0.7 / G) * float(ellipk(sin(1.0) ** 2))
    end = free(tree, links, pendulum_state(2.0), period / 200, 200, gravity=G)
    torch.testing.assert_close(end.joint_pos, row(2.0), rtol=0.0, atol=1e-5)
    torch.testing.assert_close(end.joint_vel, row(0.0), rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("dt", [2e-3, 4e-3, 1e-2])
def test_a_stiff_damper_is_stable_at_any_step_and_exact_at_rest(dt: float) -> None:
    """Damping over inertia of 230 1/s: an arm let go a quarter of a radian off comes to rest where spring and weight balance,
    without a swing; effort held through the step would diverge at 10 ms."""
    length, mass = 0.07, 0.01625
    tree, links = pendulum(length, mass)
    inertia = mass * length**2
    spring = Spring(
        stiffness=row(4000.0 * inertia), quadratic=row(5834.0 * inertia), damping=row(230.0 * inertia), rest=row(0.1),
        preload=row(0.0),
    )  # fmt: skip
    state, before = pendulum_state(0.35), 0.35
    for _ in range(round(1.0 / dt)):
        state = implicit_euler(tree, links, (spring,), state, dt, gravity=G)
        assert state.joint_pos.item() <= before + 1e-12  # creeps down, never up
        before = state.joint_pos.item()
    away = before - 0.1
    left = -(4000.0 + 5834.0 * abs(away)) * away - G / length * sin(before)
    assert abs(left) < 1e-4  # [1/s²]; 1400 at the start, and the slow mode fades with 19 1/s
    assert abs(state.joint_vel.item()) < 1e-6


def test_a_spring_that_is_stiffer_than_a_step_resolves_comes_to_rest() -> None:
    """50 rad in a step, no damper: implicit Euler shrinks the swing by ``1 + (w dt)²`` in square, to rest within rounding."""
    tree, links = pendulum(1.0, 1.0)
    spring = Spring(stiffness=row(5000.0**2), quadratic=row(0.0), damping=row(0.0), rest=row(0.0), preload=row(0.0))
    state = pendulum_state(0.2)
    for _ in range(8):
        state = implicit_euler(tree, links, (spring,), state, 0.01, gravity=0.0)
    assert abs(state.joint_pos.item()) < 0.2 * 50.0**-7


def test_implicit_steps_are_of_order_one() -> None:
    """A damped spring without weight, ``exp(-z w t) (cos + ...)``: the error of 0.5 s halves with the step."""
    tree, links = pendulum(1.0, 1.0)
    natural, share = 6.0, 0.3
    damped = natural * sqrt(1.0 - share**2)
    spring = Spring(
        stiffness=row(natural**2), quadratic=row(0.0), damping=row(2.0 * share * natural), rest=row(0.0),
        preload=row(0.0),
    )  # fmt: skip
    exact = 0.2 * exp(-share * natural * 0.5) * (cos(damped * 0.5) + share * natural / damped * sin(damped * 0.5))
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        state = pendulum_state(0.2)
        for _ in range(round(0.5 / dt)):
            state = implicit_euler(tree, links, (spring,), state, dt, gravity=0.0)
        errors.append(abs(state.joint_pos.item() - exact))
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("side", [pytest.param(1.0, marks=pytest.mark.slow), -1.0])
def test_soft_ends_stop_a_joint_and_never_pull(side: float) -> None:
    """Flung at an end at 0.3 rad: it goes past it by no more than ``v / sqrt(k / I)``, comes back, and leaves freely."""
    tree, links = pendulum(0.5, 0.4)
    inertia, stiffness = 0.4 * 0.25, 500.0
    ends = JointLimits(low=row(-0.3), high=row(0.3), stiffness=row(stiffness), damping=row(1.0))
    state, most = pendulum_state(0.0, side * 2.0), 0.0
    for _ in range(500):
        state = implicit_euler(tree, links, (ends,), state, 1e-3, gravity=0.0)
        most = max(most, side * state.joint_pos.item())
    assert 0.3 < most < 0.3 + 2.0 / sqrt(stiffness / inertia)
    assert -2.0 < side * state.joint_vel.item() < 0.0
    sticky = ends.evaluate_effort(row(side * 0.31), row(-side * 100.0))
    assert sticky.value.item() == 0.0


def test_gradients_flow_through_steps() -> None:
    tree = random_tree(3, 2)
    links, state = random_links(tree, 1, 2), random_motion(tree, 1, 2)

    def end(angles: Tensor, mass: Tensor) -> Tensor:
        own = Links(mass=mass, com=links.com, inertia=links.inertia)
        now = TreeState(**{**vars(state), "joint_pos": angles})
        for _ in range(3):
            now = implicit_euler(tree, own, (), now, 0.01, gravity=G)
        return now.joint_vel

    inputs = (state.joint_pos.requires_grad_(), links.mass.requires_grad_())
    assert torch.autograd.gradcheck(end, inputs)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Joint(parent=0, axis=(1.0, 1.0, 0.0)), "axis has length 1.41421"),
        (lambda: Joint(parent=0, attitude=(0.0, 0.0, 0.0, 0.5)), "attitude has length 0.5"),
        (lambda: Joint(parent=0, kind="ball"), "choose revolute or prismatic"),
        (lambda: Joint(parent=0, position=(float("nan"), 0.0, 0.0)), "not finite"),
        (lambda: Tree(joints=(Joint(parent=1),)), "joint 0 is on link 1"),
    ],
)
def test_what_is_no_tree_is_refused(make, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make()


def test_a_joint_moves_what_hangs_on_it() -> None:
    """A fork: link 1 carries 2 and 3; each joint moves its own branch alone."""
    tree = Tree(joints=(Joint(parent=0), Joint(parent=1), Joint(parent=1)))
    assert tree.joint_moves_link == ((False,) * 3, (True, False, False), (True, True, False), (True, False, True))


def test_a_top_gains_what_the_method_gives() -> None:
    """A torque-free symmetric top turns its lateral rate by ``x = (Iz / Ix - 1) w_z dt`` a step. Half way rates make of it
    ``1 + x J + x² J² / 2``, whose norm is ``sqrt(1 + x⁴ / 4)``; rates at the start ``sqrt(1 + x²)``, 7.1 of a hundred steps
    of 0.2 in place of 1.02. A joint about the axis, whose drive asks for nothing, has no part in it."""
    tree = Tree(joints=(Joint(parent=0, axis=(0.0, 0.0, 1.0)),), floating=True)
    inertia = torch.diag(torch.tensor([0.01, 0.01, 0.018], dtype=F64)).expand(1, 2, 3, 3)
    links = Links(mass=torch.ones(1, 2, dtype=F64), com=torch.zeros(1, 2, 3, dtype=F64), inertia=inertia)
    none = torch.zeros(1, 1, dtype=F64)
    drive = Drive(stiffness=none, damping=none, position=none, rate=none, effort=none, limit=none + 1.0)
    state = replace(TreeState.at_rest(1, 1, like=none), ang_vel=torch.tensor([[3.0, 4.0, 125.0]], dtype=F64))
    for _ in range(100):
        state = implicit_euler(tree, links, (), state, 2e-3, gravity=0.0, drive=drive)
    assert state.ang_vel[0, :2].norm().item() == pytest.approx(5.0 * (1.0 + 0.2**4 / 4.0) ** 50, rel=1e-9)
    assert state.ang_vel[0, 2].item() == pytest.approx(125.0, rel=1e-12)


def test_a_top_whose_wheel_is_driven_at_its_limit_turns_as_in_closed_form() -> None:
    """A drive at its limit T slows the body (C about z) by ``w_z' = -T / C``; body and wheel keep the momentum H about z.
    Lateral rates turn by ``integral w_z dt - H t / I`` with the inertia I across, which half way rates give to order 2. A
    drive without a limit would bring the wheel to its rate within a step: half way to that, the body turns 27 rad/s
    slower."""
    tree = Tree(joints=(Joint(parent=0, axis=(0.0, 0.0, 1.0)),), floating=True)
    across, body, wheel, limit, start = 0.02, 0.018, 1e-4, 0.3, 20.0
    inertia = torch.stack([torch.diag(torch.tensor((0.5 * across, 0.5 * across, z), dtype=F64)) for z in (body, wheel)])
    links = Links(mass=torch.ones(1, 2, dtype=F64), com=torch.zeros(1, 2, 3, dtype=F64), inertia=inertia.unsqueeze(0))
    none, span = torch.zeros(1, 1, dtype=F64), 0.1
    drive = Drive(stiffness=none, damping=none + 10.0, position=none, rate=none + 1e4, effort=none, limit=none + limit)
    angle = start * span - 0.5 * limit / body * span**2 - (body + wheel) * start / across * span
    expected = 5.0 * torch.tensor([[cos(angle), -sin(angle)]], dtype=F64)
    off = []
    for steps in (50, 100):
        state = replace(TreeState.at_rest(1, 1, like=none), ang_vel=torch.tensor([[5.0, 0.0, start]], dtype=F64))
        for _ in range(steps):
            state = implicit_euler(tree, links, (), state, span / steps, gravity=0.0, drive=drive)
        assert state.ang_vel[0, 2].item() == pytest.approx(start - limit / body * span, rel=1e-12)
        off.append((state.ang_vel[:, :2] - expected).norm().item())
    assert log2(off[0] / off[1]) == pytest.approx(2.0, abs=0.1)


def test_a_free_tree_keeps_energy_and_momentum_to_order_one_and_better_half_way() -> None:
    """Both rules of ``implicit_euler``: a drive asking for nothing has no part in the motion, but has rates taken half way."""
    tree = random_tree(4, 3)
    links, start = random_links(tree, 16, 5), random_motion(tree, 16, 5)
    none = torch.zeros(1, 4, dtype=F64)
    empty = Drive(stiffness=none, damping=none, position=none, rate=none, effort=none, limit=none + 1.0)

    def off(drive: Drive | None, dt: float) -> list[float]:
        state = start
        for _ in range(round(0.1 / dt)):
            state = implicit_euler(tree, links, (), state, dt, gravity=0.0, drive=drive)
        pairs = [(kinetic_energy(tree, links, at).unsqueeze(-1), *momenta(tree, links, at)) for at in (state, start)]
        return [
            ((a - b).norm(dim=-1) / b.norm(dim=-1)).square().mean().sqrt().item() for a, b in zip(*pairs, strict=True)
        ]

    at_start, state_with_middle_rates = ([off(drive, dt) for dt in (4e-3, 2e-3)] for drive in (None, empty))
    print(f"\nenergy, momentum, angular momentum off at 4 and 2 ms: {at_start}; half way {state_with_middle_rates}")
    for coarse, fine in (at_start, state_with_middle_rates):
        assert [log2(a / b) for a, b in zip(coarse, fine, strict=True)] == pytest.approx([1.0] * 3, abs=0.1)
    assert state_with_middle_rates[1][0] < 0.5 * at_start[1][0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "backend"), [("snakey_effort", "warp"), ("snakey_effort", "torch"), ("snakey6", "warp")]
)
def test_no_snake_is_lost_under_random_commands(name: str, backend: str) -> None:
    """Drives at their limits (of ``snakey6``) turn a snake no faster than bare efforts do; NaN is no less than any number."""
    turn, rates = fly(name, 2e-3, seconds=2.5, num_envs=64, backend=backend)
    assert turn.norm(dim=1).max() < 500.0
    assert rates.isfinite().all()
