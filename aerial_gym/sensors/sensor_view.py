"""The instances of a scene as one sensor sees them: every ray of a sensor starts at one point.

For each sensor and instance, once per image, the map from the sensor's frame to the frame of the instance's bounding box
(a cube of half edge 1) is computed; a ray then costs a matrix-vector product instead of two rotations, and reads neither
pose nor shape.

Frames: a sensor looks along its own x; world is the environment's own. Letters: E environments, B vehicles of all of them,
S sensors of one kind, M = B * S mounts, P parts.
"""

import warp as wp

from aerial_gym.assets.geometry import ray_distance_to_other_shape, ray_distance_to_unit_shape
from aerial_gym.assets.scene_arrays import (
    CYLINDER,
    PLANE,
    SceneArrays,
    Shape,
    part_attitude,
    part_is_present,
    part_position,
)
from aerial_gym.sensors.sensor_poses import SensorsOnCarrier, is_hidden, sensor_pose

ABSENT = wp.constant(-1)  # Kind of an instance that is parked, out of reach or hidden


@wp.struct
class SensorView:
    """Instance data in the sensor's frame, for tracing."""

    rows: wp.array2d[wp.vec4]  # (M, 3 P) three rows of the map from the sensor's frame: matrix and origin
    kind: wp.array2d[wp.int32]  # (M, P) kind of the shape, or ABSENT
    shapes: wp.array[Shape]
    part_shape: wp.array2d[wp.int32]  # (E, P)
    vehicles: wp.int32  # B / E


@wp.func
def write_part_in_sensor_frame(
    scene: SceneArrays, env: int, a: int, origin: wp.vec3, attitude: wp.quat, reach: float, row: int,
    rows_out: wp.array2d[wp.vec4], kind_out: wp.array2d[wp.int32],
):  # fmt: skip
    """Write one part in the frame of a sensor at a pose (sensor to world) into one row."""
    kind = wp.int32(ABSENT)
    if part_is_present(scene, env, a):
        offset = origin - part_position(scene, env, a)
        if wp.length(offset) - scene.radius[env, a] < reach:
            shape = scene.shapes[scene.part_shape[env, a]]
            kind = shape.kind
            own = part_attitude(scene, env, a)
            turn = wp.quat_to_matrix(wp.quat_inverse(own) * attitude)
            start = wp.quat_rotate_inv(own, offset) - shape.center
            for k in range(3):
                scale = 1.0 / shape.half[k]
                rows_out[row, 3 * a + k] = scale * wp.vec4(turn[k, 0], turn[k, 1], turn[k, 2], start[k])
    kind_out[row, a] = kind


@wp.kernel(enable_backward=False)
def write_parts_in_sensor_frames(
    scene: SceneArrays,
    sensors: SensorsOnCarrier,
    reach: float,  # [m] beyond which nothing is seen
    # out
    rows_out: wp.array2d[wp.vec4],  # (M, 3 P)
    kind_out: wp.array2d[wp.int32],  # (M, P)
):
    """Write one part in the frame of one sensor."""
    mount, a = wp.tid()
    body = mount // sensors.mount_position.shape[1]
    env = body // sensors.vehicles
    if is_hidden(sensors, body, scene.part_instance[env, a]):
        kind_out[mount, a] = ABSENT
        return
    origin, attitude = sensor_pose(sensors, body, mount - body * sensors.mount_position.shape[1])
    write_part_in_sensor_frame(scene, env, a, origin, attitude, reach, mount, rows_out, kind_out)


@wp.func
def slab_bounds(row: wp.vec4, middle: wp.vec3, spread: wp.vec3) -> wp.vec2:
    """Return the interval of t in which any ray of a tile lies between two faces of the cube."""
    across = row[0] * middle[0] + row[1] * middle[1] + row[2] * middle[2]
    half = wp.abs(row[0]) * spread[0] + wp.abs(row[1]) * spread[1] + wp.abs(row[2]) * spread[2]
    low = across - half
    high = across + half
    near = wp.float32(0.0)
    far = float(wp.inf)
    if row[3] > 1.0:  # the cube is on the side where this coordinate must fall
        if low >= 0.0:
            return wp.vec2(wp.inf, -wp.inf)
        near = (1.0 - row[3]) / low
    elif row[3] < -1.0:
        if high <= 0.0:
            return wp.vec2(wp.inf, -wp.inf)
        near = (-1.0 - row[3]) / high
    if low > 0.0:
        far = (1.0 - row[3]) / low
    elif high < 0.0:
        far = (-1.0 - row[3]) / high
    return wp.vec2(near, far)


