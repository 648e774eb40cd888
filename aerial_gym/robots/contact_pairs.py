"""Contact pairs: the deepest overlaps between a robot's shapes and obstacle parts, as Warp code.

Spheres, corners of boxes and ends of capsules have contact as spheres. Boxes and capsules also have contact at their
deepest point between these (an edge across an edge, a pole against a face), and with corners of box obstacles inside a box.
Frames: world of each environment, z up; shapes in the frame of their body or link.
Letters: E environments, A instances, C spheres.
"""

from collections.abc import Sequence

import warp as wp
from torch import Tensor

from aerial_gym.assets import Scene
from aerial_gym.assets.body_shapes import BodyShape, body_shapes
from aerial_gym.assets.cores import has_boxes_or_capsules
from aerial_gym.assets.geometry import outward_normal, signed_distance
from aerial_gym.assets.nearest import Core, NearestPair, as_box, box_corner, nearest_of_core
from aerial_gym.assets.scene_arrays import (
    BOX,
    SceneArrays,
    Shape,
    part_attitude,
    part_is_present,
    part_position,
    vector_view,
)
from aerial_gym.config.robot import CollisionShape
from aerial_gym.interop import make_struct
from aerial_gym.math.warp_functions import rotate, vector_type
from aerial_gym.physics.fused.contact import point_velocity, rows_type

MAX_CONTACTS = 8  # Pairs of sphere and part that push in one step; of more, the deepest

_gaps_type, _rows_type = vector_type(MAX_CONTACTS), rows_type(MAX_CONTACTS)


@wp.struct
class ContactPairs:
    """Pairs of sphere and part that overlap, as ``make_velocity_change`` takes them."""

    gaps: _gaps_type  # [m], 0 for an empty entry
    levers: _rows_type  # [m] world
    normals: _rows_type  # world
    surface_vels: _rows_type  # [m/s] world


@wp.struct
class ContactScene:
    """Obstacles, their motion, and the shapes of the robot, or of one link, that touch them."""

    scene: SceneArrays
    lin_vel: wp.array2d[wp.vec3]  # (E, A) of the instance's origin, world [m/s]
    ang_vel: wp.array2d[wp.vec3]  # (E, A) world [rad/s]
    sphere: wp.array[wp.vec4]  # (C,) contact points: centre in the body frame, radius [m]
    body: wp.array[BodyShape]  # boxes and capsules, none for robots of spheres
    reach: float  # radius of a ball about the body origin that holds all shapes [m]


def contact_scene(scene: Scene, spheres: Tensor, shapes: Sequence[CollisionShape]) -> ContactScene:
    """Return views of a scene's instances and the shapes with these contact points, (C, 4) [m]."""
    size, device = (scene.num_envs, scene.num_instances, 3), scene.device
    return make_struct(
        ContactScene,
        scene=scene.arrays,
        lin_vel=vector_view("lin_vel", scene.asset_state[..., 7:10], size, device=device),
        ang_vel=vector_view("ang_vel", scene.asset_state[..., 10:13], size, device=device),
        sphere=wp.from_torch(spheres, dtype=wp.vec4),
        body=body_shapes(shapes if has_boxes_or_capsules(shapes) else (), device=device),
        reach=float((spheres[:, :3].norm(dim=1) + spheres[:, 3]).max()),
    )


@wp.func
def index_of_shallowest(pairs: ContactPairs) -> int:
    """Return the index of the smallest overlap, or of an empty entry."""
    entry = wp.int32(0)
    for i in range(1, MAX_CONTACTS):
        if pairs.gaps[i] > pairs.gaps[entry]:
            entry = i
    return entry


@wp.func
def replace_pair(
    pairs: ContactPairs, i: int, gap: float, lever: wp.vec3, normal: wp.vec3, surface_vel: wp.vec3
) -> ContactPairs:
    """Return the pairs with another entry i."""
    pairs.gaps[i] = gap
    pairs.levers[i] = lever
    pairs.normals[i] = normal
    pairs.surface_vels[i] = surface_vel
    return pairs


@wp.func
def deepest_of_both(pairs: ContactPairs, extra: ContactPairs) -> ContactPairs:
    """Return the deepest of two sets of pairs."""
    for k in range(MAX_CONTACTS):
        i = index_of_shallowest(pairs)
        if extra.gaps[k] < pairs.gaps[i]:
            pairs = replace_pair(pairs, i, extra.gaps[k], extra.levers[k], extra.normals[k], extra.surface_vels[k])
    return pairs


@wp.func
def surface_velocity(around: ContactScene, env: int, a: int, place: wp.vec3) -> wp.vec3:
    """Return the velocity of an instance at a place [m/s], world."""
    return around.lin_vel[env, a] + wp.cross(around.ang_vel[env, a], place - around.scene.position[env, a])


CORNER = wp.constant(1.0e-3)  # Share of half an edge within which a point is taken for the corner, which pushes anyway


@wp.func
def is_near_corner(core: Core, point: wp.vec3) -> wp.bool:
    """Return whether a point is taken for a corner of a core."""
    own = wp.quat_rotate_inv(core.turn, point - core.center)
    is_corner = wp.bool(True)
    for i in range(3):
        is_corner = is_corner and wp.abs(own[i]) >= (1.0 - CORNER) * core.half[i]
    return is_corner


