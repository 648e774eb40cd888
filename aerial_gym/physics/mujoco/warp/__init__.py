"""MuJoCo Warp: one model with numbers of their own for all environments, stepped by Warp kernels in float32."""
