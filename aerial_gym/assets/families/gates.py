"""Gates of a race track (a square frame on a stand, flown through along x, origin in its centre) and poles."""

from aerial_gym.assets.families.family import Draw, Family, box
from aerial_gym.config.environment import PartCfg, ShapeCfg


def frame_parts(opening: float, bar: float, depth: float) -> tuple[PartCfg, ...]:
    """Return the four bars of a square frame in the plane x = 0, from opening edge, bar width and depth [m]."""
    outer, middle = opening + 2.0 * bar, 0.5 * (opening + bar)
    level = [box((depth, outer, bar), (0.0, 0.0, side * middle)) for side in (1.0, -1.0)]
    upright = [box((depth, bar, opening), (0.0, side * middle, 0.0)) for side in (1.0, -1.0)]
    return (*level, *upright)


def _make(draw: Draw) -> ShapeCfg:
    opening, bar = draw("opening"), draw("bar")
    width, height = draw("stand_width"), draw("stand_height")
    stand = box((width, width, height), (0.0, 0.0, -0.5 * (opening + height) - bar))
    parts = frame_parts(opening, bar, draw("depth"))
    return ShapeCfg(kind="compound", parts=(*parts, stand))


def _make_pole(draw: Draw) -> ShapeCfg:
    height = draw("height")
    pole = ShapeCfg(kind="capsule", radius=0.5 * draw("thickness"), height=height)
    return ShapeCfg(kind="compound", parts=(PartCfg(shape=pole, position=(0.0, 0.0, -0.5 * height)),))


GATES = Family(
    summary="Square frames on a stand, to be flown through along x; the origin is the middle of the opening",
    # from the gate of github learnsyslab/lsy_drone_racing (envs/assets/gate.xml) to twice its size
    ranges={
        "opening": (0.4, 0.8),
        "bar": (0.16, 0.32),
        "depth": (0.02, 0.04),
        "stand_width": (0.1, 0.2),
        "stand_height": (1.0, 2.0),
    },
    make=_make,
)

POLES = Family(
    summary="Upright poles with round ends, whose tops are the origin",
    ranges={"thickness": (0.03, 0.06), "height": (1.5, 3.0)},  # from its obstacle.xml, likewise
    make=_make_pole,
)
