"""Golden vectors of PX4's control libraries: 10,000 random states each of rate, attitude and position control.

    python -m tests.cross.firmware.px4_vectors --px4 CHECKOUT [--out tests/cross/firmware/px4_vectors.npz]

compiles ``RateControl``, ``AttitudeControl`` and ``PositionControl`` of a PX4-Autopilot checkout (BSD-3; needs g++) as a
library of the host and writes what they answer. Nothing of PX4 is kept but these numbers. States are not written: they follow
from the seed, and a checksum says whether they still do. Frames and order are PX4's: north, east, down; forward, right, down;
wxyz.
"""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from tests.cross.firmware.draws import Array, Draws, checksum, pointer, write_vectors

VECTORS = Path(__file__).with_name("px4_vectors.npz")
SEED = 17
STEPS = 4
"""Successive steps of one run, so that integrals are not empty."""

RUNS = 2500

SOURCES = (
    "src/lib/rate_control/rate_control.cpp",
    "src/modules/mc_att_control/AttitudeControl/AttitudeControl.cpp",
    "src/modules/mc_pos_control/PositionControl/PositionControl.cpp",
    "src/modules/mc_pos_control/PositionControl/ControlMath.cpp",
)
STUBS = {
    "px4_platform_common/defines.h": "#pragma once\n#include <cmath>\n#define PX4_ISFINITE(x) std::isfinite(x)\n",
    "geo/geo.h": "#pragma once\nstatic constexpr float CONSTANTS_ONE_G = 9.80665f;\n",
    "mathlib/mathlib.h": """#pragma once
#include <cmath>
#include <algorithm>
#include <math.h>
namespace math {
inline float min(float a, float b) { return a < b ? a : b; }
inline float max(float a, float b) { return a > b ? a : b; }
inline float constrain(float x, float low, float high) { return x < low ? low : (x > high ? high : x); }
inline float radians(float degrees) { return degrees * (3.14159265358979f / 180.f); }
inline float sq(float x) { return x * x; }
}
""",
    "mathlib/math/Limits.hpp": "#include <mathlib/mathlib.h>\n",
    "mathlib/math/Functions.hpp": "#include <mathlib/mathlib.h>\n",
    "uORB/topics/rate_ctrl_status.h": (
        "#pragma once\nstruct rate_ctrl_status_s { float rollspeed_integ, pitchspeed_integ, yawspeed_integ; };\n"
    ),
    "uORB/topics/vehicle_attitude_setpoint.h": """#pragma once
struct vehicle_attitude_setpoint_s { float q_d[4], thrust_body[3], yaw_sp_move_rate; };
""",
    "uORB/topics/vehicle_local_position_setpoint.h": """#pragma once
struct vehicle_local_position_setpoint_s { float x, y, z, vx, vy, vz, acceleration[3], thrust[3], yaw, yawspeed; };
""",
}
"""Headers that PX4 generates, or that ask for its operating system."""


def rate_states() -> tuple[Array, Array]:
    """Return gains (RUNS, 15) and steps (RUNS, STEPS, 13) of ``rate_control`` in ``px4_host.cpp``."""
    draw = Draws(SEED)
    gains = np.concatenate([draw(RUNS, 3, low=0.0, high=top) for top in (0.5, 2.0, 0.02, 0.1, 0.3)], axis=-1)
    saturation = np.round(1.3 * draw(RUNS, STEPS, 3)).astype(np.float32)
    parts = (draw(RUNS, STEPS, 3, low=-6.0, high=6.0), draw(RUNS, STEPS, 3, low=-6.0, high=6.0))
    return gains, np.concatenate(
        (*parts, 50.0 * draw(RUNS, STEPS, 3), saturation, draw(RUNS, STEPS, 1, low=0.001, high=0.02)), axis=-1
    )


def attitude_states() -> Array:
    """Return rows (RUNS STEPS, 16) of ``attitude_control`` in ``px4_host.cpp``."""
    draw, rows = Draws(SEED + 1), RUNS * STEPS
    unit = [draw.unit_quaternions(rows)[:, (3, 0, 1, 2)] for _ in range(2)]
    gains, weight = draw(rows, 3, low=0.5, high=8.0), draw(rows, 1, low=0.05, high=1.0)
    limit = draw(rows, 3, low=1.0, high=15.0)
    return np.concatenate((*unit, 2.0 * draw(rows, 1), gains, weight, limit), axis=-1).astype(np.float32)


def position_states() -> tuple[Array, Array]:
    """Return gains (RUNS, 20) and steps (RUNS, STEPS, 15) of ``position_control`` in ``px4_host.cpp``."""
    draw = Draws(SEED + 2)
    ends = (
        *[(0.3, 2.0)] * 3, *[(1.0, 6.0)] * 3, *[(0.0, 3.0)] * 3, *[(0.0, 0.5)] * 3,
        (1.0, 12.0), (1.0, 5.0), (1.0, 4.0), (0.02, 0.15), (0.6, 1.0), (0.1, 0.4), (0.3, 1.2), (0.2, 0.6),
    )  # fmt: skip
    gains = np.concatenate([draw(RUNS, 1, low=low, high=high) for low, high in ends], axis=-1)
    gains[:, 4] = gains[:, 3]  # PX4 has one gain for both horizontal axes, and takes that of x for its anti-windup
    moves = [size * draw(RUNS, STEPS, 3) for size in (5.0, 4.0, 6.0, 6.0)]
    rest = draw(RUNS, STEPS, 1, low=-3.1, high=3.1), draw(RUNS, STEPS, 1, low=0.004, high=0.3)
    mode = np.round(draw(RUNS, STEPS, 1, low=0.0))
    return gains, np.concatenate((*moves, *rest, mode), axis=-1).astype(np.float32)


def states_checksum() -> int:
    return checksum(*rate_states(), attitude_states(), *position_states())


def _library(px4: Path, folder: Path) -> ctypes.CDLL:
    for name, text in STUBS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    places = [folder, px4 / "src/lib", px4 / "src/lib/matrix", *{(px4 / source).parent for source in SOURCES}]
    command = ["g++", "-std=c++14", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-w", *(f"-I{p}" for p in places)]
    target = folder / "libpx4.so"
    files = [str(px4 / source) for source in SOURCES]
    subprocess.run([*command, *files, str(Path(__file__).with_name("px4_host.cpp")), "-o", str(target)], check=True)
    return ctypes.CDLL(str(target))


def answers(px4: Path) -> dict[str, Array]:
    """Return the outputs of the controllers in a PX4 checkout, by name."""
    with tempfile.TemporaryDirectory() as folder:
        library = _library(px4, Path(folder))
        torque, rate = np.zeros((RUNS, STEPS, 3), np.float32), np.zeros((RUNS * STEPS, 3), np.float32)
        position = np.zeros((RUNS, STEPS, 10), np.float32)
        library.rate_control(RUNS, STEPS, *map(pointer, (*rate_states(), torque)))
        library.attitude_control(RUNS * STEPS, *map(pointer, (attitude_states(), rate)))
        library.position_control(RUNS, STEPS, *map(pointer, (*position_states(), position)))
    return {"torque": torque, "rate": rate, "position": position}


if __name__ == "__main__":
    write_vectors(__doc__ or "", "px4", VECTORS, answers, states_checksum())
