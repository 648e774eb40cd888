"""Ray tables: the pixel directions of every sensor model, and tiles of neighbouring rays that are traced together.

Computed in float64, given in float32. Frame: the sensor's own, x forward (optical axis), y left, z up.
Letters: H x W = N pixels, row 0 on top, column 0 at the left, T tiles, L rays of a tile.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, radians, sin, tan
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.sensor import CameraCfg, FisheyeCfg, LidarCfg, PrismCfg, RangeSensorCfg, RayTableCfg, RosetteCfg
from aerial_gym.errors import ConfigError

_LEAST_COSINE = 1e-3  # Least cosine to the axis of a depth sensor's rays (89.94 deg): depth divides by it, in float32

_HEADERS = (["x", "y", "z"], ["azimuth_deg", "elevation_deg"])


def ray_table(cfg: RangeSensorCfg, *, device: torch.device) -> Tensor:
    """Return the unit ray directions of a sensor, float32, (H, W, 3), of a rosette in its first frame."""
    if isinstance(cfg, CameraCfg):
        rays = pinhole_rays(cfg, device=device)
    elif isinstance(cfg, FisheyeCfg):
        rays = fisheye_rays(cfg, device=device)
    elif isinstance(cfg, LidarCfg):
        rays = lidar_rays(cfg, device=device)
    elif isinstance(cfg, RosetteCfg):
        return rosette_rays(cfg, device=device, frames=1)[0]
    elif isinstance(cfg, RayTableCfg):
        rays = custom_rays(cfg, device=device)
    elif (own := cfg.rays()) is not None:
        rays = _unit_float32(own, device)
        if tuple(rays.shape) != (cfg.height, cfg.width, 3) or not bool(rays.isfinite().all()):
            raise ConfigError(
                f"{type(cfg).__name__}.rays: {tuple(rays.shape)}: must be finite, (H, W, 3) = {(cfg.height, cfg.width, 3)}"
            )
    else:
        raise ConfigError(f"{type(cfg).__name__} has no ray table. Give them by its method rays, or take a RayTableCfg")
    least = float(rays[..., 0].min())
    if cfg.kind == "depth" and least < _LEAST_COSINE:
        raise ConfigError(
            f"{type(cfg).__name__}.kind = 'depth': some rays do not look ahead (least cosine {least:.3g}); take 'range'"
        )
    return rays


def pinhole_rays(cfg: CameraCfg, *, device: torch.device) -> Tensor:
    """Return unit directions through the pixel centres of a pinhole camera, float32, (H, W, 3).

    Pixel (row, col) has its centre at image coordinates ``(col + 1/2 - W/2, row + 1/2 - H/2)`` right of and below the
    principal point, in pixels; the focal length is ``W / (2 tan(hfov / 2))`` pixels.

    Source: Hartley and Zisserman (2004), Multiple View Geometry, eq. 6.1, with the principal point in the middle.
    """
    focal = 0.5 * cfg.width / tan(0.5 * radians(cfg.hfov_deg))
    right, down = _pixel_centres(cfg)
    return _unit_float32(torch.stack((torch.ones_like(right), -right / focal, -down / focal), dim=-1), device)


def fisheye_rays(cfg: FisheyeCfg, *, device: torch.device) -> Tensor:
    """Return unit directions through the pixel centres of an equidistant fisheye camera, float32, (H, W, 3).

    A pixel centre at the distance r from the principal point looks ``theta = r / f`` off the axis, towards that pixel; the
    focal length is ``W / hfov`` pixels per radian. ``sin(theta) / r`` is ``sinc(theta) / f``, which holds in the middle.

    Source: Kannala and Brandt (2006), A Generic Camera Model and Calibration Method, eq. 3 (equidistance projection).
    """
    focal = cfg.width / radians(cfg.hfov_deg)
    right, down = _pixel_centres(cfg)
    theta = torch.hypot(right, down) / focal
    beside = torch.sinc(theta / pi) / focal
    return _unit_float32(torch.stack((torch.cos(theta), -right * beside, -down * beside), dim=-1), device)


def lidar_rays(cfg: LidarCfg, *, device: torch.device) -> Tensor:
    """Return unit directions of a grid of azimuths and elevations, float32, (H, W, 3).

    Azimuth falls from left to right, elevation from top to bottom, each by equal steps unless the beams are listed. A full
    turn keeps half a step from both ends, an elevation interval half a step from an end at +-90 deg: no ray repeats. Cells
    keep half a step from all ends.

    Source: Derived: spherical coordinates, ``(cos el cos az, cos el sin az, sin el)``.
    """
    half_open = 0.5 if cfg.full_turn or cfg.cells else 0.0
    azimuth = _uniform_steps(cfg.azimuth_high_deg, cfg.azimuth_low_deg, cfg.width, half_open, half_open)
    if cfg.beam_elevations_deg is not None:
        elevation = torch.tensor(cfg.beam_elevations_deg, dtype=torch.float64)
    else:
        low, high = cfg.elevation_low_deg or 0.0, cfg.elevation_high_deg or 0.0
        open_high, open_low = 0.5 * (high == 90.0 or cfg.cells), 0.5 * (low == -90.0 or cfg.cells)
        elevation = _uniform_steps(high, low, cfg.height, open_high, open_low)
    rows, columns = torch.meshgrid(elevation, azimuth, indexing="ij")
    if cfg.beam_azimuths_deg is not None:
        columns = columns + torch.tensor(cfg.beam_azimuths_deg, dtype=torch.float64).unsqueeze(-1)
    return _unit_float32(_directions_from_angles(columns, rows), device)


def rosette_rays(cfg: RosetteCfg, *, device: torch.device, frames: int | None = None) -> Tensor:
    """Return the unit directions of the frames of a rosette, float32, (K, H, W, 3); K is ``frames``, or all of them."""
    count = cfg.frames if frames is None else frames
    if cfg.path is not None:
        listed = read_ray_directions(cfg.path)
        if len(listed) < cfg.frames * cfg.width * cfg.height:
            raise ConfigError(
                f"{cfg.path} has {len(listed)} rays, expected at least frames * width * height = "
                f"{cfg.frames * cfg.width * cfg.height}"
            )
        rays = listed[: count * cfg.width * cfg.height].view(count, cfg.width, cfg.height, 3).transpose(1, 2)
        return _unit_float32(rays, device)
    time = (torch.arange(count * cfg.width, dtype=torch.float64) + 1.0) * cfg.column_duration_s
    azimuth, elevation = torch.tensor(cfg.lasers_deg, dtype=torch.float64).unbind(-1)
    lasers = _directions_from_angles(azimuth, elevation)
    rows = [through_prisms(cfg.prisms, time, laser) for laser in lasers]
    return _unit_float32(torch.stack(rows).view(cfg.height, count, cfg.width, 3).transpose(0, 1), device)


def through_prisms(prisms: Sequence[PrismCfg], time: Tensor, beam: Tensor) -> Tensor:
    """Return the direction of a beam behind turning prisms, unit, float64, (T, 3).

    At time 0 the thick ends of all wedges with an inclined entry point along +y, those with an inclined exit along -y.

    Args:
        time: When [s], float64, (T,).
        beam: Direction before the prisms, unit, (3,).

    Source:
        Li, Liu, Sun (2017), Forward and inverse solutions for three-element Risley prism beam scanners, Optics Express 25:
        Snell's law in vector form at every face.
    """
    ray = beam.expand(len(time), 3)
    flat = torch.tensor([-1.0, 0.0, 0.0], dtype=torch.float64).expand(len(time), 3)
    for prism in prisms:
        wedge, turn = radians(prism.wedge_deg), 2.0 * pi * prism.turns_hz * time
        across = sin(wedge) * (1.0 if prism.inclined_face == "entry" else -1.0)
        level = torch.full_like(turn, -cos(wedge))
        inclined = torch.stack((level, across * torch.cos(turn), across * torch.sin(turn)), dim=-1)
        faces = (inclined, flat) if prism.inclined_face == "entry" else (flat, inclined)
        ray = _refract(ray, faces[0], 1.0 / prism.refractive_index)
        ray = _refract(ray, faces[1], prism.refractive_index)
    if not bool(ray.isfinite().all()):
        raise ConfigError("RosetteCfg.prisms: a beam is reflected inside a prism. Make a wedge_deg smaller")
    return ray


def _refract(ray: Tensor, normal: Tensor, ratio: float) -> Tensor:
    """Return rays (T, 3) refracted at a face with a normal against them (T, 3); ``ratio`` is the index before over behind.

    NaN where the ray is reflected.
    """
    cosine = -(ray * normal).sum(-1, keepdim=True)
    behind = (1.0 - ratio**2 * (1.0 - cosine.square())).sqrt()
    return ratio * ray + (ratio * cosine - behind) * normal


def custom_rays(cfg: RayTableCfg, *, device: torch.device) -> Tensor:
    """Return the listed directions, made unit length, float32, (H, W, 3); raise ``ConfigError`` if a file does not fit."""
    rays = torch.tensor(cfg.rays, dtype=torch.float64) if cfg.path is None else read_ray_directions(cfg.path)
    if len(rays) != cfg.height * cfg.width:
        raise ConfigError(f"{cfg.path} has {len(rays)} rays, expected height * width = {cfg.height * cfg.width}")
    rays = rays / rays.abs().amax(dim=-1, keepdim=True)  # squares of very long or short ones would overflow
    return _unit_float32(rays.view(cfg.height, cfg.width, 3), device)


def read_ray_directions(path: str | Path) -> Tensor:
    """Return the directions in a CSV file, float64, (N, 3), not normalised; the header is one of ``_HEADERS``."""
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            header, *lines = [[cell.strip() for cell in line] for line in csv.reader(file)] or [[]]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    if header not in _HEADERS:
        raise ConfigError(f"{path}: header {','.join(header)!r}: must be x,y,z or azimuth_deg,elevation_deg")
    if not lines:
        raise ConfigError(f"{path}: has no rays")
    numbers = torch.tensor(
        [_ray_numbers(line, len(header), f"{path}: line {i}") for i, line in enumerate(lines, start=2)],
        dtype=torch.float64,
    )
    return numbers if len(header) == 3 else _directions_from_angles(numbers[:, 0], numbers[:, 1])


def _ray_numbers(cells: list[str], count: int, where: str) -> list[float]:
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) < float("inf") for value in values):
        raise ConfigError(f"{where} = {','.join(cells)!r}: must be {count} finite numbers")
    if count == 3 and not any(values):
        raise ConfigError(f"{where} = {','.join(cells)!r}: must not be zero")
    if count == 2 and abs(values[1]) > 90.0:
        raise ConfigError(f"{where} = {','.join(cells)!r}: elevation must lie within +-90 degrees")
    return values


def _pixel_centres(cfg: RangeSensorCfg) -> tuple[Tensor, Tensor]:
    """Return the pixel centres' offsets to the right and down from the image centre [pixels], (H, W) each."""
    right = torch.arange(cfg.width, dtype=torch.float64) + 0.5 - 0.5 * cfg.width
    down = torch.arange(cfg.height, dtype=torch.float64) + 0.5 - 0.5 * cfg.height
    below, beside = torch.meshgrid(down, right, indexing="ij")
    return beside, below


