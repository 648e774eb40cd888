"""Compression of range images by a variational autoencoder: network, file, and the collision distance image."""
