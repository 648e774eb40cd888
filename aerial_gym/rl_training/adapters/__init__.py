"""Tasks as other libraries for reinforcement learning see environments: one module for each, which needs its package."""
