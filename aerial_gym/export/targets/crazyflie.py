"""A policy as an out-of-tree controller of the Crazyflie's firmware, in C99.

The folder ``crazyflie`` builds with the firmware's ``oot.mk``: the policy as ``c99`` writes it, with its layers in static
memory, because the stack of the stabilizer task is small; and ``controllerOutOfTree``, which fills the observation and writes
forces. Position, velocity and setpoint are in the world, z up; the gyro is in the body frame, x forward, y left, z up [deg/s].
Source: github.com/bitcraze/crazyflie-firmware, ``oot.md``, ``controller.h``, ``stabilizer_types.h`` and
``power_distribution_quadrotor.c``.
"""

from collections.abc import Iterator

from aerial_gym.config.rotor import POLYNOMIAL_MAP
from aerial_gym.export import c99
from aerial_gym.export.layout import Layout, LayoutRotor
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.targets.requirements import INSTEAD, X_PLACES, observation_faults, rotor_faults, rotor_numbers

NAME = "crazyflie"
MOTORS = tuple(X_PLACES)  # M1 to M4
LOOP_HZ = 1000  # Rate at which the firmware calls its controller [1/s]
CYCLES = 168_000  # Of the processor between two calls; each weight takes one at least

_WORLD = {"position_error_world": "error", "velocity_error_world": "velocity_error", "lin_vel_world": "velocity"}
_BODY = {"position_error_body": "error", "lin_vel_body": "velocity"}

TERMS: dict[str, tuple[str, ...]] = {
    **{term: tuple(f"{name}[{i}]" for i in range(3)) for term, name in _WORLD.items()},
    **{term: tuple(f"along({name}, {i})" for i in range(3)) for term, name in _BODY.items()},
    "ang_vel_body": tuple(f"sensors->gyro.{axis} * radian" for axis in "xyz"),
    "attitude": tuple(f"quaternion[{i}]" for i in range(4)),
    "rotation_rows": tuple(f"rotation[{i}][{j}]" for i in range(2) for j in range(3)),
    "up_body": tuple(f"rotation[2][{j}]" for j in range(3)),
    "distance": ("sqrtf(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])",),
    "zero": ("0.0f",),
    "policy_action": tuple(f"policy.action[{i}]" for i in range(4)),
}
"""Entries of each observation term in C."""


def faults(policy: DeployablePolicy, layout: Layout) -> Iterator[str]:
    """Yield reasons why the Crazyflie cannot fly a policy."""
    yield from observation_faults(layout, TERMS, NAME)
    yield from rotor_faults(layout, ("speed", "thrust"), NAME)
    if any(rotor.mode == "speed" and rotor.rotor_map != POLYNOMIAL_MAP for rotor in layout.rotors):
        yield f"{NAME}: the thrust curve of {layout.robot} has no form in C. Give rotor_map {POLYNOMIAL_MAP}, or {INSTEAD}"
    period = LOOP_HZ / layout.rate_hz
    if abs(period - round(period)) > 1e-6:
        yield f"{NAME}: the policy runs at {layout.rate_hz:g} Hz, no divisor of {LOOP_HZ} Hz. Train at 50, 100, 250 or 500 Hz"
    if (weights := sum(parameter.numel() for parameter in policy.parameters())) > CYCLES:
        yield f"{NAME}: the policy has {weights} weights, and a call {CYCLES} cycles. Train with smaller hidden_layers"


def files(policy: DeployablePolicy, layout: Layout) -> dict[str, str | bytes]:
    """Return the files of the controller, with the policy at the end."""
    n = layout.name
    return {
        "Makefile": _MAKEFILE,
        "oot-config": "CONFIG_CONTROLLER_OOT=y\n",
        "Kbuild": f"obj-y += {n}.o\nobj-y += {n}_controller.o\n",
        f"{n}_controller.c": controller_source(layout),
        f"{n}.h": c99.policy_header(layout),
        f"{n}.c": c99.policy_source(policy, layout, storage="static "),
    }


