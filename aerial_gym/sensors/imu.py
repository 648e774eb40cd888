"""The inertial measurement unit: specific force and angular velocity at one point of the body, with their errors.

The accelerometer averages over a step, from how the velocity of its own point ``v_p = v_o + R (w x r)`` changes::

    f = R_m^T ((v_p(t) - v_p(t - dt)) / dt + g e_z),    R_m = R(t) exp(-w(t) dt / 2) R_mount

The bracket is the mean of the point's specific force in world axes, exactly, for every motion: tangential and centripetal terms
of the lever arm r are in it. R_m is the attitude at the middle of the step, so that f differs from the specific force at
t - dt/2, and from its mean over the step in IMU axes, by O(dt²); with the attitude of either end it would be O(dt).
Derived: the central difference leaves ``dt²/24 a''``, the turn back by half a step at the final rate ``dt²/8 w' x f``. Steps of
the physics of order 1 leave their own O(dt). Float32 adds about ``1e-7 |v_p| / dt`` of round-off.
The gyro gives ``w(t)`` in IMU axes, at the end of the step.

An IMU with a rate gives the mean of these forces over the n steps of its period T, and ``w(t)`` at its end; between two samples
the last one stays. Noise and walk are those of its period. Its output may have a latency of some steps.

Then, per axis: bias, white noise ``sigma N / sqrt(dt)``, saturation; the bias walks by ``sigma_b N sqrt(dt)``. Source: IEEE Std
952-1997, annex B (N and K). Draws of an episode depend on the number of the sample, beside seed, environment and episode.
Frames: world z up; body x forward, y left, z up. Letters: E environments.
"""

from math import inf, radians, sqrt

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import check_tensor, vector_view
from aerial_gym.config.sensor import ImuCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, make_struct, start_warp, with_usual_settings
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness, copy_mask
from aerial_gym.math.warp_functions import rotate, rotate_inverse, rotation_quat
from aerial_gym.physics.effects.sensor_errors import WIDTH
from aerial_gym.sensors.images import CLOCK_MARGIN, latency_steps
from aerial_gym.sensors.mounts import Carrier, Pose, file_pose
from aerial_gym.sensors.sensor_poses import PoseRange, draw_pose, pose_range


@wp.struct
class ImuParameters:
    """IMU parameters, equal in all environments. Noise and walk are per step."""

    mount: PoseRange  # IMU to body, without misalignment
    misalignment: wp.vec3  # +- [rad]
    accel_noise: wp.vec3  # [m/s²]
    gyro_noise: wp.vec3  # [rad/s]
    accel_walk: wp.vec3  # [m/s²]
    gyro_walk: wp.vec3  # [rad/s]
    accel_initial_bias: wp.vec3  # +- [m/s²]
    gyro_initial_bias: wp.vec3  # +- [rad/s]
    accel_range: wp.float32  # [m/s²]
    gyro_range: wp.float32  # [rad/s]
    gravity: wp.float32  # [m/s²]
    dt: wp.float32  # [s]
    period: wp.float32  # between two samples [s]; dt if there is one in every step
    due: wp.float32  # age of the last sample from which the next one is due [s]
    latency: wp.int32  # [steps]
    errs: wp.bool  # whether the robot has effects on inertial sensors


@wp.struct
class ImuMotion:
    """Motion of the body or link that carries the IMU."""

    attitude: wp.array[wp.quat]  # (E,) body to world, xyzw
    lin_vel: wp.array[wp.vec3]  # (E,) of the body origin, world [m/s]
    ang_vel: wp.array[wp.vec3]  # (E,) body [rad/s]
    errors: wp.array2d[
        wp.vec3
    ]  # (E, 8) of effects on inertial sensors (physics.effects.sensor_errors); not read without


@wp.struct
class ImuOutputs:
    """Arrays that a sample and a reset write."""

    sample: wp.array[wp.int32]  # (E,) counted from the reset on
    point_vel: wp.array[wp.vec3]  # (E,) world [m/s]
    mount_position: wp.array[wp.vec3]  # (E,) from the body origin, body [m]
    mount_attitude: wp.array[wp.quat]  # (E,) IMU to body, with misalignment
    bias: wp.array2d[wp.vec3]  # (E, 2) [m/s²], [rad/s]
    clock: wp.array[float]  # (E,) age of the last sample [s]
    steps: wp.array[wp.int32]  # (E,) since the last sample
    force_sum: wp.array[wp.vec3]  # (E,) of these steps, body [m/s²]
    fresh: wp.array2d[wp.vec3]  # (E, 2) last sample, IMU [m/s²], [rad/s]
    line: wp.array3d[wp.vec3]  # (L, E, 2) samples on their way
    place: wp.array[wp.int32]  # (E,) of the oldest of them
    measurement: wp.array2d[wp.vec3]  # (E, 2) output after latency


