"""The noise of a sensor, estimated from its images."""
