"""Encoder of a set of entities, such as neighbours, by attention.

The features do not depend on the order of the entities, and their number may vary: a mask says which are there.
Letters: K entities, F numbers of each, D features, H heads.

Source:
    Lee et al. (2019), Set transformer: a framework for attention-based permutation-invariant neural
    networks, arXiv 1810.00825; pooling by attention with one seed for each head.
"""

import torch
from torch import Tensor, nn

from aerial_gym.sensors.encoder.file import ACTIVATIONS

SET_FEATURES, HEADS = 64, 4  # D and H
ABSENT = -1e9  # Score of an entity that is not there: its weight is 0 beside any other


class SetEncoder(nn.Module):
    """Features (..., D) of entities (..., K F), whose last number is above 0 where the entity is there; zeros without any."""

    def __init__(self, width: int, activation: str) -> None:
        """Take the numbers F of an entity, the last one included."""
        super().__init__()
        self.width = width
        self.embed = nn.Sequential(
            nn.Linear(width - 1, SET_FEATURES),
            ACTIVATIONS[activation](),
            nn.Linear(SET_FEATURES, SET_FEATURES),
            ACTIVATIONS[activation](),
        )
        self.score = nn.Linear(SET_FEATURES, HEADS)

    def forward(self, entities: Tensor) -> Tensor:
        """Return the weighted mean of the entities' features, with weights by head."""
        rows = entities.unflatten(-1, (-1, self.width))
        there = rows[..., -1:] > 0.0
        features = self.embed(torch.where(there, rows[..., :-1], 0.0))
        weights = torch.where(there, self.score(features), ABSENT).softmax(dim=-2) * there  # (..., K, H)
        pooled = (weights.unsqueeze(-1) * features.unflatten(-1, (HEADS, -1))).sum(dim=-3)
        return pooled.flatten(-2)
