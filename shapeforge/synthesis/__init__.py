"""Meshes out of draws: retrieve a training part for each part of a draw, bend it, assemble (§5, mesh synthesis)."""
