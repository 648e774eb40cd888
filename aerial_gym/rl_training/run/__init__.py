"""Run folder, checkpoints, progress and interruption of a training."""
