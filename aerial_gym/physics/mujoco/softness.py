"""The compliance of MuJoCo's contacts that belongs to a spring and a damper.

MuJoCo's normal force of a contact with overlap r and normal speed v (both into the surface) of a body of mass m is, with an
impedance d and the numbers k, b that it calls direct,

    f = m / (1 - d) (k r + b v) + m d / (1 - d) a,

a being the acceleration out of the surface, taken with a minus sign: the last term acts like added mass and makes hard springs
stable. With ``k = (1 - d) K`` a robot at rest sinks in as deep as on a spring of ``K m``: to ``g / K`` on one contact, for any
d. Then it moves as on a spring of k per mass. Spring and damper act at the *start* of a step, so that they must be slow enough
for it. With the softening ``s = 1 - d`` and ``b = 2 zeta sqrt(s K)``, a motion that many contacts and long levers make ever
harder turns into one of at most k / d and b / d, because added mass grows with them. Therefore

    s = (sqrt(1 + beta²) - beta)²,    beta = max(1, zeta) dt sqrt(K)

keeps ``dt b / d <= 1`` and ``dt² k / d <= 1/4`` for every motion, where semi-implicit Euler is stable up to 2 and 4. Short
steps have s near 1, the very spring and damper.
Sources: MuJoCo's documentation, Computation, Constraint model, on reference and impedance (negative ``solref``); the rule for s
is derived: ``1 - s = 2 beta sqrt(s)`` is the first bound as an equality for zeta >= 1.
"""

from math import sqrt

from aerial_gym.config.contact import ContactCfg

LEAST_IMPEDANCE = 1e-4
"""MuJoCo's smallest and, taken from 1, its largest impedance."""


def softening(cfg: ContactCfg, dt: float) -> float:
    """Return s in (0, 1): which part of the stiffness moves the body in steps of ``dt`` [s]."""
    beta = max(1.0, cfg.damping_ratio) * dt * sqrt(cfg.stiffness)
    soft = (sqrt(1.0 + beta * beta) - beta) ** 2
    return min(max(soft, LEAST_IMPEDANCE), 1.0 - LEAST_IMPEDANCE)


def solver_numbers(cfg: ContactCfg, dt: float) -> tuple[tuple[float, float], tuple[float, float, float, float, float]]:
    """Return ``solref`` and ``solimp`` of a contact that gives way as ``cfg`` says, for steps of ``dt`` [s].

    ``solref`` is minus stiffness and damping per mass [1/s², 1/s]; ``solimp`` is an impedance that is the same at every depth.
    """
    soft = softening(cfg, dt)
    stiffness = soft * cfg.stiffness
    impedance = 1.0 - soft
    return (-stiffness, -2.0 * cfg.damping_ratio * sqrt(stiffness)), (impedance, impedance, 1.0, 0.5, 1.0)
