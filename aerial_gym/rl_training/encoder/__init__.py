"""Training of encoders: a fixed image set of registered environments, an autoencoder, and baselines.

``scenes`` renders, ``figures`` measures and draws, ``training`` learns and makes a folder of it all.
"""
