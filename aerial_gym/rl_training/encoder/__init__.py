"""Training of encoders: a fixed set of images of registered environments, an autoencoder, and its rivals.

``scenes`` renders, ``fit`` learns, ``figures`` measures, ``picture`` draws, ``training`` makes a folder of it all.
"""
