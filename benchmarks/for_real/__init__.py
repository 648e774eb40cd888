"""Policies trained with and without ``train --for-real``, flown on a hidden vehicle by Betaflight in the loop."""
