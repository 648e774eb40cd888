"""Initial weights from another training, whose network may have fewer inputs.

Letters: O entries of an observation, H width of the first layer.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.policies.actor_critic import ActorCritic

FIRST_LAYER = ".layers.0.weight"  # End of the name of a first layer (H, O)
NORMALISED = (".mean", ".var")  # Suffixes of the names of normaliser statistics, (O,)


def load_initial_weights(network: ActorCritic, model: Mapping[str, Tensor], *, where: str) -> None:
    """Load the weights ``model`` of another network, which may have fewer inputs; ``where`` is named in errors.

    Additional inputs must follow those of the other network. Their weights are zero, so that at first it acts like the
    other one. Their normaliser starts at mean 0 and deviation 1 and adapts slowly, as its sample count is large.
    """
    own = network.state_dict()
    if own.keys() != model.keys():
        raise ConfigError(
            f"{where}: has other networks than these settings ask for. Give the settings of its training (--config)"
        )
    wider = [name for name in own if own[name].shape != model[name].shape]
    if wider and len(network.shapes) > 1:
        raise ConfigError(
            f"{where}: networks that see {', '.join(network.shapes)} cannot see more than those before them. Train from scratch"
        )
    network.load_state_dict({name: _add_inputs(name, model[name], own[name], where) for name in own})


def _add_inputs(name: str, given: Tensor, own: Tensor, where: str) -> Tensor:
    """Return numbers in the shape of ``own``."""
    if given.shape == own.shape:
        return given
    more = own.shape[-1] - given.shape[-1]
    grows = name.endswith((FIRST_LAYER, *NORMALISED)) and given.shape[:-1] == own.shape[:-1] and more > 0
    if not grows:
        raise ConfigError(
            f"{where}: {name} has shape {tuple(given.shape)}, here {tuple(own.shape)}. Only inputs may be added: give "
            "the settings of its training (--config), and a task with its actions whose observations begin with its own"
        )
    new = given.new_full((*given.shape[:-1], more), 1.0 if name.endswith(".var") else 0.0)
    return torch.cat((given, new), dim=-1)