@wp.func
def _next_sample_state(random: RandomArrays, number: int, e: int, out: ImuOutputs) -> wp.uint32:
    """Return the random state of an environment's next sample, and count it."""
    sample = out.sample[e]
    out.sample[e] = sample + 1
    return substream(substream(episode_stream(random, e, wp.static(int(Purpose.IMU))), number), sample)


@wp.func
def _normal_vector(random: wp.uint32, index: int, std: wp.vec3) -> wp.vec3:
    """Return three normal draws; ``index`` tells the quantities of one sample apart."""
    stream = wp.rand_init(int(random), index)
    return wp.cw_mul(std, wp.vec3(wp.randn(stream), wp.randn(stream), wp.randn(stream)))


@wp.func
def _uniform_vector(random: wp.uint32, index: int, bound: wp.vec3) -> wp.vec3:
    """Return three uniform draws within +- ``bound``; ``index`` likewise."""
    stream = wp.rand_init(int(random), index)
    share = wp.vec3(wp.randf(stream), wp.randf(stream), wp.randf(stream))
    return wp.cw_mul(bound, 2.0 * share - wp.vec3(1.0, 1.0, 1.0))


@wp.func
def _saturate(value: wp.vec3, bound: float) -> wp.vec3:
    return wp.vec3(
        wp.clamp(value[0], -bound, bound), wp.clamp(value[1], -bound, bound), wp.clamp(value[2], -bound, bound)
    )


@wp.func
def _point_velocity(motion: ImuMotion, position: wp.vec3, e: int) -> wp.vec3:
    """Return ``v_o + R (w x r)`` [m/s], world."""
    return motion.lin_vel[e] + rotate(motion.attitude[e], wp.cross(motion.ang_vel[e], position))


@wp.func
def _apply_effect_errors(motion: ImuMotion, unit: ImuParameters, e: int, first: int, true: wp.vec3) -> wp.vec3:
    """Return a vector in body axes after the robot's IMU errors, ``M v + b``; rows ``first`` on hold b and the columns of M."""
    if not unit.errs:
        return true
    gain = wp.matrix_from_cols(motion.errors[e, first + 1], motion.errors[e, first + 2], motion.errors[e, first + 3])
    return gain * true + motion.errors[e, first]


@wp.func
def _write_sample(
    motion: ImuMotion, unit: ImuParameters, out: ImuOutputs, e: int, random: wp.uint32, mount: wp.quat,
    force: wp.vec3, ang_vel: wp.vec3, accel_bias: wp.vec3, gyro_bias: wp.vec3, steps: float,
):  # fmt: skip
    """Write biases and the IMU's measurement of specific force [m/s²] and angular velocity [rad/s], both in body axes.

    The noise is that of a mean over a number of steps.
    """
    share = 1.0 / wp.sqrt(steps)
    accel = (
        rotate_inverse(mount, _apply_effect_errors(motion, unit, e, 0, force))
        + accel_bias
        + _normal_vector(random, 0, share * unit.accel_noise)
    )
    gyro = (
        rotate_inverse(mount, _apply_effect_errors(motion, unit, e, 4, ang_vel))
        + gyro_bias
        + _normal_vector(random, 1, share * unit.gyro_noise)
    )
    out.bias[e, 0] = accel_bias
    out.bias[e, 1] = gyro_bias
    out.fresh[e, 0] = _saturate(accel, unit.accel_range)
    out.fresh[e, 1] = _saturate(gyro, unit.gyro_range)


@wp.func
def _output_delayed_sample(unit: ImuParameters, out: ImuOutputs, e: int):
    """Output the sample of ``latency`` steps ago, and queue the newest one."""
    place = out.place[e]
    for i in range(2):
        value = out.fresh[e, i]
        if unit.latency > 0:
            value = out.line[place, e, i]
            out.line[place, e, i] = out.fresh[e, i]
        out.measurement[e, i] = value
    if unit.latency > 0:
        out.place[e] = (place + 1) % unit.latency


