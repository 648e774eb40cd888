"""Identification of joints from a stand record of an arm, and from flights with or without logged angles."""
