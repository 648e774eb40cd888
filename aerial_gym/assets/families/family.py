"""A family of shapes: a rule and the ranges of its random dimensions."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.environment import FIRST_INSTANCE_ID, FamilyCfg, PartCfg, ShapeCfg
from aerial_gym.config.robot import Vec3
from aerial_gym.errors import ConfigError

Range = tuple[float, float]

WALL_IDS = {"front": 9, "back": 10, "left": 11, "right": 12, "bottom": 13, "top": 14}
"""Semantic ids of the faces of rooms and corridors. Source: parity 2.2."""

WALL_COLORS: dict[int, Vec3] = {
    WALL_IDS["front"]: (0.72, 0.74, 0.78),
    WALL_IDS["back"]: (0.64, 0.66, 0.70),
    WALL_IDS["left"]: (0.74, 0.70, 0.64),
    WALL_IDS["right"]: (0.66, 0.70, 0.66),
    WALL_IDS["bottom"]: (0.46, 0.44, 0.42),
    WALL_IDS["top"]: (0.86, 0.86, 0.84),
}
"""Colours of these faces, as in the registered environments. Plain choices."""

assert max(WALL_IDS.values()) < FIRST_INSTANCE_ID


class Draw:
    """Random numbers of one variant, drawn in the order of the calls."""

    def __init__(self, ranges: Mapping[str, Range], *, seed: int, variant: int) -> None:
        """Seed the draws of a variant, which depend only on the seed, its number and the ranges."""
        self._ranges, self._random = ranges, np.random.default_rng((seed, variant))

    def __call__(self, name: str) -> float:
        """Draw a declared number, uniform within its range."""
        return self.uniform(*self._ranges[name])

    def uniform(self, low: float, high: float) -> float:
        """Draw a number between two limits, for use inside a rule."""
        return low + (high - low) * float(self._random.random())

    def count(self, name: str) -> int:
        """Draw a declared integer; each value of its range has the same probability."""
        low, high = self._ranges[name]
        return int(self._random.integers(round(low), round(high), endpoint=True))


@dataclass(frozen=True, kw_only=True)
class Family:
    """A rule that makes shapes, with the ranges of its numbers."""

    summary: str  # One-line description
    ranges: Mapping[str, Range]  # Lowest and highest value of every number; lengths in metres, angles in radians
    make: Callable[[Draw], ShapeCfg]  # The rule

    def shapes(self, cfg: FamilyCfg) -> tuple[ShapeCfg, ...]:
        """Return the variants of a configuration; raise ``ConfigError`` for an unknown number or an impossible shape."""
        for name in cfg.ranges:
            if name not in self.ranges:
                known = ", ".join(self.ranges)
                raise ConfigError(f"family {cfg.name!r}: there is no number {name!r}. Known: {known}")
        ranges = {**self.ranges, **cfg.ranges}
        try:
            return tuple(self.make(Draw(ranges, seed=cfg.seed, variant=i)) for i in range(cfg.variants))
        except ConfigError as error:
            raise ConfigError(f"family {cfg.name!r} with {ranges}: {error}") from None


def box(size: tuple[float, float, float], at: tuple[float, float, float], semantic_id: int | None = None) -> PartCfg:
    """Return a box as a part, from its edge lengths and centre [m]."""
    color = None if semantic_id is None else WALL_COLORS.get(semantic_id)
    return PartCfg(shape=ShapeCfg(kind="box", size=size, color=color), position=at, semantic_id=semantic_id)