def _uniform_steps(first: float, last: float, count: int, open_first: float, open_last: float) -> Tensor:
    """Return equally spaced numbers that keep the given parts of a step from both ends; one number is in the middle."""
    if count == 1:
        return torch.tensor([0.5 * (first + last)], dtype=torch.float64)
    step = (last - first) / (count - 1 + open_first + open_last)
    return first + step * (torch.arange(count, dtype=torch.float64) + open_first)


def _directions_from_angles(azimuth_deg: Tensor, elevation_deg: Tensor) -> Tensor:
    """Return unit directions of azimuth and elevation [deg], (..., 3)."""
    azimuth, elevation = torch.deg2rad(azimuth_deg), torch.deg2rad(elevation_deg)
    level = torch.cos(elevation)
    return torch.stack((level * torch.cos(azimuth), level * torch.sin(azimuth), torch.sin(elevation)), dim=-1)


def _unit_float32(rays: Tensor, device: torch.device) -> Tensor:
    return (rays / rays.norm(dim=-1, keepdim=True)).to(device=device, dtype=torch.float32)


_MARGIN = 1e-5  # Bounds of a tile are wider by this, so that rounding (6e-8) never rejects a hit


@dataclass(frozen=True, kw_only=True)
class Tiles:
    """A ray table in tile order; incomplete tiles are filled with copies of one ray."""

    direction: Tensor  # Unit directions, (T * L, 3)
    pixel: Tensor  # Pixel index of a ray, -1 for a copy, int32, (T * L,), in every frame
    middle: Tensor  # Middle of the directions of a tile, (T, 3)
    spread: Tensor  # Half of their spread on each axis, (T, 3)

    @property
    def num_tiles(self) -> int:
        """Number of tiles T."""
        return self.middle.shape[0]


