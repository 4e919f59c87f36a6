"""Planes in clouds of free points: cubes, cells, segments, labels, Phi."""
