"""Joints: the record of an arm on a stand, and flights with or without logged angles."""