def controller_source(layout: Layout) -> str:
    """Return the source of the out-of-tree controller."""
    n, upper = layout.name, layout.name.upper()
    entries = [entry for seen in layout.observation for entry in TERMS[seen.term][: seen.count]]
    seen = "\n".join(f"    observation[{i}] = {entry};" for i, entry in enumerate(entries))
    motors = enumerate(rotor_numbers(layout, MOTORS))
    forces = "\n".join(f"    force[{i}] = {_force(layout.rotors[k], layout.command[k], k)};" for i, k in motors)
    text = "\n".join((*_VECTORS, seen))
    along = _ALONG if "along(" in text else ""
    return f"""/* Flies the policy {n} of {layout.robot} to position setpoints; aerial_gym {layout.version}.
 * Motors stop without a position setpoint in x, y and z, and after a number that is not finite.
 * Setpoints in position and level heading are those of the training: the policy follows no yaw setpoint.
 */
#include "{n}.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "controller.h"

#define PERIOD {round(LOOP_HZ / layout.rate_hz)} /* calls per step of the policy: {LOOP_HZ} Hz / {layout.rate_hz:g} Hz */

static {n}_state policy;
static float force[4]; /* of motors 1 to 4, as shares of the largest one */
{along}
static void stop(void) {{
    {n}_reset(&policy);
    for (int i = 0; i < 4; ++i) force[i] = 0.0f;
}}

static void fly(const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state) {{
    static float observation[{upper}_NUM_OBSERVATIONS], command[{upper}_NUM_COMMANDS];
{text}
    if ({n}_step(&policy, observation, command)) {{
        stop();
        return;
    }}
{forces}
}}

void controllerOutOfTreeInit(void) {{ stop(); }}

bool controllerOutOfTreeTest(void) {{ return true; }}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state,
                         const uint32_t step) {{
    if (setpoint->mode.x != modeAbs || setpoint->mode.y != modeAbs || setpoint->mode.z != modeAbs) {{
        stop();
    }} else if (step % PERIOD == 0) {{
        fly(setpoint, sensors, state);
    }}
    control->controlMode = controlModeForce;
    for (int i = 0; i < 4; ++i) control->normalizedForces[i] = force[i];
}}
"""


def _force(rotor: LayoutRotor, command: str, number: int) -> str:
    """Return the share of the largest thrust that a command is, in C."""
    share, value = f"{1.0 / rotor.thrust_range[1]:.9e}f", f"command[{number}]"
    if command.startswith("thrust") or rotor.mode == "force":
        return f"{value} * {share}"
    c0, c1, c2 = (f"{each:.9e}f" for each in rotor.thrust_map)
    return f"({c0} + {value} * ({c1} + {value} * {c2})) * {share}"


_ALONG = """
/* Entry of a vector of the world in the body frame. */
#define along(vector, i) (rotation[0][i] * vector[0] + rotation[1][i] * vector[1] + rotation[2][i] * vector[2])
"""

_VECTORS = (
    "    const float radian = 0.0174532925f;",
    "    const quaternion_t *q = &state->attitudeQuaternion;",
    "    const float sign = q->w < 0.0f ? -1.0f : 1.0f; /* q and -q are one attitude */",
    "    const float x = sign * q->x, y = sign * q->y, z = sign * q->z, w = sign * q->w;",
    "    const float quaternion[4] = { x, y, z, w };",
    "    const float rotation[3][3] = { /* body to world */",
    "        { 1.0f - 2.0f * (y * y + z * z), 2.0f * (x * y - w * z), 2.0f * (x * z + w * y) },",
    "        { 2.0f * (x * y + w * z), 1.0f - 2.0f * (x * x + z * z), 2.0f * (y * z - w * x) },",
    "        { 2.0f * (x * z - w * y), 2.0f * (y * z + w * x), 1.0f - 2.0f * (x * x + y * y) },",
    "    };",
    "    const float velocity[3] = { state->velocity.x, state->velocity.y, state->velocity.z };",
    "    const float error[3] = { setpoint->position.x - state->position.x, setpoint->position.y - state->position.y,",
    "                             setpoint->position.z - state->position.z };",
    "    const float velocity_error[3] = { setpoint->velocity.x - velocity[0], setpoint->velocity.y - velocity[1],",
    "                                      setpoint->velocity.z - velocity[2] };",
    "    (void)radian; (void)quaternion; (void)rotation; (void)error; (void)velocity_error; (void)sensors;",
)
"""Measurements from which the entries are made."""

_MAKEFILE = """# make CRAZYFLIE_BASE=PATH: PATH is a checkout of github.com/bitcraze/crazyflie-firmware
CRAZYFLIE_BASE ?= ../crazyflie-firmware
include $(CRAZYFLIE_BASE)/tools/make/oot.mk
"""
