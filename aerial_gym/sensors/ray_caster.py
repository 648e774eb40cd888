# pyright: reportArgumentType=false, reportAssignmentType=false, reportAttributeAccessIssue=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false, reportOptionalMemberAccess=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""The ray caster: one kernel writes distances and segmentation of a sensor in every environment.

A sensor is a table of ray directions and a mount, so that any camera or lidar model runs through the same kernel. Mounts
and directions are buffers that may be written between calls, also after a CUDA graph was captured. Neighbouring threads
are neighbouring pixels of a row, in the order of memory.

Frames: body is x forward, y left, z up; a sensor looks along its own x. World is the environment's own, z up.
Letters: E environments, A instances, S sensors of one kind, H x W = N pixels (row 0 on top).
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.geometry import ray_distance
from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, SceneArrays
from aerial_gym.assets.views import check_tensor, vector_view
from aerial_gym.config.sensor import CameraCfg
from aerial_gym.errors import ShapeError
from aerial_gym.interop import on_torch_stream
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.sensors.rays import pinhole_rays

MISS_ID = wp.constant(-2)
"""Segmentation of a pixel that sees nothing within its range. Source: parity with Aerial Gym (3.4)."""


@wp.struct
class Limits:
    """What becomes of a distance."""

    min_range: wp.float32  # [m]
    max_range: wp.float32  # [m]
    projected: wp.bool  # distances along the sensor's x axis instead of along the ray
    divisor: wp.float32  # of distances within the limits: max_range or 1
    near_pixel: wp.float32  # written for a hit closer than min_range
    far_pixel: wp.float32  # written for a miss


@wp.kernel(enable_backward=False)
def _cast_rays(
    # scene
    scene: SceneArrays,
    # state
    body_position: wp.array[wp.vec3],  # (E,) world [m]
    body_attitude: wp.array[wp.quat],  # (E,) body to world, xyzw
    # sensor
    mount_position: wp.array2d[wp.vec3],  # (E, S) body frame [m]
    mount_attitude: wp.array2d[wp.quat],  # (E, S) sensor to body, xyzw
    direction: wp.array[wp.vec3],  # (N,) sensor frame, unit
    limits: Limits,
    segments: wp.bool,  # whether segmentation_out is written
    # out
    distance_out: wp.array3d[float],  # (E, S, N) [m] or divided
    segmentation_out: wp.array3d[wp.int32],  # (E, S, N)
):
    """Write the distance to the first surface and its id, or ``far_pixel`` and ``MISS_ID`` for a miss.

    The bounding sphere of an instance is rejected by the distance of its centre from the ray, taken as a vector, which does
    not cancel for small instances far away.
    """
    mount, pixel = wp.tid()
    env = mount // mount_position.shape[1]
    sensor = mount - env * mount_position.shape[1]
    attitude = body_attitude[env]
    origin = body_position[env] + wp.quat_rotate(attitude, mount_position[env, sensor])
    ray = direction[pixel]
    heading = wp.quat_rotate(attitude * mount_attitude[env, sensor], ray)
    distance_per_range = wp.where(limits.projected, ray[0], 1.0)
    limit = limits.max_range / distance_per_range

    nearest = float(limit)
    hit = wp.int32(-1)
    for a in range(scene.position.shape[1]):
        position = scene.position[env, a]
        if position[2] > ABSENT_BELOW:
            radius = scene.radius[env, a]
            offset = position - origin
            along = wp.dot(offset, heading)
            across = offset - along * heading
            reached = along + radius >= 0.0 and along - radius < nearest
            if reached and wp.dot(across, across) <= radius * radius:
                shape = scene.shapes[scene.shape_index[env, a]]
                pose = scene.attitude[env, a]
                local_origin = wp.quat_rotate_inv(pose, -offset)
                local_heading = wp.quat_rotate_inv(pose, heading)
                distance = ray_distance(shape, local_origin, local_heading, nearest)
                if distance < nearest:
                    nearest = distance
                    hit = a

    measured = wp.min(nearest * distance_per_range, limits.max_range)
    value = wp.where(measured < limits.min_range, limits.near_pixel, measured / limits.divisor)
    distance_out[env, sensor, pixel] = wp.where(hit >= 0, value, limits.far_pixel)
    if segments:
        seen = wp.int32(MISS_ID)
        if hit >= 0:
            seen = scene.semantic_id[env, hit]
        segmentation_out[env, sensor, pixel] = seen


