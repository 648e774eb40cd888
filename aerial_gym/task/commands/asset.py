"""A target on an asset of the environment, which may move. Frames: world of each environment, z up. Letters: E environments."""

from collections.abc import Mapping

from torch import Tensor

from aerial_gym.config.checks import Vec3
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.task.commands.command import COMMANDS, TARGET, Command
from aerial_gym.task.values import Values

STATES = "vec_root_tensor"
"""Key of the GTD: states of the robot and, behind it, of the assets."""


@COMMANDS.generator("asset")
class OnAsset(Command):
    """A point at an asset's origin, or beside it, and the asset's velocity as ``target_velocity``."""

    def __init__(self, values: Values, env: EnvManager, *, name: str, offset: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """Take the asset.

        Args:
            name: Of an asset of the environment that is always there; of several instances the first one.
            offset: From the asset's origin to the target [m], world: it does not turn with the asset.
        """
        super().__init__(values, env)
        kept = [asset.name for asset in env.cfg.assets if asset.keep]
        if name not in kept:
            raise ConfigError(f"command asset: name = {name!r}: must be an asset with keep: true, of {kept}")
        counts = {asset.name: asset.count for asset in env.cfg.assets}
        self._row = 1 + sum(list(counts.values())[: list(counts).index(name)])
        self._offset = offset
        self._target(moving=True)
        self.reads = (STATES,)

    def at(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return place and velocity of the target at this instant."""
        state = values[STATES][:, self._row]
        return {TARGET: state[:, :3] + state.new_tensor(self._offset), "target_velocity": state[:, 7:10]}

    def after(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the same: where an episode has just begun, the asset stands elsewhere."""
        return self.at(values)