@wp.func
def corner_or_deepest_pair(shape: Shape, core: Core, radius: float, number: int) -> NearestPair:
    """Return corner 0 to 7 of a box obstacle in a box, or as number 8 the deepest pair of all; without any the distance is 0.

    The distance is that of the surfaces [m]; of a capsule the point is on its surface.
    """
    pair = NearestPair()
    pair.distance = radius
    if number < 8:
        if shape.kind != BOX or wp.min(core.half) <= 0.0:
            pair.distance = 0.0
            return pair
        corner = box_corner(shape.size, number)
        box = as_box(core)
        own = wp.quat_rotate_inv(core.turn, corner - core.center)
        pair.distance = wp.min(signed_distance(box, own), 0.0)
        pair.point = corner
        pair.normal = -wp.quat_rotate(core.turn, outward_normal(box, own))
        return pair
    pair = nearest_of_core(shape, core, radius)
    is_known = pair.distance >= radius or is_near_corner(core, pair.point)
    if shape.kind == BOX and wp.min(core.half) > 0.0:
        is_known = is_known or is_near_corner(Core(wp.vec3(), wp.quat_identity(), shape.size), pair.point)
    pair.distance = wp.where(is_known, 0.0, pair.distance - radius)
    pair.point = pair.point - radius * pair.normal
    return pair


@wp.func
def add_core_pairs(
    pairs: ContactPairs, around: ContactScene, com: wp.vec3, env: int, center_of_mass: wp.vec3, attitude: wp.quat
) -> ContactPairs:
    """Add the pairs of boxes and capsules that contact points alone miss."""
    scene = around.scene
    part = wp.int32(0)
    while part < scene.num_solid:
        a = scene.part_instance[env, part]
        if a >= 0 and part_is_present(scene, env, part):
            shape = scene.shapes[scene.part_shape[env, part]]
            turn = part_attitude(scene, env, part)
            origin = part_position(scene, env, part)
            c = wp.int32(0)
            while c < around.body.shape[0]:
                own = around.body[c]
                away = center_of_mass + rotate(attitude, own.center - com) - origin
                if own.reach > own.radius and wp.length(away) - scene.radius[env, part] < own.reach:
                    core_turn = wp.quat_inverse(turn) * attitude * own.attitude
                    core = Core(wp.quat_rotate_inv(turn, away), core_turn, own.half)
                    number = wp.int32(0)
                    while number < 9:
                        pair = corner_or_deepest_pair(shape, core, own.radius, number)
                        i = index_of_shallowest(pairs)
                        if pair.distance < pairs.gaps[i]:
                            place = origin + wp.quat_rotate(turn, pair.point)
                            normal = wp.quat_rotate(turn, pair.normal)
                            velocity = surface_velocity(around, env, a, place)
                            pairs = replace_pair(pairs, i, pair.distance, place - center_of_mass, normal, velocity)
                        number += 1
                c += 1
        part += 1
    return pairs


@wp.func
def find_pairs(
    around: ContactScene, com: wp.vec3, env: int, center_of_mass: wp.vec3, attitude: wp.quat
) -> ContactPairs:
    """Return the pairs that overlap, the deepest ``MAX_CONTACTS`` if there are more; instances alone, not the ground."""
    pairs = ContactPairs()
    scene = around.scene
    for part in range(scene.num_solid):
        a = scene.part_instance[env, part]
        if a >= 0 and part_is_present(scene, env, part):
            shape = scene.shapes[scene.part_shape[env, part]]
            turn = part_attitude(scene, env, part)
            origin = part_position(scene, env, part)
            for c in range(around.sphere.shape[0]):
                sphere = around.sphere[c]
                radius = sphere[3]
                offset = rotate(attitude, wp.vec3(sphere[0], sphere[1], sphere[2]) - com)
                away = center_of_mass + offset - origin
                if wp.length(away) - scene.radius[env, part] < radius:
                    local = wp.quat_rotate_inv(turn, away)
                    gap = signed_distance(shape, local) - radius
                    i = index_of_shallowest(pairs)
                    if gap < pairs.gaps[i]:
                        normal = wp.quat_rotate(turn, outward_normal(shape, local))
                        lever = offset - radius * normal
                        velocity = surface_velocity(around, env, a, center_of_mass + lever)
                        pairs = replace_pair(pairs, i, gap, lever, normal, velocity)
    return pairs


@wp.func
def has_fast_approach(pairs: ContactPairs, lin_vel: wp.vec3, turn: wp.vec3, crash_approach_speed: float) -> wp.bool:
    """Return whether any pair overlaps that comes together at a speed [m/s] or faster.

    ``lin_vel`` is the velocity of the origin of levers, ``turn`` the angular velocity, both world.
    """
    fast = wp.bool(False)
    for i in range(MAX_CONTACTS):
        approach = wp.dot(pairs.normals[i], pairs.surface_vels[i] - point_velocity(lin_vel, turn, pairs.levers[i]))
        fast = fast or (pairs.gaps[i] < 0.0 and approach >= crash_approach_speed)
    return fast
