"""A picture of the rotors of a robot, from above and from the side.

Frames: body is x forward, y left, z up; from above x points up in the picture, y to the left.
"""

from io import StringIO
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.config.robot import RobotCfg
from aerial_gym.extras import optional_import

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from aerial_gym.config.robot import MountCfg

COLOURS = {1: "#2a6fbb", -1: "#c4572e"}  # Of rotors that turn positively about their axis, and of the others
GRID = "#e6e6e6"
PAGE_COLOURS = {
    COLOURS[1]: "var(--blue)", COLOURS[-1]: "var(--c1)", "#000000": "var(--ink)", GRID: "var(--line)",
}  # fmt: skip
"""Variables of ``sim2real/report/templates/page.css`` for the colours of a drawing."""

SHARE = 0.35  # Radius of a rotor that has none, per distance of the outermost hub from the origin


def draw_rotors(robot: RobotCfg, path: str | Path, *, name: str = "") -> None:
    """Draw hubs, numbers, senses of turning, directions of thrust and the centre of mass into a file (png, svg, pdf)."""
    figure = _new_figure(9.0)
    for draw, axes in zip(VIEWS.values(), figure.subplots(1, 2), strict=True):
        draw(robot, axes)
    figure.suptitle(f"{name}: curved arrows: turning; straight ones: thrust" if name else "rotors")
    figure.savefig(path, dpi=110)


def rotor_views(robot: RobotCfg) -> dict[str, str]:
    """Return the same drawing as one SVG for each view; its colours are the variables of a page."""
    return {view: _page_svg(robot, draw) for view, draw in VIEWS.items()}


def _page_svg(robot: RobotCfg, draw: "Callable[[RobotCfg, Axes], None]") -> str:
    figure, file = _new_figure(4.6), StringIO()
    draw(robot, figure.subplots())
    from matplotlib import rc_context

    with rc_context({"svg.fonttype": "none"}):
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    svg = file.getvalue()
    for colour, variable in PAGE_COLOURS.items():
        svg = svg.replace(colour, variable)
    return svg[svg.index("<svg") :]


def _new_figure(width: float) -> "Figure":
    """Return a figure of a width [in]."""
    with optional_import("the picture of a robot"):
        from matplotlib.figure import Figure
    return Figure(figsize=(width, 4.6), layout="constrained")


def _draw_top_view(robot: RobotCfg, axes: "Axes") -> None:
    for number, (mount, rotor) in enumerate(zip(robot.mounts.layout, robot.rotor_types, strict=True), 1):
        (x, y, _), (ax, ay, az) = mount.position, _thrust_arrow(robot, mount)
        turn = mount.spin if az >= 0.0 else -mount.spin
        radius = rotor.radius or SHARE * _reach(robot)
        _draw_rotor_disc(axes, (-y, x), radius, turn, COLOURS[mount.spin], str(number))
        _draw_thrust_arrow(axes, (-y, x), (-ay, ax), COLOURS[mount.spin])
    _draw_frame(axes, (-robot.body.com[1], robot.body.com[0]))
    axes.set(title="from above; +: centre of mass", xlabel="-y [m], right", ylabel="x [m], forward")


def _draw_side_view(robot: RobotCfg, axes: "Axes") -> None:
    for number, mount in enumerate(robot.mounts.layout, 1):
        (x, _, z), (ax, _, az) = mount.position, _thrust_arrow(robot, mount)
        _draw_thrust_arrow(axes, (x, z), (ax, az), COLOURS[mount.spin])
        axes.annotate(str(number), (x, z), color=COLOURS[mount.spin], xytext=(4, 4), textcoords="offset points")
    _draw_frame(axes, (robot.body.com[0], robot.body.com[2]))
    axes.set(title="from the right", xlabel="x [m], forward", ylabel="z [m], up")


VIEWS = {"from above": _draw_top_view, "from the right": _draw_side_view}


def _draw_frame(axes: "Axes", com: tuple[float, float]) -> None:
    """Draw the centre of mass and the grid."""
    axes.plot(*com, "k+", ms=12)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color=GRID, lw=0.6)
    axes.locator_params(nbins=6)


def _reach(robot: RobotCfg) -> float:
    """Return the largest coordinate of a hub [m]; 1 if all are at the origin."""
    return max(max(abs(p) for p in mount.position) for mount in robot.mounts.layout) or 1.0


def _thrust_arrow(robot: RobotCfg, mount: "MountCfg") -> tuple[float, ...]:
    """Return a vector along the thrust [m], body frame, in proportion to the vehicle."""
    return tuple(0.6 * _reach(robot) * a / hypot(*mount.axis) for a in mount.axis)


def _draw_rotor_disc(
    axes: "Axes", centre: tuple[float, float], radius: float, turn: int, colour: str, text: str
) -> None:
    """Draw a rotor from above, with its number and an arrow along its turning."""
    from matplotlib.patches import Circle, FancyArrowPatch

    axes.add_patch(Circle(centre, radius, color=colour, alpha=0.15, lw=0))
    right, up = centre
    ends = [(right + 0.75 * radius * turn, up), (right - 0.75 * radius * turn, up)]
    style = f"arc3,rad={0.9 * turn:g}"
    axes.add_patch(
        FancyArrowPatch(*ends, connectionstyle=style, arrowstyle="-|>", mutation_scale=12, color=colour, lw=1.3)
    )
    axes.text(right, up, text, ha="center", va="center", color=colour, fontsize=11)
    axes.update_datalim([(right - radius, up - radius), (right + radius, up + radius)])


def _draw_thrust_arrow(axes: "Axes", start: tuple[float, float], along: tuple[float, float], colour: str) -> None:
    """Draw a direction of thrust, unless it points at the viewer."""
    if along[0] ** 2 + along[1] ** 2 > 1e-6:
        end = (start[0] + along[0], start[1] + along[1])
        axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.5})
        axes.update_datalim([start, end])
