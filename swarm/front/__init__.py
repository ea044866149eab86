"""The front door: the objects and functions that ``import swarm`` offers by name.

Each is a thin shell around the layers below. ``swarm/__init__.py`` loads a module of this package
when one of its names is first used.
"""
