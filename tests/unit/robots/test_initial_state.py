"""Initial states, uniform within their ranges, and derived states against the torch formulas in float64. Rows are written
plainly on a CPU; ``tests/integration/test_cuda.py`` does the same on a GPU. Letters: E environments."""

from dataclasses import dataclass, replace
from math import nan

import torch
from torch import Tensor

from aerial_gym.config.robot import InitialStateCfg
from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse, quat_without_tilt
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BodyState, state_at_rest
from aerial_gym.robots.finite_watch import NonFiniteRows
from aerial_gym.robots.initial_state import ActionStore, InitialState
from aerial_gym.robots.secondary_states import SecondaryStates

CFG = InitialStateCfg(
    position_ratio_low=(0.1, 0.2, 0.3), position_ratio_high=(0.9, 0.8, 0.3), euler_low=(-0.4, -0.3, -3.0),
    euler_high=(0.4, 0.3, 3.0), lin_vel_low=(-1.0, 0.0, 2.0), lin_vel_high=(1.0, 0.5, 3.0),
    ang_vel_low=(-0.1, -0.2, -0.3), ang_vel_high=(0.1, 0.2, 0.3),
)  # fmt: skip


@dataclass(frozen=True)
class InitialCase:
    initial: InitialState
    random: Randomness

    def reset(self, mask: Tensor) -> None:
        self.random.begin(mask)
        self.initial.reset(mask)


def make(num_envs: int, seed: int = 0, noticed: NonFiniteRows | None = None):
    random = Randomness(num_envs, seed=seed)
    state = state_at_rest(num_envs, 4, device=torch.device("cpu"), dtype=torch.float32)
    widths = {"ang_vel_world": 3, "lin_vel_body": 3, "vehicle_attitude": 4, "vehicle_lin_vel": 3, "euler": 3}
    widths |= {"root_state": 13}
    derived = {name: torch.full((num_envs, width), torch.nan) for name, width in widths.items()}
    bounds = tuple(torch.full((num_envs, 3), end) for end in (-2.0, 4.0))
    actions = {name: torch.ones(num_envs, 4) for name in ("actions", "prev_actions")}
    speed, rest = torch.tensor([1.0, 2.0, 3.0, 4.0]), {"random": random, "noticed": noticed}
    initial = InitialState(
        CFG, state, SecondaryStates(state, **derived), bounds=bounds, rest_speed=speed, **actions, **rest
    )
    return state, derived, InitialCase(initial, random)


def draws(num_envs: int = 20_000, seed: int = 0):
    state, derived, initial = make(num_envs, seed)
    initial.reset(torch.ones(num_envs, dtype=torch.bool))
    return state, derived


def test_every_quantity_is_uniform_in_its_range() -> None:
    """Mean and standard deviation of a uniform draw are (a + b)/2 and (b - a)/sqrt(12); 5 standard errors are allowed."""
    state, _ = draws()
    share = (state.position + 2.0) / 6.0
    for name, result in (
        ("position_ratio", share),
        ("euler", euler_from_quat(state.attitude)),
        ("lin_vel", state.lin_vel),
        ("ang_vel", state.ang_vel),
    ):
        low, high = torch.tensor(getattr(CFG, f"{name}_low")), torch.tensor(getattr(CFG, f"{name}_high"))
        width = high - low
        assert (result >= low - 1e-5).all(), name
        assert (result <= high + 1e-5).all(), name
        error = 5.0 * width / (12.0 * len(result)) ** 0.5 + 1e-6
        assert ((result.mean(0) - 0.5 * (low + high)).abs() <= error).all(), name
        assert ((result.std(0) - width / 12.0**0.5).abs() <= error).all(), name
    assert torch.equal(state.rotor_speed[7], torch.tensor([1.0, 2.0, 3.0, 4.0]))


def test_quantities_and_environments_are_independent() -> None:
    """Correlations of 13 - 1 numbers over 20,000 environments, and of neighbours, stay within 5 / sqrt(n)."""
    state, _ = draws()
    columns = torch.cat((state.position[:, :2], euler_from_quat(state.attitude), state.lin_vel, state.ang_vel), dim=1)
    shifted = torch.cat((columns, columns.roll(1, dims=0)), dim=1)
    correlation = torch.corrcoef(shifted.T) - torch.eye(shifted.shape[1])
    assert correlation.abs().max() < 5.0 / len(columns) ** 0.5


def test_what_follows_from_the_motion_is_written_with_it() -> None:
    state, derived = draws(256)
    for name, expected in reference(state).items():
        torch.testing.assert_close(derived[name].double(), expected, rtol=1e-5, atol=1e-5, msg=name)


