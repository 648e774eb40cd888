"""Golden vectors of PX4's order of desaturation: 10,000 random commands to motors with random parts in them.

    python -m tests.cross.firmware.px4_mixer_vectors --px4 CHECKOUT [--out tests/cross/firmware/px4_mixer_vectors.npz]

compiles ``ControlAllocationSequentialDesaturation.cpp`` of a PX4-Autopilot checkout (BSD-3; needs g++) with motors, limits and
commands of ``px4_mixer_host.h`` in the place of its base class, and writes the motor signals that it gives, at their limits.
Nothing of PX4 is kept but these numbers. Commands are not written: they follow from the seed, and a checksum says whether they
still do. Frames are PX4's: forward, right, down.
"""

import ctypes
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from tests.cross.firmware.draws import Array, Draws, checksum, pointer, write_vectors

VECTORS = Path(__file__).with_name("px4_mixer_vectors.npz")
SOURCE = "src/modules/control_allocator/ControlAllocation/ControlAllocationSequentialDesaturation.cpp"
SEED, ROWS, MOTORS = 23, 10_000, 6
QUADROTOR = ((-0.7071068, 0.7071068, 1.0), (0.7071068, -0.7071068, 1.0), (0.7071068, 0.7071068, -1.0),
             (-0.7071068, -0.7071068, -1.0))  # fmt: skip
"""Parts of the motors of a quadrotor in X in roll, pitch and yaw, as PX4 normalises them."""

HOST = """
#include "px4_mixer_host.h"
extern "C" void mix(int rows, const float *in, float *out)
{
	for (int n = 0; n < rows; n++, in += MOTORS * 5 + 5, out += MOTORS) {
		ControlAllocationSequentialDesaturation mixer;
		const float *wanted = in + MOTORS * 5;

		for (int i = 0; i < MOTORS; i++) {
			mixer._mix(i, 0) = in[5 * i];
			mixer._mix(i, 1) = in[5 * i + 1];
			mixer._mix(i, 2) = in[5 * i + 2];
			mixer._mix(i, 5) = in[5 * i + 3];
			mixer._actuator_min(i) = in[5 * i + 4];
			mixer._actuator_max(i) = 1.f;
		}

		for (int a = 0; a < 3; a++) { mixer._control_sp(a) = wanted[a]; }

		mixer._control_sp(5) = wanted[3];
		mixer._param_mc_airmode.value = (int)wanted[4];
		mixer.allocate();

		for (int i = 0; i < MOTORS; i++) { out[i] = mixer._actuator_sp(i); }
	}
}
"""


def states() -> tuple[Array, Array]:
    """Return parts in roll, pitch, yaw, thrust and lowest signal (ROWS, MOTORS, 5), and commands and airmode (ROWS, 5). Half
    of the rows are of a quadrotor in X, whose last two motors have no part in anything."""
    draw = Draws(SEED)
    parts, lift = draw(ROWS, MOTORS, 3), draw(ROWS, MOTORS, 1, low=-1.2, high=-0.8)
    lowest = np.repeat(draw(ROWS, 1, 1, low=0.0, high=0.2), MOTORS, axis=1)
    parts[::2], lift[::2] = 0.0, 0.0
    parts[::2, :4], lift[::2, :4], lowest[::2, 4:] = QUADROTOR, -1.0, 0.0
    wanted = np.concatenate((draw(ROWS, 3, low=-1.2, high=1.2), draw(ROWS, 1, low=-1.1, high=0.0)), axis=-1)
    wanted[:, :3] *= draw(ROWS, 1, low=0.0)  # small torques as well
    airmode = (np.arange(ROWS) % 6 // 2).astype(np.float32)[:, None]
    return np.concatenate((parts, lift, lowest), axis=-1), np.concatenate((wanted, airmode), axis=-1)


def states_checksum() -> int:
    return checksum(*states())


def signals(px4: Path) -> Array:
    """Return the motor signals of a checkout, (ROWS, MOTORS)."""
    parts, wanted = states()
    rows = np.ascontiguousarray(np.concatenate((parts.reshape(ROWS, -1), wanted), axis=-1))
    result = np.zeros((ROWS, MOTORS), np.float32)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "ControlAllocationSequentialDesaturation.hpp").write_text('#include "px4_mixer_host.h"\n')
        (folder / "host.cpp").write_text(HOST)
        (folder / "mixer.cpp").write_text((px4 / SOURCE).read_text(encoding="utf-8"))
        command = [
            "g++", "-std=c++14", "-O2", "-ffp-contract=off", "-fPIC", "-shared", f"-I{folder}", f"-I{VECTORS.parent}",
        ]  # fmt: skip
        subprocess.run(
            [*command, str(folder / "host.cpp"), str(folder / "mixer.cpp"), "-o", str(folder / "mixer.so")], check=True
        )
        ctypes.CDLL(str(folder / "mixer.so")).mix(ROWS, pointer(rows), pointer(result))
    return np.clip(result, parts[..., 4], np.float32(1.0))


if __name__ == "__main__":
    write_vectors(__doc__ or "", "px4", VECTORS, lambda px4: {"signals": signals(px4)}, states_checksum())
