"""Depth images that were enlarged, as to the size of a picture, and what they were before."""
