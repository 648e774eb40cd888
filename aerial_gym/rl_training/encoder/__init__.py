"""Training of encoders: a fixed image set of registered environments, an autoencoder, and baselines.

``scenes`` renders, ``fit`` learns, ``figures`` measures, ``picture`` draws, ``training`` makes a folder of it all.
"""