class RayCaster:
    """A camera in every environment, with all views made at construction."""

    def __init__(
        self,
        cfg: CameraCfg,
        scene: Scene,
        *,
        position: Tensor,
        attitude: Tensor,
        distance_out: Tensor,
        segmentation_out: Tensor | None = None,
    ) -> None:
        """Take views of the tensors, which must stay where they are, and load the kernel.

        Args:
            cfg: The camera.
            scene: What it sees.
            position: Body origin [m], world, (E, 3); may be strided, but for the last axis.
            attitude: Body to world, xyzw, unit, (E, 4); likewise.
            distance_out: Receives distances [m], or shares of max_range if the camera normalises, float32, (E, S, H, W).
            segmentation_out: Receives semantic ids, -2 for a miss, int32, (E, S, H, W); given if and only if the camera
                segments.

        Raises:
            ShapeError: If a tensor does not fit camera and scene.
        """
        envs, device = scene.num_envs, scene.device
        self.num_sensors = distance_out.shape[1] if distance_out.dim() == 4 else 1
        image = (envs, self.num_sensors, cfg.height, cfg.width)
        _check_image("distance_out", distance_out, image, device=device, dtype=torch.float32)
        if (segmentation_out is not None) != cfg.segmentation:
            raise ShapeError(f"segmentation_out must be given exactly if the camera segments: it is {cfg.segmentation}")
        if segmentation_out is not None:
            _check_image("segmentation_out", segmentation_out, image, device=device, dtype=torch.int32)
        self.cfg, self._out = cfg, distance_out
        self.direction = pinhole_rays(cfg, device=device)
        mounts, pixels = image[:2], cfg.height * cfg.width
        self._nominal_position = torch.tensor(cfg.position, device=device)
        self._nominal_attitude = quat_from_euler(torch.tensor(cfg.euler, device=device))
        self.mount_position = self._nominal_position.expand(*mounts, 3).clone()
        self.mount_attitude = self._nominal_attitude.expand(*mounts, 4).clone()
        nothing = wp.empty((0, 0, 0), dtype=wp.int32, device=wp.device_from_torch(device))
        self._inputs = [
            scene.arrays,
            vector_view("position", position, (envs, 3), device=device),
            vector_view("attitude", attitude, (envs, 4), device=device),
            vector_view("mount_position", self.mount_position, (*mounts, 3), device=device),
            vector_view("mount_attitude", self.mount_attitude, (*mounts, 4), device=device),
            vector_view("direction", self.direction.view(-1, 3), (pixels, 3), device=device),
            _limits(cfg),
            cfg.segmentation,
        ]
        self._outputs = [
            wp.from_torch(distance_out.view(*mounts, pixels)),
            wp.from_torch(segmentation_out.view(*mounts, pixels)) if segmentation_out is not None else nothing,
        ]
        self._command = wp.launch(
            _cast_rays,
            dim=(envs * self.num_sensors, pixels),
            inputs=self._inputs,
            outputs=self._outputs,
            device=wp.device_from_torch(device),
            record_cmd=True,
        )

    def cast(self) -> None:
        """Write every pixel from the present poses; launched on torch's current stream, not waited for."""
        with on_torch_stream(self._out):
            self._command.launch()

    def reset(self, mask: Tensor) -> None:
        """Put the mounts of masked environments, bool (E,), back to where the configuration has them."""
        rows = mask[:, None, None]
        self.mount_position.copy_(torch.where(rows, self._nominal_position, self.mount_position))
        self.mount_attitude.copy_(torch.where(rows, self._nominal_attitude, self.mount_attitude))


def _limits(cfg: CameraCfg) -> Limits:
    limits = Limits()
    limits.min_range, limits.max_range = cfg.min_range, cfg.max_range
    limits.projected = cfg.kind == "depth"
    limits.divisor = cfg.max_range if cfg.normalize else 1.0
    limits.near_pixel, limits.far_pixel = cfg.near_pixel, cfg.far_pixel
    return limits


def _check_image(name: str, image: Tensor, shape: tuple[int, ...], *, device: torch.device, dtype: torch.dtype) -> None:
    check_tensor(name, image, shape, device=device, dtype=dtype)
    if not image.is_contiguous():
        raise ShapeError(f"{name} has stride {image.stride()}: images must be contiguous")
