"""Meshes out of draws: retrieve a training part for every part of a draw, bend it to fit, assemble (§5, mesh synthesis)."""
