"""Sims: ``class sim`` with time step and gravity; settings of PhysX and the viewer are ignored."""

from aerial_gym.compat.config.fields import Changes, ConfigTable, Values, idle_field, native_field, unchangeable_field
from aerial_gym.config.sim import SimCfg
from aerial_gym.env_manager import SIMS
from aerial_gym.errors import ConfigError


def _gravity_changes(values: Values) -> Changes:
    x, y, z = values["sim.gravity"]
    if x or y or z > 0.0:
        raise ConfigError(
            f"sim.gravity = {[x, y, z]!r}: must point down, [0, 0, -g] with g >= 0. Turn the environment instead, or add a "
            "constant force as an effect of the robot"
        )
    return {"gravity": abs(float(z))}


TABLE = ConfigTable(
    kind="sim",
    fields=(
        native_field("sim.dt", "dt", lambda cfg: cfg.dt),
        native_field(
            "sim.gravity", "gravity", lambda cfg: [0.0, 0.0, -cfg.gravity], _gravity_changes,
            "here the amount, downwards",
        ),
        unchangeable_field(
            "sim.substeps", 1, "must be 1; take a smaller dt and more physics steps of an env step"
        ),
        idle_field("sim.up_axis", 1, "z is up"),
        idle_field("sim.use_gpu_pipeline", True, "the device says where everything runs"),
    ),
    idle_sections={
        "sim.physx": "there is no PhysX: contacts are `contact:` of an environment file",
        "viewer": "there is no viewer window",
    },
)  # fmt: skip
"""Translation of the attributes of a sim class."""


def translate_sim(cls: object) -> SimCfg:
    """Return the translated sim of a sim class."""
    return TABLE.translate(cls, SIMS.get("base_sim"))


BaseSimConfig = TABLE.make_class("BaseSimConfig", SIMS.get("base_sim"))
BaseSimHeadlessConfig = TABLE.make_class("BaseSimHeadlessConfig", SIMS.get("base_sim_headless"), parent=BaseSimConfig)
BaseSimNoGravityConfig = type(
    "BaseSimNoGravityConfig",
    (BaseSimConfig,),
    {"sim": type("sim", (BaseSimConfig.sim,), {"gravity": [0.0, 0.0, 0.0]})},  # pyright: ignore
)
SimCfg2Ms = TABLE.make_class("SimCfg2Ms", SIMS.get("base_sim_2ms"), parent=BaseSimConfig)
SimCfg4Ms = TABLE.make_class("SimCfg4Ms", SIMS.get("base_sim_4ms"), parent=BaseSimConfig)

CLASSES: dict[str, type] = {
    "base_sim": BaseSimConfig, "base_sim_headless": BaseSimHeadlessConfig, "base_sim_2ms": SimCfg2Ms,
    "base_sim_4ms": SimCfg4Ms,
}  # fmt: skip
"""Classes by the names under which that simulator registers them."""
