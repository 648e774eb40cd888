"""The nearest distance in each cell of an image, against a loop over cells."""

from math import inf

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.sensors.cells import NearestInCells

DEVICES = ["cpu", *(["cuda:0"] if torch.cuda.is_available() else [])]


def reference(image: Tensor, cells: tuple[int, int], *, largest: float, empty: float) -> np.ndarray:
    """Return the nearest distance in each cell as a share of ``largest``, (E, R, C), by a loop over cells."""
    pixels = image[:, 0].cpu().numpy()
    size = [-(-n // parts) for n, parts in zip(pixels.shape[1:], cells, strict=True)]
    result = np.full((len(pixels), *cells), empty, dtype=np.float32)
    for env, row, column in np.ndindex(*result.shape):
        cell = pixels[env, row * size[0] : (row + 1) * size[0], column * size[1] : (column + 1) * size[1]]
        held = cell[cell >= 0.0]
        if held.size and held.min() < inf:
            result[env, row, column] = held.min() / np.float32(largest)
    return result


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(("height", "width"), [(135, 240), (8, 8), (5, 70), (64, 7), (20, 520), (24, 40)])
def test_cells_hold_the_smallest_distance_of_their_pixels(device: str, height: int, width: int) -> None:
    image = 0.2 + 9.8 * torch.rand(3, 2, height, width, generator=torch.Generator().manual_seed(0))
    image[:, :, ::5, ::3] = -1.0
    image[1, 0, height // 2 :, width // 2 :] = -1.0  # whole cells
    image[2, 0, : height // 2] = inf
    image = image.to(device)
    kept = NearestInCells(image, cells=(8, 8), largest=10.0, empty=0.25)
    kept.nearest.fill_(float("nan"))
    kept.measure()
    expected = reference(image, (8, 8), largest=10.0, empty=0.25)
    assert np.array_equal(kept.nearest.cpu().numpy().reshape(3, 8, 8), expected)
    assert (expected == 0.25).any()
    image.fill_(5.0)  # the next image is seen at once
    kept.measure()
    assert kept.nearest[0, 0].item() == 0.5


def test_what_is_no_image_is_refused() -> None:
    with pytest.raises(ShapeError, match=r"image is \(2, 0, 0, 0\) torch.float32, expected \(E, S, H, W\)"):
        NearestInCells(torch.zeros(2, 0, 0, 0), cells=(8, 8), largest=1.0, empty=1.0)
