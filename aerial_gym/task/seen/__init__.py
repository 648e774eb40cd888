"""What a task makes of its robot's images: raw ones, the nearest distance in cells, latents of an encoder."""