@wp.kernel(enable_backward=False)
def _measure(motion: ImuMotion, unit: ImuParameters, random: RandomArrays, number: int, out: ImuOutputs):
    """Add the last step to the sample, and write the sample if due."""
    e = wp.tid()
    ang_vel = motion.ang_vel[e]
    velocity = _point_velocity(motion, out.mount_position[e], e)
    acceleration = (velocity - out.point_vel[e]) / unit.dt
    out.point_vel[e] = velocity
    middle = motion.attitude[e] * rotation_quat(-0.5 * unit.dt * ang_vel)
    force = out.force_sum[e] + rotate_inverse(middle, acceleration + wp.vec3(0.0, 0.0, unit.gravity))
    clock = out.clock[e] + unit.dt
    steps = out.steps[e] + 1
    if clock >= unit.due:
        count = float(steps)
        state = _next_sample_state(random, number, e, out)
        accel_bias = out.bias[e, 0] + _normal_vector(state, 2, wp.sqrt(count) * unit.accel_walk)
        gyro_bias = out.bias[e, 1] + _normal_vector(state, 3, wp.sqrt(count) * unit.gyro_walk)
        _write_sample(
            motion, unit, out, e, state, out.mount_attitude[e], force / count, ang_vel, accel_bias, gyro_bias, count
        )
        clock -= unit.period
        steps = 0
        force = wp.vec3()
    out.clock[e] = clock
    out.steps[e] = steps
    out.force_sum[e] = force
    _output_delayed_sample(unit, out, e)


@wp.kernel(enable_backward=False)
def _reset(
    mask: wp.array[wp.bool], motion: ImuMotion, unit: ImuParameters, random: RandomArrays, number: int, out: ImuOutputs
):
    """Draw place, bias and misalignment and write a first sample where the mask says so; leave every other row alone."""
    e = wp.tid()
    if not mask[e]:
        return
    out.sample[e] = 0
    state = _next_sample_state(random, number, e, out)
    turn = _uniform_vector(state, 4, unit.misalignment)
    yaw_pitch = rotation_quat(wp.vec3(0.0, 0.0, turn[2])) * rotation_quat(wp.vec3(0.0, turn[1], 0.0))
    position, nominal = draw_pose(unit.mount, substream(state, 7))
    mount = wp.normalize(nominal * yaw_pitch * rotation_quat(wp.vec3(turn[0], 0.0, 0.0)))
    accel_bias = _uniform_vector(state, 5, unit.accel_initial_bias)
    gyro_bias = _uniform_vector(state, 6, unit.gyro_initial_bias)
    force = rotate_inverse(motion.attitude[e], wp.vec3(0.0, 0.0, unit.gravity))
    out.mount_position[e] = position
    out.mount_attitude[e] = mount
    out.point_vel[e] = _point_velocity(motion, position, e)
    _write_sample(motion, unit, out, e, state, mount, force, motion.ang_vel[e], accel_bias, gyro_bias, 1.0)
    out.clock[e] = 0.0
    out.steps[e] = 0
    out.force_sum[e] = wp.vec3()
    out.place[e] = 0
    for i in range(2):
        out.measurement[e, i] = out.fresh[e, i]
        for k in range(unit.latency):
            out.line[k, e, i] = out.fresh[e, i]


