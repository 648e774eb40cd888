"""Dead time between commands and rotors, caused by radio, bus and electronic speed controllers.

The rotors follow ``w_c(t - delay)``, with a constant command over each substep. If the delay is no multiple of the substep,
the delayed command changes within a substep, and the lag follows one command, then the other. Speeds (in force mode thrusts)
of either sign are exact at the stages and ends of substeps for every delay and division into substeps. The rotors keep their
states until the first command after a reset arrives.
Source: Derived: transport delay of a piecewise constant signal; in multirotors e.g. Foerster (2015), System identification of
the Crazyflie 2.0, section 3.2.
"""

from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR
from aerial_gym.physics.effects.kinds.command import DelayEffect
from aerial_gym.physics.effects.parameter import Parameter

LONGEST = 0.1
"""Largest delay [s]; the backend stores the commands of this span (51 at substeps of 2 ms)."""


class ActuationDelay(DelayEffect):
    """A dead time between commands and rotors."""

    name = "actuation_delay"
    summary = "dead time between the commands and the rotors"
    parameters = (Parameter("delay", "s", 0.0, LONGEST, 0.01, "dead time"),)
    excitation = "quick changes of the rotor commands, best with measured rotor speeds"
    confused_with = ("motor_time_constant", "motor_asymmetry")
    rotors = ANY_ROTOR
    longest = LONGEST

    def delay(self, params: Tensor) -> Tensor:
        """Return the delay [s], (E,)."""
        return params[:, 0]
