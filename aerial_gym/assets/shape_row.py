"""Rows of the shape table in kernels, and the kinds of shapes."""

import warp as wp

BOX = wp.constant(0)
SPHERE = wp.constant(1)
CYLINDER = wp.constant(2)
CAPSULE = wp.constant(3)
MESH = wp.constant(4)
PLANE = wp.constant(5)
"""Half space below z = 0 of its own frame."""
TRIANGLE = wp.constant(6)
"""One face of a mesh, made during a sweep and in no table; its corners are ``size``, ``center`` and ``half``."""


@wp.struct
class Shape:
    """One row of the shape table."""

    mesh: wp.uint64  # Warp mesh id for distances; 0 unless kind is MESH
    ray_mesh: wp.uint64  # the same triangles in a tree optimised for rays
    position: wp.vec3  # of the shape in the frame of its asset [m]
    attitude: wp.quat  # shape to asset, xyzw, unit
    kind: wp.int32  # BOX, SPHERE, CYLINDER, CAPSULE, MESH, PLANE or TRIANGLE
    radius: wp.float32  # of the bounding sphere about the shape's origin [m]
    size: wp.vec3  # box: half edges; else: radius, half height along z, 0 [m]
    center: wp.vec3  # of the bounding box in the shape's own axes [m]; 0 but for meshes
    half: wp.vec3  # half edges of the bounding box [m]
