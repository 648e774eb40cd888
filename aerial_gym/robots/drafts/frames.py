"""Frames: places and spins of the rotors of common multirotors, by name.

Sources: PX4 airframe reference; ArduPilot, ``AP_MotorsMatrix.cpp``; Betaflight 4.5, ``mixer_init.c``. Body axes are forward,
left, up; a spin of 1 turns positively about the thrust. Letters: R rotors.
"""

import numpy as np
from numpy.typing import NDArray

from aerial_gym.errors import UnknownNameError, suggest_name

FRAMES = {
    "quad_x": "45+ -135+ -45- 135-",
    "quad_plus": "90+ -90+ 0- 180-",
    "quad_h": "45- -135- -45+ 135+",
    "quad_plus_reversed": "90- -90- 0+ 180+",
    "quad_x_dji": "45+ -45- -135+ 135-",
    "quad_x_clockwise": "45+ 135- -135+ -45-",
    "quad_x_betaflight": "135- 45+ -135+ -45-",
    "quad_x_betaflight_reversed": "135+ 45- -135- -45+",
    "quad_x_1234": "-45- 45+ 135- -135+",
    "quad_plus_betaflight": "180- 90+ -90+ 0-",
    "y4": "45+ 180- 180+ -45-",
    "y4_betaflight": "180- 45+ 180+ -45-",
    "hexa_x": "90- -90+ -30- 150+ 30+ -150-",
    "hexa_plus": "0- 180+ -120- 60+ -60+ 120-",
    "hexa_x_dji": "30+ -30- -90+ -150- 150+ 90-",
    "hexa_x_clockwise": "30+ 90- 150+ -150- -90+ -30-",
    "hexa_x_betaflight": "150+ 30+ -150- -30- 90- -90+",
    "hexa_plus_betaflight": "120+ 60- -120+ -60- 0+ 180-",
    "octo_x": "22.5- -157.5- 67.5+ 157.5+ -22.5+ -112.5+ -67.5- 112.5-",
    "octo_plus": "0- 180- 45+ 135+ -45+ -135+ -90- 90-",
    "octo_x_dji": "22.5+ -22.5- -67.5+ -112.5- -157.5+ 157.5- 112.5+ 67.5-",
    "octo_x_clockwise": "22.5+ 67.5- 112.5+ 157.5- -157.5+ -112.5- -67.5+ -22.5-",
    "octo_x_betaflight": "-67.5+ 22.5+ 112.5+ -157.5+ -22.5- 67.5- 157.5- -112.5-",
    "octo_plus_betaflight": "-45+ 45+ 135+ -135+ 0- 90- 180- -90-",
    "coax_quad_x": "45+ -45- -135+ 135- -45+ 45- 135+ -135-",
    "coax_quad_plus": "0+ -90- 180+ 90- -90+ 0- 90+ 180-",
    "coax_quad_h": "45- -45+ -135- 135+ -45- 45+ 135- -135+",
    "coax_quad_x_betaflight": "135- 45+ -135+ -45- 135+ 45- -135- -45+",
    "coax_hexa_x": "30+ 30- 90- 90+ 150+ 150- -150- -150+ -90+ -90- -30- -30+",
    "coax_hexa_plus": "0+ 0- 60- 60+ 120+ 120- 180- 180+ -120+ -120- -60- -60+",
    "y6": "60+ -60- -60+ 180- 60- 180+",
    "y6b": "60- 60+ 180- 180+ -60- -60+",
    "y6f": "180+ 60+ -60+ 180- 60- -60-",
    "y6_betaflight": "180+ 60- -60- 180- 60+ -60+",
}
"""Angle of each rotor, clockwise from the front [deg], and + for a counter-clockwise spin, both from above."""


def frame_rotors(name: str, *, more: str = "") -> tuple[NDArray[np.float64], tuple[int, ...]]:
    """Return the places of the rotors on the unit circle, (R, 3), and their spins; ``more`` ends the error for no such name."""
    if name not in FRAMES:
        raise UnknownNameError(f"no frame {name!r}.{suggest_name(name, FRAMES)} Known: {', '.join(FRAMES)}{more}")
    rotors = FRAMES[name].split()
    angles = np.radians([float(rotor[:-1]) for rotor in rotors])
    places = np.stack((np.cos(angles), -np.sin(angles), np.zeros(len(rotors))), axis=1)
    return places, tuple(1 if rotor.endswith("+") else -1 for rotor in rotors)
