"""MuJoCo's contact parameters for a given spring and damper.

MuJoCo's normal force of a contact with overlap r and normal speed v (both into the surface) of a body of mass m is, with an
impedance d and its direct stiffness k and damping b,

    f = m / (1 - d) (k r + b v) + m d / (1 - d) a,

with the acceleration a out of the surface, taken negative: the last term acts like added mass and stabilises stiff springs.
With ``k = (1 - d) K`` a robot at rest sinks in by ``g / K`` on one contact for any d, as on a spring of ``K m``. It then moves
as on a spring of k per mass. Spring and damper act at the *start* of a step, so they must be slow enough for it. With the
softness ``s = 1 - d`` and ``b = 2 zeta sqrt(s K)``, many contacts and long levers give at most k / d and b / d, because added
mass grows with them. Therefore

    s = (sqrt(1 + beta²) - beta)²,    beta = max(1, zeta) dt sqrt(K)

keeps ``dt b / d <= 1`` and ``dt² k / d <= 1/4`` for every motion, where semi-implicit Euler is stable up to 2 and 4. Short
steps have s near 1, hence the original spring and damper.
Sources: MuJoCo's documentation, Computation, Constraint model, on reference and impedance (negative ``solref``); the rule for s
is derived: ``1 - s = 2 beta sqrt(s)`` is the first bound as an equality for zeta >= 1.
"""

from math import sqrt

from aerial_gym.config.contact import ContactCfg

LEAST_IMPEDANCE = 1e-4
"""MuJoCo's smallest impedance, and 1 minus its largest."""


def contact_softness(cfg: ContactCfg, dt: float) -> float:
    """Return the softness s in (0, 1) for steps of ``dt`` [s]: the share of the stiffness that moves the body."""
    beta = max(1.0, cfg.damping_ratio) * dt * sqrt(cfg.stiffness)
    soft = (sqrt(1.0 + beta * beta) - beta) ** 2
    return min(max(soft, LEAST_IMPEDANCE), 1.0 - LEAST_IMPEDANCE)


def solver_numbers(cfg: ContactCfg, dt: float) -> tuple[tuple[float, float], tuple[float, float, float, float, float]]:
    """Return ``solref`` and ``solimp`` of a contact with the parameters of ``cfg``, for steps of ``dt`` [s].

    ``solref`` is minus stiffness and damping per mass [1/s², 1/s]; ``solimp`` is a constant impedance.
    """
    soft = contact_softness(cfg, dt)
    stiffness = soft * cfg.stiffness
    impedance = 1.0 - soft
    return (-stiffness, -2.0 * cfg.damping_ratio * sqrt(stiffness)), (impedance, impedance, 1.0, 0.5, 1.0)
