"""Nodes that are started elsewhere: ``remote`` from a bundle, ``seat`` from an invitation, and an ``observer``."""
