"""Random draws in kernels: the Warp version of ``math.random``.

Letters: E environments.
"""

import warp as wp

from aerial_gym.math.random import Randomness


@wp.struct
class RandomArrays:
    """Kernel arrays of ``Randomness``."""

    seed: wp.array[wp.int32]  # (1,)
    environment: wp.array[wp.int32]  # (E,)
    episode: wp.array[wp.int32]  # (E,)


def random_arrays(random: Randomness) -> RandomArrays:
    """Return views of the tensors, which must be kept alive."""
    arrays = RandomArrays()
    for name in ("seed", "environment", "episode"):
        setattr(arrays, name, wp.from_torch(getattr(random, name)))
    return arrays


@wp.func
def substream(state: wp.uint32, index: int) -> wp.uint32:
    """Return the random state of an index within a state."""
    return wp.rand_init(int(state), index)


@wp.func
def episode_stream(random: RandomArrays, env: int, purpose: int) -> wp.uint32:
    """Return the random state of a purpose in an environment's present episode, as ``Randomness.stream``."""
    state = substream(wp.rand_init(random.seed[0], purpose), random.environment[env])
    return substream(state, random.episode[env])


@wp.func
def draw_vec3(random: wp.uint32, quantity: int, low: wp.vec3, high: wp.vec3) -> wp.vec3:
    """Return three uniform draws between ``low`` and ``high``; ``quantity`` separates the draws of one ``random``."""
    stream = substream(random, quantity)
    share = wp.vec3(wp.randf(stream), wp.randf(stream), wp.randf(stream))
    return low + wp.cw_mul(high - low, share)


@wp.func
def quat_from_angles(angles: wp.vec3) -> wp.quat:
    """Return the quaternion of ZYX Euler angles [rad], R = Rz(yaw) Ry(pitch) Rx(roll): ``quat_from_euler`` in a kernel."""
    roll = wp.quat(wp.sin(0.5 * angles[0]), 0.0, 0.0, wp.cos(0.5 * angles[0]))
    pitch = wp.quat(0.0, wp.sin(0.5 * angles[1]), 0.0, wp.cos(0.5 * angles[1]))
    yaw = wp.quat(0.0, 0.0, wp.sin(0.5 * angles[2]), wp.cos(0.5 * angles[2]))
    return wp.normalize(yaw * pitch * roll)
