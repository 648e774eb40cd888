"""MuJoCo Warp: one model with parameters per environment, stepped by Warp kernels in float32."""