def make_tiles(direction: Tensor, *, height: int, width: int) -> Tiles:
    """Return the tiles, ``height`` x ``width`` pixels each, of a ray table (H, W, 3)."""
    rows, columns = direction.shape[:2]
    down, across = -(-rows // height), -(-columns // width)
    index = torch.arange(rows * columns, device=direction.device).view(rows, columns)
    y = torch.arange(down * height, device=direction.device)
    x = torch.arange(across * width, device=direction.device)
    inside = (y < rows)[:, None] & (x < columns)
    nearest = index[y.clamp(max=rows - 1)[:, None], x.clamp(max=columns - 1)]

    def by_tile(image: Tensor) -> Tensor:
        return image.view(down, height, across, width).transpose(1, 2).reshape(down * across, height * width)

    source, real = by_tile(nearest), by_tile(inside)
    rays = direction.reshape(-1, 3)[source]
    low, high = rays.amin(dim=1), rays.amax(dim=1)
    return Tiles(
        direction=rays.reshape(-1, 3).contiguous(),
        pixel=torch.where(real, source, -1).reshape(-1).int().contiguous(),
        middle=0.5 * (low + high),
        spread=0.5 * (high - low) * (1.0 + _MARGIN) + _MARGIN,
    )


def stack_tiles(frames: Sequence[Tiles]) -> Tiles:
    """Return the concatenated tiles of several frames, with the pixels of the first."""
    parts = {name: torch.cat([getattr(tiles, name) for tiles in frames]) for name in ("direction", "middle", "spread")}
    return Tiles(pixel=frames[0].pixel, **parts)
