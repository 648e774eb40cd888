"""Image observations of a task: raw images, nearest distances in cells, latents of an encoder."""
