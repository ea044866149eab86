"""The public API: the types and functions of ``import swarm``.

Each is a thin shell around the layers below. ``swarm/__init__.py`` imports a module of this package
at the first use of one of its names.
"""
