"""Drives with limits and dry friction within a step: efforts stay within limits, and follow their laws at the end of it.
Dry friction in joints, on both backends: a swing that comes to rest, and a weight that is held or not.
"""

from dataclasses import replace
from itertools import pairwise, product
from math import log2

import pytest
import torch

from aerial_gym.config.joint import SpringCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.physics.articulated import steppers
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.joint_laws import STICK_RATE, Drive, Effort, EffortLimits
from aerial_gym.physics.articulated.steppers import step_within_limits
from aerial_gym.physics.articulated.tree import TreeState
from tests.builders import simulation
from tests.physics.articulated.effort_rig import (
    DT,
    StepRecorder,
    fly,
    no_efforts,
    random_bent,
    random_snakes,
    residuals,
    step,
    worst_residuals,
)
from tests.physics.articulated.trees import F64
from tests.physics.test_links_seen import DOWN, LEFT, arm, bending
from tests.repetitions import frequent_values

LIMIT = 1e-5
"""Share of its limit by which an effort may be off."""


@pytest.fixture
def step_recorder(monkeypatch: pytest.MonkeyPatch) -> StepRecorder:
    return StepRecorder(monkeypatch, steppers, "_implicit_step")


@pytest.mark.parametrize(
    ("name", "friction"),
    frequent_values(
        [
            (f"snakey{rods}{mode}", f)
            for rods in ("", "5", "6")
            for mode in ("", "_position", "_effort")
            for f in (0.0, 0.05)
        ],
        [("snakey_position", 0.05)],
    ),
)
def test_snakes_told_anything_keep_the_limits_of_their_drives(
    name: str, friction: float, step_recorder: StepRecorder
) -> None:
    """32 snakes, 0.1 s in steps of 2 ms: complementarity, limits and friction's power, in shares of a limit."""
    worst = worst_residuals(
        [random_snakes(name, friction=friction)], step_recorder, 50, lambda _: steppers.implicit_euler
    )
    print(f"\n{name}, friction {friction:g} N m: {worst}")
    assert worst.worst <= LIMIT


@pytest.mark.parametrize("count", frequent_values([10, 200], [10]))
def test_trees_keep_the_limits_of_drives_and_friction(count: int, step_recorder: StepRecorder) -> None:
    """Trees of 1 to 10 joints of both kinds, on a stand and free, with drives, friction or both in a joint."""
    worst = worst_residuals(
        [random_bent(seed) for seed in range(count)], step_recorder, 5, lambda _: steppers.implicit_euler
    )
    print(f"\n{count} trees: {worst}")
    assert worst.worst <= LIMIT


@pytest.mark.parametrize("rounds", [0, 1, 2])
def test_no_limit_is_exceeded_however_few_rounds_a_solution_has(rounds: int, step_recorder: StepRecorder) -> None:
    """Efforts of rows that are not solved are held within the limits, and friction along the motion is left out."""
    was_held = 0
    for bent in (random_snakes("snakey6", friction=0.05), *map(random_bent, range(1, 10, 2))):

        def stepper(tree, links, laws, state, dt, *, gravity, drive, friction, wrench, applied):
            def own(acts: Effort, swings: TreeState) -> TreeState:
                result = equations_of_motion(tree, links, swings, gravity=gravity, wrench=wrench)
                return steppers._implicit_step(tree, state, result, acts, dt)

            return step_within_limits(own, laws, drive, friction, state, dt, rounds=rounds, applied=applied)

        for _ in range(3):
            applied = no_efforts(bent)
            end = step(bent, stepper=stepper, applied=applied)
            now = residuals(bent, applied, step_recorder.effort(bent, end), end)
            was_held += now.law > LIMIT
            assert max(now.excess, now.power, now.change) <= LIMIT
            bent = replace(bent, state=end)
    assert was_held or rounds > 1


