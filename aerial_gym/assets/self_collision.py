"""Self-collision of an articulated robot: contact between its links, now or during a step.

Every pair of shapes on different links is measured and swept as in the collision test. Pairs that always touch are excluded:
pairs on links that a joint connects (links without shapes are skipped), and pairs that touch in the reference pose.
Frames: shapes in the frames of their links, which are the body's in the reference pose. Letters: E environments, C shapes, L
links, K substeps, N pairs.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.body_shapes import BodyShape, body_shapes, shape_gap
from aerial_gym.assets.scene_arrays import Shape, check_tensor, vector_view
from aerial_gym.assets.shapes import ShapeTable
from aerial_gym.assets.sweep import make_path, make_touches
from aerial_gym.config.checks import Vec3
from aerial_gym.config.robot import CollisionCfg
from aerial_gym.config.shape import BASE, ShapeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import ReusableLaunch, on_torch_stream

_touches = make_touches(cores=True, meshes=False)


@wp.func
def _link_gap(one: Shape, x: wp.vec3, q: wp.quat, other: BodyShape, y: wp.vec3, p: wp.quat, limit: float) -> float:
    """Return the signed distance of two shapes on links at poses (x, q) and (y, p) [m], at most ``limit``."""
    return shape_gap(one, x + wp.quat_rotate(q, one.position), q * one.attitude, other, y, p, limit)


@wp.kernel(enable_backward=False)
def _reference_gaps(
    shapes: wp.array[Shape],  # (C,)
    body: wp.array[BodyShape],  # (C,)
    pairs: wp.array2d[wp.int32],  # (N, 2)
    # out
    gap_out: wp.array[float],  # (N,) [m]
):
    """Write the signed distance of each pair of shapes in the reference pose."""
    n = wp.tid()
    unit, zero = wp.quat_identity(), wp.vec3()
    gap_out[n] = _link_gap(shapes[pairs[n, 0]], zero, unit, body[pairs[n, 1]], zero, unit, float(wp.inf))


@wp.kernel(enable_backward=False)
def _test_pairs(
    # params
    shapes: wp.array[Shape],  # (C,)
    body: wp.array[BodyShape],  # (C,) the same
    link: wp.array[wp.int32],  # (C,) that carries each
    pairs: wp.array2d[wp.int32],  # (N, 2)
    pivot: wp.array[wp.vec3],  # (L,) point that moves straight between poses, frame of the link [m]
    # state
    position: wp.array3d[wp.vec3],  # (K + 1, E, L) at the start and after each substep, or (1, E, L), world [m]
    attitude: wp.array3d[wp.quat],  # (K + 1, E, L) link to world, xyzw
    is_step: wp.bool,  # whether contacts are crashes
    # out
    distance_out: wp.array[float],  # (E,) [m]
    crashes_out: wp.array[wp.bool],  # (E,) set where links touch at or between the poses
):
    """Write the least signed distance between links at the last pose, and set crashes of a step."""
    e = wp.tid()
    last = position.shape[0] - 1
    nearest = float(wp.inf)
    touches = wp.bool(False)
    for n in range(pairs.shape[0]):
        a = pairs[n, 0]
        b = pairs[n, 1]
        i = link[a]
        j = link[b]
        k = wp.int32(0)
        while k < last and not touches:
            later = k + 1
            one = make_path(
                pivot[i], position[k, e, i], attitude[k, e, i], position[later, e, i], attitude[later, e, i]
            )
            other = make_path(
                pivot[j], position[k, e, j], attitude[k, e, j], position[later, e, j], attitude[later, e, j]
            )
            touches = _touches(shapes[a], one, body[b], other, 0.0, 1.0)
            k += 1
        x = position[last, e, i]
        y = position[last, e, j]
        nearest = _link_gap(shapes[a], x, attitude[last, e, i], body[b], y, attitude[last, e, j], nearest)
    touches = touches or nearest < 0.0
    distance_out[e] = nearest
    if is_step and touches:
        crashes_out[e] = True


class SelfCollisionTest:
    """Signed distances between the links of one robot per environment; all views are made at construction."""

    def __init__(
        self, cfg: CollisionCfg, *, names: Sequence[str], parents: Sequence[int], pivots: Sequence[Vec3],
        state: Tensor, distance_out: Tensor,
    ) -> None:  # fmt: skip
        """Take views of the tensors, which must stay where they are.

        Args:
            names: Of the links, L of them, the base first.
            parents: Parent of each link but the base, L - 1 of them.
            pivots: Point of each link's frame that moves in a straight line between two poses [m], L of them.
            state: Position [m] and attitude, xyzw, of the links first, world, (E, L, 13).
            distance_out: Receives the least signed distance of two links [m], negative where they overlap, float32, (E,).
        """
        device = state.device
        check_tensor("distance_out", distance_out, (len(state),), device=device)
        self._out, self._place = distance_out, wp.device_from_torch(device)
        with on_torch_stream(distance_out):
            parts = tuple(replace(part, link=BASE) for part in cfg.parts)  # places in the frame of each link
            self._table = ShapeTable([ShapeCfg(kind="compound", parts=parts)] if parts else [], device=device)
            body = body_shapes(cfg.shapes, device=device)
            links = [list(names).index(shape.link) for shape in cfg.shapes]
            self.pairs = select_link_pairs(cfg, names=names, parents=parents, device=device)
            """Tested pairs of indices into ``cfg.shapes``."""
            pairs = wp.array(self.pairs, dtype=wp.int32, device=self._place, ndim=2)
            self._fixed = [self._table.array, body, wp.array(links, dtype=wp.int32, device=self._place), pairs]
            self._fixed.append(wp.array(list(pivots), dtype=wp.vec3, device=self._place))
        no_crashes = torch.zeros(0, dtype=torch.bool, device=device)
        now = state.unsqueeze(0)
        self._now = self._record_launch(now[..., :3], now[..., 3:7], is_step=False, crashes=no_crashes)
        self._step: ReusableLaunch | None = None

    def record_launches(self, position: Tensor, attitude: Tensor, *, crashes_out: Tensor) -> None:
        """Record the launches of ``step``.

        Args:
            position: Origins of the frames of links at the start of a step and after each substep [m], world,
                (K + 1, E, L, 3); read at every step.
            attitude: To the world, xyzw, unit, (K + 1, E, L, 4); likewise.
        """
        check_tensor("crashes_out", crashes_out, (len(self._out),), device=self._out.device, dtype=torch.bool)
        self._step = self._record_launch(position, attitude, is_step=True, crashes=crashes_out)

    def _record_launch(self, position: Tensor, attitude: Tensor, *, is_step: bool, crashes: Tensor) -> ReusableLaunch:
        device = self._out.device
        poses = [
            vector_view("position", position, (*position.shape[:3], 3), device=device),
            vector_view("attitude", attitude, (*position.shape[:3], 4), device=device),
        ]
        return ReusableLaunch(
            _test_pairs, dim=len(self._out), inputs=[*self._fixed, *poses, is_step], outputs=[self._out, crashes],
            device=self._place,
        )  # fmt: skip

    def measure(self) -> None:
        """Launch the measurement at the present poses on torch's current stream."""
        self._now.launch(self._out)

    def step(self) -> None:
        """Launch the test of a step: it sets crashes and writes the distances after the last substep."""
        assert self._step is not None
        self._step.launch(self._out)


