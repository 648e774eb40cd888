"""Optical flow: the velocity of each pixel's visible point on the image plane [pixel/s].

A material point at p in the sensor's frame moves with dp/dt = a + b x p, where (a, b) is the twist of its instance relative
to the sensor, computed once per image. Its image moves with J dp/dt / |p|, J being the derivative of the projection at the
pixel's unit direction. A miss is a point at infinity, whose flow depends on the sensor's rotation alone.

Frames: a sensor looks along its own x, y left, z up; flow is right and down. World is the environment's own.
Letters: E environments, B vehicles of all of them, S sensors of one kind, M = B * S mounts, H x W = N pixels, A instances,
P parts, L links of all vehicles that are seen.
"""

from math import radians, tan

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene import Scene
from aerial_gym.assets.scene_arrays import BODY, WORLD, SceneArrays, vector_view
from aerial_gym.config.sensor import CameraCfg, FisheyeCfg, RangeSensorCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, make_struct
from aerial_gym.sensors.rays import ray_table
from aerial_gym.sensors.sensor_poses import SensorsOnCarrier, first_own_link, sensor_pose

LEAST_DISTANCE = wp.constant(1.0e-6)  # Lower limit of the distance [m], as flow diverges at the pupil


@wp.struct
class Flow:
    """Inputs of the flow kernel: pixel directions and relative twists."""

    right: wp.array[wp.vec3]  # (N,) derivative of the column by the point, at distance 1 [pixel]
    down: wp.array[wp.vec3]  # (N,) derivative of the row
    # of the instances, then of the links, of the world and of points at infinity:
    drift: wp.array2d[wp.vec3]  # (M, A + L + 2) a, sensor frame [m/s]
    turn: wp.array2d[wp.vec3]  # (M, A + L + 2) b, sensor frame [rad/s]
    num_instances: wp.int32  # A
    part_instance: wp.array2d[wp.int32]  # (E, P)


@wp.struct
class SceneTwists:
    """Velocities of the origins of instances and links, and their angular velocities."""

    lin_vel: wp.array2d[wp.vec3]  # (E, A) world [m/s]
    ang_vel: wp.array2d[wp.vec3]  # (E, A) world [rad/s]
    link_lin_vel: wp.array2d[wp.vec3]  # (E, L) world [m/s]
    link_ang_vel: wp.array2d[wp.vec3]  # (E, L) world [rad/s]


@wp.kernel(enable_backward=False)
def relative_twist(
    scene: SceneArrays,
    twists: SceneTwists,
    sensors: SensorsOnCarrier,
    # out
    drift_out: wp.array2d[wp.vec3],  # (M, A + L + 2) sensor frame [m/s]
    turn_out: wp.array2d[wp.vec3],  # (M, A + L + 2) sensor frame [rad/s]
):
    """Write the relative motion of an instance, a link or the world in the sensor's frame, velocity ``a + b x p`` at p."""
    mount, a = wp.tid()
    body = mount // sensors.mount_position.shape[1]
    env = body // sensors.vehicles
    sensor = mount - body * sensors.mount_position.shape[1]
    body_spin = sensors.ang_vel[body]
    turn = -wp.quat_rotate_inv(sensors.mount_attitude[body, sensor], body_spin)
    drift = wp.vec3(0.0, 0.0, 0.0)
    count = scene.position.shape[1]
    world = count + twists.link_lin_vel.shape[1]
    if a < world and a - count == first_own_link(sensors, body) + sensors.link:  # the link moves with its sensors
        turn = wp.vec3(0.0, 0.0, 0.0)
    elif a <= world:
        origin, attitude = sensor_pose(sensors, body, sensor)
        lever = wp.cross(body_spin, sensors.mount_position[body, sensor])
        own = sensors.lin_vel[body] + wp.quat_rotate(sensors.attitude[body], lever)
        spin = wp.vec3(0.0, 0.0, 0.0)
        there = wp.vec3(0.0, 0.0, 0.0)
        if a < count:
            spin = twists.ang_vel[env, a]
            there = twists.lin_vel[env, a] + wp.cross(spin, origin - scene.position[env, a])
        elif a < world:
            spin = twists.link_ang_vel[env, a - count]
            there = twists.link_lin_vel[env, a - count] + wp.cross(spin, origin - scene.link_position[env, a - count])
        drift = wp.quat_rotate_inv(attitude, there - own)
        turn += wp.quat_rotate_inv(attitude, spin)
    drift_out[mount, a] = drift
    turn_out[mount, a] = turn


