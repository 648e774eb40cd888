"""A sensor: a lidar whose single ring of rays goes up and down three times in a turn."""

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from aerial_gym.config.sensor import RangeSensorCfg


@dataclass(frozen=True, kw_only=True)
class WaveScanner(RangeSensorCfg):
    """A ring of rays with the elevation ``amplitude sin(waves azimuth)``."""

    model: str = "wave_scanner"
    amplitude: float  # Largest elevation [rad]
    waves: int = 3  # Periods in a turn

    def rays(self) -> Tensor:
        """Return the directions, x forward, y left, z up, (1, W, 3)."""
        azimuth = torch.arange(self.width, dtype=torch.float64) * (2.0 * pi / self.width)
        level = torch.stack((azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)), dim=-1)
        elevation = self.amplitude * torch.sin(self.waves * azimuth).unsqueeze(-1)
        up = torch.tensor((0.0, 0.0, 1.0), dtype=torch.float64)
        return (elevation.cos() * level + elevation.sin() * up).unsqueeze(0)


WAVE_SCANNER = WaveScanner(
    summary="ring of 72 rays that wave by 20 degrees",
    width=72,
    height=1,
    min_range=0.1,
    max_range=10.0,
    amplitude=0.35,
    source="an example",
)