def select_link_pairs(
    cfg: CollisionCfg, *, names: Sequence[str], parents: Sequence[int], device: torch.device
) -> list[tuple[int, int]]:
    """Return pairs of indices into ``cfg.shapes``, on links without a common joint and apart in the reference pose.

    Args:
        parents: Parent of each link but the base, L - 1 of them.
    """
    links = [list(names).index(shape.link) for shape in cfg.shapes]
    carrier = dict(zip(range(1, len(parents) + 1), parents, strict=True))

    def next_carrier_with_shapes(link: int) -> int | None:
        while link > 0:
            link = carrier[link]
            if link in links:
                return link
        return None

    def are_adjacent(a: int, b: int) -> bool:
        return a == b or next_carrier_with_shapes(a) == b or next_carrier_with_shapes(b) == a

    index_pairs = [(i, j) for i, j in combinations(range(len(links)), 2) if not are_adjacent(links[i], links[j])]
    if index_pairs:
        place, body = wp.device_from_torch(device), body_shapes(cfg.shapes, device=device)
        parts = tuple(replace(part, link=BASE) for part in cfg.parts)
        table = ShapeTable([ShapeCfg(kind="compound", parts=parts)], device=device)
        gap = wp.zeros(len(index_pairs), dtype=wp.float32, device=place)
        pairs = wp.array(index_pairs, dtype=wp.int32, device=place, ndim=2)
        wp.launch(_reference_gaps, dim=len(index_pairs), inputs=[table.array, body, pairs], outputs=[gap], device=place)
        index_pairs = [pair for pair, apart in zip(index_pairs, gap.numpy().tolist(), strict=True) if apart > 0.0]
    if not index_pairs:
        raise ConfigError(
            "CollisionCfg.between_links: no pair of shapes to test. Give shapes on links that no joint connects and "
            "that are apart in the reference pose"
        )
    return index_pairs
