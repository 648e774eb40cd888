"""Sample times of sensors, and delay lines for images with latency.

Letters: E environments.
"""

import torch
from torch import Tensor

from aerial_gym.sensors.images import SensorImages

CLOCK_MARGIN = 1e-4
"""Share of a period by which a measurement may come early: steps do not add up to a period exactly in float32."""


def latency_steps(latency_s: float, dt: float) -> int:
    """Return a latency in steps of ``dt`` [s], rounded to a whole number."""
    return round(latency_s / dt)


class DelayLine:
    """Keeps the last images of a sensor and gives out the oldest; an environment starts with its first image at every age."""

    def __init__(self, fresh: SensorImages, out: SensorImages, steps: int) -> None:
        """Take the sensor's images, the delayed images, and the delay in steps, >= 1."""
        self._pairs: list[tuple[Tensor, Tensor, list[Tensor]]] = []
        for name, image in fresh.items():
            self._pairs.append((image, out[name], [torch.zeros_like(image) for _ in range(steps)]))
        like = fresh.distance
        self._started = torch.zeros(like.shape[0], dtype=torch.bool, device=like.device)

    def push(self, mask: Tensor | None = None) -> None:
        """Output the images of ``steps`` calls ago and store the present ones, without waiting.

        With a mask, bool (E,), the other environments stay as they are.
        """
        for fresh, out, kept in self._pairs:
            tail = [1] * (fresh.dim() - 1)
            started, rows = self._started.view(-1, *tail), None if mask is None else mask.view(-1, *tail)

            def write(target: Tensor, image: Tensor, rows: Tensor | None = rows) -> None:
                target.copy_(image if rows is None else torch.where(rows, image, target))

            write(out, torch.where(started, kept[-1], fresh))
            for older, newer in zip(reversed(kept[1:]), reversed(kept[:-1]), strict=True):
                write(older, torch.where(started, newer, fresh))
            write(kept[0], fresh)
        if mask is None:
            self._started.fill_(True)
        else:
            self._started.logical_or_(mask)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        kept = {f"{i}.{age}": image for i, (_, _, ages) in enumerate(self._pairs) for age, image in enumerate(ages)}
        return {"started": self._started, **kept}

    def reset(self, mask: Tensor) -> None:
        """Forget the images of the environments in ``mask``, bool (E,)."""
        self._started.logical_and_(~mask)


def make_zeros_like(images: SensorImages) -> SensorImages:
    """Return images of the same shapes."""
    return SensorImages(**{name: torch.zeros_like(image) for name, image in images.items()})
