"""Range images as a few numbers: a variational autoencoder, its file, and the image of what a robot would run into."""
