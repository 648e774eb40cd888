"""Integration of a gyro to an attitude. Letters: T samples, B blocks."""

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.raw_log import LogChannel


def integrate_attitude(gyro: LogChannel) -> LogChannel:
    """Return the attitude by integration of the angular velocity from a level attitude, with a note that says so."""
    steps = np.clip(np.diff(gyro.time, prepend=gyro.time[:1]), 0.0, 1.0)
    turns = np.nan_to_num(gyro.values)
    turns[1:] += turns[:-1].copy()
    turns *= 0.5 * steps[:, None]
    attitude = product_of_turns(Rotation.from_rotvec(turns).as_quat())
    return LogChannel(
        quantity="attitude",
        time=gyro.time,
        values=attitude,
        source=gyro.source,
        notes=(Finding("attitude_integrated"),),
    )


def product_of_turns(turns: Array) -> Array:
    """Return the products of all quaternions up to each, (T, 4), xyzw.

    The samples are cut into blocks of equal length. All blocks advance together, and are then joined one after the other.
    """
    length = max(int(np.sqrt(turns.shape[0])), 1)
    number = -(-turns.shape[0] // length)
    rest = np.tile((0.0, 0.0, 0.0, 1.0), (number * length - turns.shape[0], 1))
    blocks = np.concatenate((turns, rest)).reshape(number, length, 4)
    for i in range(1, length):
        blocks[:, i] = _multiply(blocks[:, i - 1], blocks[:, i])
    for block in range(1, number):
        blocks[block] = _multiply(blocks[block - 1, -1], blocks[block])
    results = blocks.reshape(-1, 4)[: turns.shape[0]]
    results /= np.sqrt(np.einsum("ij,ij->i", results, results))[:, None]
    return results


def _multiply(first: Array, second: Array) -> Array:
    """Return the quaternion products ``first second``, (..., 4), xyzw."""
    a, b = first[..., :3], second[..., :3]
    vector = first[..., 3:] * b + second[..., 3:] * a + np.cross(a, b)
    scalar = first[..., 3:] * second[..., 3:] - np.sum(a * b, axis=-1, keepdims=True)
    return np.concatenate((vector, scalar), axis=-1)
