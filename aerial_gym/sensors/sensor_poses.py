"""Poses of the sensors of one kind on the body, constant or drawn at every reset, and in the world.

Frames: body is x forward, y left, z up. Letters: B vehicles of all environments, which are the environments where each has one,
S sensors of one kind, M = B * S mounts.
"""

import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import BODY
from aerial_gym.config.sensor import RangeSensorCfg
from aerial_gym.config.sensor_mount import PlacementCfg
from aerial_gym.interop import ReusableLaunch
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, quat_from_angles, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness, copy_mask
from aerial_gym.sensors.mounts import Pose, file_pose


@wp.struct
class SensorsOnCarrier:
    """Sensors of one kind, with the motion of the body or link that carries them."""

    position: wp.array[wp.vec3]  # (B,) origin of the carrier, world [m]
    attitude: wp.array[wp.quat]  # (B,) carrier to world, xyzw
    lin_vel: wp.array[wp.vec3]  # (B,) of that origin, world [m/s]; empty where no image needs it
    ang_vel: wp.array[wp.vec3]  # (B,) carrier's axes [rad/s]; likewise
    mount_position: wp.array2d[wp.vec3]  # (B, S) carrier's frame [m]
    mount_attitude: wp.array2d[wp.quat]  # (B, S) sensor to carrier, xyzw
    link: wp.int32  # number of the carrier; 0 of the body
    vehicles: wp.int32  # of this kind in an environment: body b is in the scene of environment b // vehicles
    first_link: wp.int32  # of the first of them, among all links of the scene
    num_links: wp.int32  # of one vehicle
    hides_own: wp.bool  # whether the sensors of a vehicle do not see it


@wp.func
def first_own_link(sensors: SensorsOnCarrier, body: int) -> int:
    """Return the number of a vehicle's base among all links of the scene."""
    return sensors.first_link + (body % sensors.vehicles) * sensors.num_links


@wp.func
def is_hidden(sensors: SensorsOnCarrier, body: int, instance: int) -> wp.bool:
    """Return whether a vehicle's sensors do not see the carrier of a part, as it is the vehicle itself."""
    own = BODY - instance - first_own_link(sensors, body)
    return sensors.hides_own and own >= 0 and own < sensors.num_links


@wp.func
def sensor_pose(sensors: SensorsOnCarrier, body: int, sensor: int):
    """Return position [m] and attitude (sensor to world) of a sensor in the world."""
    carrier = sensors.attitude[body]
    origin = sensors.position[body] + wp.quat_rotate(carrier, sensors.mount_position[body, sensor])
    return origin, carrier * sensors.mount_attitude[body, sensor]


@wp.kernel(enable_backward=False)
def write_sensor_poses(
    sensors: SensorsOnCarrier,
    origin_out: wp.array[wp.vec3],  # (M,) world [m]
    attitude_out: wp.array[wp.quat],  # (M,) sensor to world
):
    """Write where every sensor is."""
    mount = wp.tid()
    body = mount // sensors.mount_position.shape[1]
    origin, attitude = sensor_pose(sensors, body, mount - body * sensors.mount_position.shape[1])
    origin_out[mount] = origin
    attitude_out[mount] = attitude


@wp.struct
class PoseRange:
    """Nominal pose of sensors and the range of its draws."""

    position: wp.vec3  # body [m], where nothing is drawn
    attitude: wp.quat  # sensor to body
    is_drawn: wp.bool
    position_low: wp.vec3  # [m] in the frame of the sensor's own file
    position_high: wp.vec3
    euler_low: wp.vec3  # ZYX roll, pitch, yaw [rad]
    euler_high: wp.vec3
    shift: wp.vec3  # from that frame to the body [m]
    turn: wp.quat


@wp.func
def draw_pose(place: PoseRange, random: wp.uint32):
    """Return position [m] and attitude (sensor to body) of a random state, both in the body frame."""
    position = place.position
    attitude = place.attitude
    if place.is_drawn:
        position = place.shift + wp.quat_rotate(
            place.turn, draw_vec3(random, 0, place.position_low, place.position_high)
        )
        attitude = wp.normalize(place.turn * quat_from_angles(draw_vec3(random, 1, place.euler_low, place.euler_high)))
    return position, attitude


@wp.kernel(enable_backward=False)
def _place_sensors(
    mask: wp.array[wp.bool],  # (E,)
    # params
    random: RandomArrays,
    number: int,  # of the kind on its robot
    place: PoseRange,
    # out
    position_out: wp.array2d[wp.vec3],  # (E, S) body [m]
    attitude_out: wp.array2d[wp.quat],  # (E, S) sensor to body, xyzw
):
    """Draw the sensor poses of masked environments."""
    env, sensor = wp.tid()
    if not mask[env]:
        return
    stream = substream(substream(episode_stream(random, env, wp.static(int(Purpose.MOUNTS))), number), sensor)
    position, attitude = draw_pose(place, stream)
    position_out[env, sensor] = position
    attitude_out[env, sensor] = attitude


class SensorPoses:
    """Poses of the sensors of one kind, with all views made at construction."""

    def __init__(self, cfg: RangeSensorCfg, random: Randomness, *, number: int, pose: Pose | None) -> None:
        """Set every sensor to its nominal pose or that of its mount; ``number`` separates the draws of kinds on a robot."""
        device, rows = random.seed.device, (random.num_envs, cfg.count)
        nominal = pose or file_pose(cfg)
        self.position = nominal.position.float().to(device).expand(*rows, 3).clone()
        """From the body origin [m], body, (E, S, 3)."""
        self.attitude = nominal.attitude.float().to(device).expand(*rows, 4).clone()
        """Sensor to body, xyzw, (E, S, 4)."""
        self._mask = random.mask
        place = pose_range(cfg, nominal)
        self.is_drawn = bool(place.is_drawn)
        """Whether they differ between episodes."""
        self._command = ReusableLaunch(
            _place_sensors, dim=rows, inputs=[self._mask, random_arrays(random), number, place],
            outputs=[self.position, self.attitude], device=device,
        )  # fmt: skip

    def reset(self, mask: Tensor) -> None:
        """Reset the sensor poses of the environments in ``mask``, bool (E,), to nominal or drawn ones, without waiting."""
        copy_mask(self._mask, mask)
        self._command.launch(self._mask)


def pose_range(cfg: PlacementCfg, nominal: Pose) -> PoseRange:
    """Return the pose range of a sensor: draws deviate from ``nominal`` as in its file from the placement there."""
    place, back = PoseRange(), file_pose(cfg).inverse()
    shift, turn = nominal.transform(back.position, back.attitude)
    place.position, place.attitude = wp.vec3(*nominal.position.tolist()), wp.quat(*nominal.attitude.tolist())
    place.shift, place.turn = wp.vec3(*shift.tolist()), wp.quat(*turn.tolist())
    for name in ("position", "euler"):
        ends = getattr(cfg, f"{name}_low"), getattr(cfg, f"{name}_high")
        drawn = None not in ends
        low, high = ends if drawn else (getattr(cfg, name), getattr(cfg, name))
        setattr(place, f"{name}_low", wp.vec3(*low))
        setattr(place, f"{name}_high", wp.vec3(*high))
        place.is_drawn = place.is_drawn or drawn
    return place