def make_record(num_envs: int) -> NonFiniteRows:
    made = NonFiniteRows.placeholder(state_at_rest(num_envs, 4, device=torch.device("cpu"), dtype=torch.float32))
    marks = torch.arange(num_envs, dtype=torch.int32)
    return replace(made, bits=marks % 2, episode_step=7 + marks, flags=(marks >= 0, marks >= 0))


def test_a_reset_notices_what_ended_its_rows_and_clears_it_there_alone() -> None:
    marked = make_record(4)
    _, _, begun = make(4, noticed=marked)
    begun.reset(torch.tensor([True, True, False, False]))
    # One row: environment 1, the episode before the first, step 8.
    assert marked.record[:5].tolist() == [1, 1, -1, 8, 1]
    assert marked.bits.tolist() == [0, 0, 0, 1]
    assert marked.episode_step.tolist() == [0, 0, 9, 10]
    for flag in marked.flags:
        assert flag.tolist() == [False, False, True, True]


def test_a_step_begins_with_its_action_whatever_its_layout_and_keeps_the_earlier_one() -> None:
    marked, actions, before = make_record(3), torch.full((3, 2), 5.0), torch.zeros(3, 2)
    begin = ActionStore(actions, before, marked)
    numbers = torch.arange(6.0)
    last = actions.clone()
    views = (numbers.view(3, 2), numbers.view(2, 3).T, numbers[:2].expand(3, 2))
    for given in (*views, numbers.double().view(3, 2).requires_grad_(), actions, before):
        wanted = (last if given is before else given).detach().float().clone()
        begin.begin(given)
        assert torch.equal(before, last)
        assert torch.equal(actions, wanted)
        last = wanted
    assert marked.episode_step.tolist() == [13, 14, 15]
    assert not any(flag.any() for flag in marked.flags)
    assert marked.bits.tolist() == [0, 1, 0]


EPS = torch.finfo(torch.float32).eps


def motions(num_envs: int, device: str) -> BodyState:
    """Return motions; environment i has the same among any number of others. No nose stands within 0.2 rad of straight up."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.randn(70_000, 17, generator=generator)[:num_envs]
    q = rows[:, 3:7]
    steep = (2.0 * (q[:, 3] * q[:, 1] - q[:, 2] * q[:, 0]) / (q * q).sum(-1)).abs() > 0.98
    q = torch.where(steep.unsqueeze(-1), torch.tensor([0.0, 0.0, 0.6, 0.8]), q)
    q = q / q.norm(dim=-1, keepdim=True)
    parts = {"position": rows[:, :3], "attitude": q, "lin_vel": rows[:, 7:10], "ang_vel": rows[:, 10:13]}
    parts["rotor_speed"] = rows[:, 13:]
    return BodyState(**{name: part.contiguous().to(device) for name, part in parts.items()})


def reference(state: BodyState) -> dict[str, Tensor]:
    x, q, v, w = (t.double() for t in (state.position, state.attitude, state.lin_vel, state.ang_vel))
    turn, level = quat_rotate(q, w), quat_without_tilt(q)
    return {
        "ang_vel_world": turn, "lin_vel_body": quat_rotate_inverse(q, v), "vehicle_attitude": level,
        "vehicle_lin_vel": quat_rotate_inverse(level, v), "euler": euler_from_quat(q),
        "root_state": torch.cat((x, q, v, turn), dim=-1),
    }  # fmt: skip


def compute_states(state: BodyState, *, beside: int) -> dict[str, Tensor]:
    """Return the kernel's outputs in tensors filled with NaN; ``beside`` further rows of each root state must stay NaN."""
    rows, device = state.num_envs, state.position.device
    widths = {"ang_vel_world": 3, "lin_vel_body": 3, "vehicle_attitude": 4, "vehicle_lin_vel": 3, "euler": 3}
    out = {name: torch.full((rows, width), nan, device=device) for name, width in widths.items()}
    root = torch.full((rows, 1 + beside, 13), nan, device=device)
    SecondaryStates(state, **out, root_state=root[:, 0]).refresh()
    assert root[:, 1:].isnan().all()
    return {**out, "root_state": root[:, 0]}


def worst(result: Tensor, expected: Tensor) -> float:
    """Return the largest error of a row over the length of its velocity or angles, in units of float32's eps."""
    size = expected.norm(dim=-1, keepdim=True).clamp_min(1.0)
    return float(((result.double() - expected).abs() / size).max()) / EPS


def check_derived(num_envs: int, device: str) -> None:
    """Compare with float64: what is left is rounding, a few units of it; a number of another row would be millions."""
    state = motions(num_envs, device)
    for beside in (0, 2):
        results = compute_states(state, beside=beside)
        for name, expected in reference(state).items():
            assert worst(results[name], expected) < 16.0, (name, beside)


def test_derived_states_are_the_formulas() -> None:
    check_derived(33, "cpu")