def test_two_drives_whose_limits_depend_on_each_other_are_solved_in_closed_form() -> None:
    """Rates of two joints that push each other: sets of limited drives that are tried in turn cycle here. With ``v = A e``
    for the efforts e and ``e = clamp(-k v + w)`` the answer is found by trying all nine sets."""
    generator = torch.Generator().manual_seed(0)
    count = 2000
    root = torch.randn(count, 2, 2, generator=generator, dtype=F64)
    matrix = root @ root.mT + 0.01 * torch.eye(2, dtype=F64)
    rate, gain, limit = (torch.randn(count, 2, generator=generator, dtype=F64) for _ in range(3))
    none, gain, limit = torch.zeros_like(rate), 10.0 * gain.abs(), limit.abs() + 0.01
    free = 3.0 * torch.randn(count, 2, generator=generator, dtype=F64)
    drive = Drive(stiffness=none, damping=gain, position=none, rate=rate, effort=none, limit=limit)
    start = TreeState.at_rest(count, 2, like=none)

    def own(acts: Effort, swings: TreeState) -> TreeState:
        eye = torch.eye(2, dtype=F64)
        pushed = free + (matrix @ acts.value.unsqueeze(-1)).squeeze(-1)
        return replace(start, joint_vel=torch.linalg.solve(eye + matrix * acts.damping.unsqueeze(1), pushed))

    def lawful(at: torch.Tensor) -> torch.Tensor:
        return (gain * (rate - at)).clamp(-limit, limit)

    end, cycled, at = step_within_limits(own, (), drive, None, start, DT), start.joint_vel, start.joint_vel
    residual = free + (matrix @ lawful(end.joint_vel).unsqueeze(-1)).squeeze(-1) - end.joint_vel
    assert residual.abs().max() < 1e-10
    ends = EffortLimits.at_end_of_step((drive,), none, DT)
    for _ in range(30):
        value, slope = (rows[:, 0] for rows in ends.tangent(ends.side(cycled)))
        at, cycled = cycled, own(Effort(value=value, stiffness=none, damping=slope), start).joint_vel
    assert not torch.allclose(at, cycled)


@pytest.mark.slow
def test_efforts_within_limits_converge_to_order_one() -> None:
    """Snakes with friction, against steps of 12.5 us: errors of rates halve with the step; the median counts."""
    start = random_snakes("snakey_position", num_envs=8, friction=0.02)
    span, off = 0.02, []
    exact = fly(start, round(span / 12.5e-6), dt=12.5e-6).state
    for dt in (1e-3, 5e-4, 2.5e-4):
        state = fly(start, round(span / dt), dt=dt).state
        error = torch.cat((state.ang_vel - exact.ang_vel, state.joint_pos - exact.joint_pos), dim=1)
        off.append(error.norm(dim=1).median().item())
    orders = [log2(a / b) for a, b in pairwise(off)]
    print(f"\noff at 1, 0.5 and 0.25 ms: {off}, orders {orders}")
    assert sum(orders) / len(orders) == pytest.approx(1.0, abs=0.15)


INERTIA = 1e-6 + 1e-3 * 0.05**2
"""Of the arm about its hinge [kg m²]: 1 g at 0.05 m."""

WEIGHT = 1e-3 * 9.81 * 0.05
"""Its moment about the hinge where it is level [N m]."""


def course(axis: tuple[float, float, float], friction: float, rate: float, *, backend: str, dt: float, time: float):
    spring = SpringCfg(friction=friction)
    manager = simulation(
        bending(arm(axis, 0.0, rate=rate, spring=spring)), sim=replace(SIMS.get("base_sim"), backend=backend, dt=dt),
        num_envs=1, seed=1,
    )  # fmt: skip
    manager.reset()
    result = []
    for _ in range(round(time / dt)):
        manager.step(torch.zeros(1, 4))
        result.append(torch.cat((manager.gtd["dof_position"][0], manager.gtd["dof_velocity"][0])))
    return torch.stack(result)


@pytest.mark.parametrize(
    ("rate", "backend"), frequent_values(product((1.0, -1.0), ("warp", "torch")), [(1.0, "torch"), (-1.0, "warp")])
)
def test_a_swing_slows_down_evenly_and_stays_where_it_stops(rate, backend) -> None:
    """By F / I: to rest after w I / F = 0.1 s and w² I / 2 F = 0.05 rad, to order 1; it never turns round."""
    off = []
    for dt in (0.004, 0.002):
        result = course(LEFT, 10.0 * INERTIA, rate, backend=backend, dt=dt, time=0.2)
        assert (result[:, 1] * rate > -1e-6).all()
        assert result[round(0.11 / dt) :, 1].abs().max() < STICK_RATE
        half = round(0.052 / dt)
        assert result[half - 1, 1].item() == pytest.approx(rate * (1.0 - 10.0 * half * dt), abs=6.0 * dt)
        off.append(abs(result[-1, 0].item()) - 0.05)
    assert abs(off[1]) < 0.6 * abs(off[0])
    assert abs(off[1]) < 2e-3


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_a_weight_is_held_by_more_friction_and_falls_from_less(backend) -> None:
    held = course(DOWN, 2.0 * WEIGHT, 0.0, backend=backend, dt=0.01, time=0.5)
    assert held[-1, 1].item() == pytest.approx(0.5 * STICK_RATE, rel=1e-3)
    assert 0.0 < held[-1, 0].item() < 0.5 * STICK_RATE
    falls = course(DOWN, 0.5 * WEIGHT, 0.0, backend=backend, dt=0.001, time=0.02)
    expected = 0.5 * 0.5 * WEIGHT / INERTIA * 0.02**2
    assert falls[-1, 0].item() == pytest.approx(expected, rel=0.08)
