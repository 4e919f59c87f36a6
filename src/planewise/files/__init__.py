"""Files read and written, a format each."""
