"""Fast turns of vehicles with drives: what turning takes is that of the rates half way through a step."""

from dataclasses import replace
from math import cos, log2, sin

import pytest
import torch

from aerial_gym.physics.articulated.dynamics import kinetic_energy, momenta
from aerial_gym.physics.articulated.joint_laws import Drive
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from benchmarks.joints.random_commands import fly
from tests.physics.articulated.trees import F64, random_links, random_motion, random_tree


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

    at_start, half_way = ([off(drive, dt) for dt in (4e-3, 2e-3)] for drive in (None, empty))
    print(f"\nenergy, momentum, angular momentum off at 4 and 2 ms: {at_start}; half way {half_way}")
    for coarse, fine in (at_start, half_way):
        assert [log2(a / b) for a, b in zip(coarse, fine, strict=True)] == pytest.approx([1.0] * 3, abs=0.1)
    assert half_way[1][0] < 0.5 * at_start[1][0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "backend"), [("snakey_effort", "warp"), ("snakey_effort", "torch"), ("snakey6", "warp")]
)
def test_no_snake_is_lost_under_random_commands(name: str, backend: str) -> None:
    """Drives at their limits (of ``snakey6``) turn a snake no faster than bare efforts do; NaN is no less than any number."""
    turn, rates = fly(name, 2e-3, seconds=2.5, num_envs=64, backend=backend)
    assert turn.norm(dim=1).max() < 500.0
    assert rates.isfinite().all()