@wp.func
def tile_entry(x: wp.vec4, y: wp.vec4, z: wp.vec4, middle: wp.vec3, spread: wp.vec3) -> float:
    """Return a lower bound of the distance to the bounding box along a tile's rays [m], inf without a hit.

    Interval arithmetic on the slab test.
    """
    a = slab_bounds(x, middle, spread)
    b = slab_bounds(y, middle, spread)
    c = slab_bounds(z, middle, spread)
    near = wp.max(a[0], wp.max(b[0], c[0]))
    far = wp.min(a[1], wp.min(b[1], c[1]))
    return wp.where(near * 0.99999 <= far, near, wp.inf)


@wp.func
def plane_entry(row: wp.vec4, middle: wp.vec3, spread: wp.vec3) -> float:
    """Return a lower bound of the distance to the plane of coordinate 0 along a tile's rays [m], inf without a hit."""
    across = row[0] * middle[0] + row[1] * middle[1] + row[2] * middle[2]
    half = wp.abs(row[0]) * spread[0] + wp.abs(row[1]) * spread[1] + wp.abs(row[2]) * spread[2]
    if row[3] > 0.0:
        return wp.where(across - half < 0.0, row[3] / (half - across), wp.inf)
    return wp.where(across + half > 0.0, -row[3] / (across + half), wp.inf)


@wp.func
def ray_distance(view: SensorView, env: int, mount: int, a: int, ray: wp.vec3, limit: float) -> float:
    """Return the distance along a ray to an instance [m], or ``limit`` if there is none before it."""
    x = view.rows[mount, 3 * a]
    y = view.rows[mount, 3 * a + 1]
    z = view.rows[mount, 3 * a + 2]
    origin = wp.vec3(x[3], y[3], z[3])
    direction = wp.vec3(
        x[0] * ray[0] + x[1] * ray[1] + x[2] * ray[2],
        y[0] * ray[0] + y[1] * ray[1] + y[2] * ray[2],
        z[0] * ray[0] + z[1] * ray[1] + z[2] * ray[2],
    )
    kind = view.kind[mount, a]
    if kind <= CYLINDER:
        return ray_distance_to_unit_shape(kind, origin, direction, limit)
    return ray_distance_to_other_shape(view.shapes[view.part_shape[env, a]], origin, direction, limit)


@wp.func
def is_blocked(view: SensorView, env: int, mount: int, start: wp.vec3, ray: wp.vec3, limit: float) -> wp.bool:
    """Return whether something lies on a ray from a point in the sensor's frame before ``limit`` [m]."""
    for a in range(view.kind.shape[1]):
        kind = view.kind[mount, a]
        if kind != ABSENT:
            x = view.rows[mount, 3 * a]
            y = view.rows[mount, 3 * a + 1]
            z = view.rows[mount, 3 * a + 2]
            i = wp.vec3(x[0], x[1], x[2])
            j = wp.vec3(y[0], y[1], y[2])
            k = wp.vec3(z[0], z[1], z[2])
            origin = wp.vec3(wp.dot(i, start) + x[3], wp.dot(j, start) + y[3], wp.dot(k, start) + z[3])
            direction = wp.vec3(wp.dot(i, ray), wp.dot(j, ray), wp.dot(k, ray))
            distance = limit
            if kind <= CYLINDER:
                distance = ray_distance_to_unit_shape(kind, origin, direction, limit)
            else:
                distance = ray_distance_to_other_shape(view.shapes[view.part_shape[env, a]], origin, direction, limit)
            if distance < limit:
                return True
    return False


@wp.func
def part_entry(view: SensorView, mount: int, a: int, middle: wp.vec3, spread: wp.vec3) -> float:
    """Return a lower bound of the distance to a part along a tile's rays [m], inf if it is absent or not hit."""
    kind = view.kind[mount, a]
    if kind == ABSENT:
        return wp.inf
    if kind == PLANE:
        return plane_entry(view.rows[mount, 3 * a + 2], middle, spread)
    return tile_entry(view.rows[mount, 3 * a], view.rows[mount, 3 * a + 1], view.rows[mount, 3 * a + 2], middle, spread)


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ballot_sync(0xffffffffu, predicate);
#else
    return predicate ? 1u : 0u;
#endif
""")
def ballot(predicate: wp.bool) -> wp.uint32:
    """Return the bits of the 32 threads of a warp for which a predicate holds; all of them must call it."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return __ffs(bits) - 1;
#else
    return __builtin_ctz(bits);
#endif
""")
def lowest_bit(bits: wp.uint32) -> int:
    """Return the index of the lowest bit that is set; one must be."""


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const unsigned mine = __float_as_uint(value);  // of numbers >= 0 the bits are in the same order
    unsigned least = mine;
    for (unsigned step = 16; step > 0; step /= 2)
        least = min(least, __shfl_xor_sync(0xffffffffu, least, step));
    return __ffs(__ballot_sync(0xffffffffu, mine == least)) - 1;
#else
    return 0;
#endif
""")
def least_lane(value: float) -> int:
    """Return the lane 0 to 31 of a warp with the smallest value >= 0; all lanes must call it."""
