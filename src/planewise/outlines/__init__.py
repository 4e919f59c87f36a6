"""Outlines of planes: polygons, areas, meshes."""
