"""What a training leaves and how it is continued: run folder, checkpoints, progress, interruption."""
