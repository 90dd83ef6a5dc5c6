"""shapeforge: understand a family of 3D shapes."""