@wp.func
def ray_flow(flow: Flow, env: int, mount: int, pixel: int, ray: wp.vec3, distance: float, part: int) -> wp.vec2:
    """Return the optical flow [pixel/s] of a ray's hit at a distance; part -1 is a miss, at infinity."""
    a = flow.drift.shape[1] - 1
    if part >= 0:
        a = flow.part_instance[env, part]
        if a <= BODY:
            a = flow.num_instances + BODY - a
        elif a == WORLD:
            a = flow.drift.shape[1] - 2
    rate = flow.drift[mount, a] / wp.max(distance, LEAST_DISTANCE) + wp.cross(flow.turn[mount, a], ray)
    return wp.vec2(wp.dot(flow.right[pixel], rate), wp.dot(flow.down[pixel], rate))


def make_flow_inputs(cfg: RangeSensorCfg, scene: Scene, mounts: int) -> Flow:
    """Return the input struct of a camera's optical-flow kernel."""
    device = wp.device_from_torch(scene.device)
    table = pixel_derivatives(cfg, device=scene.device).view(-1, 2, 3)
    columns = scene.num_instances + scene.num_links + 2
    return make_struct(
        Flow, right=table[:, 0].contiguous(), down=table[:, 1].contiguous(), num_instances=scene.num_instances,
        drift=wp.zeros((mounts, columns), dtype=wp.vec3, device=device),
        turn=wp.zeros((mounts, columns), dtype=wp.vec3, device=device), part_instance=scene.arrays.part_instance,
    )  # fmt: skip


def record_relative_twist(flow: Flow, scene: Scene, sensors: SensorsOnCarrier) -> ReusableLaunch:
    """Record the launch that writes the relative motions before the rays are traced."""
    inputs, outputs = [scene.arrays, scene_twists(scene), sensors], [flow.drift, flow.turn]
    return ReusableLaunch(relative_twist, dim=flow.drift.shape, inputs=inputs, outputs=outputs, device=scene.device)


def scene_twists(scene: Scene) -> SceneTwists:
    """Return views of the velocities of a scene's instances and of the vehicles' links."""
    links = scene.asset_state.new_zeros(scene.num_envs, 0, 13) if scene.link_state is None else scene.link_state
    twists = SceneTwists()
    for prefix, state in (("", scene.asset_state), ("link_", links)):
        for name, columns in (("lin_vel", slice(7, 10)), ("ang_vel", slice(10, 13))):
            view = vector_view(prefix + name, state[..., columns], (*state.shape[:2], 3), device=state.device)
            setattr(twists, prefix + name, view)
    return twists


def pixel_derivatives(cfg: RangeSensorCfg, *, device: torch.device) -> Tensor:
    """Return the derivatives of column and row by the point in the sensor's frame, at distance 1 [pixel], (H, W, 2, 3).

    At the distance d they are 1/d of that.
    """
    if isinstance(cfg, CameraCfg):
        derivative, focal = _pinhole_derivative, 0.5 * cfg.width / tan(0.5 * radians(cfg.hfov_deg))
    elif isinstance(cfg, FisheyeCfg):
        derivative, focal = _fisheye_derivative, cfg.width / radians(cfg.hfov_deg)
    else:
        raise ConfigError(f"{type(cfg).__name__}.optical_flow: only pinhole, stereo and fisheye cameras have a flow")
    rays = ray_table(cfg, device=torch.device("cpu")).double()
    return (focal * derivative(rays)).to(device=device, dtype=torch.float32)


def _pinhole_derivative(rays: Tensor) -> Tensor:
    """Return the gradients of ``-y / x`` and ``-z / x`` at unit directions, (..., 2, 3)."""
    x, y, z = rays.unbind(-1)
    zero = torch.zeros_like(x)
    right = torch.stack((y / x, -torch.ones_like(x), zero), dim=-1)
    down = torch.stack((z / x, zero, -torch.ones_like(x)), dim=-1)
    return torch.stack((right, down), dim=-2) / x[..., None, None]


def _fisheye_derivative(rays: Tensor) -> Tensor:
    """Return the gradients of ``-theta y / rho`` and ``-theta z / rho`` at unit directions, (..., 2, 3).

    With ``rho = hypot(y, z)``, ``theta = atan2(rho, x)``, ``c = y / rho``, ``s = z / rho``: the gradient of theta is
    ``(-rho, x c, x s)`` and that of c is ``(0, s², -c s) / rho``. In the middle ``theta / rho`` is 1, whatever c and s are.
    """
    x, y, z = rays.unbind(-1)
    rho = torch.hypot(y, z)
    beside = rho > 0.0
    c, s = torch.where(beside, y / rho, 1.0), torch.where(beside, z / rho, 0.0)
    wide = torch.where(beside, torch.atan2(rho, x) / rho, 1.0)
    mixed = (x - wide) * c * s
    right = torch.stack((-y, x * c * c + wide * s * s, mixed), dim=-1)
    down = torch.stack((-z, mixed, x * s * s + wide * c * c), dim=-1)
    return -torch.stack((right, down), dim=-2)
