"""A picture of the rotors of a robot, from above and from the side.

Frames: body is x forward, y left, z up; from above x points up in the picture, y to the left.
"""

from pathlib import Path
from typing import TYPE_CHECKING

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import MissingDependencyError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = {1: "#2a6fbb", -1: "#c4572e"}  # Of rotors that turn positively about their axis, and of the others
SHARE = 0.35  # Radius of a rotor that has none, per distance of the outermost hub from the origin


def draw_rotors(robot: RobotCfg, path: str | Path, *, name: str = "") -> None:
    """Draw hubs, numbers, senses of turning, directions of thrust and the centre of mass into a file (png, svg, pdf)."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("matplotlib is not installed: pip install 'aerial-gym[sim2real]'") from None
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    above, side = figure.subplots(1, 2)
    outermost = max(max(abs(p) for p in mount.position) for mount in robot.mounts.layout) or 1.0
    for number, (mount, rotor) in enumerate(zip(robot.mounts.layout, robot.rotor_types, strict=True), 1):
        radius, colour = rotor.radius or SHARE * outermost, COLOURS[mount.spin]
        length = sum(a * a for a in mount.axis) ** 0.5
        x, y, z = mount.position
        ax, ay, az = (0.6 * outermost * a / length for a in mount.axis)
        _draw_rotor_disc(above, (-y, x), radius, mount.spin if az >= 0.0 else -mount.spin, colour, str(number))
        _draw_thrust_arrow(above, (-y, x), (-ay, ax), colour)
        _draw_thrust_arrow(side, (x, z), (ax, az), colour)
        side.annotate(str(number), (x, z), color=colour, xytext=(4, 4), textcoords="offset points")
    com = robot.body.com
    for axes, (right, up) in ((above, (-com[1], com[0])), (side, (com[0], com[2]))):
        axes.plot(right, up, "k+", ms=12, label="centre of mass")
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(color="0.9", lw=0.6)
    above.set(title="from above", xlabel="-y [m], right", ylabel="x [m], forward")
    side.set(title="from the right", xlabel="x [m], forward", ylabel="z [m], up")
    above.legend(loc="upper right", fontsize=8)
    figure.suptitle(f"{name}: curved arrows: turning; straight ones: thrust" if name else "rotors")
    figure.savefig(path, dpi=110)


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
