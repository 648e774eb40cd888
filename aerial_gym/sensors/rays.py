"""Ray tables: the directions in which the pixels of a sensor look.

Frame: the sensor's own, x forward (optical axis), y left, z up. Letters: H x W pixels, row 0 on top.
"""

from math import radians, tan

import torch
from torch import Tensor

from aerial_gym.config.sensor import CameraCfg


def pinhole_rays(cfg: CameraCfg, *, device: torch.device) -> Tensor:
    """Return unit directions through the pixel centres, float32, (H, W, 3).

    Pixel (row, col) has its centre at image coordinates ``(col + 1/2 - W/2, row + 1/2 - H/2)`` right of and below the
    principal point, in pixels; the focal length is ``W / (2 tan(hfov / 2))`` pixels. Computed in float64.

    Source: Hartley and Zisserman (2004), Multiple View Geometry, eq. 6.1, with the principal point in the middle.
    """
    focal = 0.5 * cfg.width / tan(0.5 * radians(cfg.hfov_deg))
    right = (torch.arange(cfg.width, dtype=torch.float64) + 0.5 - 0.5 * cfg.width) / focal
    down = (torch.arange(cfg.height, dtype=torch.float64) + 0.5 - 0.5 * cfg.height) / focal
    below, beside = torch.meshgrid(down, right, indexing="ij")
    rays = torch.stack((torch.ones_like(beside), -beside, -below), dim=-1)
    return (rays / rays.norm(dim=-1, keepdim=True)).to(device=device, dtype=torch.float32)
