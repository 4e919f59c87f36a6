"""The spatial objective of images: frame, cells, segments, labels, Phi."""
