"""Derived states against the torch formulas in float64. On a CPU rows are written plainly;
``tests/integration/test_cuda.py`` does the same on a GPU. Letters: E environments."""

from math import nan

import torch
from torch import Tensor

from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse, quat_yaw
from aerial_gym.physics import BodyState
from aerial_gym.robots.secondary_states import SecondaryStates

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
    turn, level = quat_rotate(q, w), quat_yaw(q)
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