@with_usual_settings
class Imu:
    """One IMU in every environment, with all views made at construction."""

    def __init__(
        self, cfg: ImuCfg, carrier: Carrier, *, measurement_out: Tensor, dt: float, gravity: float,
        random: Randomness | None = None, number: int = 0, errors: Tensor | None = None, pose: Pose | None = None,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are, and load the kernels; then ``reset`` all rows.

        Args:
            carrier: With velocities.
            measurement_out: Receives specific force [m/s²] and angular velocity [rad/s], IMU axes, float32, (E, 6).
            dt: Time between two samples [s], > 0: the environment step.
            gravity: Downward acceleration of free fall [m/s²].
            number: Of the IMU on its robot: two IMUs are drawn apart.
            errors: IMU errors by effects of the robot, (E, 24), from ``imu_errors``; read at
                every sample and reset. None where it has none.
        """
        if not 0.0 < dt < inf:
            raise ConfigError(f"dt = {dt!r}: must be > 0 and finite")
        if cfg.rate_hz is not None and cfg.rate_hz * dt > 1.0 + CLOCK_MARGIN:
            raise ConfigError(
                f"ImuCfg.rate_hz = {cfg.rate_hz!r}: steps of {dt:g} s give at most {1.0 / dt:g} measurements per second. "
                "Use shorter environment steps or a lower rate"
            )
        start_warp()
        envs, device = measurement_out.shape[0], measurement_out.device
        check_tensor("measurement_out", measurement_out, (envs, 6), device=device)
        self.cfg, self.measurement = cfg, measurement_out
        self.bias = torch.zeros(envs, 6, device=device)
        """Present bias [m/s²] and [rad/s], IMU axes, (E, 6)."""
        pose = file_pose(cfg) if pose is None else pose
        self.mount_position = pose.position.float().to(device).expand(envs, 3).clone()
        """Place in this episode from the body origin [m], body, (E, 3)."""
        self.mount_attitude = pose.attitude.float().to(device).expand(envs, 4).clone()
        """IMU to body, with the misalignment of the episode, (E, 4)."""
        latency = latency_steps(cfg.latency_s, dt)
        vectors = {"point_vel": (envs, 3), "clock": (envs,), "force_sum": (envs, 3), "fresh": (envs, 6)}
        self._state = {
            "bias": self.bias,
            "mount_position": self.mount_position,
            "mount_attitude": self.mount_attitude,
            **{name: torch.zeros(envs, dtype=torch.int32, device=device) for name in ("sample", "steps", "place")},
            **{name: torch.zeros(size, device=device) for name, size in vectors.items()},
            "line": torch.zeros(latency, envs, 6, device=device),
        }
        self._random = random or Randomness(envs, device=device)
        self._mask = self._random.mask
        unit = _imu_parameters(cfg, pose, dt, gravity)
        unit.latency, unit.errs = latency, errors is not None
        self.is_drawn = bool(unit.mount.is_drawn)
        """Whether its place differs between episodes."""
        motion = ImuMotion()
        for name, width in (("attitude", 4), ("lin_vel", 3), ("ang_vel", 3)):
            setattr(motion, name, vector_view(name, getattr(carrier, name), (envs, width), device=device))
        if errors is not None:
            check_tensor("errors", errors, (envs, WIDTH), device=device)
            motion.errors = wp.from_torch(errors.view(envs, -1, 3), dtype=wp.vec3)
        arrays = {**self._state, "measurement": self.measurement}
        arrays |= {name: arrays[name].unflatten(-1, (2, 3)) for name in ("bias", "fresh", "line", "measurement")}
        outputs = make_struct(ImuOutputs, **arrays)
        inputs = [motion, unit, random_arrays(self._random), number, outputs]
        launch = {"dim": envs, "device": wp.device_from_torch(device)}
        self._measure_command = ReusableLaunch(_measure, inputs=inputs, **launch)
        self._reset_command = ReusableLaunch(_reset, inputs=[self._mask, *inputs], **launch)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        return dict(self._state)

    def measure(self) -> None:
        """Take the step that has just ended into the measurement; launched on torch's current stream, once per ``dt``."""
        self._measure_command.launch(self.measurement)

    def reset(self, mask: Tensor) -> None:
        """Restart in the environments of ``mask``, bool (E,), from their present state; others stay bit for bit.

        Draws place, bias and misalignment, and writes a first sample: that of a vehicle without acceleration in its present
        attitude, as no step has shown one yet, with its present angular velocity.
        Launched on torch's current stream, not waited for.
        """
        copy_mask(self._mask, mask)
        self._reset_command.launch(self._mask)


def _imu_parameters(cfg: ImuCfg, pose: Pose, dt: float, gravity: float) -> ImuParameters:
    unit = ImuParameters()
    unit.dt, unit.gravity = dt, gravity
    unit.period = dt if cfg.rate_hz is None else 1.0 / cfg.rate_hz
    unit.due = (1.0 - CLOCK_MARGIN) * unit.period
    unit.mount = pose_range(cfg, pose)
    unit.misalignment = wp.vec3(*(radians(angle) for angle in cfg.misalignment_deg))
    for kind in ("accel", "gyro"):
        noise = wp.vec3(*getattr(cfg, f"{kind}_noise_density")) / sqrt(dt)
        walk = wp.vec3(*getattr(cfg, f"{kind}_bias_walk")) * sqrt(dt)
        setattr(unit, f"{kind}_noise", noise)
        setattr(unit, f"{kind}_walk", walk)
        setattr(unit, f"{kind}_initial_bias", wp.vec3(*getattr(cfg, f"{kind}_initial_bias")))
        setattr(unit, f"{kind}_range", getattr(cfg, f"{kind}_range"))
    return unit
