"""MuJoCo on the CPU: models, and a threaded rollout of one step of all environments."""
