"""Induced flow of one rotor in Warp against torch in float64, in every state of its descent."""

import pytest
import torch
import warp as wp

from aerial_gym.interop import start_warp
from aerial_gym.physics.effects.induced_flow import WINDMILL, axial_induced, axial_induced_warp, induced, induced_warp


@wp.kernel(enable_backward=False)
def _axial(climb: wp.array[float], inverse_out: wp.array[float], slope_out: wp.array[float]):
    i = wp.tid()
    inverse, slope = axial_induced_warp(climb[i])
    inverse_out[i] = inverse
    slope_out[i] = slope


@wp.kernel(enable_backward=False)
def _induced(
    hover: wp.array[float],
    climb: wp.array[float],
    edgewise: wp.array[float],
    value_out: wp.array[float],
    slope_out: wp.array[float],
):
    i = wp.tid()
    value, slope = induced_warp(hover[i], climb[i], edgewise[i])
    value_out[i] = value
    slope_out[i] = slope


def run(kernel: wp.Kernel, *given: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    start_warp()
    result = (torch.full_like(given[0], torch.nan), torch.full_like(given[0], torch.nan))
    arrays = [[wp.from_torch(each) for each in part] for part in (given, result)]
    wp.launch(kernel, dim=len(given[0]), inputs=arrays[0], outputs=arrays[1], device="cpu")
    return result


STATES = {"climb": (0.0, 4.0), "vortex ring": (WINDMILL + 1e-3, -1e-3), "windmill brake": (-8.0, WINDMILL - 1e-3)}


@pytest.mark.parametrize("state", STATES)
def test_along_the_axis(state: str) -> None:
    """Round-off: the largest value there is 2.1 of four terms of up to 8; slopes are compared with the largest, 2.5."""
    x = torch.linspace(*STATES[state], 301)
    value, slope = axial_induced(x.double())
    inverse, relative = run(_axial, x)
    torch.testing.assert_close(inverse.double(), 1.0 / value, atol=2e-6, rtol=2e-6)
    torch.testing.assert_close(relative.double(), slope / value, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("state", STATES)
def test_in_sideways_flow(state: str) -> None:
    """Climb per hover is drawn from the state; slopes change fast where the windmill brake state begins, hence the bound."""
    g = torch.Generator().manual_seed(1)
    low, high = STATES[state]
    hover, mu = 0.02 + 0.1 * torch.rand(400, generator=g), torch.rand(400, generator=g) ** 3
    climb = (low + (high - low) * torch.rand(400, generator=g)) * hover
    result = run(_induced, hover, climb, mu)
    for single, truth in zip(result, induced(*(each.double() for each in (hover, climb, mu))), strict=True):
        torch.testing.assert_close(single.double(), truth, atol=1e-6, rtol=2e-4)
